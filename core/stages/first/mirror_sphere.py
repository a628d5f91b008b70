# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror spheres: the surface of a ball of metal, of which stereo sees virtual images inside the ball.

A convex mirror shows its surroundings at half its radius where it is looked at head-on, and at its surface towards its outline. The hull
that is carved around a region of virtual images is one of the ball; a sphere is fitted to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ...scene.dataset import View
from ...scene.gaussians import Gaussians, quaternion_to
from .carved_hull import carve_hull
from .depth_anchors import DepthAnchors

DIRECTIONS, STEPS = 4000, 200  # rays from the centre to the end of the hull, and steps along each
REACH = 0.01, 0.5  # first and last step, radii of the bound; the centre is at most as far from the region's
FITS, ROUNDS = 4, 50  # of the centre, each with the hull seen from the one before; rounds of a robust fit
TOLERANCE = 0.08  # radii of the sphere at which a ray's end counts half
# Fraction of the rays' ends that count more than half: .78 for a ball. It spares trials of most other shapes, which have .2 to .4; trial
# fits reject those that pass, nine on five objects.
MIN_INLIERS = 0.6
MIN_ENDS = 200  # rays that end within their reach
SIZES = 0.02, 0.5  # least and largest radius, radii of the bound
WITHIN = 1.05  # radii of the sphere around which surfels belong to it
MIN_SURFELS = 50  # that belong to it


@dataclass(frozen=True, eq=False)
class MirrorSphere:
    """Sphere that a region of virtual images lies in.

    Attributes:
        centre: (3,) world.
        radius: world units.
    """

    centre: np.ndarray
    radius: float

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Return which points (N, 3) belong to it, (N,) bool."""
        return np.linalg.norm(points - self.centre, axis=1) < WITHIN * self.radius


def mirror_sphere(views: Sequence[View], anchors: DepthAnchors, points: np.ndarray, radius: float) -> MirrorSphere | None:
    """Fit a sphere to the hull of a region of virtual images; None where it is no ball.

    Args:
        views: training views.
        anchors: stereo's depths in them.
        points: (M, 3) of the region, world.
        radius: of the bound, world units.
    """
    hull = carve_hull(views, anchors, points, radius)
    index = np.arange(DIRECTIONS) + 0.5  # a spiral of even density
    height, turn = 1 - 2 * index / DIRECTIONS, np.pi * (1 + 5**0.5) * index
    across = np.sqrt(1 - height**2)
    direction = np.stack([np.cos(turn) * across, np.sin(turn) * across, height], 1)
    distance = np.linspace(REACH[0] * radius, REACH[1] * radius, STEPS)
    centre, size, inliers = np.median(points, 0), 0.0, 0.0
    for _ in range(FITS):
        emptiness = hull.at(hull.emptiness, centre + direction[:, None] * distance[:, None])
        ended = (emptiness > 0.5).any(1)
        if ended.sum() < MIN_ENDS:
            return None
        ends = centre + direction[ended] * distance[(emptiness[ended] > 0.5).argmax(1), None]
        centre, size, inliers = _fitted(ends, centre)
        if not np.isfinite(size) or np.linalg.norm(centre - points.mean(0)) > REACH[1] * radius:
            return None
    fits = inliers >= MIN_INLIERS and SIZES[0] * radius <= size <= SIZES[1] * radius
    return MirrorSphere(centre, size) if fits else None


def _fitted(points: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Fit a sphere to points (M, 3) by Gauss-Newton steps with Cauchy's weights; return centre, radius, and the fraction of inliers."""
    radius, weight = float(np.median(np.linalg.norm(points - centre, axis=1))), np.ones(len(points))
    for _ in range(ROUNDS):
        if not radius > 0:
            return centre, float("nan"), 0.0
        offset = points - centre
        distance = np.linalg.norm(offset, axis=1)
        error = distance - radius
        weight = 1 / (1 + (error / (TOLERANCE * radius)) ** 2)
        jacobian = np.column_stack([-offset / np.maximum(distance, 1e-12)[:, None], -np.ones(len(points))])
        weighted = jacobian * weight[:, None]
        step = np.linalg.lstsq(weighted.T @ jacobian, -weighted.T @ error, rcond=None)[0]
        centre, radius = centre + step[:3], radius + float(step[3])
    return centre, radius, float((weight > 0.5).mean())


def moved_onto(gaussians: Gaussians, spheres: Sequence[MirrorSphere]) -> Gaussians:
    """Return Gaussians of which those that belong to a sphere lie on it, and face outwards.

    Args:
        gaussians: N surfels.
        spheres: the spheres; where two hold a surfel, the last one counts.
    """
    position, quaternion = gaussians.position.clone(), gaussians.quaternion.clone()
    points = gaussians.position.T.double().cpu().numpy()
    for sphere in spheres:
        held = torch.from_numpy(sphere.holds(points)).to(position.device)
        centre = position.new_tensor(sphere.centre)[:, None]
        normal = torch.nn.functional.normalize(gaussians.position[:, held] - centre, dim=0)
        position[:, held] = centre + sphere.radius * normal
        quaternion[:, held] = quaternion_to(normal)
    return replace(gaussians, position=position, quaternion=quaternion)

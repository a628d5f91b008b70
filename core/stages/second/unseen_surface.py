# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfels on the parts of the surface that no photograph shows, such as the floor of a mug.

The mesh is closed there, but the first stage has no surfels: light would leak out of a hollow, and new views would show a hole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ...io.grown_mask import grown_mask
from ...scene.gaussians import Gaussians, surfels
from ...scene.gbuffer import GBuffer
from ...scene.reconstruction import Reconstruction
from ...scene.spherical_harmonics import SH_C0
from ...scene.surface import Surface
from ..common.nearest_neighbours import nearest_neighbours

SPACING = 2.0  # of the new surfels and their standard deviation, voxels: what no view shows needs no detail
POINTS = 2.0  # surface points looked at, on an area of SPACING x SPACING
MIN_GAP = 3.0  # distance to the nearest surfel from which a point is in a gap, voxels
CLEARANCE = 2.0  # depth behind the surfels from which they hide a point, voxels
MIN_HIDING_OPACITY = 0.5  # opacity of the surfels in a pixel that hides what lies behind
MARGIN = 4.0  # pixels that a point keeps from the surfels' outline, so that new surfels do not stick out
OPACITY = 0.95  # of the new surfels
NEIGHBOURS = 16  # nearest surfels whose means give their radiance and materials


def with_unseen_surface(reconstruction: Reconstruction, surface: Surface, views: Sequence[GBuffer], seed: int) -> Reconstruction:
    """Add surfels where the surface has none and no view can tell that there is nothing.

    Their radiance, the same in all directions, and their materials are the means of the nearest surfels.

    Args:
        reconstruction: result of the first stage.
        surface: closed mesh that was fused from its depth.
        views: its G-buffers at the training cameras; looked up only while there are points in gaps.
        seed: seed of the points.

    Returns:
        The reconstruction with the new surfels last; itself where there are none.
    """
    count = int(POINTS * surface.areas().sum() / (SPACING * surface.voxel) ** 2)
    position, normal = surface.samples(count, np.random.default_rng(seed))
    gaussians = reconstruction.gaussians.to("cpu")
    near = nearest_neighbours(gaussians.position.T, torch.from_numpy(position), 1)[:, 0]
    distance = np.linalg.norm(gaussians.position.T[near].detach().numpy() - position, axis=1)
    gap = distance > MIN_GAP * surface.voxel
    position, normal = position[gap], normal[gap]
    for index in range(len(views)):
        if not len(position):
            break
        kept = hidden(position, views[index], CLEARANCE * surface.voxel)
        position, normal = position[kept], normal[kept]
    if not len(position):
        return reconstruction
    new = _alike(gaussians, position, normal, SPACING * surface.voxel).to(reconstruction.gaussians.position.device)
    return replace(reconstruction, gaussians=reconstruction.gaussians.joined(new))


def hidden(points: np.ndarray, view: GBuffer, clearance: float) -> np.ndarray:
    """Return True for points (P, 3) that surfels hide from a view, away from their outline, or that lie outside its image.

    Args:
        points: world.
        view: depth and opacity of the surfels.
        clearance: depth behind the surfels from which a point counts as hidden, world units.
    """
    pixel, depth = view.camera.project(points)
    inside = view.camera.in_image(pixel, depth)
    column, row = pixel[inside].astype(int).T
    result = np.ones(len(points), bool)
    opaque = grown_mask((view.alpha >= MIN_HIDING_OPACITY).astype(np.uint8), -MARGIN) > 0
    result[inside] = opaque[row, column] & (depth[inside] > view.depth[row, column] + clearance)
    return result


def _alike(gaussians: Gaussians, position: np.ndarray, normal: np.ndarray, scale: float) -> Gaussians:
    """Return surfels at positions (M, 3) that look like the nearest ones."""
    around = nearest_neighbours(gaussians.position.T, torch.from_numpy(position), NEIGHBOURS)
    radiance = 0.5 + SH_C0 * gaussians.sh[0][:, around].mean(-1)
    new = surfels(position, normal, radiance.T.clamp_min(0).numpy(), np.full(len(position), scale), OPACITY)
    return replace(new, material=gaussians.material[:, around].mean(-1))

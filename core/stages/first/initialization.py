# SPDX-License-Identifier: GPL-3.0-or-later
"""Initial Gaussians: on the visual hull of the masks, or else on sparse points and at random positions in and around the bound."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import KDTree

from ...datasets.visual_hull import visual_hull
from ...io.srgb import decode_srgb
from ...scene.dataset import Dataset, View
from ...scene.gaussians import Gaussians, surfels

OPACITY = 0.7  # of surfels on a surface
FAINT_OPACITY = 0.1  # of surfels on sparse points and at random places, where there may be no surface
MAX_SURROUNDINGS_RADII = 5.0  # largest distance of random points from the bound's centre, in radii of the bound; behind far cameras more
MIN_CAMERA_DISTANCES = 1.2  # least distance of those on the cameras' side, in median distances of the cameras
CAMERA_SIDE_COSINE = math.cos(math.radians(45))  # angle to a camera at the bound's centre up to which a point is on the cameras' side
SURFACE_SPREAD = 0.92  # scale of a surfel over the spacing of points that cover a surface evenly
SPARSE_SPREAD = 0.65  # scale of a surfel over the distance to its neighbours among points in space
NEIGHBOURS = 16  # of a point that tell its surface's spacing
MIN_FACING_COSINE = 0.2  # cosine between normal and view from which a view's colour counts


def observed_colour(views: list[View], points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Average the images' colours at surface points, weighted by the cosine between normal and view; occlusion is neglected.

    Args:
        views: images, which are averaged as they are encoded.
        points: (N, 3) world.
        normals: (N, 3) unit.

    Returns:
        (N, 3) float32 linear colour; grey where no view faces the point.
    """
    total, weight = np.zeros((len(points), 3)), np.full((len(points), 1), 1e-9)
    for view in views:
        pixel, depth = view.camera.project(points)
        to_camera = view.camera.centre - points
        cosine = (to_camera * normals).sum(1) / np.linalg.norm(to_camera, axis=1)
        visible = view.camera.in_image(pixel, depth) & (cosine > MIN_FACING_COSINE)
        column, row = pixel[visible].astype(int).T
        total[visible] += cosine[visible, None] * view.colour[row, column]
        weight[visible] += cosine[visible, None]
    return decode_srgb(np.where(weight > 1e-6, total / weight, 0.5)).astype(np.float32)


def from_hull(dataset: Dataset, count: int, rng: np.random.Generator) -> Gaussians:
    """Place surfels on the visual hull of the training masks, in spatial order.

    Args:
        dataset: views that all have masks.
        count: number of surfels.
        rng: random generator of their positions.
    """
    points, normals, area = visual_hull(dataset.train, dataset.bound).sample(count, rng)
    order, scale = spatial_order(points), np.full(count, SURFACE_SPREAD * np.sqrt(area / count))
    points, normals = points[order], normals[order]
    return surfels(points, normals, observed_colour(dataset.train, points, normals), scale, OPACITY)


def from_points(dataset: Dataset, count: int, rng: np.random.Generator) -> Gaussians:
    """Place surfels on the sparse points, and at random in and around the bound up to half of `count`; density control adds the rest.

    Normals point to the nearest camera.

    Args:
        dataset: views and sparse points.
        count: most surfels.
        rng: random generator of the selection of sparse points and of random positions.
    """
    known = dataset.points.position if dataset.points is not None else np.zeros((0, 3), np.float32)
    colours = decode_srgb(dataset.points.colour) if dataset.points is not None else np.zeros((0, 3), np.float32)
    if len(known) > count:
        chosen = rng.choice(len(known), count, replace=False)
        known, colours = known[chosen], colours[chosen]
    filler, facing = random_points(dataset, max(count // 2 - len(known), 0), rng)
    points, normals = np.concatenate([known, filler]), np.concatenate([towards_cameras(dataset, known), facing])
    colour = np.concatenate([colours, observed_colour(dataset.train, filler, facing)])
    return surfels(points, normals, colour, SPARSE_SPREAD * neighbour_distance(points, dataset.bound.radius), FAINT_OPACITY)


def neighbour_distance(points: np.ndarray, radius: float) -> np.ndarray:
    """Return the (N,) root mean square distance of points (N, 3) to their three nearest neighbours, limited in units of the radius."""
    distance, _ = KDTree(points).query(points, k=4)
    return np.clip(np.sqrt((distance[:, 1:] ** 2).mean(1)), 1e-4 * radius, 0.2 * radius)


def surface_spacing(points: np.ndarray, radius: float) -> np.ndarray:
    """Return the (N,) root of the area per point of points (N, 3) on surfaces, limited in units of the radius.

    A disk around each point holds NEIGHBOURS others. The distance to the very nearest ones would vary with the randomness of the points.
    """
    count = min(NEIGHBOURS, len(points) - 1)
    distance = KDTree(points).query(points, k=count + 1, workers=-1)[0].reshape(len(points), -1)[:, -1]
    return np.clip(distance * np.sqrt(np.pi / max(count, 1)), 1e-4 * radius, 0.2 * radius)


def random_points(dataset: Dataset, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw points in and around the bound, without those close to a camera or beside the cameras: surfels there would hide everything.

    Args:
        dataset: views and bound.
        count: most points.
        rng: random generator of the points.

    Returns:
        Points (N, 3), N <= count, and unit normals (N, 3) towards the nearest camera.
    """
    centre, radius = np.asarray(dataset.bound.centre), dataset.bound.radius
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    cameras = np.stack([v.camera.centre for v in dataset.train])
    distance = np.linalg.norm(cameras - centre, axis=1)
    # Every other point lies around the object, log-uniform in distance, to represent the background. On the cameras' side of the object it
    # lies behind them: before a new camera among them it would cover the image.
    facing = (direction @ ((cameras - centre) / distance[:, None]).T).max(1) > CAMERA_SIDE_COSINE
    nearest = np.where(facing, max(1.0, MIN_CAMERA_DISTANCES * float(np.median(distance)) / radius), 1.0)
    farthest = np.maximum(MAX_SURROUNDINGS_RADII, 2 * nearest)
    inner = rng.random(count) ** (1 / 3)
    outer = nearest * (farthest / nearest) ** rng.random(count)
    points = centre + direction * radius * np.where(np.arange(count) % 2 == 0, inner, outer)[:, None]
    points = points[KDTree(cameras).query(points)[0] > 0.5 * distance.min()]
    return points, towards_cameras(dataset, points)


def towards_cameras(dataset: Dataset, points: np.ndarray) -> np.ndarray:
    """Return unit vectors (N, 3) from points (N, 3) to the nearest camera of each."""
    cameras = np.stack([v.camera.centre for v in dataset.train])
    offset = cameras[KDTree(cameras).query(points)[1]] - points
    return offset / np.linalg.norm(offset, axis=1, keepdims=True)


def spatial_order(points: np.ndarray) -> np.ndarray:
    """Return the (N,) order of points (N, 3) along a Morton curve, so that neighbours in space are neighbours in memory."""
    low, extent = points.min(0), np.ptp(points, 0).max()
    grid = ((points - low) / max(extent, 1e-30) * 1023).astype(np.uint32)
    code = np.zeros(len(points), np.uint32)
    for bit in range(10):
        for axis in range(3):
            code |= ((grid[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def initial_gaussians(dataset: Dataset, count: int, rng: np.random.Generator) -> Gaussians:
    """Make the initial Gaussians of the first stage: on the visual hull where every view has a mask, else on points and at random.

    Args:
        dataset: views, bound and sparse points.
        count: most surfels; exactly as many on a hull.
        rng: random generator of positions.
    """
    return from_hull(dataset, count, rng) if dataset.has_alpha else from_points(dataset, count, rng)

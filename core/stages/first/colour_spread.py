# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour spread: by how much the photographs that see a point differ in its colour. Metal shows each view something else."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ...scene.dataset import View
from .depth_anchors import DepthAnchors

HIDDEN = 0.02  # radii of the bound by which a point may lie behind stereo's depth and still be seen
MIN_COSINE = 0.3  # between a point's normal and the direction to a view that sees it
OPAQUE = 0.99  # alpha from which a pixel shows the object alone
MIN_VIEWS = 6  # that see a point whose spread is known


def colour_spread(views: Sequence[View], anchors: DepthAnchors, points: np.ndarray, normals: np.ndarray, radius: float) -> np.ndarray:
    """Return how much the encoded colours of points differ among the views that see them.

    It is the standard deviation (N,), mean of the channels; NaN for points that fewer than MIN_VIEWS see.

    Args:
        views: training views with masks.
        anchors: stereo's depths in them.
        points: (N, 3) world.
        normals: (N, 3) unit, outwards.
        radius: of the bound, world units.
    """
    count, total, squares = np.zeros(len(points)), np.zeros((len(points), 3)), np.zeros((len(points), 3))
    for number, view in enumerate(views):
        seen, row, column = _seen(view, *anchors.of_view(number), points, normals, HIDDEN * radius)
        colour = view.colour[row, column].astype(np.float64)
        count[seen] += 1
        total[seen] += colour
        squares[seen] += colour**2
    known = np.where(count < MIN_VIEWS, np.nan, count)[:, None]
    return np.sqrt(np.maximum(squares / known - (total / known) ** 2, 0)).mean(1)


def _seen(
    view: View, pixel: torch.Tensor, depth: torch.Tensor, points: np.ndarray, normals: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the indices (K,) of the points that a view sees, and their rows and columns."""
    camera = view.camera
    known = np.zeros(camera.width * camera.height)
    known[pixel.numpy()] = depth.numpy()
    known = known.reshape(camera.height, camera.width)
    place, distance = camera.project(points)
    inside = np.flatnonzero(camera.in_image(place, distance))
    column, row = place[inside].astype(int).T
    to_view = camera.centre - points[inside]
    facing = (to_view * normals[inside]).sum(1) > MIN_COSINE * np.linalg.norm(to_view, axis=1)
    nearest = known[row, column]
    seen = facing & (nearest > 0) & (distance[inside] < nearest + tolerance)
    if view.alpha is not None:
        seen &= view.alpha[row, column] > OPAQUE
    return inside[seen], row[seen], column[seen]

# SPDX-License-Identifier: GPL-3.0-or-later
"""Choice of the training views that sample each surface point: at random among those that see it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ....datasets.mask_limits import narrowest_mask
from ....kernels.trace import transmittance
from ....rendering.secondary_rays import SecondaryTracer
from ....scene.camera import Camera
from ....scene.dataset import View

MIN_FACING_COSINE = 0.15  # least cosine between normal and view direction; grazing views see the silhouette rather than the point
MIN_TRANSMITTANCE = 0.5  # least transmittance towards the camera
MIN_MASK_OPACITY = 0.99  # least mask opacity of the pixels around a point, so that no background is mixed into its colour


@dataclass(frozen=True, eq=False)
class ViewChoice:
    """Views of the surface points that enough of them see.

    Attributes:
        chosen: (P,) indices of these points among the given ones, ascending.
        point: (K,) which of the P points a sample is of, ascending.
        view: (K,) number of its view.
    """

    chosen: np.ndarray
    point: np.ndarray
    view: np.ndarray


def choose_views(
    position: np.ndarray,
    normal: np.ndarray,
    views: Sequence[View],
    tracer: SecondaryTracer,
    random: np.random.Generator,
    most: int,
    least: int,
) -> ViewChoice:
    """Choose views of surface points. Rays are traced until enough views are found to see a point, not to all cameras.

    Args:
        position: (N, 3) float32 points of the surface, world.
        normal: (N, 3) float32 unit normals.
        views: images.
        tracer: tracer of the surfels that may occlude a point.
        random: random generator of the choice.
        most: views per point, at most.
        least: points seen by fewer views are left out.
    """
    candidates = [facing_points(position, normal, view) for view in views]
    view = np.repeat(np.arange(len(views)), [len(points) for points in candidates])
    point = np.concatenate(candidates)
    shuffled = random.permutation(len(point))
    order = shuffled[np.argsort(point[shuffled], kind="stable")]
    point, view = point[order], view[order]
    centres = np.stack([view.camera.centre for view in views])

    def sees(rows: np.ndarray) -> np.ndarray:
        """Return whether the views of candidates see their points, bool."""
        start, direction = position[point[rows]] + tracer.offset * normal[point[rows]], centres[view[rows]] - position[point[rows]]
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        rays = (torch.from_numpy(array.astype(np.float32)).to(tracer.device) for array in (start, direction))
        return transmittance(tracer.tree, *rays).cpu().numpy() > MIN_TRANSMITTANCE

    kept = _first_seen(np.searchsorted(point, np.arange(len(position) + 1)), sees, max(most, least))
    count = np.bincount(point[kept], minlength=len(position))
    rank = np.arange(len(kept)) - np.repeat(np.cumsum(count) - count, count)
    kept = kept[(count[point[kept]] >= least) & (rank < most)]
    chosen = np.flatnonzero(count >= least)
    return ViewChoice(chosen, np.searchsorted(chosen, point[kept]), view[kept])


def _first_seen(start: np.ndarray, sees: Callable[[np.ndarray], np.ndarray], enough: int) -> np.ndarray:
    """Return the rows of the first `enough` candidates of each point that see it, ascending.

    Args:
        start: (N + 1,) row of each point's first candidate, and the number of candidates.
        sees: tells of an array of rows which see their point.
        enough: rows per point, at most.
    """
    next_row, missing, kept = start[:-1].copy(), np.full(len(start) - 1, enough), []
    while (take := np.minimum(start[1:] - next_row, missing)).any():
        owner = np.repeat(np.arange(len(take)), take)
        rows = next_row[owner] + np.arange(len(owner)) - np.repeat(np.cumsum(take) - take, take)
        seen = sees(rows)
        kept.append(rows[seen])
        missing -= np.bincount(owner[seen], minlength=len(take))
        next_row += take
    return np.sort(np.concatenate(kept)) if kept else np.zeros(0, int)


def facing_points(position: np.ndarray, normal: np.ndarray, view: View) -> np.ndarray:
    """Return the indices of the points (N, 3) that face a view, inside its image and its mask, whether hidden or not."""
    camera = view.camera
    place, depth = image_places(position, camera)
    direction = camera.centre - position
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    inside = (depth > 0) & (place >= 0).all(1) & (place < (camera.height - 1, camera.width - 1)).all(1)
    index = np.flatnonzero(inside & ((direction * normal).sum(1) > MIN_FACING_COSINE))
    if view.alpha is None:
        return index
    mask = narrowest_mask(view)
    return index[np.min([mask[at] for at, _ in bilinear_pixels(place[index])], axis=0) > MIN_MASK_OPACITY]


def image_places(position: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns (N, 2) of points in an image, whole at the centres of pixels, and their planar depths (N,)."""
    place, depth = camera.project(position)
    return place[:, ::-1] - 0.5, depth


def bilinear_pixels(place: np.ndarray) -> list[tuple[tuple[np.ndarray, np.ndarray], np.ndarray]]:
    """Return rows, columns and bilinear weights (N,) of the four pixels around places (N, 2), as of `image_places`."""
    whole = place.astype(int)
    row, column = whole.T
    down, across = (place - whole).T
    return [((row + i, column + j), (down if i else 1 - down) * (across if j else 1 - across)) for i in (0, 1) for j in (0, 1)]

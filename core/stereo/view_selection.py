# SPDX-License-Identifier: GPL-3.0-or-later
"""View selection: the views that each view is matched with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..scene.camera import Camera

BEST_ANGLE = 10.0  # degrees between the rays to a point: less tells depth badly, more changes the patch's look
NARROW_POWER = 1.5  # of the decline towards 0 degrees
WIDE_SIGMA = 15.0  # degrees, of the decline beyond BEST_ANGLE
WIDEST_COSINE = 0.5  # of the angle beyond which the score counts as 0; it would be below 1e-4
SMALLEST_SCORE = 1e-3  # for each point that the view sees: about 50 degrees, where patches no longer look alike
SMALLEST_FRACTION = 0.02  # of the best source's score


def choose_sources(cameras: Sequence[Camera], points: np.ndarray, count: int) -> list[list[int]]:
    """Choose the source views of each view: those that see the same points at a like scale and a helpful angle.

    The score sums over the points that both see the product of a function of the angle between their rays and the ratio of their scales
    (Yao et al. 2018).

    Args:
        cameras: cameras of all views.
        points: (P, 3) points about where the surfaces are.
        count: largest number of sources of a view.

    Returns:
        Indices of each view's sources, the best first; empty for a view that shares no points with others.
    """
    visible = np.stack([camera.in_image(*camera.project(points)) for camera in cameras])  # what hides points is neglected
    scores, seen = _scores(cameras, points, visible), visible.sum(-1)
    chosen = []
    for i, row in enumerate(scores):
        least = max(SMALLEST_FRACTION * row.max(), SMALLEST_SCORE * seen[i])
        chosen.append([int(j) for j in np.argsort(-row, kind="stable")[:count] if row[j] > least])
    return chosen


def _scores(cameras: Sequence[Camera], points: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Return the scores (V, V) of all pairs of views, which are symmetric; visible: (V, P) points that each view sees."""
    offsets = np.stack([camera.centre - points for camera in cameras])
    distances = np.maximum(np.linalg.norm(offsets, axis=-1), 1e-12)
    directions = (offsets / distances[..., None]).astype(np.float32)
    scales = np.array([camera.fx for camera in cameras])[:, None] / distances
    scores = np.zeros((len(cameras), len(cameras)))
    for i in range(len(cameras) - 1):
        cosine = np.einsum("pk,vpk->vp", directions[i], directions[i + 1 :])
        views, shared = np.nonzero(visible[i] & visible[i + 1 :] & (cosine > WIDEST_COSINE))
        ratio = scales[i + 1 :][views, shared] / scales[i][shared]
        values = _angle_score(cosine[views, shared]) * np.minimum(ratio, 1 / ratio)
        scores[i, i + 1 :] = scores[i + 1 :, i] = np.bincount(views, values, len(cameras) - i - 1)
    return scores


def choose_witnesses(sources: Sequence[Sequence[int]], most: int) -> list[tuple[int, ...]]:
    """Return the views that each view's depths are compared with: its sources, then those that it is a source of.

    Args:
        sources: sources of each view.
        most: largest number of witnesses of a view.
    """
    back = [[j for j, own in enumerate(sources) if i in own and j not in sources[i]] for i in range(len(sources))]
    return [tuple([*own, *others][:most]) for own, others in zip(sources, back, strict=True)]


def _angle_score(cosine: np.ndarray) -> np.ndarray:
    """Return a score in 0..1 for the cosines of angles between rays, 1 at BEST_ANGLE."""
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    narrow, wide = (angle / BEST_ANGLE) ** NARROW_POWER, np.exp(-(((angle - BEST_ANGLE) / WIDE_SIGMA) ** 2))
    return np.where(angle < BEST_ANGLE, narrow, wide)

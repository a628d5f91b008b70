# SPDX-License-Identifier: GPL-3.0-or-later
"""Mouths of a vessel: parts of the visual hull that may close one, as stereo's depths lie behind them in most views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ...stereo.depth_map import DepthMap
from .free_space import views_of, views_through

REACH = 0.03  # radii of the bound: tolerance of depths, and distance up to which points are of one part, more where they are sparse
NEIGHBOURS = 24  # of a point of the hull, at most two such distances away, whose views count together
RING = 6  # neighbours that surround a point
SHARE_THROUGH = 0.7  # of the views that see them, share in which any depth of stereo lies behind them, from which they may close a mouth
MIN_MOUTH = 0.01  # share of the hull's points that a mouth has at least
CLOSING = 0.08  # radii of the bound: holes of a mouth half as wide as that are filled, as under a handle
RIM_STEP, RIM_STEPS = 0.025, 4  # radii of the bound by which a mouth grows to its rim, and how often
MIN_RIM_COSINE = 0.85  # between the normals of the rim and of the mouth: beyond it the hull turns away


def vessel_mouths(
    points: np.ndarray, normals: np.ndarray, maps: Sequence[DepthMap], hull_depth: Sequence[np.ndarray], radius: float
) -> list[np.ndarray]:
    """Return masks (M,) bool of the parts of a hull that may close mouths, the largest first.

    Args:
        points: (M, 3) of the hull's surface, world.
        normals: (M, 3) of the hull there, outwards.
        maps: depth maps of stereo.
        hull_depth: (H, W) depth of the hull in the same views.
        radius: of the bound, world units.
    """
    seen = views_of(points, [one.camera for one in maps], hull_depth, REACH * radius)
    through = views_through(points, maps, REACH * radius, 0)
    distance, near = KDTree(points).query(points, min(NEIGHBOURS, len(points)), workers=-1)
    reach = max(REACH * radius, float(np.median(distance[:, :RING].max(1))))
    seen, through = ((views[near] * (distance <= 2 * reach)).sum(1) for views in (seen, through))
    looked_through = np.flatnonzero(through >= np.maximum(SHARE_THROUGH * seen, 1))
    parts = _parts(points[looked_through], reach)
    return [_whole(looked_through[part], points, normals, radius) for part in parts if len(part) >= MIN_MOUTH * len(points)]


def _parts(points: np.ndarray, reach: float) -> list[np.ndarray]:
    """Return the indices of the connected parts of points (K, 3), the largest first."""
    if not len(points):
        return []
    pairs = KDTree(points).query_pairs(reach, output_type="ndarray")
    graph = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
    _, part = connected_components(graph, directed=False)
    return [np.flatnonzero(part == one) for one in np.argsort(-np.bincount(part), kind="stable")]


def _whole(part: np.ndarray, points: np.ndarray, normals: np.ndarray, radius: float) -> np.ndarray:
    """Return the mask (M,) of a part of the hull's points, indices (K,), with its holes filled and grown to the rim."""
    closing, growth = CLOSING * radius, RIM_STEP * radius
    distance, nearest = KDTree(points[part]).query(points, distance_upper_bound=max(closing, RIM_STEPS * growth), workers=-1)
    nearest = np.asarray(nearest)
    near = np.flatnonzero(nearest < len(part))  # KDTree gives K for none
    places, wide = points[near], distance[near] <= closing
    mask = np.zeros(len(near), bool)
    mask[np.searchsorted(near, part)] = True
    if not wide.all():
        mask |= wide & (KDTree(places[~wide]).query(places, distance_upper_bound=closing, workers=-1)[0] > closing)
    flat = (normals[near] * normals[part[nearest[near]]]).sum(1) > MIN_RIM_COSINE
    for _ in range(RIM_STEPS):
        mask |= flat & (KDTree(places[mask]).query(places, distance_upper_bound=growth, workers=-1)[0] <= growth)
    whole = np.zeros(len(points), bool)
    whole[near[mask]] = True
    return whole

# SPDX-License-Identifier: GPL-3.0-or-later
"""Layered regions: parts of a start whose points lie one behind the other, as stereo finds them on metal.

A reflection looks like texture at the depth of its virtual image, which lies behind the surface and differs from view to view. Fused,
the points fill the space from there to the surface. Noise where there is no texture looks alike, so that trial fits must tell the two
apart (`select_metal`).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

SPACING_NEIGHBOURS = 6  # the spacing is the median distance to this neighbour
NORMAL_NEIGHBOURS, NORMAL_PASSES = 16, 2  # normals of fused points are averaged before: on metal they are noisy
NEAREST, REACH = 2.0, 0.1  # spacings and radii of the bound between which points in front of a point are another layer
WIDTH = 1.5  # spacings beside the normal up to which a point counts as in front
MIN_AGREEMENT = 0.5  # cosine between the normals of two layers: a thin part's two sides disagree
LAYERED_NEIGHBOURS, MIN_LAYERED = 32, 0.25  # a point is in a layered region if so many of so many around it lie behind another layer
MIN_SHARE = 0.0015  # share of all points that a region has at least
MARGIN = 2.0  # spacings around a region's points that belong to it, too; points of one region are as near to each other


def layered_regions(points: np.ndarray, normals: np.ndarray, radius: float) -> list[np.ndarray]:
    """Find the regions of points in several layers.

    Args:
        points: (N, 3) of surfels, world.
        normals: (N, 3) unit, outwards.
        radius: of the bound, world units.

    Returns:
        One mask (N,) bool for each region, the largest first; no point is in two.
    """
    if len(points) <= LAYERED_NEIGHBOURS:
        return []
    tree = KDTree(points)
    distance, around = (np.asarray(found) for found in tree.query(points, LAYERED_NEIGHBOURS, workers=-1))
    spacing = float(np.median(distance[:, SPACING_NEIGHBOURS]))
    behind = _behind(tree, points, _averaged(normals, around[:, :NORMAL_NEIGHBOURS]), spacing, REACH * radius)
    layered = np.flatnonzero(behind[around].mean(1) > MIN_LAYERED)
    owner = np.full(len(points), -1)
    for index, part in enumerate(_connected(points[layered], MARGIN * spacing, MIN_SHARE * len(points))):
        near = KDTree(points[layered[part]]).query(points, workers=-1)[0] <= MARGIN * spacing
        owner[near & (owner < 0)] = index
    return [owner == index for index in range(owner.max() + 1)]


def _averaged(normals: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Average normals (N, 3) with those of neighbours (N, K) that agree."""
    for _ in range(NORMAL_PASSES):
        weight = np.einsum("nkc,nc->nk", normals[around], normals).clip(0)
        normals = np.einsum("nk,nkc->nc", weight, normals[around])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals


def _behind(tree: KDTree, points: np.ndarray, normals: np.ndarray, spacing: float, reach: float) -> np.ndarray:
    """Return the points (N,) bool that another layer hides: a point of like normal lies in front of them, up to `reach` away."""
    hidden = np.zeros(len(points), bool)
    for ahead in np.arange(NEAREST + 1, max(reach / spacing, NEAREST + 2)) * spacing:
        _, other = tree.query(points + ahead * normals, distance_upper_bound=WIDTH * spacing, workers=-1)
        other = np.where(other < len(points), other, 0)  # none is near: any point, which is tested as all are
        offset = points[other] - points
        height = np.einsum("nc,nc->n", offset, normals)
        beside = np.linalg.norm(offset - height[:, None] * normals, axis=1)
        alike = np.einsum("nc,nc->n", normals[other], normals) > MIN_AGREEMENT
        hidden |= (height > NEAREST * spacing) & (height < reach) & (beside < WIDTH * spacing) & alike
    return hidden


def _connected(points: np.ndarray, gap: float, least: float) -> list[np.ndarray]:
    """Split points (M, 3) into parts that are more than `gap` apart: indices of those of at least `least` points, the largest first."""
    if not len(points):
        return []
    pairs = KDTree(points).query_pairs(gap, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (len(points), len(points)))
    part = connected_components(graph, directed=False)[1]
    size = np.bincount(part)
    return [np.flatnonzero(part == one) for one in np.argsort(-size, kind="stable") if size[one] >= least]

# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions of points that may be metal: points with clear evidence, and those around that do not contradict it.

A single point hardly tells metal from a rough dielectric: wrong normals and shadows make either fit a little better. The search has four
steps (called by `LightMaterialSolver`):

1. Candidates, by two thresholds as in Canny's edge detector: a point needs clear evidence (MIN_SURE_GAIN), unless its neighbours are
   candidates (MIN_POSSIBLE_GAIN). They count as metal until the test, so that the light adapts to them: else a region that was missed once
   was seldom found again.
2. Before the test, light and albedo adapt to the candidates. Those that metal does not explain better then are dropped (MIN_SUPPORT_GAIN).
   Without this, metal spread in the shadow from a belt to the skin around it.
3. The test: each connected region counts as metal only if the photographs are explained clearly better so, see `metal_confirmation`.
4. A graph cut draws the borders of the confirmed regions anew, see `metal_cut`; at the end by their tint, too, see `metal_colours`. Then
   parts that were missed become metal where they have that tint, and regions that few views show are dropped.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ....io.srgb import encode_srgb
from ...common.nearest_neighbours import nearest_neighbours

NEIGHBOURS = 13  # of a point, the point itself included
# Exponential decay of similarity with differences of chromaticity and of encoded colour, channels summed.
CHROMATICITY_DECAY, ENCODED_DECAY = 15, 3
CHROMATICITY_OFFSET = 0.02  # radiance added to the sum of the channels, so that the chromaticity of dark points tells little
MIN_SURE_GAIN = 0.4  # gain per view from which a point is a candidate; the gain is a difference of robust costs, see `MaterialSearch`
MIN_POSSIBLE_GAIN = -0.3  # gain from which a point is a candidate where its neighbours are
MIN_NEIGHBOUR_SHARE = 0.1  # share of the neighbours, by similarity of colour, that must be metal
MIN_LINK_SIMILARITY = 0.02  # similarity from which a neighbour belongs to the same region
MIN_REGION_POINTS, MAX_REGIONS = 4, 16  # points of a region, and regions that are tested
# A point is seldom seen if it has less than this share of the most views that a point has. Metal is dropped where more than this share of a
# region's points are seldom seen: beneath a captured toy car, a patch that few photographs show had the colours of its wheel caps. Of 73
# seldom seen points there, whose truth no test view shows, 27 were metal, now 3. No true metal is lost on suzanne_mixed, rocker_corner,
# capture_ogre, and the car, captured and with masks.
SELDOM_SEEN, MAX_SELDOM_SHARE = 0.6, 0.7
MIN_SUPPORT_GAIN, SUPPORT_PASSES = 0.1, 3  # gain per view, with an adapted light, from which a candidate stays one; passes that average it


def neighbourhood(position: torch.Tensor, colour: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Find the nearest NEIGHBOURS of each point, itself included.

    Args:
        position: (P, 3).
        colour: (P, 3) linear.

    Returns:
        Indices (P, N), and weights by similarity of colour (P, N) that sum to 1.
    """
    index = nearest_neighbours(position, position, NEIGHBOURS)
    chromaticity, encoded = colour / (colour.sum(1, keepdim=True) + CHROMATICITY_OFFSET), encode_srgb(colour)
    difference = CHROMATICITY_DECAY * (chromaticity[:, None] - chromaticity[index]).abs().sum(-1)
    difference = difference + ENCODED_DECAY * (encoded[:, None] - encoded[index]).abs().sum(-1)
    similarity = torch.exp(-difference)
    return index, similarity / similarity.sum(1, keepdim=True)


def grow_metal(gain: torch.Tensor, neighbours: torch.Tensor, similarity: torch.Tensor) -> torch.Tensor:
    """Find the points that may be metal: those with clear evidence, and those around that do not contradict it.

    Args:
        gain: (P,) by how much less a metal's fit costs than a dielectric's, per view.
        neighbours: (P, N) indices of points.
        similarity: (P, N) weights of these, which sum to 1.

    Returns:
        (P,) bool.
    """
    metal, possible = gain > MIN_SURE_GAIN, gain > MIN_POSSIBLE_GAIN
    while True:
        grown = metal | (possible & ((similarity * metal[neighbours]).sum(1) > MIN_NEIGHBOUR_SHARE))
        if bool((grown == metal).all()):
            return metal
        metal = grown


def connected_regions(metal: torch.Tensor, neighbours: torch.Tensor, similarity: torch.Tensor) -> list[torch.Tensor]:
    """Split points into regions that are connected by neighbours of like colour.

    Args:
        metal: (P,) bool.
        neighbours: (P, N) indices of points.
        similarity: (P, N) weights of these.

    Returns:
        Up to MAX_REGIONS masks (P,) bool of regions with MIN_REGION_POINTS points or more, the largest first.
    """
    label = _region_labels(metal, neighbours, similarity)
    names, counts = label[metal].unique(return_counts=True)
    largest = counts.sort(descending=True, stable=True).indices[:MAX_REGIONS]
    return [metal & (label == names[k]) for k in largest if counts[k] >= MIN_REGION_POINTS]


def often_seen(metal: torch.Tensor, views: torch.Tensor, neighbours: torch.Tensor, similarity: torch.Tensor) -> torch.Tensor:
    """Drop regions of metal that few views show: what a reflection does from view to view can hardly be told there.

    Args:
        metal: (P,) bool.
        views: (P,) number of views of each point.
        neighbours: (P, N) indices of points.
        similarity: (P, N) weights of these.

    Returns:
        (P,) bool, without regions that are seldom seen, see SELDOM_SEEN.
    """
    label, seldom = _region_labels(metal, neighbours, similarity), views < SELDOM_SEEN * views.max()
    share = torch.bincount(label, seldom.double()) / torch.bincount(label)
    return metal & (share[label] <= MAX_SELDOM_SHARE)


def _region_labels(metal: torch.Tensor, neighbours: torch.Tensor, similarity: torch.Tensor) -> torch.Tensor:
    """Return the number (P,) of each point's region, see `connected_regions`; a point that is no metal is a region by itself."""
    linked = metal[:, None] & metal[neighbours] & (similarity > MIN_LINK_SIMILARITY)
    row, column = torch.nonzero(linked, as_tuple=True)
    pairs = (row.cpu().numpy(), neighbours[row, column].cpu().numpy())
    _, label = connected_components(coo_matrix((np.ones(len(row)), pairs), (len(metal), len(metal))), directed=False)
    return torch.from_numpy(label).long().to(metal.device)

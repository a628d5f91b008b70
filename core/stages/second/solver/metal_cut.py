# SPDX-License-Identifier: GPL-3.0-or-later
"""Borders of metal by a graph cut.

A threshold on each point's gain keeps points of another material beside the metal whose loss is small, and drops points of the metal
whose normals are wrong. The cut weighs a point's evidence against its neighbours (Boykov and Jolly 2001). Evidence is the log of a
ratio of errors: where normals are wrong, both errors are large, and their difference tells little.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

# Added to the evidence of a point near metal, and weight of its links to its neighbours. In three runs each, points of another material
# that became metal, and points of metal that did not: capture_ogre 112 and 111 by a threshold, 50 and 57 by the cut; rocker_corner 13
# and 57, 1 and 70; suzanne_mixed 5 and 24, 3 and 18.
METAL_PRIOR, NEIGHBOUR_COUPLING = 0.06, 0.75
# The prior where normals of metal are searched, too, and colours are compared (`MaterialSearch.grown_metal`); weight of the colours'
# evidence, and passes in which colours and borders are found in turns. `metal_colours` has figures of five scenes; priors of .06 to .15 and
# weights of .2 to .3 give about the same. By searched normals alone metal leaked; without them, more of it was missed, which costs more.
# All points may become metal there. With MAX_RINGS rings around the metal only, points of metal that were missed, in two runs of the solver
# each, and points of other materials: a captured toy car 97 and 3, now 48 and 18; the same with masks 92 and 28, now 53 and 37.
SEARCHED_NORMALS_PRIOR, COLOUR_WEIGHT, COLOUR_PASSES = 0.1, 0.3, 2
MAX_RINGS = 4  # rings of neighbours around metal that may become metal before its normals are searched
MAX_EVIDENCE = 100.0  # of the evidence; the links of a point sum to about twice the coupling, so that more decides by itself
CAPACITY_SCALE = 10_000  # capacities are integers, in this fraction of the evidence's unit


def cut_metal(evidence: torch.Tensor, metal: torch.Tensor, neighbours: torch.Tensor, similarity: torch.Tensor) -> torch.Tensor:
    """Draw the borders of metal anew, so that the evidence within them, less the similarity across them, is greatest.

    Args:
        evidence: (P,) log of a dielectric's over a metal's error.
        metal: (P,) bool, metal so far.
        neighbours: (P, N) indices of points.
        similarity: (P, N) weights of these, which sum to 1.

    Returns:
        (P,) bool: metal, at most MAX_RINGS rings of neighbours beyond what was metal.
    """
    near = metal
    for _ in range(MAX_RINGS):
        near = near | near[neighbours].any(1)
    return least_cut(torch.where(near, evidence + METAL_PRIOR, -MAX_EVIDENCE), neighbours, similarity, NEIGHBOUR_COUPLING)


def least_cut(evidence: torch.Tensor, neighbours: torch.Tensor, similarity: torch.Tensor, coupling: float) -> torch.Tensor:
    """Choose points so that their evidence, less the similarity across their border times half the coupling, is greatest.

    Args:
        evidence: (P,) that a point is to be chosen; MAX_EVIDENCE decides by itself.
        neighbours: (P, N) indices of points.
        similarity: (P, N) weights of these, which sum to 1.
        coupling: weight of a point's links to its neighbours.

    Returns:
        (P,) bool.
    """
    value = evidence.cpu().double().numpy().clip(-MAX_EVIDENCE, MAX_EVIDENCE)
    link = 0.5 * coupling * similarity.cpu().double().numpy()
    return torch.from_numpy(_source_side(_graph(value, neighbours.cpu().numpy(), link))).to(evidence.device)


def _graph(value: np.ndarray, neighbours: np.ndarray, link: np.ndarray) -> csr_matrix:
    """Build the graph whose least cut takes the points (P,) of greatest total value, less the links (P, N) across its border.

    Its last two nodes are the source, linked to points of positive value, and the sink, linked to the others.
    """
    count, point = len(value), np.arange(len(value))
    source, sink = np.full(count, count), np.full(count, count + 1)
    one, other = np.repeat(point, neighbours.shape[1]), neighbours.reshape(-1)
    between = one != other
    one, other, link = one[between], other[between], link.reshape(-1)[between]
    begin, end = np.concatenate([one, other, source, point]), np.concatenate([other, one, point, sink])
    capacity = np.concatenate([link, link, value.clip(0), (-value).clip(0)])
    whole = np.round(CAPACITY_SCALE * capacity).astype(np.int32)
    return csr_matrix(coo_matrix((whole, (begin, end)), (count + 2, count + 2)))


def _source_side(graph: csr_matrix) -> np.ndarray:
    """Return the (P,) bool nodes on the source's side of the least cut of a graph of P + 2 nodes, see `_graph`."""
    count = len(graph.indptr) - 3
    rest = graph - maximum_flow(graph, count, count + 1).flow
    rest.eliminate_zeros()  # breadth_first_order follows stored zeros
    side = np.zeros(count + 2, np.bool_)
    side[breadth_first_order(rest, count, return_predecessors=False)] = True
    return side[:count]

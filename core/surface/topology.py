# SPDX-License-Identifier: GPL-3.0-or-later
"""Topology of a triangle mesh: edges and the faces on them, neighbours and fans of vertices, components, orientation, border loops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ..scene.unique_rows import unique_rows


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges of a triangle mesh.

    Attributes:
        vertices: (E, 2) both ends, the smaller index first.
        of_side: (3 F,) edge of each side of a face: sides 3 f, 3 f + 1 and 3 f + 2 begin at the three corners of face f.
        faces: (E,) number of faces on the edge: 1 on an open border, 2 on a manifold surface.
        forward: (3 F,) bool, True where the side runs from the smaller index to the larger.
    """

    vertices: np.ndarray
    of_side: np.ndarray
    faces: np.ndarray
    forward: np.ndarray

    @property
    def border(self) -> np.ndarray:
        """(E,) bool, True on open borders."""
        return self.faces == 1

    @property
    def non_manifold(self) -> np.ndarray:
        """(E,) bool, True where three or more faces meet."""
        return self.faces > 2

    def pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Return both sides, (P, 2), of every edge between exactly two faces, and whether they run in opposite directions, (P,) bool."""
        order = np.argsort(self.of_side, kind="stable")
        sides = order[self.faces[self.of_side[order]] == 2].reshape(-1, 2)
        return sides, self.forward[sides[:, 0]] != self.forward[sides[:, 1]]


def edges_of(faces: np.ndarray) -> Edges:
    """Find the edges of the faces (F, 3)."""
    sides = np.asarray(faces, np.int64)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    vertices, of_side, count = unique_rows(np.sort(sides, -1), return_inverse=True, return_counts=True)
    return Edges(vertices, of_side, count, sides[:, 0] < sides[:, 1])


def adjacency(faces: np.ndarray, count: int) -> sparse.csr_matrix:
    """Find the neighbours of vertices.

    Args:
        faces: (F, 3) vertices of the triangles.
        count: number V of vertices.

    Returns:
        Symmetric matrix (V, V), 1 where two vertices share an edge.
    """
    i, j = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    ones = np.ones(2 * len(i))
    matrix = sparse.csr_matrix((ones, (np.r_[i, j], np.r_[j, i])), shape=(count, count))
    matrix.data[:] = 1
    return matrix


def neighbour_average(faces: np.ndarray, count: int, own: bool = True) -> sparse.csr_matrix:
    """Build the matrix that averages values over the neighbours of vertices.

    Args:
        faces: (F, 3) vertices of the triangles.
        count: number V of vertices.
        own: a vertex's own value counts as one of its neighbours'.

    Returns:
        Matrix (V, V) whose rows have sum 1; without `own`, 0 for vertices of no face.
    """
    near = adjacency(faces, count)
    if own:
        near = near + sparse.identity(count, format="csr")
    return sparse.csr_matrix(sparse.diags(1 / np.maximum(np.asarray(near.sum(1)).ravel(), 1)) @ near)


def face_components(faces: np.ndarray, edges: Edges) -> np.ndarray:
    """Return the connected component (F,) of each face; faces are connected across edges, not at single vertices."""
    face = np.repeat(np.arange(len(faces)), 3)
    graph = sparse.coo_matrix((np.ones(len(face)), (face, edges.of_side + len(faces))), shape=(len(faces) + len(edges.vertices),) * 2)
    return _dense_labels(connected_components(graph, directed=False)[1][: len(faces)])


def _dense_labels(labels: np.ndarray) -> np.ndarray:
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def fans(faces: np.ndarray, edges: Edges) -> np.ndarray:
    """Label the corners of faces so that corners at the same vertex have one label where a walk across edges leads from one to the other.

    Args:
        faces: (F, 3).
        edges: edges of these faces.

    Returns:
        (3 F,) labels; a vertex is manifold where all its corners have one.
    """
    order = np.argsort(edges.of_side, kind="stable")
    same = edges.of_side[order[1:]] == edges.of_side[order[:-1]]
    return joined_corners(faces, np.stack([order[:-1][same], order[1:][same]], -1))


def joined_corners(faces: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Label the corners of faces (F, 3), (3 F,): equal for corners at the same vertex that pairs of sides (P, 2) of one edge connect."""
    vertex, (one, other) = np.asarray(faces).reshape(-1), sides.T
    after, behind = (side - side % 3 + (side + 1) % 3 for side in (one, other))
    parallel = vertex[one] == vertex[other]  # both sides begin at the same vertex
    i, j = np.r_[one, after], np.r_[np.where(parallel, other, behind), np.where(parallel, behind, other)]
    graph = sparse.coo_matrix((np.ones(len(i)), (i, j)), shape=(len(vertex),) * 2)
    return connected_components(graph, directed=False)[1]


def non_manifold_vertices(faces: np.ndarray, edges: Edges) -> np.ndarray:
    """Return the vertices at which several fans of faces meet: parts of the surface that touch at this point alone."""
    vertex = np.asarray(faces).reshape(-1)
    ends = unique_rows(np.stack([vertex, fans(faces, edges)], -1))[:, 0]
    found, count = np.unique(ends, return_counts=True)
    return found[count > 1]


def flipped_faces(faces: np.ndarray, edges: Edges, area: np.ndarray) -> np.ndarray:
    """Find faces wound against their neighbours: in each component the side with the smaller area.

    Args:
        faces: (F, 3).
        edges: edges of these faces.
        area: (F,) of the faces.

    Returns:
        (F,) bool. A component that can't be wound consistently (a Moebius strip) counts whole.
    """
    sides, opposite = edges.pairs()
    one, other, count = sides[:, 0] // 3, sides[:, 1] // 3, len(faces)
    # Each face is there twice, as it is and turned; an edge connects the two states of its faces that agree.
    i, j = np.r_[one, one + count], np.r_[np.where(opposite, other, other + count), np.where(opposite, other + count, other)]
    graph = sparse.coo_matrix((np.ones(len(i)), (i, j)), shape=(2 * count,) * 2)
    label = connected_components(graph, directed=False)[1]
    kept, turned = label[:count], label[count:]
    total = np.bincount(kept, area, label.max(initial=-1) + 1)
    return (kept == turned) | (total[kept] < total[turned]) | ((total[kept] == total[turned]) & (kept > turned))


def border_loops(edges: Edges) -> tuple[np.ndarray, int]:
    """Return the label (B,) of the loop that each border edge belongs to, and the number of loops."""
    ends = edges.vertices[edges.border]
    if not len(ends):
        return np.zeros(0, np.int64), 0
    used, index = np.unique(ends, return_inverse=True)
    i, j = index.reshape(-1, 2).T
    count, label = connected_components(sparse.coo_matrix((np.ones(len(i)), (i, j)), shape=(len(used),) * 2), directed=False)
    return label[i], count

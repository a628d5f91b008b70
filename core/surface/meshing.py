# SPDX-License-Identifier: GPL-3.0-or-later
"""From a distance field to a clean, smooth mesh within a triangle budget."""

from __future__ import annotations

from dataclasses import dataclass

import fast_simplification
import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from ..errors import IrgsppError
from .voxel_grid import Grid

PATIENCE = 5  # how fast decimation allows greater errors; its default, 7, errs three times as far in no less time
TAUBIN = (0.5, -0.53)  # a shrinking and a growing step: noise goes, volume stays (Taubin 1995)


@dataclass(frozen=True, eq=False)
class Triangles:
    """Bare geometry: vertices (V, 3) float64 and faces (F, 3) int64, counter-clockwise seen from outside."""

    vertices: np.ndarray
    faces: np.ndarray


def isosurface(distance: np.ndarray, grid: Grid) -> Triangles:
    """Marching cubes over the active blocks' distances. Raises IrgsppError where there is no surface."""
    known = grid.dense(np.ones(distance.shape, bool), False)
    cubes = known[1:, 1:, 1:].copy()
    for x, y, z in np.ndindex(2, 2, 2):
        cubes &= known[x : known.shape[0] - 1 + x, y : known.shape[1] - 1 + y, z : known.shape[2] - 1 + z]
    known[:] = False
    known[1:, 1:, 1:] = cubes  # scikit-image asks the mask at a cube's far corner
    # A vertex exactly on a voxel would make triangles of no area.
    distance = np.where(np.abs(distance) < 1e-4, np.float32(1e-4), distance)
    try:
        vertices, faces, _, _ = marching_cubes(grid.dense(distance, 1.0), 0.0, mask=known)
    except (ValueError, RuntimeError) as error:
        raise IrgsppError("no surface: the views' depths agree on none; is the object inside the bound?") from error
    return Triangles(grid.origin + grid.voxel * vertices.astype(np.float64), faces.astype(np.int64))


def cleaned(mesh: Triangles) -> Triangles:
    """Without degenerate and repeated faces, fins (two faces back to back, which decimation leaves), and vertices that no face uses."""
    f = mesh.faces
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    smallest_first = np.take_along_axis(f, (f.argmin(-1)[:, None] + np.arange(3)) % 3, -1)
    side = np.where(smallest_first[:, 1] < smallest_first[:, 2], 1, -1)
    _, group = np.unique(np.sort(f, -1), axis=0, return_inverse=True)
    group = group.reshape(-1)
    keep = np.sign(np.bincount(group, side))[group] == side
    _, index = np.unique(smallest_first[keep], axis=0, return_index=True)
    return compacted(Triangles(mesh.vertices, f[keep][np.sort(index)]))


def compacted(mesh: Triangles) -> Triangles:
    """Only the vertices that faces use."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return Triangles(mesh.vertices[used], faces.reshape(-1, 3))


def main_components(mesh: Triangles, share: float) -> Triangles:
    """The components with at least `share` of the largest one's area. Hollows (closed, inside out) go too: no view can have seen them."""
    v, f = mesh.vertices, mesh.faces
    _, vertex_label = connected_components(adjacency(mesh), directed=False)
    label = vertex_label[f[:, 0]]
    a, b, c = v[f[:, 0]], v[f[:, 1]], v[f[:, 2]]
    cross = np.cross(b - a, c - a)
    area = np.bincount(label, np.linalg.norm(cross, axis=-1) / 2)
    centre = (np.bincount(label, a[:, i]) / np.maximum(np.bincount(label), 1) for i in range(3))
    offset = a - np.stack(list(centre), -1)[label]
    volume = np.bincount(label, (offset * cross).sum(-1) / 6)
    open_surface = np.zeros(len(area), bool)  # its signed volume says nothing: a wall seen from one side
    open_surface[vertex_label[border_vertices(f)]] = True
    outward = open_surface | (volume > -1e-3 * area**1.5)
    keep = outward & (area >= share * area[outward].max(initial=0))
    return compacted(Triangles(v, f[keep[label]]))


def border_vertices(faces: np.ndarray) -> np.ndarray:
    """Vertices on edges that belong to one face only."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    once, count = np.unique(edges, axis=0, return_counts=True)
    return np.unique(once[count == 1])


def adjacency(mesh: Triangles) -> sparse.csr_matrix:
    """(V, V) symmetric matrix, 1 where two vertices share an edge."""
    i, j = mesh.faces[:, [0, 1, 2]].ravel(), mesh.faces[:, [1, 2, 0]].ravel()
    ones = np.ones(2 * len(i))
    matrix = sparse.csr_matrix((ones, (np.r_[i, j], np.r_[j, i])), shape=(len(mesh.vertices),) * 2)
    matrix.data[:] = 1
    return matrix


def smoothed(mesh: Triangles, passes: int) -> Triangles:
    """Taubin smoothing; vertices of an open border follow their neighbours on the border only."""
    average = _neighbour_average(mesh)
    vertices = mesh.vertices
    for _ in range(passes):
        for factor in TAUBIN:
            vertices = vertices + factor * (average @ vertices - vertices)
    return Triangles(vertices, mesh.faces)


def _neighbour_average(mesh: Triangles) -> sparse.csr_matrix:
    """(V, V) matrix whose rows average a vertex's neighbours."""
    edges = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), -1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    border = np.zeros(len(mesh.vertices), bool)
    border[edges[count == 1]] = True
    i, j = np.r_[edges[:, 0], edges[:, 1]], np.r_[edges[:, 1], edges[:, 0]]
    keep = ~border[i] | np.r_[count == 1, count == 1]
    i, j = i[keep], j[keep]
    degree = np.maximum(np.bincount(i, minlength=len(mesh.vertices)), 1)
    return sparse.csr_matrix((1 / degree[i], (i, j)), shape=(len(mesh.vertices),) * 2)


def decimated(mesh: Triangles, triangles: int) -> Triangles:
    """Quadric edge collapse down to about `triangles` faces; the mesh itself where it has no more."""
    if len(mesh.faces) <= triangles:
        return mesh
    vertices, faces, *_ = fast_simplification.simplify(mesh.vertices, mesh.faces.astype(np.int32), target_count=triangles, agg=PATIENCE)
    return Triangles(np.asarray(vertices, np.float64), np.asarray(faces, np.int64))


def vertex_normals(mesh: Triangles, averages: int = 0) -> np.ndarray:
    """(V, 3) float64 unit normals, faces weighted by their angle at the vertex, then averaged with the neighbours' `averages` times."""
    corner = mesh.vertices[mesh.faces]
    face = unit(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))
    normals = np.zeros_like(mesh.vertices)
    for k in range(3):
        a = unit(corner[:, (k + 1) % 3] - corner[:, k])
        b = unit(corner[:, (k + 2) % 3] - corner[:, k])
        angle = np.arccos(np.clip((a * b).sum(-1), -1, 1))
        for axis in range(3):
            normals[:, axis] += np.bincount(mesh.faces[:, k], angle * face[:, axis], len(normals))
    normals = unit(normals)
    if averages:
        matrix = adjacency(mesh) + sparse.identity(len(normals), format="csr")
        for _ in range(averages):
            normals = unit(matrix @ normals)
    return normals


def carried_normals(source: Triangles, normals: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(P, 3) unit normals at points on a mesh from those of its nearest vertices: a decimated mesh keeps the normals of the fine one."""
    distance, nearest = KDTree(source.vertices).query(points, k=4, workers=-1)
    weight = 1 / (distance + 1e-3 * distance[:, -1:] + 1e-12)
    return unit((normals[nearest] * weight[..., None]).sum(1))


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) of length one; +Z where there is none, so that no normal is ever invalid."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-20, vectors / np.maximum(length, 1e-20), np.array([0.0, 0.0, 1.0]))

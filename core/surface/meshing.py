# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshing of a signed distance field: marching cubes, clean-up, Taubin smoothing, decimation and vertex normals."""

from __future__ import annotations

from dataclasses import dataclass

import fast_simplification
import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from ..errors import IrgsppError
from ..scene.unique_rows import unique_rows, used_numbers
from .topology import adjacency, edges_of
from .voxel_grid import Grid

AGGRESSION = 5  # `agg` of decimation; the library's default, 7, has three times the error in the same time
# Nearest fine vertices that are looked at, and those that a decimated vertex takes its normal from.
NORMAL_CANDIDATES, CARRIED_NORMALS = 12, 4
TAUBIN_FACTORS = (0.5, -0.53)  # factors of the shrinking and the growing step, which together keep the volume (Taubin 1995)


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangle mesh without attributes.

    Attributes:
        vertices: (V, 3) float64.
        faces: (F, 3) int64, counter-clockwise seen from outside.
    """

    vertices: np.ndarray
    faces: np.ndarray


def isosurface(distance: np.ndarray, grid: Grid) -> Triangles:
    """Extract the zero level by marching cubes (Lorensen and Cline 1987).

    Args:
        distance: (B, BLOCK^3) signed distances of the active blocks.
        grid: their voxel grid.

    Raises:
        IrgsppError: there is no surface.
    """
    known = grid.dense(np.ones(distance.shape, bool), False)
    cubes = known[1:, 1:, 1:].copy()
    for x, y, z in np.ndindex(2, 2, 2):
        cubes &= known[x : known.shape[0] - 1 + x, y : known.shape[1] - 1 + y, z : known.shape[2] - 1 + z]
    known[:] = False
    known[1:, 1:, 1:] = cubes  # scikit-image reads the mask at a cube's far corner
    # A vertex exactly on a voxel would create triangles without area.
    distance = np.where(np.abs(distance) < 1e-4, np.float32(1e-4), distance)
    try:
        vertices, faces, _, _ = marching_cubes(grid.dense(distance, 1.0), 0.0, mask=known)
    except (ValueError, RuntimeError) as error:
        raise IrgsppError("no surface: the views' depths agree on none; check that the object is inside the bound") from error
    return Triangles(grid.origin + grid.voxel * vertices.astype(np.float64), faces.astype(np.int64))


def cleaned(mesh: Triangles) -> Triangles:
    """Remove degenerate and repeated faces, fins (two faces back to back, which decimation leaves), and unused vertices."""
    f = mesh.faces
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    smallest_first = np.take_along_axis(f, (f.argmin(-1)[:, None] + np.arange(3)) % 3, -1)
    side = np.where(smallest_first[:, 1] < smallest_first[:, 2], 1, -1)
    _, group = unique_rows(np.sort(f, -1), return_inverse=True)
    keep = np.sign(np.bincount(group, side))[group] == side
    _, index = unique_rows(smallest_first[keep], return_index=True)
    return compacted(Triangles(mesh.vertices, f[keep][np.sort(index)]))


def compacted(mesh: Triangles) -> Triangles:
    """Remove the vertices that no face uses."""
    used, faces = used_numbers(mesh.faces)
    return Triangles(mesh.vertices[used], faces)


def main_components(mesh: Triangles, fraction: float) -> Triangles:
    """Keep the large connected components; closed components that are inside out are cavities that no view can see, and are removed.

    Args:
        mesh: mesh of any number of components.
        fraction: least area of a component over that of the largest one.
    """
    v, f = mesh.vertices, mesh.faces
    _, vertex_label = connected_components(adjacency(mesh.faces, len(mesh.vertices)), directed=False)
    label = vertex_label[f[:, 0]]
    a, b, c = v[f[:, 0]], v[f[:, 1]], v[f[:, 2]]
    cross = np.cross(b - a, c - a)
    area = np.bincount(label, np.linalg.norm(cross, axis=-1) / 2)
    centre = (np.bincount(label, a[:, i]) / np.maximum(np.bincount(label), 1) for i in range(3))
    offset = a - np.stack(list(centre), -1)[label]
    volume = np.bincount(label, (offset * cross).sum(-1) / 6)
    open_surface = np.zeros(len(area), bool)  # its signed volume is meaningless: a wall seen from one side
    open_surface[vertex_label[border_vertices(f)]] = True
    outward = open_surface | (volume > -1e-3 * area**1.5)
    keep = outward & (area >= fraction * area[outward].max(initial=0))
    return compacted(Triangles(v, f[keep[label]]))


def border_vertices(faces: np.ndarray) -> np.ndarray:
    """Return the vertices on edges that belong to only one of the faces (F, 3)."""
    edges = edges_of(faces)
    return np.unique(edges.vertices[edges.border])


def smoothed(mesh: Triangles, passes: int) -> Triangles:
    """Smooth a mesh while keeping its volume (Taubin 1995); vertices of an open border average their neighbours on the border only.

    Args:
        mesh: mesh to smooth.
        passes: number of shrinking and growing steps.
    """
    average = _neighbour_average(mesh)
    vertices = mesh.vertices
    for _ in range(passes):
        for factor in TAUBIN_FACTORS:
            vertices = vertices + factor * (average @ vertices - vertices)
    return Triangles(vertices, mesh.faces)


def _neighbour_average(mesh: Triangles) -> sparse.csr_matrix:
    """Return the matrix (V, V) whose rows average a vertex's neighbours."""
    edges = edges_of(mesh.faces)
    ends = edges.vertices
    border = np.zeros(len(mesh.vertices), bool)
    border[ends[edges.border]] = True
    i, j = np.r_[ends[:, 0], ends[:, 1]], np.r_[ends[:, 1], ends[:, 0]]
    keep = ~border[i] | np.r_[edges.border, edges.border]
    i, j = i[keep], j[keep]
    degree = np.maximum(np.bincount(i, minlength=len(mesh.vertices)), 1)
    return sparse.csr_matrix((1 / degree[i], (i, j)), shape=(len(mesh.vertices),) * 2)


def decimated(mesh: Triangles, triangles: int) -> Triangles:
    """Decimate a mesh by quadric edge collapse (Garland and Heckbert 1997).

    Args:
        mesh: mesh to decimate; it is returned itself where it is small enough.
        triangles: approximate number of faces of the result, at most.
    """
    if len(mesh.faces) <= triangles:
        return mesh
    vertices, faces, *_ = fast_simplification.simplify(mesh.vertices, mesh.faces.astype(np.int32), target_count=triangles, agg=AGGRESSION)
    return Triangles(np.asarray(vertices, np.float64), np.asarray(faces, np.int64))


def vertex_normals(mesh: Triangles, averages: int = 0) -> np.ndarray:
    """Compute vertex normals: the mean of the face normals, weighted by the face's angle at the vertex.

    Args:
        mesh: V vertices.
        averages: number of times that normals are averaged with their neighbours'.

    Returns:
        (V, 3) float64 unit normals.
    """
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
        matrix = adjacency(mesh.faces, len(mesh.vertices)) + sparse.identity(len(normals), format="csr")
        for _ in range(averages):
            normals = unit(matrix @ normals)
    return normals


def carried_normals(source: Triangles, normals: np.ndarray, mesh: Triangles) -> np.ndarray:
    """Interpolate normals at the vertices of a decimated mesh from the nearest vertices of the fine one, so that it keeps their detail.

    Fine vertices that face away from a vertex belong to the other side of a thin part and are left out, where there are others.

    Args:
        source: fine mesh with V vertices.
        normals: (V, 3) its unit normals.
        mesh: decimated mesh with P vertices.

    Returns:
        (P, 3) unit normals.
    """
    distance, nearest = KDTree(source.vertices).query(mesh.vertices, k=NORMAL_CANDIDATES, workers=-1)
    away = (normals[nearest] * vertex_normals(mesh)[:, None]).sum(-1) <= 0
    order = np.argsort(away, axis=-1, kind="stable")[:, :CARRIED_NORMALS]
    distance, nearest = (np.take_along_axis(values, order, -1) for values in (distance, nearest))
    weight = 1 / (distance + 1e-3 * distance.max(-1, keepdims=True) + 1e-12)
    weight *= ~np.take_along_axis(away, order, -1) | away.all(-1, keepdims=True)
    return unit((normals[nearest] * weight[..., None]).sum(1))


def unit(vectors: np.ndarray) -> np.ndarray:
    """Normalise vectors (..., 3) to unit length; zero vectors become +Z, so that all normals are valid."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-20, vectors / np.maximum(length, 1e-20), np.array([0.0, 0.0, 1.0]))

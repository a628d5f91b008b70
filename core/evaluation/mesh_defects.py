# SPDX-License-Identifier: GPL-3.0-or-later
"""Defects of a mesh's geometry: edges and vertices that are not manifold, holes, floaters, flipped and degenerate faces, duplicates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from ..scene.mesh import Mesh
from ..surface import topology
from ..surface.meshing import unit

FLOATER = 0.01  # a component with less than this fraction of the largest component's area floats beside the object
SMALL_HOLE = 1.0  # an open border shorter than so many diameters of the object is a hole, not the end of a surface
FLAT = 1e-3  # least height of a triangle over its longest edge
NEAR = 1e-6  # distance, in diameters of the object, below which two vertices are the same point


@dataclass(frozen=True)
class Geometry:
    """Counts of a mesh without its UV seams: vertices at equal positions count as one.

    Attributes:
        vertices: number of different positions.
        faces: number of triangles.
        diameter: diagonal of the bounding box, world units.
        area: of the surface, square world units.
        non_manifold_edges: edges of three or more faces.
        non_manifold_vertices: points at which several fans of faces meet.
        border_edges: edges of one face.
        holes: short loops of border edges.
        borders: long loops of border edges, where the surface ends.
        component_areas: fraction of the area in each component, the largest first.
        floaters: components far smaller than the largest.
        flipped: faces wound against their neighbours.
        inside_out: closed components that enclose a negative volume.
        folded: faces turned away from the normals of all three vertices.
        flat: triangles without area or height.
        repeated_faces: faces on the same three points as an earlier one.
        near_vertices: vertices closer to another one than `NEAR`, without being at the same position.
        doubled_vertices: vertices equal to another one in position, normal and UV.
        unused_vertices: vertices of no face.
    """

    vertices: int
    faces: int
    diameter: float
    area: float
    non_manifold_edges: int
    non_manifold_vertices: int
    border_edges: int
    holes: int
    borders: int
    component_areas: list[float]
    floaters: int
    flipped: int
    inside_out: int
    folded: int
    flat: int
    repeated_faces: int
    near_vertices: int
    doubled_vertices: int
    unused_vertices: int


def geometry_of(mesh: Mesh) -> Geometry:
    """Count the defects of a mesh with at least one face."""
    points, welded = np.unique(mesh.vertices, axis=0, return_inverse=True)
    points, faces = points.astype(np.float64), welded.reshape(-1)[mesh.faces]
    diameter = float(np.linalg.norm(np.ptp(points, axis=0)))
    corner = points[faces]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(cross, axis=-1) / 2
    edges = topology.edges_of(faces)
    return Geometry(
        vertices=len(points),
        faces=len(faces),
        diameter=diameter,
        area=float(area.sum()),
        non_manifold_edges=int(edges.non_manifold.sum()),
        non_manifold_vertices=len(topology.non_manifold_vertices(faces, edges)),
        flipped=int(topology.flipped_faces(faces, edges, area).sum()),
        folded=int(((mesh.normals[mesh.faces] * unit(cross)[:, None]).sum(-1) < 0).all(-1).sum()),
        flat=int((2 * area <= FLAT * _longest(corner) ** 2).sum()),
        repeated_faces=len(faces) - len(np.unique(np.sort(faces, -1), axis=0)),
        near_vertices=_near(points, NEAR * diameter),
        **_borders(points, edges, diameter),
        **_components(faces, edges, area, ((corner[:, 0] - points.mean(0)) * cross).sum(-1) / 6),
        **_redundant_vertices(mesh),
    )


def _borders(points: np.ndarray, edges: topology.Edges, diameter: float) -> dict[str, Any]:
    """Return the counts of border edges, and of short and long loops of them."""
    loop, count = topology.border_loops(edges)
    ends = points[edges.vertices[edges.border]]
    length = np.bincount(loop, np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1), count)
    short = int((length < SMALL_HOLE * diameter).sum())
    return {"border_edges": int(edges.border.sum()), "holes": short, "borders": count - short}


def _components(faces: np.ndarray, edges: topology.Edges, area: np.ndarray, volume: np.ndarray) -> dict[str, Any]:
    """Return the areas of the components, and the counts of floaters and of closed components that are inside out.

    Args:
        faces: (F, 3).
        edges: of the faces.
        area: of each face (F,).
        volume: signed volume of each face's tetrahedron with a fixed point (F,).
    """
    component = topology.face_components(faces, edges)
    areas = np.bincount(component, area)
    closed = np.ones(len(areas), bool)
    closed[component[np.nonzero(edges.border[edges.of_side])[0] // 3]] = False
    return {
        "component_areas": [float(x) for x in np.sort(areas)[::-1] / max(area.sum(), 1e-300)],
        "floaters": int((areas < FLOATER * areas.max()).sum()),
        "inside_out": int((closed & (np.bincount(component, volume) < 0)).sum()),
    }


def _redundant_vertices(mesh: Mesh) -> dict[str, Any]:
    """Return the counts of vertices that equal another one in position, normal and UV, and of vertices without a face."""
    different = len(np.unique(np.c_[mesh.vertices, mesh.normals, mesh.uvs], axis=0))
    return {
        "doubled_vertices": len(mesh.vertices) - different,
        "unused_vertices": len(mesh.vertices) - len(np.unique(mesh.faces)),
    }


def _longest(corner: np.ndarray) -> np.ndarray:
    """Return the longest edge (F,) of triangles (F, 3, 3)."""
    return np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=-1).max(-1)


def _near(points: np.ndarray, distance: float) -> int:
    """Count the points that have another one within a distance."""
    pairs = KDTree(points).query_pairs(distance, output_type="ndarray")
    return len(np.unique(pairs))

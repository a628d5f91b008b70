# SPDX-License-Identifier: GPL-3.0-or-later
"""Repair of a mesh: small holes filled, edges and vertices made manifold, folded faces unfolded."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from . import topology
from .meshing import Triangles, cleaned, unit, vertex_normals

PULL_FRACTION = 0.05  # of the way to its neighbours' mean by which a vertex that is divided moves, so that its copies are apart
MAX_ROUNDS = 8  # a division can leave another one to do
MAX_UNFOLDING_STEPS = 10  # smoothing steps of the vertices of folded faces
STEP_FRACTION = 0.5  # of the way to the neighbours' mean, in one of these steps
NORMAL_AVERAGES = 1  # times that normals are averaged with their neighbours': the normal of a vertex folded over an edge is nearly zero
AFFECTED_RINGS = 2 + NORMAL_AVERAGES  # rings of faces around folded faces that may fold or unfold when the vertices of these move
SUPPORT_RINGS = AFFECTED_RINGS + 1 + NORMAL_AVERAGES  # rings of faces that have to be known to compute the normals of the affected faces


def fill_holes(mesh: Triangles, longest: float) -> Triangles:
    """Fill holes, each by a fan of triangles around its centre.

    Args:
        mesh: mesh, which may have open borders.
        longest: border of a hole, world units; longer ones are ends of the surface and stay open.
    """
    edges = topology.edges_of(mesh.faces)
    sides = np.nonzero(edges.border[edges.of_side])[0]
    if not len(sides):
        return mesh
    corner = mesh.faces.reshape(-1)
    begin, end = corner[sides], corner[sides - sides % 3 + (sides + 1) % 3]
    loop, count = topology.border_loops(edges)
    loop = loop[np.searchsorted(np.nonzero(edges.border)[0], edges.of_side[sides])]
    length = np.bincount(loop, np.linalg.norm(mesh.vertices[end] - mesh.vertices[begin], axis=-1), count)
    simple = _each_vertex_once(begin, loop, count) & _each_vertex_once(end, loop, count)
    chosen = np.nonzero(simple & (length < longest))[0]
    centre = [mesh.vertices[begin[loop == one]].mean(0) for one in chosen]
    number = np.full(count, -1)
    number[chosen] = len(mesh.vertices) + np.arange(len(chosen))
    kept = number[loop] >= 0
    fans = np.stack([end[kept], begin[kept], number[loop[kept]]], -1)
    return Triangles(np.concatenate([mesh.vertices, np.reshape(centre, (-1, 3))]), np.concatenate([mesh.faces, fans]))


def _each_vertex_once(vertex: np.ndarray, loop: np.ndarray, count: int) -> np.ndarray:
    """Return (count,) bool: loops in which no vertex is repeated."""
    repeated = np.bincount(vertex)[vertex] > 1
    return np.bincount(loop, repeated, count) == 0


def make_manifold(mesh: Triangles) -> Triangles:
    """Divide the vertices where sheets of the surface touch, and move the copies apart by a fraction of an edge.

    At an edge of 2 n faces the faces are paired so that each pair bounds one wedge of the solid.

    Args:
        mesh: without repeated faces. Edges of an odd number of faces get an open border.
    """
    for _ in range(MAX_ROUNDS):
        edges = topology.edges_of(mesh.faces)
        pairs = _paired_sides(mesh, edges)
        divided = _divided(mesh, topology.joined_corners(mesh.faces, pairs))
        if divided is mesh and not edges.non_manifold.any():
            break
        mesh = divided if divided is not mesh else _bisected(mesh, edges)
    return mesh


def _bisected(mesh: Triangles, edges: topology.Edges) -> Triangles:
    """Divide edges of several faces, and these faces, in the middle: sheets that hang together at both ends can be parted there."""
    sides = np.nonzero(edges.non_manifold[edges.of_side])[0]
    taken, chosen = set[int](), []
    for edge in np.unique(edges.of_side[sides]):  # a face is divided once a round
        own = sides[edges.of_side[sides] == edge]
        if taken.isdisjoint(own // 3):
            taken.update(own // 3)
            chosen.append(own)
    side = np.concatenate(chosen)
    middle = np.repeat(len(mesh.vertices) + np.arange(len(chosen)), [len(own) for own in chosen])
    corner = mesh.faces.reshape(-1)
    a, b, c = (corner[side - side % 3 + (side + k) % 3] for k in range(3))
    rest = np.delete(mesh.faces, side // 3, axis=0)
    points = mesh.vertices[edges.vertices[edges.of_side[[own[0] for own in chosen]]]].mean(1)
    halves = np.stack([a, middle, c], -1), np.stack([middle, b, c], -1)
    return Triangles(np.concatenate([mesh.vertices, points]), np.concatenate([rest, *halves]))


def _paired_sides(mesh: Triangles, edges: topology.Edges) -> np.ndarray:
    """Return sides (P, 2) of faces that stay connected across each edge."""
    sides, _ = edges.pairs()
    found = [sides]
    order = np.argsort(edges.of_side, kind="stable")
    begin = np.searchsorted(edges.of_side[order], np.nonzero(edges.non_manifold)[0])
    for edge, first in zip(np.nonzero(edges.non_manifold)[0], begin, strict=True):
        around = order[first : first + edges.faces[edge]]
        found.append(_pairs_around(mesh, edges.vertices[edge], around, edges.forward[around]))
    return np.concatenate(found)


def _pairs_around(mesh: Triangles, edge: np.ndarray, sides: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """Pair the sides of faces around an edge (2,): each that has the solid in front, in the order of angles, with the next behind."""
    origin, axis = mesh.vertices[edge[0]], unit(mesh.vertices[edge[1]] - mesh.vertices[edge[0]])
    tip = mesh.vertices[mesh.faces.reshape(-1)[sides - sides % 3 + (sides + 2) % 3]] - origin
    tip = tip - (tip @ axis)[:, None] * axis
    across = unit(tip[0])
    angle = np.arctan2(tip @ np.cross(axis, across), tip @ across)
    order = np.argsort(angle, kind="stable")
    sides, forward = sides[order], forward[order]
    # A face whose side runs along the axis has its outside at smaller angles, so the solid lies at larger ones, up to the next face.
    waiting = [i for i in range(len(sides)) if forward[i] and not forward[(i + 1) % len(sides)]]
    return np.array([(sides[i], sides[(i + 1) % len(sides)]) for i in waiting]).reshape(-1, 2)


def _divided(mesh: Triangles, label: np.ndarray) -> Triangles:
    """Give each label (3 F,) of corners a vertex of its own; vertices that become several move towards their own neighbours."""
    corner = mesh.faces.reshape(-1)
    kept, first, index = np.unique(label, return_index=True, return_inverse=True)
    if len(kept) == len(mesh.vertices):
        return mesh
    source = corner[first]
    order = np.argsort(source, kind="stable")
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    faces, source = place[index.reshape(-1)].reshape(-1, 3), source[order]
    several = (np.bincount(source, minlength=len(mesh.vertices)) > 1)[source]
    vertices = mesh.vertices[source]
    mean = neighbour_mean(Triangles(vertices, faces))
    vertices[several] += PULL_FRACTION * (mean - vertices)[several]
    return Triangles(vertices, faces)


def neighbour_mean(mesh: Triangles) -> np.ndarray:
    """Return the mean (V, 3) of each vertex's neighbours; those on an edge of two faces count twice."""
    i, j = mesh.faces[:, [0, 1, 2, 1, 2, 0]].reshape(-1), mesh.faces[:, [1, 2, 0, 0, 1, 2]].reshape(-1)
    matrix = sparse.csr_matrix((np.ones(len(i)), (i, j)), shape=(len(mesh.vertices),) * 2)
    return (matrix @ mesh.vertices) / np.maximum(np.asarray(matrix.sum(1)), 1)


def unfold(mesh: Triangles) -> Triangles:
    """Move the vertices of faces that are turned away from the surface around them along it until none is; other vertices stay."""
    turned = folded_faces(mesh, vertex_normals(mesh, NORMAL_AVERAGES))
    for _ in range(MAX_UNFOLDING_STEPS):
        if not turned.any():
            break
        # What a vertex's move changes is near it: only the faces around are looked at again.
        chosen = np.nonzero(near_faces(mesh, turned, SUPPORT_RINGS))[0]
        corner, faces = np.unique(mesh.faces[chosen], return_inverse=True)
        part = Triangles(mesh.vertices[corner], faces.reshape(-1, 3))
        moving = np.unique(part.faces[turned[chosen]])
        normals = vertex_normals(part, NORMAL_AVERAGES)[moving]
        step = STEP_FRACTION * (neighbour_mean(part) - part.vertices)[moving]
        part.vertices[moving] += step - (step * normals).sum(-1, keepdims=True) * normals
        vertices = mesh.vertices.copy()
        vertices[corner] = part.vertices
        mesh = Triangles(vertices, mesh.faces)
        again = near_faces(mesh, turned, AFFECTED_RINGS)
        now = turned.copy()
        now[chosen] = folded_faces(part, vertex_normals(part, NORMAL_AVERAGES))
        turned = np.where(again, now, turned)
    return mesh


def near_faces(mesh: Triangles, faces: np.ndarray, rings: int) -> np.ndarray:
    """Return (F,) bool: the given faces (F,) bool, and as many rings of faces around them that share a vertex."""
    for _ in range(rings):
        vertices = np.zeros(len(mesh.vertices), np.bool_)
        vertices[mesh.faces[faces]] = True
        faces = vertices[mesh.faces].any(-1)
    return faces


def remove_folds(mesh: Triangles, longest: float) -> Triangles:
    """Unfold a mesh, and collapse the shortest edge of faces that stay folded.

    Args:
        mesh: mesh, which may have open borders.
        longest: border of a hole, world units, see `fill_holes`: where three sheets meet after a collapse, a division leaves a hole.
    """
    for _ in range(MAX_ROUNDS):
        mesh = unfold(mesh)
        turned = folded_faces(mesh, vertex_normals(mesh, NORMAL_AVERAGES))
        if not turned.any():
            break
        mesh = fill_holes(make_manifold(cleaned(_collapsed(mesh, turned))), longest)
    return mesh


def _collapsed(mesh: Triangles, chosen: np.ndarray) -> Triangles:
    """Collapse the shortest edge of the chosen faces (F,) bool, as far as they share no vertex, to its middle."""
    faces = mesh.faces[chosen]
    corner = mesh.vertices[faces]
    shortest = np.linalg.norm(corner - np.roll(corner, -1, axis=1), axis=-1).argmin(-1)
    vertices, target = mesh.vertices.copy(), np.arange(len(mesh.vertices))
    for face, k in zip(faces, shortest, strict=True):
        kept, removed = face[k], face[(k + 1) % 3]
        if (target[face] == face).all() and not np.isin(face, target[target != np.arange(len(target))]).any():
            vertices[kept] = (vertices[kept] + vertices[removed]) / 2
            target[removed] = kept
    return Triangles(vertices, target[mesh.faces])


def facing_normals(mesh: Triangles, normals: np.ndarray) -> np.ndarray:
    """Replace the normals of faces that all three turn away from by the mesh's own, so that no face is shaded from behind.

    Args:
        mesh: V vertices.
        normals: (V, 3) unit normals.

    Returns:
        (V, 3) unit normals.
    """
    own, normals = vertex_normals(mesh), normals.copy()
    for _ in range(MAX_ROUNDS):
        wrong = np.unique(mesh.faces[folded_faces(mesh, normals)])
        if not len(wrong) or np.array_equal(normals[wrong], own[wrong]):
            break
        normals[wrong] = own[wrong]
    return normals


def folded_faces(mesh: Triangles, normals: np.ndarray) -> np.ndarray:
    """Return (F,) bool: faces turned away from the normals (V, 3) of all three vertices."""
    corner = mesh.vertices[mesh.faces]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return ((normals[mesh.faces] * cross[:, None]).sum(-1) < 0).all(-1)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Origin of an imported object at its foot, and the way back to the run's frame, also after the user has set another origin."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

ORIGIN = "irgspp_origin"  # custom property of the object: its origin in the run's frame (3 numbers)
REFERENCES = "irgspp_references"  # custom property of the object: number of vertices, and places of a few of them in the run's frame
REFERENCE_COUNT = 12
FITS = 1e-4  # distance of a reference vertex from its place, as a fraction of the object's size, at most


def set_origin(thing: bpy.types.Object, before: Matrix, origin: np.ndarray) -> None:
    """Note the origin of an object's new mesh, and move the object so that the mesh is where the one before was.

    Args:
        thing: object whose mesh was just replaced.
        before: `mesh_to_run` of the object before; the identity for a new object.
        origin: (3,) of the mesh, in the run's frame.
    """
    thing.matrix_basis = thing.matrix_basis @ before.inverted() @ Matrix.Translation(origin.tolist())
    thing[ORIGIN] = np.asarray(origin, float).tolist()
    count = len(thing.data.vertices)
    thing[REFERENCES] = [float(count), *(_vertices(thing, _chosen(count)) + origin).reshape(-1).tolist()]


def mesh_to_run(thing: bpy.types.Object) -> Matrix:
    """Return the similarity (4, 4) from the mesh's own coordinates to the run's frame; the identity for objects of earlier versions.

    It is found from a few vertices, so that *Set Origin* and *Apply Transform* do no harm. Where the mesh was edited, its vertices tell
    nothing, and the origin of the import counts.

    Args:
        thing: imported object, original or evaluated.
    """
    if ORIGIN not in thing:
        return Matrix()
    imported = Matrix.Translation(list(thing[ORIGIN]))
    known = np.array(thing.get(REFERENCES, (0.0,)), float)
    places = known[1:].reshape(-1, 3)
    if not len(places) or len(thing.original.data.vertices) != int(known[0]):
        return imported
    now = _vertices(thing.original, _chosen(int(known[0])))
    size = float(np.linalg.norm(np.ptp(places, axis=0))) or 1.0
    for step in (np.array(imported), _similarity(now, places)):
        if np.abs(now @ step[:3, :3].T + step[:3, 3] - places).max() < FITS * size:
            return Matrix(step.tolist())
    return imported


def _chosen(count: int) -> np.ndarray:
    """Return the indices of the reference vertices among `count`, evenly spread."""
    return np.unique(np.linspace(0, count - 1, REFERENCE_COUNT).astype(int)) if count else np.zeros(0, int)


def _vertices(thing: bpy.types.Object, indices: np.ndarray) -> np.ndarray:
    return np.array([thing.data.vertices[int(i)].co for i in indices], float).reshape(-1, 3)


def _similarity(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the similarity (4, 4) that maps points (P, 3) to others by least squares (Umeyama 1991)."""
    centre, to = source.mean(0), target.mean(0)
    u, s, vt = np.linalg.svd((target - to).T @ (source - centre))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float((s * sign).sum() / max(((source - centre) ** 2).sum(), 1e-30))
    step = np.eye(4)
    step[:3, :3] = scale * rotation
    step[:3, 3] = to - step[:3, :3] @ centre
    return step

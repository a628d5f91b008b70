# SPDX-License-Identifier: GPL-3.0-or-later
"""Collision hulls: a few convex solids that together fill the object, as physics engines want them."""

from __future__ import annotations

import importlib
import importlib.util

import numpy as np
from trimesh import Trimesh
from trimesh.convex import convex_hull

from ..errors import IrgsppError
from ..progress.protocol import Progress
from ..scene.mesh import Mesh
from ..surface import topology
from ..surface.meshing import Triangles, cleaned, compacted, decimated

MOST, CORNERS = 16, 64  # convex solids, and vertices of each, at most
TRIANGLES = 3000  # of the mesh that is taken apart: convex solids need no detail
CONCAVITY = 0.1  # distance that a solid may stand off the surface, relative to the object's size, as CoACD counts it
SEARCH = {"resolution": 1000, "mcts_iterations": 60, "mcts_nodes": 15}  # of CoACD; its defaults take ten times as long

Hull = tuple[np.ndarray, np.ndarray]  # vertices (V, 3) and faces (F, 3)


def collision_hulls(mesh: Mesh, progress: Progress) -> list[Hull]:
    """Take a mesh apart into convex solids (CoACD, Wei et al. 2022); without the package coacd, one hull for each connected component.

    Args:
        mesh: the asset's mesh.
        progress: receives the phase, and a message where coacd is not installed.

    Raises:
        IrgsppError: if no solid is found.
    """
    progress.phase("collision hulls", 0)
    points, welded = np.unique(mesh.vertices.astype(np.float64), axis=0, return_inverse=True)
    coarse = cleaned(decimated(Triangles(points, welded.reshape(-1)[mesh.faces].astype(np.int64)), TRIANGLES))
    if importlib.util.find_spec("coacd") is not None:
        hulls = _convex_parts(coarse)
    else:
        progress.message("the Python package coacd is not installed: each connected part of the object gets one convex hull")
        hulls = [_hull(part) for part in _components(coarse)]
    if not hulls:
        raise IrgsppError("collision hulls: the mesh has no convex parts; check it by `irgspp evaluate RUN --asset`")
    return hulls


def _convex_parts(mesh: Triangles) -> list[Hull]:
    coacd = importlib.import_module("coacd")
    coacd.set_log_level("error")
    options = {"threshold": CONCAVITY, "max_convex_hull": MOST, "decimate": True, "max_ch_vertex": CORNERS, "seed": 0, **SEARCH}
    parts = coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.faces), **options)
    return [(np.asarray(vertices, np.float64), np.asarray(faces, np.int64)) for vertices, faces in parts]


def _components(mesh: Triangles) -> list[Triangles]:
    """Return the connected components, the MOST largest first."""
    label = topology.face_components(mesh.faces, topology.edges_of(mesh.faces))
    corner = mesh.vertices[mesh.faces]
    area = np.bincount(label, np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=-1))
    return [compacted(Triangles(mesh.vertices, mesh.faces[label == one])) for one in np.argsort(-area, kind="stable")[:MOST]]


def _hull(mesh: Triangles) -> Hull:
    """Return the convex hull of at most CORNERS vertices: those farthest along evenly spread directions."""
    whole = convex_hull(Trimesh(mesh.vertices, mesh.faces, process=False))
    if len(whole.vertices) > CORNERS:
        z = 1 - 2 * (np.arange(CORNERS) + 0.5) / CORNERS
        angle = np.arange(CORNERS) * 2.39996322972865
        spread = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)
        points = np.asarray(whole.vertices)
        whole = convex_hull(points[np.unique((points @ spread.T).argmax(0))])
    return np.asarray(whole.vertices, np.float64), np.asarray(whole.faces, np.int64)

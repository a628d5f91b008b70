# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender mesh of a run's mesh.ply: welded UV seams, quads, normals, and the materials at the vertices as attributes."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ...core.errors import InputError
from ...core.scene.gbuffer import CONFIDENCE
from ...core.scene.similarity import moved_points
from .confidence_view import ATTRIBUTE
from .ply import read_ply

COLUMNS = ("x", "y", "z", "nx", "ny", "nz", "s", "t", "albedo_r", "albedo_g", "albedo_b", "roughness", "metallic", "vertex_indices")
QUAD = "quad"  # property of faces: this triangle and the next one make up a quad
COVERAGE = "confidence"  # column that runs of version 0.1 lack


def read_mesh(path: Path) -> dict[str, np.ndarray]:
    """Read the elements "vertex" and "face" of a mesh.ply.

    Args:
        path: mesh.ply of a run.

    Raises:
        InputError: if the file is missing or no mesh of a run.
    """
    elements = read_ply(path)
    found = [name for element in ("vertex", "face") if element in elements for name in elements[element].dtype.names or ()]
    missing = [name for name in COLUMNS if name not in found]
    if missing:
        raise InputError(path, f"lacks {', '.join(missing)}", "choose the folder of a finished run")
    return elements


def textured_mesh(path: Path, name: str, matrix: np.ndarray, tiles: int = 1) -> bpy.types.Mesh:
    """Build the mesh of a run with its UVs and normals, without the materials at its vertices.

    Args:
        path: mesh.ply of the run.
        name: of the mesh.
        matrix: (4, 4) that the vertices are multiplied by.
        tiles: UDIM tiles along a side, up to which the UVs reach.

    Raises:
        InputError: if the file is missing or no mesh of a run.
    """
    mesh = built_mesh(read_mesh(path), name, matrix, tiles)
    for name in ("albedo", "roughness", "metallic", COVERAGE, ATTRIBUTE):
        if name in mesh.attributes:
            mesh.attributes.remove(mesh.attributes[name])
    return mesh


def built_mesh(elements: dict[str, np.ndarray], name: str, matrix: np.ndarray, tiles: int = 1) -> bpy.types.Mesh:
    """Build the mesh with welded UV seams, a connected surface for sculpting and smoothing: Blender stores UVs per corner.

    Args:
        elements: of mesh.ply.
        name: of the mesh.
        matrix: (4, 4) that the vertices are multiplied by.
        tiles: UDIM tiles along a side, up to which the UVs reach.
    """
    vertex, face = elements["vertex"], elements["face"]
    corners, sizes = _polygons(face)
    positions, first, welded = np.unique(columns(vertex, "x", "y", "z"), axis=0, return_index=True, return_inverse=True)
    mesh = bpy.data.meshes.new(name)
    set_polygons(mesh, moved_points(positions, matrix), welded.reshape(-1)[corners], sizes)
    uv = mesh.uv_layers.new(name="UVMap")
    uv.data.foreach_set("uv", (tiles * columns(vertex, "s", "t")[corners]).reshape(-1))
    _set_attributes(mesh, vertex[first])
    mesh.shade_smooth()
    mesh.update()
    normals = columns(vertex[first], "nx", "ny", "nz") @ np.linalg.inv(matrix[:3, :3])
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    mesh.normals_split_custom_set_from_vertices(normals.tolist())
    return mesh


def _polygons(face: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners (L,) of the polygons one after another, and their numbers: 4 where two triangles are marked as a quad."""
    triangles = face["vertex_indices"].astype(np.int64)
    quads = face[QUAD].astype(bool) if QUAD in face.dtype.names else np.zeros(len(face), bool)
    quads[-1:] = False  # there is no next one
    rows = np.concatenate([triangles, np.roll(triangles, -1, axis=0)[:, 2:]], -1)
    begins = ~np.append([False], quads[:-1])
    sizes = np.where(quads, 4, 3)[begins]
    return rows[begins][np.arange(4) < sizes[:, None]], sizes


def set_polygons(mesh: bpy.types.Mesh, positions: np.ndarray, corners: np.ndarray, sizes: np.ndarray) -> None:
    """Set vertices and polygons as `from_pydata` does, without a Python object for each number.

    Args:
        mesh: empty mesh.
        positions: (V, 3).
        corners: (L,) indices of vertices, all valid, polygon after polygon.
        sizes: (P,) number of corners of each polygon.
    """
    mesh.vertices.add(len(positions))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(positions, np.float32).reshape(-1))
    mesh.loops.add(len(corners))
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(corners, np.int32))
    mesh.polygons.add(len(sizes))
    mesh.polygons.foreach_set("loop_start", (np.cumsum(sizes) - sizes).astype(np.int32))
    mesh.update(calc_edges=True)


def _set_attributes(mesh: bpy.types.Mesh, vertex: np.ndarray) -> None:
    if set(CONFIDENCE) <= set(vertex.dtype.names):
        _set_colour(mesh, ATTRIBUTE, columns(vertex, *CONFIDENCE))
    _set_colour(mesh, "albedo", columns(vertex, "albedo_r", "albedo_g", "albedo_b"))
    mesh.color_attributes.active_color = mesh.color_attributes["albedo"]
    for name in ("roughness", "metallic", *({COVERAGE} & set(vertex.dtype.names))):
        mesh.attributes.new(name, "FLOAT", "POINT").data.foreach_set("value", columns(vertex, name)[:, 0])


def _set_colour(mesh: bpy.types.Mesh, name: str, rgb: np.ndarray) -> None:
    """Add a colour attribute with the values (N, 3)."""
    attribute = mesh.color_attributes.new(name, "FLOAT_COLOR", "POINT")
    attribute.data.foreach_set("color", np.c_[rgb, np.ones(len(rgb), np.float32)].reshape(-1))


def columns(vertex: np.ndarray, *names: str) -> np.ndarray:
    """Return columns of a PLY element as (N, len(names)) float32.

    Args:
        vertex: structured array of the element.
        *names: of the columns.
    """
    return np.stack([vertex[name] for name in names], -1).astype(np.float32)

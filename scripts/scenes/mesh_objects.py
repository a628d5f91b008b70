# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh objects of procedural scenes, smooth and with one material."""

from __future__ import annotations

from itertools import pairwise
from math import tau

import bmesh
import bpy
import numpy as np


def empty_file() -> None:
    """Begin an empty file, whatever the user's start-up file holds."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def finished(thing: bpy.types.Object, material: bpy.types.Material, smooth: bool = True) -> bpy.types.Object:
    """Give an object its only material, shade it smooth or flat, and return it."""
    if smooth:
        thing.data.shade_smooth()
    thing.data.materials.append(material)
    return thing


def linked(name: str, shape: bmesh.types.BMesh) -> bpy.types.Object:
    """Return a new object of the scene with this shape, which is freed."""
    mesh = bpy.data.meshes.new(name)
    shape.to_mesh(mesh)
    shape.free()
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def revolved(name: str, profile: np.ndarray, segments: int = 160) -> bpy.types.Object:
    """Return the closed surface that a profile sweeps around the z axis.

    Args:
        name: name of the object.
        profile: (K, 2) distance from the axis and height; the first and the last point lie on the axis.
        segments: faces around the axis.
    """
    shape = bmesh.new()
    corners = [shape.verts.new((radius, 0.0, height)) for radius, height in profile]
    edges = [shape.edges.new(pair) for pair in pairwise(corners)]
    bmesh.ops.spin(shape, geom=[*corners, *edges], cent=(0, 0, 0), axis=(0, 0, 1), angle=tau, steps=segments, use_merge=True)
    bmesh.ops.remove_doubles(shape, verts=shape.verts, dist=1e-6)
    bmesh.ops.recalc_face_normals(shape, faces=shape.faces)
    return linked(name, shape)

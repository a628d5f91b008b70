# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene of the kind "relief": a stone of almost one colour with rough ground, carved grooves and pits that no silhouette shows."""

from __future__ import annotations

import bmesh
import bpy
import numpy as np
from mathutils import Vector, noise

from .mesh_objects import empty_file, finished, linked
from .shader_nodes import dielectric

SHAPE = np.array([1.02, 0.94, 1.06])  # half axes of the stone before it is carved
STONE = [(0.36, (0.43, 0.39, 0.33)), (0.50, (0.50, 0.46, 0.40)), (0.64, (0.57, 0.51, 0.43))]
# Each groove runs along a wavy circle of the sphere: axis of the circle, its height on that axis.
GROOVES = (((0.2, 0.1, 1.0), 0.28), ((-0.3, 0.2, 1.0), -0.36), ((1.0, 0.35, 0.25), 0.15), ((-0.45, 1.0, 0.3), -0.3))
GROOVE_DEPTH, GROOVE_WIDTH, GROOVE_WALL = 0.13, 0.045, 0.05  # the floor's half width, and the width of each wall
PITS, PIT_SIZES, PIT_DEPTH = 20, (0.13, 0.26), 0.95  # number; radii in radians; depth as a factor of the radius
SEED = 11


def build_relief_scene(subdivisions: int = 8) -> list[bpy.types.Object]:
    """Fill an empty file with the stone, inside radius 1.3 around the origin, and return it.

    Args:
        subdivisions: of the icosahedron; each one more has four times the triangles.
    """
    empty_file()
    shape = bmesh.new()
    bmesh.ops.create_icosphere(shape, subdivisions=subdivisions, radius=1.0)
    directions = np.array([v.co for v in shape.verts], np.float64)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    for vertex, place in zip(shape.verts, stone_points(directions), strict=True):
        vertex.co = place
    stone = dielectric("stone", (6.0, 9.0), STONE, (0.4, 0.6), detail=4.0)
    return [finished(linked("stone", shape), stone)]


def stone_points(directions: np.ndarray) -> np.ndarray:
    """Return the stone's surface along unit directions (N, 3) from its centre, (N, 3)."""
    lumps = 0.09 * _octaves(1.7 * directions + 4.0, 3)
    grain = 0.03 * _octaves(6.5 * directions + 7.0, 5)
    carved = np.maximum(groove_depths(directions), pit_depths(directions))
    return SHAPE * directions * (1 + lumps + grain - carved)[:, None]


def groove_depths(directions: np.ndarray) -> np.ndarray:
    """Return the depth of the grooves along unit directions (N, 3), (N,): a flat floor between steep walls."""
    wobble = 0.09 * _octaves(2.3 * directions + 12.0, 2)
    depth = np.zeros(len(directions))
    for axis, height in GROOVES:
        away = np.abs(directions @ (np.array(axis) / np.linalg.norm(axis)) - height + wobble)
        depth = np.maximum(depth, GROOVE_DEPTH * _falling(away, GROOVE_WIDTH, GROOVE_WIDTH + GROOVE_WALL))
    return depth


def pit_depths(directions: np.ndarray) -> np.ndarray:
    """Return the depth of the pits along unit directions (N, 3), (N,): round bowls, spread over the whole stone."""
    random = np.random.default_rng(SEED)
    depth = np.zeros(len(directions))
    for k in range(PITS):
        z, azimuth = 1 - 2 * (k + random.uniform(0.2, 0.8)) / PITS, 2.399963 * k + random.uniform(-0.3, 0.3)
        r = np.sqrt(1 - z * z)
        radius = random.uniform(*PIT_SIZES)
        away = np.arccos(np.clip(directions @ (r * np.cos(azimuth), r * np.sin(azimuth), z), -1, 1)) / radius
        depth = np.maximum(depth, PIT_DEPTH * radius * _falling(away, 0.25, 1.0))
    return depth


def _octaves(points: np.ndarray, octaves: int) -> np.ndarray:
    """Return Perlin noise of several octaves at points (N, 3), about -1..1, (N,)."""
    return np.array([noise.fractal(Vector(point), 1.0, 2.1, octaves, noise_basis="PERLIN_ORIGINAL") for point in points])


def _falling(value: np.ndarray, start: float, end: float) -> np.ndarray:
    """Return a smooth step from 1 up to `start` to 0 from `end` on."""
    t = np.clip((end - value) / (end - start), 0, 1)
    return t * t * (3 - 2 * t)

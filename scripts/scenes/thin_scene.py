# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene of the kind "thin": a basket of wire on a thin plate, a brass chain over its rim, and two leaves on stems."""

from __future__ import annotations

from itertools import pairwise
from math import pi, tau

import bmesh
import bpy
import numpy as np

from .mesh_objects import empty_file, finished, linked, revolved
from .shader_nodes import dielectric, metal

WIRE = 0.028  # radius of the basket's wires
HEIGHTS = (-0.62, -0.40, -0.15, 0.10, 0.32)  # of the basket's rings
RIBS = 14  # upright wires
PLATE = (0.98, 0.03)  # radius and thickness
LINK = (0.105, 0.028)  # radii of a link of the chain
PAINT = [(0.36, (0.04, 0.16, 0.36)), (0.48, (0.16, 0.38, 0.52)), (0.56, (0.62, 0.60, 0.50)), (0.66, (0.60, 0.20, 0.06))]
WOOD = [(0.38, (0.22, 0.11, 0.05)), (0.50, (0.44, 0.26, 0.12)), (0.62, (0.62, 0.44, 0.24))]
GREEN = [(0.36, (0.03, 0.14, 0.03)), (0.50, (0.12, 0.34, 0.06)), (0.64, (0.45, 0.50, 0.10))]


def build_thin_scene() -> list[bpy.types.Object]:
    """Fill an empty file with the plate and the things on it, inside radius 1.3 around the origin, and return them."""
    empty_file()
    paint = dielectric("paint", (5.0, 3.0), PAINT, (0.4, 0.6), detail=2.0)
    leaf = dielectric("leaf", (6.0, 7.0), GREEN, (0.35, 0.55), detail=3.0)
    plate = finished(revolved("plate", plate_profile()), dielectric("plate", (4.0, 11.0), WOOD, (0.5, 0.7), detail=3.0))
    wires = [finished(tube(f"wire {i}", path, WIRE, closed), paint) for i, (path, closed) in enumerate(basket())]
    chain = [finished(_link(*place), metal("brass", (0.86, 0.62, 0.27), (0.25, 0.38), offset=4.0)) for place in chain_links()]
    leaves = [finished(sheet(f"leaf {i}", turn), leaf) for i, turn in enumerate((0.5, 2.9))]
    return [plate, *wires, *chain, *leaves]


def plate_profile() -> np.ndarray:
    """Return the outline of the plate from its lower to its upper middle, radius and height, (8, 2)."""
    radius, thickness = PLATE
    top = HEIGHTS[0] - WIRE
    low, edge = top - thickness, thickness / 4
    outer = [(radius - edge, low), (radius, low + edge), (radius, top - edge), (radius - edge, top)]
    # Smooth shading turns the normals only between the edge and the rings of points beside it: the plate is shaded as flat as it is.
    inner = [(radius - 2 * edge, height) for height in (low, top)]
    return np.array([(0.0, low), inner[0], *outer, inner[1], (0.0, top)])


def basket_radius(height: np.ndarray) -> np.ndarray:
    """Return the radius of the basket at heights, both (N,)."""
    up = (height - HEIGHTS[0]) / (HEIGHTS[-1] - HEIGHTS[0])
    return 0.52 + 0.34 * up - 0.10 * np.sin(pi * up)


def basket() -> list[tuple[np.ndarray, bool]]:
    """Return the middle lines (N, 3) of the basket's rings and ribs, and whether each is closed."""
    turn, height = np.linspace(0, tau, 96, endpoint=False), np.linspace(HEIGHTS[0], HEIGHTS[-1], 40)
    circle = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], -1)
    rings = [(circle * basket_radius(np.array([z]))[0] + [0, 0, z], True) for z in HEIGHTS]
    ribs = []
    for i in range(RIBS):
        angle = tau * i / RIBS + 0.5 * (height - HEIGHTS[0])  # twisted
        radius = basket_radius(height)
        ribs.append((np.stack([radius * np.cos(angle), radius * np.sin(angle), height], -1), False))
    return rings + ribs


def chain_links() -> list[tuple[tuple[float, float, float], float, float]]:
    """Return place, turn about the z axis and roll of the links of a chain that hangs over the rim, inside and outside."""
    places, spacing = [], 1.55 * LINK[0]
    rim, radius = HEIGHTS[-1] + WIRE + LINK[1], float(basket_radius(np.array([HEIGHTS[-1]]))[0])
    for i in range(-4, 5):
        down = abs(i) * spacing
        along = radius + np.sign(i) * min(abs(i), 1) * 0.09
        places.append(((along * np.cos(-0.8), along * np.sin(-0.8), rim - down + 0.06), -0.8, i % 2 * pi / 2))
    return places


def _link(place: tuple[float, float, float], turn: float, roll: float) -> bpy.types.Object:
    """Return one upright link of the chain."""
    sizes = {"major_radius": LINK[0], "minor_radius": LINK[1], "major_segments": 48, "minor_segments": 16}
    bpy.ops.mesh.primitive_torus_add(location=place, rotation=(pi / 2, 0.0, turn + roll), **sizes)
    return bpy.context.object


def tube(name: str, path: np.ndarray, radius: float, closed: bool) -> bpy.types.Object:
    """Return a round tube around a path, with closed ends.

    Args:
        name: name of the object.
        path: (N, 3) middle line.
        radius: of the tube.
        closed: the path ends where it begins.
    """
    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions, curve.bevel_depth, curve.bevel_resolution, curve.use_fill_caps = "3D", radius, 6, True
    spline = curve.splines.new("POLY")
    spline.points.add(len(path) - 1)
    spline.points.foreach_set("co", np.concatenate([path, np.ones((len(path), 1))], 1).astype(np.float32).ravel())
    spline.use_cyclic_u = closed
    bent = bpy.data.objects.new(name, curve)
    bpy.context.scene.collection.objects.link(bent)
    mesh = bpy.data.meshes.new_from_object(bent.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    bpy.data.objects.remove(bent)
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def sheet(name: str, turn: float, thickness: float = 0.014) -> bpy.types.Object:
    """Return a bent leaf that rises from the basket's middle outwards.

    Args:
        name: name of the object.
        turn: its direction around the z axis, radians.
        thickness: of the sheet.
    """
    along, across = np.meshgrid(np.linspace(0, 1, 40), np.linspace(-1, 1, 17), indexing="ij")
    width = 0.24 * np.sin(pi * np.clip(along, 0.02, 0.985) ** 0.8) + 0.012
    out = 0.10 + 0.62 * along
    up = HEIGHTS[0] + 1.55 * along - 0.75 * along**3 + 0.16 * across**2 * width / 0.24
    side = across * width
    points = np.stack([out * np.cos(turn) - side * np.sin(turn), out * np.sin(turn) + side * np.cos(turn), up], -1)
    shape = bmesh.new()
    corners = [[shape.verts.new(point) for point in row] for row in points]
    for a, b in pairwise(corners):
        for (a0, a1), (b0, b1) in zip(pairwise(a), pairwise(b), strict=True):
            shape.faces.new((a0, b0, b1, a1))
    shape.normal_update()  # along which the sheet is made thick
    bmesh.ops.solidify(shape, geom=shape.faces[:], thickness=thickness)
    bmesh.ops.recalc_face_normals(shape, faces=shape.faces)
    return linked(name, shape)

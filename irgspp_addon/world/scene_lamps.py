# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps of a Blender scene as the engine's lamps, with the radiometry of Cycles."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import bpy
import numpy as np

from ...core.scene.lamps import IDENTITY, Kind, Lamp
from .shader_nodes import uses_nodes

KINDS: dict[str, Kind] = {"SUN": "sun", "POINT": "point", "SPOT": "spot", "AREA": "area"}
UNSHADED = 4.0  # Cycles' factor of a point or spot lamp of radius 0 whose power is not normalised by its size
SMALLEST = 1e-6  # side of an area lamp that is not smaller than this, metres


def scene_lamps(
    things: Iterable[bpy.types.Object], lit: bpy.types.Object | None, depsgraph: bpy.types.Depsgraph | None = None
) -> tuple[Lamp, ...]:
    """Return the lamps among objects, in Blender's world.

    Args:
        things: objects, original ones.
        lit: the object that they light, for light linking; None: any.
        depsgraph: dependency graph of a final render, from which animated values are read; None: the values that Blender shows.
    """
    lamps = []
    for thing in things:
        if not is_lamp(thing) or not _linked(thing, lit, "receiver_collection"):
            continue
        placed = thing.evaluated_get(depsgraph) if depsgraph is not None else thing
        lamp = _lamp(placed, _linked(thing, lit, "blocker_collection"))
        if lamp is not None and any(lamp.emission):
            lamps.append(lamp)
    return tuple(lamps)


def is_lamp(thing: bpy.types.Object) -> bool:
    """Return True for a lamp whose light the engine knows: not one with nodes beyond an Emission, and no portal."""
    if thing.type != "LIGHT" or thing.data.type not in KINDS:
        return False
    return not getattr(getattr(thing.data, "cycles", None), "is_portal", False) and _node_emission(thing.data) is not None


def _lamp(thing: bpy.types.Object, shadow: bool) -> Lamp | None:
    """Return an object's lamp; None where it has no size to emit from."""
    data, kind = thing.data, KINDS[thing.data.type]
    colour = np.array(data.color[:]) * data.energy * 2.0 ** getattr(data, "exposure", 0.0) * _node_emission(data)
    if getattr(data, "use_temperature", False):
        colour = colour * np.array(data.temperature_color[:])
    placed = {"kind": kind, "to_world": _rows(thing), "shadow": shadow and data.use_shadow}
    if kind == "sun":
        radius = min(data.angle, math.pi) / 2
        factor = 1.0 if _normalised(data) or not radius else math.pi * math.sin(radius) ** 2
        return Lamp(radius=radius, emission=_rgb(colour * factor), **placed)
    if kind == "area":
        return _area(thing, colour, placed)
    radius = data.shadow_soft_size
    factor = 1.0 if _normalised(data) else (4 * math.pi * radius**2 if radius else UNSHADED)
    cone = {"cone": max(data.spot_size / 2, 1e-3), "blend": data.spot_blend} if kind == "spot" else {}
    sphere = not getattr(data, "use_soft_falloff", True)
    return Lamp(radius=radius, emission=_rgb(colour * factor / (4 * math.pi)), sphere=sphere, **cone, **placed)


def _area(thing: bpy.types.Object, colour: np.ndarray, placed: dict) -> Lamp | None:
    """Return an area lamp of a power `colour` (3,), with the attributes `placed`; None where it has no area."""
    data, scale = thing.data, np.linalg.norm(np.array(thing.matrix_world, float)[:3, :2], axis=0)
    sides = np.array([data.size, data.size_y if data.shape in ("RECTANGLE", "ELLIPSE") else data.size]) * scale
    if sides.min() < SMALLEST:
        return None
    ellipse = data.shape in ("DISK", "ELLIPSE")
    area = sides.prod() * (math.pi / 4 if ellipse else 1.0)
    factor = 1 / (math.pi * area) if _normalised(data) else 1 / math.pi
    spread = min(max(data.spread, math.radians(1)), math.pi) / 2
    return Lamp(emission=_rgb(colour * factor), size=(float(sides[0]), float(sides[1])), ellipse=ellipse, spread=spread, **placed)


def _normalised(data: bpy.types.Light) -> bool:
    """Return True where a lamp's power does not depend on its size; Blender before 4.5 knows no other lamps."""
    return getattr(data, "normalize", True)


def _rgb(values: np.ndarray) -> tuple[float, float, float]:
    """Return three finite values of at least 0; Blender also allows negative light, which has no radiometry."""
    red, green, blue = (float(value) for value in np.clip(np.nan_to_num(values), 0, None))
    return red, green, blue


def _rows(thing: bpy.types.Object) -> tuple[float, ...]:
    """Return an object's matrix as 16 numbers; one that is scaled to nothing counts as unscaled."""
    matrix = np.array(thing.matrix_world, float)
    if abs(np.linalg.det(matrix[:3, :3])) < 1e-12:
        matrix[:3, :3] = np.eye(3)
    return tuple(matrix.reshape(-1).tolist()) if np.isfinite(matrix).all() else IDENTITY


def _node_emission(data: bpy.types.Light) -> np.ndarray | None:
    """Return the factor (3,) of a lamp's nodes: 1 without nodes, None for nodes beyond an Emission with constant inputs."""
    if not uses_nodes(data):
        return np.ones(3)
    output = data.node_tree.get_output_node("CYCLES")
    surface = output.inputs["Surface"] if output is not None else None
    if surface is None or len(surface.links) != 1 or surface.links[0].is_muted:
        return np.zeros(3)
    node = surface.links[0].from_node
    if node.bl_idname != "ShaderNodeEmission" or node.mute or any(node.inputs[name].is_linked for name in ("Color", "Strength")):
        return None
    return np.array(node.inputs["Color"].default_value[:3]) * node.inputs["Strength"].default_value


def _linked(lamp: bpy.types.Object, thing: bpy.types.Object | None, name: str) -> bool:
    """Return True where a lamp's light linking (`receiver_collection`) or shadow linking (`blocker_collection`) includes an object."""
    collection = getattr(getattr(lamp, "light_linking", None), name, None)
    if collection is None or thing is None:
        return True
    states = dict(_link_states(collection))
    if thing.original in states:
        return states[thing.original] == "INCLUDE"
    return "INCLUDE" not in states.values()


def _link_states(collection: bpy.types.Collection) -> Iterator[tuple[bpy.types.Object, str]]:
    """Yield the objects of a linking collection and whether they are included or excluded."""
    for thing, link in zip(collection.objects, collection.collection_objects, strict=True):
        yield thing, link.light_linking.link_state
    for child, link in zip(collection.children, collection.collection_children, strict=True):
        for thing in child.all_objects:
            yield thing, link.light_linking.link_state

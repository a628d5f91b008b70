# SPDX-License-Identifier: GPL-3.0-or-later
"""Fingerprint of a World: a hash that changes when its light may have changed, so that it is rendered once and not for every image."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Any

import bpy

# Properties of nodes that do not affect the light
LAYOUT = ("location", "location_absolute", "width", "height", "select", "label", "color", "use_custom_color", "show_options")
LAYOUT += ("show_preview", "hide", "name", "warning_propagation", "show_texture", "dimensions", "rna_type")


def fingerprint(world: bpy.types.World) -> str:
    """Return the SHA-256 of a World's nodes, values, links and images; the layout of the node editor does not count."""
    parts = [*_tree(world.node_tree)] if world.node_tree else []
    return hashlib.sha256("\n".join([repr(tuple(world.color)), *parts]).encode()).hexdigest()


def _tree(tree: bpy.types.NodeTree) -> Iterator[str]:
    """Yield descriptions of the nodes and links of a node tree and its groups."""
    for node in tree.nodes:
        yield f"{node.name} {node.bl_idname} {list(_values(node))}"
        for socket in node.inputs:
            yield f"{socket.identifier} {_plain(getattr(socket, 'default_value', None))}"
        for socket in node.outputs:  # Value and RGB nodes store their value in the output
            yield f"{socket.identifier} {_plain(getattr(socket, 'default_value', None))}"
        inner = getattr(node, "node_tree", None)
        if inner is not None:
            yield from _tree(inner)
    for link in tree.links:
        ends = (link.from_node.name, link.from_socket.identifier, link.to_node.name, link.to_socket.identifier)
        yield f"{ends} {link.is_muted}"


def _values(owner: bpy.types.bpy_struct) -> Iterator[str]:
    """Yield descriptions of a node's properties, including colour ramps, curves and images."""
    for known in owner.bl_rna.properties:
        name = known.identifier
        if name in LAYOUT or name.startswith("bl_") or known.is_hidden:
            continue
        value = getattr(owner, name)
        if isinstance(value, bpy.types.ColorRamp):
            stops = [(e.position, tuple(e.color)) for e in value.elements]
            yield f"{value.color_mode} {value.interpolation} {value.hue_interpolation} {stops}"
        elif isinstance(value, bpy.types.CurveMapping):
            yield repr([[(*p.location, p.handle_type) for p in curve.points] for curve in value.curves])
        elif isinstance(value, bpy.types.Image):
            about = (tuple(value.size), value.colorspace_settings.name, value.alpha_mode, value.is_dirty)
            yield f"{value.name_full} {value.filepath} {about}"
        elif isinstance(value, bpy.types.Object):
            yield f"{value.name_full} {[tuple(row) for row in value.matrix_world]}"
        elif known.type not in ("POINTER", "COLLECTION"):
            yield f"{name}={_plain(value)}"


def _plain(value: Any) -> str:
    return repr(tuple(value)) if hasattr(value, "__len__") and not isinstance(value, str) else repr(value)

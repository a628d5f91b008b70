# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentence about what IRGS++ leaves out of images: it draws one reconstruction under World and lamps, without other objects."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy

from ..importer.ownership import KEY, folder_of
from ..importer.run_frame import run_object
from ..translations import translated
from ..world.scene_lamps import is_lamp
from .ground import shadow_catcher
from .world_follower import changes

SURFACES = ("MESH", "CURVE", "SURFACE", "META", "FONT", "VOLUME", "POINTCLOUD", "CURVES", "GREASEPENCIL", "GPENCIL")
KINDS = {  # one and several of each, in the order of the sentence
    "lamp with nodes": ("1 lamp with nodes", "{count} lamps with nodes"),
    "other reconstruction": ("1 other reconstruction", "{count} other reconstructions"),
    "collection instance": ("1 collection instance", "{count} collection instances"),
    "object": ("1 object", "{count} objects"),
}

_known: dict[tuple, tuple[int, str]] = {}  # by scene, view layer and run: the count of changes, and the text


def left_out(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, run: Path | None, final: bool = False) -> str:
    """Return a sentence such as "Not drawn: 2 lamps, 1 object"; "" where everything visible is drawn.

    Args:
        scene: original scene, not an evaluated one.
        layer: its view layer.
        run: run that is drawn; None for the chosen one.
        final: True for a final render, False for what 3D Views show.
    """
    key = (scene.name, layer.name, run, final)
    count, text = _known.get(key, (-1, ""))
    if count != changes.count:
        text = _sentence(list(_kinds(scene, layer, run, final)))
        _known[key] = (changes.count, text)
    return text


def seen_objects(scene: bpy.types.Scene, layer: bpy.types.ViewLayer | None = None, final: bool = False) -> list[bpy.types.Object]:
    """Return the objects of a scene that are not hidden.

    Args:
        scene: original scene.
        layer: view layer; None for the one that is shown, or the scene's first.
        final: True for a final render, False for what 3D Views show.
    """
    if layer is None:
        shown = bpy.context.view_layer
        layer = shown if shown is not None and bpy.context.scene == scene else scene.view_layers[0]
    assert layer is not None
    return [thing for thing in layer.objects if not (thing.hide_render if final else not thing.visible_get(view_layer=layer))]


def _sentence(kinds: list[str]) -> str:
    counts = {kind: kinds.count(kind) for kind in KINDS if kind in kinds}
    parts = [translated(KINDS[kind][count > 1], count=count) for kind, count in counts.items()]
    return translated("Not drawn: {things}", things=", ".join(parts)) if parts else ""


def _kinds(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, run: Path | None, final: bool) -> Iterator[str]:
    """Yield the kind of each visible object that is not drawn."""
    drawn = run_object(scene, run, layer)
    things = seen_objects(scene, layer, final)
    catcher = shadow_catcher(things)
    for thing in things:
        if thing in (drawn, catcher):
            continue
        if thing.type == "LIGHT":
            if scene.irgspp.use_lamps and not is_lamp(thing):
                yield "lamp with nodes"
        elif thing.type == "EMPTY" and thing.instance_type == "COLLECTION" and thing.instance_collection is not None:
            yield "collection instance"
        elif folder_of(thing) is not None and thing.type == "MESH" and thing[KEY].endswith("#mesh"):
            yield "other reconstruction"
        elif thing.type in SURFACES and folder_of(thing) is None:  # the points of a dataset are no part of an image
            yield "object"

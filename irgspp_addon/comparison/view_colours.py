# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of the comparison: the result under the view transform Standard and its World has those of a photograph, and all comes back."""

from __future__ import annotations

import bpy

from ..windows import show_studio_light, show_world

PLAIN = {"view_transform": "Standard", "look": "None", "exposure": 0.0, "gamma": 1.0, "use_curve_mapping": False}
KEPT = "irgspp_view"  # custom property of a scene: the view settings before the comparison
LIT = "irgspp_studio_lit"  # custom property of a scene: the 3D Views that were lit by the studio light before, and the World since


def are_plain(scene: bpy.types.Scene) -> bool:
    """Return True where the scene's view settings show colours as a photograph has them."""
    return all(getattr(scene.view_settings, name) == value for name, value in PLAIN.items())


def make_plain(scene: bpy.types.Scene) -> None:
    """Choose the view settings of photographs, light Material Preview by the World, and keep what was before in the scene for `restore`."""
    views = show_world(scene)  # Blender's studio light is not the photograph's
    if are_plain(scene):
        return
    scene[KEPT] = {name: getattr(scene.view_settings, name) for name in PLAIN}
    scene[LIT] = {"views": "\n".join(views), "world": _world(scene)}
    _set(scene, PLAIN)


def kept_transform(scene: bpy.types.Scene) -> str:
    """Return the name of the kept view transform; "" where none is kept, or the settings were changed since."""
    return scene[KEPT]["view_transform"] if KEPT in scene and are_plain(scene) else ""


def restore(scene: bpy.types.Scene) -> None:
    """Choose the kept view settings again, if there are any, and the studio light where the comparison replaced it.

    Another World that was chosen since is to be seen, and stays.
    """
    if KEPT not in scene:
        return
    _set(scene, scene[KEPT].to_dict())
    lit = scene.get(LIT)
    if lit is not None and lit["world"] == _world(scene):  # files of earlier versions lack it
        show_studio_light(scene, lit["views"].split("\n"))
    for name in (KEPT, LIT):
        scene.pop(name, None)


def _world(scene: bpy.types.Scene) -> str:
    return scene.world.name if scene.world is not None else ""


def _set(scene: bpy.types.Scene, values: dict) -> None:
    for name, value in values.items():  # the transform comes first: the looks depend on it
        setattr(scene.view_settings, name, value)

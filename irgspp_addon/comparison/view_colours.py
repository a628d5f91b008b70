# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of the comparison: the result under the view transform Standard has those of a photograph; what the artist had is kept."""

from __future__ import annotations

import bpy

PLAIN = {"view_transform": "Standard", "look": "None", "exposure": 0.0, "gamma": 1.0, "use_curve_mapping": False}
KEPT = "irgspp_view"  # custom property of a scene: the view settings before the comparison


def are_plain(scene: bpy.types.Scene) -> bool:
    """Return True where the scene's view settings show colours as a photograph has them."""
    return all(getattr(scene.view_settings, name) == value for name, value in PLAIN.items())


def make_plain(scene: bpy.types.Scene) -> None:
    """Choose the view settings of photographs, and keep the present ones in the scene for `restore`."""
    if are_plain(scene):
        return
    scene[KEPT] = {name: getattr(scene.view_settings, name) for name in PLAIN}
    _set(scene, PLAIN)


def kept_transform(scene: bpy.types.Scene) -> str:
    """Return the name of the kept view transform; "" where none is kept, or the settings were changed since."""
    return scene[KEPT]["view_transform"] if KEPT in scene and are_plain(scene) else ""


def restore(scene: bpy.types.Scene) -> None:
    """Choose the kept view settings again, if there are any."""
    if KEPT in scene:
        _set(scene, scene[KEPT].to_dict())
        del scene[KEPT]


def _set(scene: bpy.types.Scene, values: dict) -> None:
    for name, value in values.items():  # the transform comes first: the looks depend on it
        setattr(scene.view_settings, name, value)

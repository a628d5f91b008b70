# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrangement of a scene in which a result has arrived: cameras and the untouched objects of a new file hidden, the recovered light on."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from .object_sphere import BOUND
from .ownership import KEY

CUBE_CORNERS = 8  # of Blender's default cube, each coordinate 1 or -1
LIGHT_PLACE, LIGHT_WATTS = (4.0762, 1.0055, 5.9039), 1000.0  # of Blender's default light
WORLD_GREY = 0.0508761  # linear colour of Blender's default World, nearly black
ROUNDING = 1e-3
HIDDEN = "irgspp_hidden"  # custom property of an object that is hidden while a job runs: the job's folder, and where it was shown before


def arrange(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, light: bpy.types.World) -> None:
    """Hide imported cameras and spheres, and the untouched default cube and light; replace the default World by the recovered light.

    Args:
        scene: scene with the result.
        layer: its view layer that is shown.
        light: World of the recovered light.
    """
    show_cameras(scene, False)
    hide_default_objects(scene, layer)
    if is_default_world(scene.world):
        scene.world = light


def hide_default_objects(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, run: Path | None = None) -> bool:
    """Hide the untouched default cube and light; return True where one was shown.

    Args:
        scene: scene that may have them.
        layer: its view layer that is shown.
        run: folder of a running job, at whose end `end_hiding` can show them again; None to hide them for good.
    """
    found = [thing for thing in scene.objects if (is_default_cube(thing) or is_default_light(thing)) and thing.name in layer.objects]
    shown = [thing for thing in found if not thing.hide_get(view_layer=layer)]
    for thing in found:
        if run is None:
            thing.pop(HIDDEN, None)
        else:  # where the file was opened again while the job runs, the object knows from before where it was shown
            now = {"layer": layer.name if thing in shown else "", "render": int(not thing.hide_render)}
            thing[HIDDEN] = (thing[HIDDEN].to_dict() if HIDDEN in thing else now) | {"run": str(run.resolve())}
        thing.hide_set(True, view_layer=layer)
        thing.hide_render = True
    return bool(shown)


def end_hiding(run: Path, show: bool) -> None:
    """End the hiding of the default cube and light for a job that has ended.

    What was shown is stored in the objects, so that it is also known where the file was saved and opened again meanwhile.

    Args:
        run: folder of the job.
        show: True to show them again as before the job, False to leave them hidden.
    """
    for thing in [thing for thing in bpy.data.objects if HIDDEN in thing and thing[HIDDEN]["run"] == str(run.resolve())]:
        before = thing[HIDDEN].to_dict()
        del thing[HIDDEN]
        if not show:
            continue
        if before["render"]:
            thing.hide_render = False
        for layer in [layer for scene in thing.users_scene for layer in scene.view_layers if layer.name == before["layer"]]:
            if thing.name in layer.objects:
                thing.hide_set(False, view_layer=layer)


def is_imported_camera(thing: bpy.types.Object | None) -> bool:
    """Return True for a camera that an import has made: it stores the size of its photograph."""
    return thing is not None and thing.type == "CAMERA" and "width" in thing.data


def cameras_in(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the imported cameras of a scene, sorted by name."""
    return sorted((thing for thing in scene.objects if is_imported_camera(thing)), key=lambda thing: thing.name)


def camera_label(camera: bpy.types.Object) -> str:
    """Return an imported camera's name, without the number that Blender adds where a camera of another import has the same name."""
    imported_as, (name, _, number) = str(camera.get(KEY, "")).rpartition("#camera ")[2], camera.name.rpartition(".")
    return name if name == imported_as and number.isdigit() else camera.name


def cameras_shown(scene: bpy.types.Scene) -> bool:
    """Return True where imported cameras are shown, apart from the one that the scene is seen through."""
    return any(not thing.hide_viewport for thing in scene.objects if is_imported_camera(thing) and thing != scene.camera)


def show_cameras(scene: bpy.types.Scene, show: bool) -> None:
    """Show or hide all imported cameras of a scene in 3D Views, and the spheres of their datasets, whose outlines lie across the object.

    Args:
        scene: the scene.
        show: True to show them.
    """
    spheres = [thing for thing in scene.objects if BOUND in thing]
    for thing in cameras_in(scene) + spheres:
        if thing.hide_viewport == show:
            thing.hide_viewport = not show


def show_alone(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    """Show the camera that is looked through where the others are hidden, since Blender draws its photograph only then.

    Args:
        scene: the scene; its present camera is hidden again.
        camera: camera that is looked through next.
    """
    if not cameras_shown(scene) and is_imported_camera(scene.camera):
        scene.camera.hide_viewport = True
    camera.hide_viewport = False


def is_default_cube(thing: bpy.types.Object) -> bool:
    """Return True for the cube of a new file, as long as nothing about it was changed."""
    if thing.type != "MESH" or not thing.name.startswith("Cube") or not _is_left_alone(thing):
        return False
    corners = thing.data.vertices
    placed = np.abs(np.array(thing.matrix_world) - np.eye(4)).max() < ROUNDING
    return placed and len(corners) == CUBE_CORNERS and all(abs(abs(x) - 1) < ROUNDING for corner in corners for x in corner.co)


def is_default_light(thing: bpy.types.Object) -> bool:
    """Return True for the light of a new file, as long as nothing about it was changed."""
    if thing.type != "LIGHT" or thing.data.type != "POINT" or not _is_left_alone(thing):
        return False
    return abs(thing.data.energy - LIGHT_WATTS) < 1 and np.abs(np.array(thing.location) - LIGHT_PLACE).max() < 10 * ROUNDING


def _is_left_alone(thing: bpy.types.Object) -> bool:
    return not (thing.modifiers or thing.children or thing.parent or thing.animation_data or thing.constraints or thing.library)


def is_default_world(world: bpy.types.World | None) -> bool:
    """Return True for the World of a new file, one dark grey, as long as it was not changed."""
    if world is None or world.library is not None or world.node_tree is None:
        return False
    kinds = sorted(node.bl_idname for node in world.node_tree.nodes)
    if kinds != ["ShaderNodeBackground", "ShaderNodeOutputWorld"]:
        return False
    background = next(node for node in world.node_tree.nodes if node.bl_idname == "ShaderNodeBackground")
    colour, strength = background.inputs["Color"].default_value, background.inputs["Strength"].default_value
    return strength == 1 and all(abs(value - WORLD_GREY) < ROUNDING for value in colour[:3])

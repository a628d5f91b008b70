# SPDX-License-Identifier: GPL-3.0-or-later
"""Request for a final image: the scene's camera, World and lamps at the present frame."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import InputError
from ...core.scene.camera import Camera
from ..importer.run_frame import albedo_scale, chosen_run, frame_of, run_object, scene_camera
from ..importer.run_root import recovered_light
from ..world.scene_lamps import scene_lamps
from ..world.world_light import world_light
from .ground import ground_height, ground_plane
from .left_out import seen_objects
from .preview import settings_of
from .session import RelightRequest


def final_request(depsgraph: bpy.types.Depsgraph, size: tuple[int, int], turn: float = 0.0) -> tuple[RelightRequest, Path]:
    """Return the request for a final image and the run folder it is for.

    Args:
        depsgraph: evaluated dependency graph.
        size: width and height in pixels, of the render border if there is one.
        turn: rotation of World and lamps about the vertical axis through the object, radians, counter-clockwise seen from above.

    Raises:
        InputError: if there is no run, object, camera or World to render.
    """
    scene = depsgraph.scene.original
    run = chosen_run(scene, depsgraph.view_layer)
    thing = run_object(scene, run, depsgraph.view_layer)
    if thing is None:
        raise InputError(f"scene {scene.name}", "has no object of the run", "import the run")
    frame = frame_of(thing.evaluated_get(depsgraph))
    camera = frame.camera(_cropped(scene_camera(scene, depsgraph, *full_size(scene.render), frame), scene.render, size))
    settings = settings_of(scene)
    use_world, use_lamps = settings.pop("use_world"), settings.pop("use_lamps")
    around = _rotation(turn)
    world = _world(depsgraph, run, use_world, bool(turn))
    light = world_light(world, scene.frame_current).turned(around[:3, :3].T @ frame.rotation) if use_world or turn else None
    backdrop = use_world and not scene.render.film_transparent
    things = seen_objects(scene, scene.view_layers[depsgraph.view_layer.name], final=True)
    centre = _translation(frame.centre)
    step = centre @ around @ np.linalg.inv(centre)
    lamps = frame.lamps(lamp.moved(step) for lamp in scene_lamps(things, thing, depsgraph)) if use_lamps else ()
    ground = ground_plane(ground_height(scene, things, thing.evaluated_get(depsgraph)), frame)
    return RelightRequest(camera, light, lamps, albedo_scale=albedo_scale(thing), backdrop=backdrop, ground=ground, **settings), run


def _world(depsgraph: bpy.types.Depsgraph, run: Path, use_world: bool, turned: bool) -> bpy.types.World | None:
    """Return the World that lights the object; None without one.

    Args:
        depsgraph: evaluated dependency graph.
        run: run folder.
        use_world: True for the scene's World, False for the recovered light.
        turned: True where the light is rotated; the engine itself has the recovered light as it was photographed.
    """
    if not use_world:
        return _recovered(run) if turned else None
    world = depsgraph.scene.original.world
    return world.evaluated_get(depsgraph) if world is not None else None  # with animated values, which an evaluated scene's World lacks


def _rotation(angle: float) -> np.ndarray:
    """Return the rotation (4, 4) about +Z by an angle in radians."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, -sine, 0, 0], [sine, cosine, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], float)


def _translation(offset: np.ndarray) -> np.ndarray:
    """Return the translation (4, 4) by an offset (3,)."""
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix


def _recovered(run: Path) -> bpy.types.World:
    """Return the World of the recovered light; raise InputError where it is not in the file."""
    world = recovered_light(run)
    if world is None:
        raise InputError(run.name, "its recovered light is not in this file, so that it can't be turned", "import the run")
    return world


def full_size(render: bpy.types.RenderSettings) -> tuple[int, int]:
    """Return the width and height of a final image in pixels, without its border."""
    scale = render.resolution_percentage / 100
    return max(1, int(render.resolution_x * scale)), max(1, int(render.resolution_y * scale))


def _cropped(camera: Camera, render: bpy.types.RenderSettings, size: tuple[int, int]) -> Camera:
    """Crop a camera to the render border of `size` (width, height), whose origin is the bottom left corner."""
    if size == (camera.width, camera.height):
        return camera
    left, top = int(render.border_min_x * camera.width), camera.height - int(render.border_min_y * camera.height) - size[1]
    return replace(camera, width=size[0], height=size[1], cx=camera.cx - left, cy=camera.cy - top)

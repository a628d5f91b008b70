# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a run's object stands in Blender's world, and cameras and light as the run's own frame sees them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.errors import InputError
from ...core.scene.camera import Camera
from .ownership import KEY, folder_of

FAR = 300.0  # radii: parallel projection is one from so far away
SLACK = 1e-3  # of the scale, by which the axes may differ


@dataclass(frozen=True, eq=False)
class Frame:
    """A similarity (4, 4) from the run's frame to Blender's world, and a sphere there around the object."""

    matrix: np.ndarray
    centre: np.ndarray
    radius: float

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) of directions, from the run's frame to the world's."""
        return self.matrix[:3, :3] / np.cbrt(np.linalg.det(self.matrix[:3, :3]))

    def camera(self, camera: Camera) -> Camera:
        """A camera of Blender's world, in the run's frame."""
        return camera.moved(np.linalg.inv(self.matrix))


ALBEDO_SCALE = "irgspp_albedo_scale"  # custom property of the mesh: the brightness of all albedo is open, the light being unknown
UNMOVED = Frame(np.eye(4), np.zeros(3), 1.0)


def run_object(scene: bpy.types.Scene, run: Path | None, layer: bpy.types.ViewLayer | None = None) -> bpy.types.Object | None:
    """The mesh of an imported run in a scene, the active one of several; run: None takes any."""
    found = [thing for thing in scene.objects if _shows(thing, run)]
    active = _active(scene, layer)
    return active if active in found else min(found, key=lambda thing: (len(thing.name), thing.name), default=None)


def chosen_run(scene: bpy.types.Scene, layer: bpy.types.ViewLayer | None = None) -> Path:
    """The run to relight: that of the active object, the one the scene names, or the only one there. Raises InputError without any."""
    imported = run_object(scene, None, layer)
    named = scene.irgspp.run_path() if hasattr(scene, "irgspp") else None
    for folder in (folder_of(_active(scene, layer)), named, folder_of(imported)):
        if folder is not None and (folder / "gaussians.ply").is_file():
            return folder
    if imported is not None:
        raise InputError(folder_of(imported), "the run folder is gone", "move it back, or import the run from where it is now")
    raise InputError("relight", "there is no reconstructed object in the scene", "import a run, or choose its folder")


def _active(scene: bpy.types.Scene, layer: bpy.types.ViewLayer | None) -> bpy.types.Object | None:
    if layer is None:
        here = bpy.context.view_layer
        layer = here if here is not None and bpy.context.scene == scene else scene.view_layers[0]
    active = layer.objects.active if layer is not None else None
    return active.original if active is not None else None


def frame_of(thing: bpy.types.Object | None) -> Frame:
    """How the run's mesh stands in the world; None: as it was reconstructed. Raises InputError where it is stretched or mirrored."""
    if thing is None:
        return UNMOVED
    matrix = np.array(thing.matrix_world, float)  # of the evaluated object where it may be animated
    axes = matrix[:3, :3]
    scale = np.cbrt(np.linalg.det(axes))
    if not np.isfinite(matrix).all() or scale <= 0 or np.abs(axes.T @ axes - scale**2 * np.eye(3)).max() > SLACK * scale**2:
        raise InputError(thing.name, "is stretched, mirrored or of no size, which the engine can't relight", "give it one positive scale")
    corners = np.array([[*corner, 1.0] for corner in thing.bound_box]) @ matrix.T
    low, high = corners[:, :3].min(0), corners[:, :3].max(0)
    return Frame(matrix, (low + high) / 2, float(np.linalg.norm(high - low)) / 2 or 1.0)


def albedo_scale(thing: bpy.types.Object | None) -> tuple[float, float, float]:
    """Factors of the albedo that a person gave the run's mesh as custom property; one number stands for all three."""
    given: Any = 1.0 if thing is None else thing.get(ALBEDO_SCALE, 1.0)
    factors = tuple(max(0.0, float(x)) for x in given) if hasattr(given, "__len__") else (max(0.0, float(given)),) * 3
    if len(factors) != 3:
        raise InputError(f"{thing.name if thing else ''}: {ALBEDO_SCALE}", "is not one factor or three")
    return (factors[0], factors[1], factors[2])


def scene_camera(
    scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, width: int, height: int, frame: Frame, square: bool = False
) -> Camera:
    """The scene's camera for an image of so many pixels, in Blender's world; square: whatever pixels the scene's render has.

    Raises InputError without a usable camera.
    """
    placed = scene.camera
    if placed is None or placed.type != "CAMERA":
        raise InputError(f"scene {scene.name}", "has no camera", "add one, or look from the 3D View")
    if placed.data.type not in ("PERSP", "ORTHO"):
        raise InputError(placed.name, "is a panoramic camera, which the engine does not know", "make it perspective")
    seen = placed.evaluated_get(depsgraph)
    render = scene.render
    aspect = {} if square else {"scale_x": render.pixel_aspect_x, "scale_y": render.pixel_aspect_y}
    projection = seen.calc_matrix_camera(depsgraph, x=width, y=height, **aspect)
    return camera_of(seen.matrix_world, projection, width, height, frame)


def view_camera(view: bpy.types.RegionView3D, width: int, height: int, frame: Frame, region: Sequence[int]) -> Camera:
    """What a 3D View of `region` (width, height) shows, for an image of the same proportions."""
    camera = camera_of(view.view_matrix.inverted(), view.window_matrix, region[0], region[1], frame)
    return camera.resized(width, height)


def camera_of(to_world: Any, projection: Any, width: int, height: int, frame: Frame) -> Camera:
    """From Blender's camera-to-world and projection matrices (4, 4); a parallel projection becomes one from far away."""
    pose, p = np.array(to_world, float), np.array(projection, float)
    axes = pose[:3, :3] / np.linalg.norm(pose[:3, :3], axis=0)
    centre, reach = pose[:3, 3], 1.0
    if p[3, 3] == 0:
        offset = -p[0, 2], -p[1, 2]
    else:
        offset, reach = (p[0, 3], p[1, 3]), FAR * frame.radius
        centre = centre + axes[:, 2] * (reach - (centre - frame.centre) @ axes[:, 2])
    placed = np.eye(4)
    placed[:3, :3], placed[:3, 3] = axes, centre
    fx, fy = p[0, 0] * width / 2 * reach, p[1, 1] * height / 2 * reach
    return Camera(width, height, float(fx), float(fy), width / 2 * (1 + offset[0]), height / 2 * (1 - offset[1]), placed)


def _shows(thing: bpy.types.Object, run: Path | None) -> bool:
    folder = folder_of(thing)
    if folder is None or thing.type != "MESH" or not thing.get(KEY, "").endswith("#mesh"):
        return False
    return run is None or folder == run.resolve()

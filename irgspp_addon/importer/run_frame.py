# SPDX-License-Identifier: GPL-3.0-or-later
"""Frame of a run's object in Blender's world, and conversion of Blender's cameras into it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.assets.options import UNTURNED
from ...core.errors import InputError
from ...core.scene.camera import Camera
from ...core.scene.lamps import Lamp
from .mesh_origin import mesh_to_run
from .ownership import KEY, folder_of

FAR = 300.0  # distance, in radii of the object, of the perspective camera that replaces an orthographic one
ROUNDING = 1e-5  # of matrices that are composed and inverted
SLACK = 1e-3  # tolerance for unequal scale of the axes, relative to the scale


@dataclass(frozen=True, eq=False)
class Frame:
    """Similarity from the run's frame to Blender's world, and the object's bounding sphere.

    Attributes:
        matrix: (4, 4) similarity.
        centre: (3,) centre of the sphere in Blender's world.
        radius: its radius.
    """

    matrix: np.ndarray
    centre: np.ndarray
    radius: float

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) rotation of directions from the run's frame to Blender's world."""
        return self.matrix[:3, :3] / np.cbrt(np.linalg.det(self.matrix[:3, :3]))

    def camera(self, camera: Camera) -> Camera:
        """Transform a camera from Blender's world into the run's frame."""
        return camera.moved(np.linalg.inv(self.matrix))

    def lamps(self, lamps: Iterable[Lamp]) -> tuple[Lamp, ...]:
        """Transform lamps from Blender's world into the run's frame."""
        step = np.linalg.inv(self.matrix)
        return tuple(lamp.moved(step) for lamp in lamps)


ALBEDO_SCALE = "irgspp_albedo_scale"  # custom property of the mesh: albedo is recovered up to a factor, as the light is unknown
UNMOVED = Frame(np.eye(4), np.zeros(3), 1.0)


def run_object(scene: bpy.types.Scene, run: Path | None, layer: bpy.types.ViewLayer | None = None) -> bpy.types.Object | None:
    """Return the mesh object of an imported run, preferring the active object; None if there is none.

    Args:
        scene: scene to search.
        run: run folder; None for any run.
        layer: view layer whose active object counts; None for the scene's.
    """
    found = [thing for thing in scene.objects if _is_mesh_of(thing, run)]
    active = _active(scene, layer)
    return active if active in found else min(found, key=lambda thing: (len(thing.name), thing.name), default=None)


def chosen_run(scene: bpy.types.Scene, layer: bpy.types.ViewLayer | None = None) -> Path:
    """Return the run folder to relight: that of the active object, else the one chosen in the scene, else that of any imported mesh.

    Args:
        scene: scene to search.
        layer: view layer whose active object counts; None for the scene's.

    Raises:
        InputError: if there is no run, or its folder no longer exists.
    """
    imported = run_object(scene, None, layer)
    named = scene.irgspp.run_path() if hasattr(scene, "irgspp") else None
    for folder in (folder_of(_active(scene, layer)), named, folder_of(imported)):
        if folder is not None and (folder / "gaussians.ply").is_file():
            return folder
    if imported is not None:
        raise InputError(folder_of(imported), "the run folder does not exist", "move it back, or import the run from its new place")
    raise InputError("relight", "there is no reconstructed object in the scene", "import a run, or choose its folder")


def _active(scene: bpy.types.Scene, layer: bpy.types.ViewLayer | None) -> bpy.types.Object | None:
    if layer is None:
        current = bpy.context.view_layer
        layer = current if current is not None and bpy.context.scene == scene else scene.view_layers[0]
    active = layer.objects.active if layer is not None else None
    return active.original if active is not None else None


def frame_of(thing: bpy.types.Object | None) -> Frame:
    """Return the frame of a run's mesh object in Blender's world; None stands for a mesh that was not moved.

    Raises:
        InputError: if the object is scaled unequally, mirrored or has no size.
    """
    if thing is None:
        return UNMOVED
    placed = np.array(thing.matrix_world, float)  # of the evaluated object where it may be animated
    matrix = placed @ np.array(mesh_to_run(thing).inverted(), float)
    axes = matrix[:3, :3]
    scale = np.cbrt(np.linalg.det(axes))
    if not np.isfinite(matrix).all() or scale <= 0 or np.abs(axes.T @ axes - scale**2 * np.eye(3)).max() > SLACK * scale**2:
        raise InputError(
            thing.name, "is stretched, mirrored or of no size, so it can't be relit", "give its axes one equal, positive scale"
        )
    corners = np.array([[*corner, 1.0] for corner in thing.bound_box]) @ placed.T
    low, high = corners[:, :3].min(0), corners[:, :3].max(0)
    return Frame(matrix, (low + high) / 2, float(np.linalg.norm(high - low)) / 2 or 1.0)


def transform_of(thing: bpy.types.Object | None) -> tuple[float, ...]:
    """Return how an object is turned and scaled in Blender's world, relative to the run: the rows of a matrix (3, 3).

    Args:
        thing: mesh object of a run; None stands for one that was not moved.
    """
    if thing is None:
        return UNTURNED
    matrix = (np.array(thing.matrix_world, float) @ np.array(mesh_to_run(thing).inverted(), float))[:3, :3]
    return UNTURNED if np.abs(matrix - np.eye(3)).max() < ROUNDING else tuple(matrix.reshape(-1).tolist())


def albedo_scale(thing: bpy.types.Object | None) -> tuple[float, float, float]:
    """Return the RGB factors for the albedo in the mesh's custom property, which holds one number or three.

    Raises:
        InputError: if it holds another number of values.
    """
    value: Any = 1.0 if thing is None else thing.get(ALBEDO_SCALE, 1.0)
    factors = tuple(max(0.0, float(x)) for x in value) if hasattr(value, "__len__") else (max(0.0, float(value)),) * 3
    if len(factors) != 3:
        raise InputError(f"{thing.name if thing else ''}: {ALBEDO_SCALE}", "does not hold one number or three", "set it to one number")
    return (factors[0], factors[1], factors[2])


def scene_camera(
    scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, width: int, height: int, frame: Frame, square: bool = False
) -> Camera:
    """Return the scene's active camera, in Blender's world.

    Args:
        scene: scene of the camera.
        depsgraph: evaluated dependency graph.
        width: width of the image in pixels.
        height: height of the image in pixels.
        frame: frame of the object.
        square: True for square pixels, False for the scene's pixel aspect.

    Raises:
        InputError: if there is no camera or it is panoramic.
    """
    placed = scene.camera
    if placed is None or placed.type != "CAMERA":
        raise InputError(f"scene {scene.name}", "has no camera", "add one, or look from the 3D View")
    if placed.data.type not in ("PERSP", "ORTHO"):
        raise InputError(placed.name, "is a panoramic camera, which the engine does not support", "set its type to Perspective")
    evaluated = placed.evaluated_get(depsgraph)
    render = scene.render
    aspect = {} if square else {"scale_x": render.pixel_aspect_x, "scale_y": render.pixel_aspect_y}
    projection = evaluated.calc_matrix_camera(depsgraph, x=width, y=height, **aspect)
    return camera_of(evaluated.matrix_world, projection, width, height, frame)


def view_camera(view: bpy.types.RegionView3D, width: int, height: int, frame: Frame, region: Sequence[int]) -> Camera:
    """Return the camera of a 3D View, in Blender's world.

    Args:
        view: the 3D View.
        width: width of the image in pixels.
        height: height of the image in pixels, in the view's proportions.
        frame: frame of the object.
        region: width and height of the view's region in pixels.
    """
    camera = camera_of(view.view_matrix.inverted(), view.window_matrix, region[0], region[1], frame)
    return camera.resized(width, height)


def camera_of(to_world: Any, projection: Any, width: int, height: int, frame: Frame) -> Camera:
    """Convert Blender's camera matrices; an orthographic camera becomes a perspective one at a distance of FAR radii.

    Args:
        to_world: (4, 4) matrix from the camera to Blender's world.
        projection: (4, 4) projection matrix.
        width: width of the image in pixels.
        height: height of the image in pixels.
        frame: frame of the object.
    """
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


def _is_mesh_of(thing: bpy.types.Object, run: Path | None) -> bool:
    """Return True for the imported mesh of a run; None for any run."""
    folder = folder_of(thing)
    if folder is None or thing.type != "MESH" or not thing.get(KEY, "").endswith("#mesh"):
        return False
    return run is None or folder == run.resolve()

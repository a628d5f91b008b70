# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground that receives the object's shadow: a flat shadow catcher of the scene, or the plane at the object's foot."""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np

from ..importer.run_frame import Frame

CATCHER = "irgspp_ground"  # custom property of the plane that the panel adds
WIDTH = 8.0  # of this plane, in widths of the object: long shadows end on it
FLAT = 1e-3  # height of a flat shadow catcher, as a fraction of its width at most


def ground_height(scene: bpy.types.Scene, things: Iterable[bpy.types.Object], thing: bpy.types.Object | None) -> float | None:
    """Return the height of the ground in Blender's world; None where no shadow is wanted.

    Args:
        scene: original scene; its setting *Ground Shadow* puts the ground at the object's foot.
        things: objects that are seen.
        thing: the object, original or evaluated.
    """
    catcher = shadow_catcher(things)
    if catcher is not None:
        return float(_corners(catcher)[:, 2].mean())
    if not scene.irgspp.ground_shadow or thing is None:
        return None
    vertices = _vertices(thing)
    return float(vertices[:, 2].min()) if len(vertices) else None


def added_plane(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """Return the shadow-catcher plane that was added to a scene; None without one."""
    return next((thing for thing in scene.objects if CATCHER in thing), None)


def add_plane(scene: bpy.types.Scene, thing: bpy.types.Object) -> bpy.types.Object:
    """Add a level plane under the foot of an object that catches its shadow in IRGS++ and Cycles.

    It is a wire in 3D Views, as EEVEE has no shadow catchers and would cover what is below by a white plane.

    Args:
        scene: scene that receives it.
        thing: the object.
    """
    vertices = _vertices(thing)
    low, high = vertices.min(0), vertices.max(0)
    half = WIDTH / 2 * float((high - low).max())
    mesh = bpy.data.meshes.new("Shadow Catcher")
    mesh.from_pydata([(-half, -half, 0.0), (half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0)], [], [(0, 1, 2, 3)])
    plane = bpy.data.objects.new("Shadow Catcher", mesh)
    plane[CATCHER] = True
    plane.location = (*((low + high)[:2] / 2).tolist(), float(low[2]))
    plane.is_shadow_catcher, plane.display_type = True, "WIRE"
    scene.collection.objects.link(plane)
    return plane


def remove_plane(scene: bpy.types.Scene) -> None:
    """Remove the shadow-catcher plane that was added to a scene."""
    plane = added_plane(scene)
    if plane is not None:
        mesh = plane.data
        bpy.data.objects.remove(plane)
        if not mesh.users:
            bpy.data.meshes.remove(mesh)


def shadow_catcher(things: Iterable[bpy.types.Object]) -> bpy.types.Object | None:
    """Return the first flat, level mesh among objects that is marked as shadow catcher; None without one."""
    return next((thing for thing in things if thing.type == "MESH" and thing.is_shadow_catcher and _is_level(thing)), None)


def ground_plane(height: float | None, frame: Frame) -> tuple[float, float, float, float] | None:
    """Return the ground as a plane in the run's frame, unit normal and offset; None where there is none.

    Args:
        height: of the ground in Blender's world.
        frame: frame of the object.
    """
    if height is None:
        return None
    normal = frame.rotation.T @ np.array([0.0, 0.0, 1.0])
    scale = float(np.cbrt(np.linalg.det(frame.matrix[:3, :3])))
    return (float(normal[0]), float(normal[1]), float(normal[2]), (height - float(frame.matrix[2, 3])) / scale)


def _vertices(thing: bpy.types.Object) -> np.ndarray:
    """Return the vertices (V, 3) of a mesh object in Blender's world."""
    vertices = np.empty(3 * len(thing.data.vertices), np.float32)
    thing.data.vertices.foreach_get("co", vertices)
    matrix = np.array(thing.matrix_world, float)
    return vertices.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]


def _corners(thing: bpy.types.Object) -> np.ndarray:
    """Return the corners (8, 3) of an object's bounding box in Blender's world."""
    return np.array([[*corner, 1.0] for corner in thing.bound_box]) @ np.array(thing.matrix_world, float)[:3].T


def _is_level(thing: bpy.types.Object) -> bool:
    """Return True where an object is flat and horizontal."""
    size = np.ptp(_corners(thing), axis=0)
    return size[2] <= FLAT * max(size[0], size[1])

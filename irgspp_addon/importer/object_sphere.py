# SPDX-License-Identifier: GPL-3.0-or-later
"""Sphere around the object of a dataset: an empty that shows the object's bound, and by which the user changes it."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from .capture_file import CaptureSummary, read_capture
from .ownership import KEY, Owner, put
from .placement import TO_WORLD

PART = "object"  # of the owner
BOUND = "irgspp_bound"  # custom property: the engine's bound in the engine's frame, centre and radius, (4,)
TOLERANCE = 1e-3  # of the radius: a smaller difference is rounding, no change by the user


def build_sphere(
    owner: Owner, name: str, centre: list[float], radius: float, root: bpy.types.Object, collection: bpy.types.Collection
) -> bpy.types.Object:
    """Create the sphere, or move it to a new bound unless the user has changed it.

    Args:
        owner: owner of the datablocks.
        name: name of a new empty.
        centre: (3,) centre of the bound in the engine's frame.
        radius: radius of the bound.
        root: parent of the sphere, in the engine's frame.
        collection: collection of the sphere.
    """
    known = owner.find(bpy.data.objects, PART)
    keep = known is not None and is_changed(known)
    sphere = owner.object(PART, name, None, root)
    if not keep:
        sphere.empty_display_type, sphere.empty_display_size = "SPHERE", 1.0
        sphere.matrix_parent_inverse = Matrix()
        sphere.matrix_basis = Matrix.Translation(centre) @ Matrix.Diagonal((radius, radius, radius, 1.0))
    sphere[BOUND] = [*map(float, centre), float(radius)]
    put(sphere, collection)
    return sphere


def find_sphere(scene: bpy.types.Scene, dataset: Path | None) -> bpy.types.Object | None:
    """Return the sphere of an imported dataset; None if it is not in the scene.

    Args:
        scene: scene to search.
        dataset: path of the dataset without links; None without one.
    """
    found = [thing for thing in scene.objects if thing.get(KEY) == f"{dataset}#{PART}"]
    return min(found, key=lambda thing: (len(thing.name), thing.name), default=None)


def is_changed(sphere: bpy.types.Object) -> bool:
    """Return True if the user has moved or scaled the sphere."""
    if BOUND not in sphere:
        return False
    before, (centre, radius) = np.array(sphere[BOUND], float), bound_in_root(sphere)
    allowed = TOLERANCE * before[3]
    return bool(np.abs(centre - before[:3]).max() > allowed or abs(radius - before[3]) > allowed)


def bound_settings(scene: bpy.types.Scene, dataset: Path) -> list[str]:
    """Return `data.centre=x,y,z` and `data.radius=r` in the dataset's own frame, if the user has changed its sphere; else nothing.

    Of captures nothing, either: there the sphere chooses the object, which `cut_settings` tells.

    Args:
        scene: scene with the imported dataset.
        dataset: path of the dataset.
    """
    sphere = None if read_capture(dataset) else changed_sphere(scene, dataset)
    return [] if sphere is None else _settings("data", *sphere)


def cut_settings(scene: bpy.types.Scene, dataset: Path, capture: CaptureSummary | None) -> list[str]:
    """Return `capture.centre=x,y,z` and `capture.radius=r` if the object of a finished capture is not that of its sphere; else nothing.

    Args:
        scene: scene with the imported capture.
        dataset: path of the capture.
        capture: its summary; None for a dataset that is none.
    """
    sphere = changed_sphere(scene, dataset) if capture is not None and capture.status == "done" else None
    if capture is None or sphere is None or _equal(*sphere, capture.bound):
        return []
    return _settings("capture", *sphere)


def changed_sphere(scene: bpy.types.Scene, dataset: Path) -> tuple[np.ndarray, float] | None:
    """Return centre (3,) and radius of a dataset's sphere in the dataset's own frame, if the user has changed it; else None.

    Args:
        scene: scene with the imported dataset.
        dataset: path of the dataset.
    """
    sphere = find_sphere(scene, dataset.resolve())
    root = None if sphere is None else root_of(sphere)
    if sphere is None or root is None or not is_changed(sphere):
        return None
    centre, radius = bound_in_root(sphere)
    to_own = own_frame(root)
    return to_own[:3, :3] @ centre + to_own[:3, 3], radius * float(np.cbrt(np.linalg.det(to_own[:3, :3])))


def _settings(group: str, centre: np.ndarray, radius: float) -> list[str]:
    x, y, z = centre
    return [f"{group}.centre={x:.7g},{y:.7g},{z:.7g}", f"{group}.radius={radius:.7g}"]


def _equal(centre: np.ndarray, radius: float, bound: tuple[float, ...] | None) -> bool:
    """Return True where a sphere is a bound: centre and radius, (4,)."""
    return bound is not None and bool(np.abs(np.array([*centre, radius]) - bound).max() <= TOLERANCE * bound[3])


def bound_in_root(sphere: bpy.types.Object) -> tuple[np.ndarray, float]:
    """Return centre (3,) and radius in the engine's frame; of a stretched sphere the longest half-axis, so that nothing is cut off.

    Args:
        sphere: sphere of an imported dataset.
    """
    values = matrix_in_root(sphere)
    return values[:3, 3], float(np.linalg.norm(values[:3, :3], axis=0).max() * sphere.empty_display_size)


def matrix_in_root(thing: bpy.types.Object) -> np.ndarray:
    """Return the matrix (4, 4) of an imported object in the engine's frame.

    Args:
        thing: object of an imported dataset.
    """
    root = root_of(thing)
    if root is None or thing.parent == root:
        return np.array(thing.matrix_parent_inverse @ thing.matrix_basis, float)  # up to date also before the scene is evaluated
    return np.array(root.matrix_world.inverted() @ thing.matrix_world, float)


def own_frame(root: bpy.types.Object) -> np.ndarray:
    """Return the similarity (4, 4) from the engine's frame to the dataset's own.

    Args:
        root: empty above the imported dataset.
    """
    return np.linalg.inv(np.array(root[TO_WORLD], float).reshape(4, 4))


def root_of(thing: bpy.types.Object) -> bpy.types.Object | None:
    """Return the empty above an imported dataset, also where the user has given its object another parent; None if it is gone.

    Args:
        thing: object of the dataset.
    """
    if thing.parent is not None and TO_WORLD in thing.parent:
        return thing.parent
    key = f"{thing[KEY].rpartition('#')[0]}#root"
    return next((thing for thing in bpy.data.objects if thing.get(KEY) == key), None)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Live shape of a running reconstruction: its Gaussians as points, then its surface, where the result will be."""

from __future__ import annotations

import zipfile
from pathlib import Path

import bpy
import numpy as np

from .ownership import Owner, put
from .point_cloud import build_points
from .run_mesh import set_polygons
from .run_root import placed_root

SHAPE = "previews/shape.npz"  # in a run folder, see `Progress.shape` of the engine
PARTS = ("position", "colour", "centre", "to_world")
SIZE = 0.012  # radius of a point over that of the object: 10,000 of them nearly touch
POINTS, SURFACE = "points", "live surface"  # parts of the run


def show_live_shape(run: Path, scene: bpy.types.Scene) -> bpy.types.Object | None:
    """Show the present shape of a run in a scene, in place of the one before.

    Args:
        run: run folder of a job.
        scene: scene for its result.

    Returns:
        The object; None where there is no shape yet, where an earlier result of the run is in the file, or in Edit Mode.
    """
    shape, owner = read_shape(run), Owner(run)
    if shape is None or owner.find(bpy.data.objects, "mesh") is not None or _is_edited(owner):
        return None
    x, y, z = shape["centre"].tolist()
    collection, root = placed_root(owner, scene, shape["to_world"], (x, y, z))
    name = f"{owner.folder.name} (in progress)"
    if "faces" not in shape:
        radius = float(np.linalg.norm(shape["position"] - shape["centre"], axis=1).max(initial=0.0))
        return build_points(owner, name, shape["position"], shape["colour"], radius, root, collection, SIZE)
    _remove(owner, POINTS)
    mesh = bpy.data.meshes.new(name)
    set_polygons(mesh, shape["position"], shape["faces"].reshape(-1), np.full(len(shape["faces"]), 3))
    mesh.shade_smooth()
    surface = owner.object(SURFACE, name, owner.replace(bpy.data.meshes, f"{SURFACE} data", mesh), root)
    surface.hide_render = True
    put(surface, collection)
    return surface


def remove_live_shape(run: Path) -> None:
    """Remove the shape of a job that ended; an import of its result has done so already.

    Args:
        run: run folder of the job.
    """
    owner = Owner(run)
    shown = [part for part in (POINTS, SURFACE) if owner.find(bpy.data.objects, part) is not None]
    for part in shown:
        _remove(owner, part)
    root, collection = owner.find(bpy.data.objects, "root"), owner.find(bpy.data.collections, "collection")
    if shown and root is not None and not root.children:
        bpy.data.objects.remove(root)
        if collection is not None and not collection.all_objects and not collection.children:
            bpy.data.collections.remove(collection)


def read_shape(run: Path) -> dict[str, np.ndarray] | None:
    """Return the present shape of a run; None where there is none, or its file is damaged: the next one replaces it."""
    try:
        with np.load(run / SHAPE, allow_pickle=False) as stored:
            shape = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return None
    return shape if _is_shape(shape) else None


def _is_edited(owner: Owner) -> bool:
    """Return True where the user is editing the shape, which must not be replaced meanwhile."""
    shown = (owner.find(bpy.data.objects, part) for part in (POINTS, SURFACE))
    return any(thing is not None and thing.mode == "EDIT" for thing in shown)


def _remove(owner: Owner, part: str) -> None:
    """Remove the object of a part and its mesh."""
    for blocks, name in ((bpy.data.objects, part), (bpy.data.meshes, f"{part} data")):
        block = owner.find(blocks, name)
        if block is not None:
            blocks.remove(block)


def _is_shape(shape: dict[str, np.ndarray]) -> bool:
    """Check what Blender does not: it may crash on faces of missing vertices."""
    if not set(PARTS) <= set(shape) or any(shape[name].dtype.kind != "f" or not np.isfinite(shape[name]).all() for name in PARTS):
        return False
    count, faces = len(shape["position"]), shape.get("faces")
    sizes = {"position": (count, 3), "colour": (count, 3), "centre": (3,), "to_world": (4, 4)}
    if any(shape[name].shape != size for name, size in sizes.items()) or abs(np.linalg.det(shape["to_world"])) < 1e-12:
        return False
    if faces is None:
        return True
    return (
        faces.dtype.kind == "i" and faces.ndim == 2 and faces.shape[1] == 3 and len(faces) > 0 and 0 <= faces.min() <= faces.max() < count
    )

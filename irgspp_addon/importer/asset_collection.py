# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's collection as an asset: the object with its levels of detail and collision hulls, without the cameras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy
from mathutils import Matrix

from ...core.errors import InputError
from .asset_parts import HULL, add_levels, hull_name
from .mesh_origin import ORIGIN, mesh_to_run
from .ownership import KEY, Owner, folder_of, link

PART = "irgspp_part"  # custom property of the objects that belong to the asset: "level" or "hull"
FULL = "_LOD0"  # ending of the object's name beside its levels


def collection_of(thing: bpy.types.Object) -> bpy.types.Collection | None:
    """Return the collection that a run's object was imported into, where it still is in it."""
    folder = folder_of(thing)
    collection = Owner(folder).find(bpy.data.collections, "collection") if folder is not None else None
    return collection if collection is not None and thing.name in collection.objects else None


def asset_collection(thing: bpy.types.Object) -> bpy.types.Collection:
    """Return the collection of a run's object, ready to be an asset: its cameras beside it, its instances' origin at the object's.

    Args:
        thing: object of a run.

    Raises:
        InputError: if the object was moved out of its collection.
    """
    collection = collection_of(thing)
    if collection is None:
        raise InputError(thing.name, "is not in the collection of its import", "move it back, or mark the object alone")
    cameras = Owner(folder_of(thing) or Path()).find(bpy.data.collections, "cameras")
    if cameras is not None and cameras.name in collection.children:
        collection.children.unlink(cameras)
        for parent in (*bpy.data.collections, *(scene.collection for scene in bpy.data.scenes)):
            if collection.name in parent.children and parent.library is None:
                link(cameras, parent)
    collection.instance_offset = thing.matrix_world.translation
    return collection


def marked_asset(thing: bpy.types.Object, other_than: bpy.types.ID | None = None) -> bpy.types.Object | bpy.types.Collection | None:
    """Return the asset that a run's object is in: its collection, or the object itself; None where neither is one.

    Args:
        thing: object of the run.
        other_than: datablock that does not count.
    """
    blocks = (block for block in (collection_of(thing), thing) if block is not None and block != other_than)
    return next((block for block in blocks if block.asset_data is not None), None)


def replace_levels(thing: bpy.types.Object, ratios: Sequence[float]) -> None:
    """Give an object levels of detail in place of those that it has; they are hidden.

    Args:
        thing: object of a run, which is called NAME_LOD0 while it has levels.
        ratios: fraction of the triangles in each level; empty for none.
    """
    name = thing.name.removesuffix(FULL)
    _remove_parts(thing, "level")
    if not ratios:
        thing.name = thing.data.name = name
        return
    for level in add_levels(thing, ratios, name):
        level.data.pop(KEY, None)  # which the copy of the mesh has, too
        _hide(level, "level")


def replace_hulls(thing: bpy.types.Object, file: Path | None) -> None:
    """Give an object the collision hulls of a .blend in place of those that it has; they are hidden.

    Args:
        thing: object of a run.
        file: .blend of the run that has hulls; None for none.

    Raises:
        InputError: if the file can't be read.
    """
    _remove_parts(thing, "hull")
    if file is None:
        return
    try:
        with bpy.data.libraries.load(str(file)) as (source, wanted):
            wanted.objects = [name for name in source.objects if name.startswith(HULL)]
    except OSError as error:
        raise InputError(file, f"can't be read ({error})", "mark the asset again") from error
    hulls = list(wanted.objects)
    roots = {hull.parent for hull in hulls if hull.parent is not None}
    to_mesh = mesh_to_run(thing).inverted() @ Matrix.Translation(list(thing[ORIGIN]))  # the file's meshes begin at the foot
    for number, hull in enumerate(hulls):
        hull.name = hull.data.name = hull_name(thing, number)
        hull.data.transform(to_mesh)
        hull.parent, hull.matrix_parent_inverse, hull.matrix_basis = thing.parent, thing.matrix_parent_inverse, thing.matrix_basis
        for collection in thing.users_collection:
            collection.objects.link(hull)
        _hide(hull, "hull")
    for root in roots:
        bpy.data.objects.remove(root)


def _hide(thing: bpy.types.Object, part: str) -> None:
    thing[PART] = part
    thing.hide_render = thing.hide_viewport = True


def _remove_parts(thing: bpy.types.Object, part: str) -> None:
    """Remove the levels or hulls in the collections of an object."""
    found = {other for collection in thing.users_collection for other in collection.objects if other.get(PART) == part}
    for other in found:
        mesh = other.data
        bpy.data.objects.remove(other)
        if not mesh.users:
            bpy.data.meshes.remove(mesh)

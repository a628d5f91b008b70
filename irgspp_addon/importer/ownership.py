# SPDX-License-Identifier: GPL-3.0-or-later
"""Ownership of datablocks by imported folders, so that importing a folder again updates its datablocks and creates no duplicates."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import bpy

KEY = "irgspp"  # custom property of a datablock: folder and part, as FOLDER#PART

Block = TypeVar("Block", bound=bpy.types.ID)


class Owner:
    """Datablocks of one imported folder.

    Objects, collections, cameras and materials are reused and filled again, so that the user's changes to them (position, name,
    modifiers, being the scene's camera) stay; images, meshes and Worlds are replaced wherever they are used.
    An instance serves one import and must not be kept: it refers to datablocks, which Blender may free afterwards.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        self._parts: set[str] = set()
        self._known: dict[str, dict[str, Any]] = {}  # by type and key, because a search of all datablocks for each of many cameras is slow

    def key(self, part: str) -> str:
        """Return the key for the datablock of a part, and record that the part is in use."""
        self._parts.add(part)
        return f"{self.folder}#{part}"

    def find(self, blocks: Any, part: str) -> Any | None:
        """Return the folder's datablock of a part, or None; if the user has copied it, the one with the shortest name.

        Args:
            blocks: collection of datablocks, such as `bpy.data.objects`.
            part: name of the part.
        """
        return self._of_kind(blocks).get(f"{self.folder}#{part}")

    def _of_kind(self, blocks: Any) -> dict[str, Any]:
        kind = blocks.bl_rna.identifier
        if kind not in self._known:
            found = [block for block in blocks if block.get(KEY, "").startswith(f"{self.folder}#") and block.library is None]
            found.sort(key=lambda block: (len(block.name), block.name), reverse=True)
            self._known[kind] = {block[KEY]: block for block in found}
        return self._known[kind]

    def _claim(self, blocks: Any, part: str, block: Any) -> Any:
        """Mark a datablock as the folder's and return it."""
        block[KEY] = self.key(part)
        self._of_kind(blocks)[block[KEY]] = block
        return block

    def reuse(self, blocks: Any, part: str, name: str, *arguments: Any) -> Any:
        """Return the folder's datablock of a part, or create it.

        Args:
            blocks: collection of datablocks, such as `bpy.data.cameras`.
            part: name of the part.
            name: name of a new datablock.
            *arguments: further arguments of `blocks.new`.
        """
        return self._claim(blocks, part, self.find(blocks, part) or blocks.new(name, *arguments))

    def replace(self, blocks: Any, part: str, new: Block) -> Block:
        """Replace the folder's datablock of a part wherever it is used, remove it, and return the new one.

        Args:
            blocks: collection of datablocks, such as `bpy.data.meshes`.
            part: name of the part.
            new: new datablock, which takes over the old one's name.
        """
        old = self.find(blocks, part)
        if old is not None:
            name = old.name
            old.user_remap(new)
            blocks.remove(old)
            new.name = name
        return self._claim(blocks, part, new)

    def object(self, part: str, name: str, data: bpy.types.ID | None, parent: bpy.types.Object | None) -> bpy.types.Object:
        """Return the folder's object of a part, created if needed.

        Args:
            part: name of the part.
            name: name of a new object.
            data: its data; None for an empty.
            parent: its parent object.
        """
        placed = self.find(bpy.data.objects, part)
        if placed is None or (placed.data is None) != (data is None):
            placed = bpy.data.objects.new(name, data)
        elif data is not None and placed.data is not data:
            placed.data = data
        placed.parent = parent
        return self._claim(bpy.data.objects, part, placed)

    def remove_unused(self) -> None:
        """Remove the folder's objects, cameras and meshes whose part was not used, because the folder no longer contains it."""
        used = {f"{self.folder}#{part}" for part in self._parts}
        for blocks in (bpy.data.objects, bpy.data.cameras, bpy.data.meshes):
            for key, block in list(self._of_kind(blocks).items()):
                if key not in used:
                    blocks.remove(block)
        self._known.clear()


def rename_owner(folder: Path, place: Path) -> None:
    """Let the datablocks of a folder belong to another folder.

    Args:
        folder: folder that they were imported from.
        place: folder that they belong to from now on.
    """
    data = bpy.data
    for blocks in (data.objects, data.collections, data.cameras, data.meshes, data.materials, data.images, data.worlds):
        for block in blocks:
            key = block.get(KEY, "")
            if block.library is None and key.startswith(f"{folder}#"):
                block[KEY] = f"{place}#{key.rpartition('#')[2]}"


def link(collection: bpy.types.Collection, parent: bpy.types.Collection) -> None:
    """Link a collection into another, unless it is there already.

    Args:
        collection: collection to link.
        parent: collection that receives it.
    """
    if collection.name not in parent.children:
        parent.children.link(collection)


def put(thing: bpy.types.Object, collection: bpy.types.Collection) -> None:
    """Link an object into a collection, unless it is in any collection already, such as one that the user moved it to.

    Args:
        thing: object to link.
        collection: collection that receives it.
    """
    if not thing.users_collection:
        collection.objects.link(thing)


def folder_of(block: bpy.types.ID | None) -> Path | None:
    """Return the imported folder that a datablock belongs to, or None."""
    key = block.get(KEY, "") if block is not None else ""
    return Path(key.rpartition("#")[0]) if "#" in key else None

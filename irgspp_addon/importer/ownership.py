# SPDX-License-Identifier: GPL-3.0-or-later
"""Which datablocks belong to an imported folder: found again on the next import, so that it replaces and never duplicates."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import bpy

KEY = "irgspp"  # custom property that names the folder and the part of it that a datablock shows

Block = TypeVar("Block", bound=bpy.types.ID)


class Owner:
    """The datablocks of one folder.

    Objects, collections, cameras and materials are kept and filled anew, so that what a person did to them (moved, renamed, put a
    modifier on, chose as the scene's camera) stays; images, meshes and Worlds are exchanged wherever they are used.
    Made for one import and not kept: it remembers datablocks, which Blender may free afterwards.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        self._parts: set[str] = set()
        self._known: dict[str, dict[str, Any]] = {}  # by kind and key: a look through everything for each of many cameras takes long

    def key(self, part: str) -> str:
        """What the datablock of a part carries."""
        self._parts.add(part)
        return f"{self.folder}#{part}"

    def find(self, blocks: Any, part: str) -> Any | None:
        """The folder's datablock of that part among e.g. `bpy.data.objects`; of a person's copies the one with the shortest name."""
        return self._of_kind(blocks).get(f"{self.folder}#{part}")

    def _of_kind(self, blocks: Any) -> dict[str, Any]:
        kind = blocks.bl_rna.identifier
        if kind not in self._known:
            found = [block for block in blocks if block.get(KEY, "").startswith(f"{self.folder}#") and block.library is None]
            found.sort(key=lambda block: (len(block.name), block.name), reverse=True)
            self._known[kind] = {block[KEY]: block for block in found}
        return self._known[kind]

    def _keep(self, blocks: Any, part: str, block: Any) -> Any:
        block[KEY] = self.key(part)
        self._of_kind(blocks)[block[KEY]] = block
        return block

    def kept(self, blocks: Any, part: str, name: str, *arguments: Any) -> Any:
        """The datablock of the part, or a new one of this name."""
        return self._keep(blocks, part, self.find(blocks, part) or blocks.new(name, *arguments))

    def exchanged(self, blocks: Any, part: str, new: Block) -> Block:
        """`new` in the place of the part's old datablock, which goes."""
        old = self.find(blocks, part)
        if old is not None:
            name = old.name
            old.user_remap(new)
            blocks.remove(old)
            new.name = name
        return self._keep(blocks, part, new)

    def object(self, part: str, name: str, data: bpy.types.ID | None, parent: bpy.types.Object | None) -> bpy.types.Object:
        """The object of the part with this data, in its place below `parent`."""
        placed = self.find(bpy.data.objects, part)
        if placed is None or (placed.data is None) != (data is None):
            placed = bpy.data.objects.new(name, data)
        elif data is not None and placed.data is not data:
            placed.data = data
        placed.parent = parent
        return self._keep(bpy.data.objects, part, placed)

    def drop_rest(self) -> None:
        """Remove objects and cameras of the folder whose part was not asked for: it is not in the folder any more."""
        kept = {f"{self.folder}#{part}" for part in self._parts}
        for blocks in (bpy.data.objects, bpy.data.cameras, bpy.data.meshes):
            for key, block in list(self._of_kind(blocks).items()):
                if key not in kept:
                    blocks.remove(block)
        self._known.clear()


def link(collection: bpy.types.Collection, parent: bpy.types.Collection) -> None:
    """Put a collection below another, once."""
    if collection.name not in parent.children:
        parent.children.link(collection)


def put(thing: bpy.types.Object, collection: bpy.types.Collection) -> None:
    """Put an object into a collection, unless it is in one of the scene already (a person may have sorted it elsewhere)."""
    if not thing.users_collection:
        collection.objects.link(thing)


def folder_of(block: bpy.types.ID | None) -> Path | None:
    """The imported folder that a datablock belongs to."""
    key = block.get(KEY, "") if block is not None else ""
    return Path(key.rpartition("#")[0]) if "#" in key else None

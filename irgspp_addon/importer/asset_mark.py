# SPDX-License-Identifier: GPL-3.0-or-later
"""Marking of an imported object or its collection as an asset of Blender's Asset Browser: details, catalogue and preview image."""

from __future__ import annotations

import os
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import InputError
from ...core.io.srgb import straight_srgb
from .texture_images import has_file

CATALOGUES = "blender_assets.cats.txt"  # Blender's file of catalogues, in the folder of a library
HEADER = "# This is an Asset Catalog Definition file for Blender.\n\nVERSION 1\n\n"
NAMESPACE = uuid.UUID("6b0f5c0e-3c39-4f0b-9a53-5d2c2f1e7a10")  # of the identifiers of new catalogues


@dataclass(frozen=True)
class AssetDetails:
    """Details of an asset, as the Asset Browser shows them; empty ones stay empty.

    Attributes:
        author: who made it.
        licence: under which it may be used.
        description: of the object.
        tags: words to search by.
        catalogue: path in the library's catalogues, such as "Reconstructions/Toys"; empty: none.
    """

    author: str = ""
    licence: str = ""
    description: str = ""
    tags: tuple[str, ...] = ()
    catalogue: str = ""


def mark_asset(thing: bpy.types.Object | bpy.types.Collection, details: AssetDetails) -> None:
    """Mark an object or collection as asset, or change the details of one.

    Args:
        thing: local datablock.
        details: of the asset.

    Raises:
        InputError: if the object is linked from a library, or the catalogue can't be written.
    """
    check_local(thing)
    catalogue = catalogue_of(details.catalogue) if details.catalogue else None
    if thing.asset_data is None:
        thing.asset_mark()
    asset = thing.asset_data
    assert asset is not None
    asset.author, asset.license, asset.description = details.author, details.licence, details.description
    for tag in list(asset.tags):
        asset.tags.remove(tag)
    for word in details.tags:
        asset.tags.new(word, skip_if_exists=True)
    if catalogue is not None:
        asset.catalog_id = catalogue


def check_local(block: bpy.types.ID) -> None:
    """Raise InputError if a datablock is linked from a library."""
    if block.library is not None or block.override_library is not None:
        raise InputError(block.name, "is linked from another file", "mark it as asset there")


def details_of(thing: bpy.types.Object | bpy.types.Collection) -> AssetDetails | None:
    """Return the details of a datablock that is an asset; None for others.

    Raises:
        InputError: if the library's file of catalogues can't be read.
    """
    asset = thing.asset_data
    if asset is None:
        return None
    file = library_folder() / CATALOGUES if bpy.data.filepath else None
    try:
        entries = _entries(file.read_text("utf-8")) if file is not None and file.is_file() else ()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(file, f"can't be read ({error})", "repair or remove it") from error
    catalogue = next((path for path, identifier in entries if identifier == asset.catalog_id), "")
    return AssetDetails(asset.author, asset.license, asset.description, tuple(tag.name for tag in asset.tags), catalogue)


def catalogue_of(path: str) -> str:
    """Return the identifier of a catalogue of the present file's library, which is added to the library's file if it is new.

    Args:
        path: of the catalogue, with slashes.

    Raises:
        InputError: if the .blend file has not been saved, the path is invalid, or the file of catalogues can't be read or written.
    """
    if not bpy.data.filepath:
        raise InputError("catalogue", "this file has not been saved, so it is in no library", "save it, or leave the catalogue empty")
    clean = "/".join(part.strip() for part in path.split("/") if part.strip())
    if not clean or ":" in clean or "\n" in clean:
        raise InputError(f"catalogue {path}", "is not a path such as Reconstructions/Toys", "use names and slashes, without colons")
    file = library_folder() / CATALOGUES
    try:
        text = file.read_text("utf-8") if file.is_file() else HEADER
        known = dict(_entries(text))
        if clean not in known:
            known[clean] = str(uuid.uuid5(NAMESPACE, clean))
            text += ("" if text.endswith("\n") else "\n") + f"{known[clean]}:{clean}:{clean.replace('/', '-')}\n"
            partial = file.with_name(f".{CATALOGUES}.part")
            partial.write_text(text, "utf-8")
            os.replace(partial, file)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(file, f"can't be read or written ({error})", "choose another folder for the file, or no catalogue") from error
    return known[clean]


def library_folder() -> Path:
    """Return the root of the asset library that the present file is in: one of the preferences', else the file's own folder."""
    folder = Path(bpy.data.filepath).resolve().parent
    roots = [Path(library.path).resolve() for library in bpy.context.preferences.filepaths.asset_libraries if library.path]
    return max((root for root in roots if folder.is_relative_to(root)), key=lambda root: len(root.parts), default=folder)


def _entries(text: str) -> Sequence[tuple[str, str]]:
    """Return paths and identifiers of the catalogues in a file."""
    lines = [line.split(":") for line in text.splitlines() if line.strip() and not line.startswith(("#", "VERSION"))]
    return [(words[1], words[0]) for words in lines if len(words) >= 2]


def set_preview(block: bpy.types.ID, image: np.ndarray) -> None:
    """Give a datablock a preview image.

    Args:
        block: datablock.
        image: (H, W, 4) linear premultiplied, top row first.
    """
    pixels = straight_srgb(image)[::-1]
    preview = block.preview_ensure()
    assert preview is not None
    preview.image_size = (image.shape[1], image.shape[0])
    preview.image_pixels_float.foreach_set(np.ascontiguousarray(pixels, np.float32).reshape(-1))


def missing_images(thing: bpy.types.Object) -> list[str]:
    """Return the names of images in an object's materials that are neither packed nor in a file, so that others would not find them."""
    trees = [slot.material.node_tree for slot in thing.material_slots if slot.material is not None and slot.material.node_tree is not None]
    images = {node.image for tree in trees for node in tree.nodes if node.bl_idname == "ShaderNodeTexImage" and node.image is not None}
    return sorted(image.name for image in images if image.packed_file is None and not has_file(Path(bpy.path.abspath(image.filepath))))

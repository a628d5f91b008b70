# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures of a folder as image datablocks: one image, or UDIM tiles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import bpy

from ...core.errors import InputError, IrgsppError
from ...core.scene.udim import ALL_TILES, tile_number, tile_numbers
from ..image_path import path_in_file
from ..world.light_to_world import load_image


def texture_path(folder: Path, name: str, tiles: int = 1) -> Path:
    """Return the path of a texture: NAME.png, or NAME.<UDIM>.png for all its tiles.

    Args:
        folder: of the files.
        name: of the texture, such as "albedo".
        tiles: along a side.
    """
    return folder / (f"{name}.png" if tiles == 1 else f"{name}.{ALL_TILES}.png")


def texture_files(folder: Path, name: str, tiles: int = 1) -> list[Path]:
    """Return the files of a texture, one or that of each tile.

    Args:
        folder: of the files.
        name: of the texture, such as "albedo".
        tiles: along a side.
    """
    if tiles == 1:
        return [texture_path(folder, name)]
    return [folder / f"{name}.{number}.png" for number in tile_numbers(tiles)]


def has_file(path: Path) -> bool:
    """Return True where the file of an image exists, or that of its first UDIM tile."""
    return path.with_name(path.name.replace(ALL_TILES, str(tile_number(0, 0)))).is_file()


@contextmanager
def existing_paths(images: Iterable[bpy.types.Image]) -> Iterator[None]:
    """Let a file exist at the path NAME.<UDIM>.png of each tiled image meanwhile: Blender writes only paths of files relative to USD.

    Args:
        images: of any source; others than tiled ones are left out.

    Raises:
        IrgsppError: if the system has no such names, as Windows.
    """
    paths = [Path(bpy.path.abspath(image.filepath)) for image in images if image.source == "TILED"]
    try:
        _touch(paths)
        yield
    finally:
        for path in paths:
            with suppress(OSError):
                path.unlink()


def _touch(paths: Iterable[Path]) -> None:
    """Create empty files."""
    for path in paths:
        try:
            path.touch()
        except OSError as error:
            raise IrgsppError(f"{path}: this system allows no such file name, which Blender needs to write UDIM tiles to USD") from error


def load_texture(folder: Path, name: str, pack: bool, tiles: int = 1) -> bpy.types.Image:
    """Load a texture as a new image datablock, with source TILED where there are tiles.

    Args:
        folder: of the files.
        name: of the texture, such as "albedo", whose colours alone are sRGB.
        pack: True to pack the files into the .blend, False to link them.
        tiles: along a side.

    Raises:
        InputError: if a file is missing.
    """
    files = texture_files(folder, name, tiles)
    missing = next((file for file in files if not file.is_file()), None)
    if missing is not None:
        raise InputError(missing, "is missing", "bake the run again")
    image = load_image(files[0], "sRGB" if name == "albedo" else "Non-Color", pack and tiles == 1)
    if tiles > 1:
        image.source, image.name = "TILED", name
        image.filepath = path_in_file(texture_path(folder, name, tiles))
        known = {tile.number for tile in image.tiles}
        for number in tile_numbers(tiles):
            if number not in known:
                image.tiles.new(tile_number=number)
        if pack:
            image.pack()
    return image

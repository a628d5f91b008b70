# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture sizes made from one bake: the run keeps its bake in textures/baked while textures/ holds a smaller size made from it."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

from ..io.image import image_size, png_bits
from ..io.run_json import udim_tiles
from ..scene.mesh import Mesh
from ..scene.mesh_ply import load_mesh_ply
from ..scene.textures import load_textures
from ..scene.udim import FOLDER
from ..surface.texture_reduction import reduced_textures

KEPT = "baked"  # folder in textures/


def bake_folder(run: Path) -> Path:
    """Return the folder with the textures of a run's last bake, whatever size is in use."""
    kept = run / "textures" / KEPT
    return kept if (kept / "albedo.png").is_file() else run / "textures"


def baked_size(run: Path) -> int | None:
    """Return the texels along a side of a run's last bake, of a UDIM tile where it has several; None where it has no textures.

    Raises:
        InputError: if the texture can't be read.
    """
    file = bake_folder(run) / "albedo.png"
    return image_size(file)[0] // udim_tiles(run) if file.is_file() else None


def baked_bits(run: Path) -> int | None:
    """Return the bits of each value of a run's last bake, 8 or 16; None where it has no textures.

    Raises:
        InputError: if the texture can't be read.
    """
    file = bake_folder(run) / "albedo.png"
    if not file.is_file():
        return None
    return 16 if png_bits(file) == 16 else 8  # as `load_texture` reads it


def is_made_from_bake(run: Path, size: int, bits: int) -> bool:
    """Return True for a size that a run's bake gives without baking: a smaller one, or the bake's own while a smaller one is in use.

    Args:
        run: run folder.
        size: texels along a side (of a tile).
        bits: of each value; another number than the bake's is baked.
    """
    baked = baked_size(run)
    return baked is not None and baked_bits(run) == bits and (size < baked or (size == baked and bake_folder(run).name == KEPT))


def mesh_at_size(run: Path, size: int) -> Mesh:
    """Return a run's mesh with textures of a size made from its bake.

    Args:
        run: run folder.
        size: texels along a side (of a tile), at most `baked_size`.

    Raises:
        InputError: if a file can't be read.
    """
    baked = dataclasses.replace(load_mesh_ply(run / "mesh.ply"), textures=load_textures(bake_folder(run)))
    along = size * udim_tiles(run)
    if along == len(baked.textures["albedo"]):
        return baked
    return dataclasses.replace(baked, textures=reduced_textures(baked, along))


def keep_bake(run: Path, partial: Path) -> None:
    """Copy the textures in use to the folder of the bake, unless it is there.

    Args:
        run: run folder.
        partial: folder on the same disk, in which the copy is completed first.
    """
    kept = run / "textures" / KEPT
    if bake_folder(run) == kept:
        return
    shutil.rmtree(kept, ignore_errors=True)  # an incomplete one
    partial.mkdir(exist_ok=True)
    shutil.copytree(run / "textures", partial / KEPT, ignore=shutil.ignore_patterns(FOLDER))
    (partial / KEPT).replace(kept)


def drop_kept_bake(run: Path) -> None:
    """Remove the bake that a run keeps beside its textures: they are of full size again, or another bake has replaced them."""
    shutil.rmtree(run / "textures" / KEPT, ignore_errors=True)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh files of a run folder: mesh.ply, textures/ (with UDIM tiles where there are some) and asset.glb."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from ..scene.glb import save_glb
from ..scene.mesh import Mesh
from ..scene.mesh_ply import save_mesh_ply
from ..scene.textures import save_textures
from ..scene.udim import FOLDER, tile_images
from ..surface.bake import tangents


def save_mesh_files(mesh: Mesh, run: Path, tiles: int = 1) -> None:
    """Write a textured mesh into a run folder as mesh.ply, textures/*.png and asset.glb.

    Args:
        mesh: with its textures.
        run: run folder.
        tiles: UDIM tiles along a side.
    """
    save_mesh_ply(mesh, run / "mesh.ply")
    save_textures(mesh.textures, run / "textures")
    save_tiles(mesh.textures, run / "textures", tiles)
    save_asset_glb(mesh, run / "asset.glb")


def save_tiles(textures: dict[str, np.ndarray], folder: Path, tiles: int) -> None:
    """Write UDIM tiles of textures to folder/udim/<name>.<number>.png, in place of all that are there.

    Args:
        textures: (T, T, 3) or (T, T) by name, as in `Mesh.textures`.
        folder: of the textures.
        tiles: along a side; 1 writes none.
    """
    shutil.rmtree(folder / FOLDER, ignore_errors=True)
    if tiles > 1:
        save_textures(tile_images(textures, tiles), folder / FOLDER)


def save_asset_glb(mesh: Mesh, path: Path, name: str = "object") -> None:
    """Write a mesh as .glb, with the tangents that its normal texture was baked for.

    Args:
        mesh: with its textures, if it has any.
        path: the .glb to write.
        name: of the object.
    """
    frames = tangents(mesh.vertices, mesh.normals, mesh.uvs, mesh.faces) if "normal" in mesh.textures else None
    save_glb(mesh, path, frames, name)

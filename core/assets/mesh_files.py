# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh files of a run folder: mesh.ply, textures/ and asset.glb."""

from __future__ import annotations

from pathlib import Path

from ..scene.glb import save_glb
from ..scene.mesh import Mesh
from ..scene.mesh_ply import save_mesh_ply
from ..scene.textures import save_textures
from ..surface.bake import tangents


def save_mesh_files(mesh: Mesh, run: Path) -> None:
    """Write a textured mesh into a run folder as mesh.ply, textures/*.png and asset.glb.

    Args:
        mesh: with its textures.
        run: run folder.
    """
    save_mesh_ply(mesh, run / "mesh.ply")
    save_textures(mesh.textures, run / "textures")
    save_asset_glb(mesh, run / "asset.glb")


def save_asset_glb(mesh: Mesh, path: Path, name: str = "object") -> None:
    """Write a mesh as .glb, with the tangents that its normal texture was baked for.

    Args:
        mesh: with its textures, if it has any.
        path: the .glb to write.
        name: of the object.
    """
    frames = tangents(mesh.vertices, mesh.normals, mesh.uvs, mesh.faces) if "normal" in mesh.textures else None
    save_glb(mesh, path, frames, name)

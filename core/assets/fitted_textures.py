# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures fitted to what they hold, and what run.json records of them."""

from __future__ import annotations

from dataclasses import replace

from ..detail.report import DetailReport
from ..scene.mesh import Mesh
from ..surface.mesh_texels import mean_texel_side
from ..surface.texture_reduction import reduced_textures


def fitted_textures(mesh: Mesh, report: DetailReport, plain: int, why: str, tiles: int = 1) -> tuple[Mesh, dict[str, object]]:
    """Reduce textures that were made large for detail of the photographs where they hold none.

    Args:
        mesh: with its textures.
        report: of the albedo detail.
        plain: texels along a side (of a tile) that are enough without this detail.
        why: reason of the present size, in one line.
        tiles: UDIM tiles along a side.

    Returns:
        The mesh, and what run.json records of its textures.
    """
    size = len(mesh.textures["albedo"]) // tiles
    if not report.applied and size > plain:
        size, why = plain, f"no detail of the photographs: {report.why}"
        mesh = replace(mesh, textures=reduced_textures(mesh, tiles * size))
    return mesh, texture_state(mesh, size, why, tiles)


def texture_state(mesh: Mesh, baked: int, why: str, tiles: int = 1) -> dict[str, object]:
    """Return what run.json records of textures.

    Args:
        mesh: with the textures that are in use.
        baked: texels along a side (of a tile) of the bake that they are, or are made from.
        why: reason of the size, in one line.
        tiles: UDIM tiles along a side.

    Returns:
        tiles along a side, size and baked in texels along a side of a tile, why, and texel: mean side of a texel on the surface,
        world units.
    """
    along = len(mesh.textures["albedo"])
    texel = mean_texel_side(mesh.vertices, mesh.faces, mesh.uvs, along)
    return {"tiles": tiles, "size": along // tiles, "baked": baked, "texel": float(f"{texel:.4g}"), "why": why}


def texture_line(state: dict[str, object]) -> str:
    """Return the record of textures as one line for the user."""
    tiles = "" if state["tiles"] == 1 else f" in {state['tiles']} x {state['tiles']} UDIM tiles"
    return f"textures of {state['size']} texels{tiles}, {state['texel']} world units each: {state['why']}"

# SPDX-License-Identifier: GPL-3.0-or-later
"""UV unwrapping by xatlas, and packing into UDIM tiles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xatlas

from ..scene.mesh import Mesh, joined_quads
from .meshing import Triangles
from .tile_packing import packed_in_tiles
from .uv_overlap import without_overlap

PADDING = 4  # texels between charts


def unwrap(mesh: Triangles, texture: int, tiles: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unwrap a mesh into charts packed into one square texture, or into UDIM tiles.

    Args:
        mesh: mesh to unwrap.
        texture: texels along a side, of all tiles together.
        tiles: UDIM tiles along a side.

    Returns:
        source: (V,) int64, vertex of `mesh` that each new vertex is a copy of; vertices on a seam have several copies.
        faces: (F, 3) int32 in the order of `mesh.faces`.
        uvs: (V, 2) float32 in 0..1; no chart is mirrored, so that painted text stays readable, and none overlaps
            or crosses the border of a tile.

    Raises:
        InputError: if the tiles have too few texels for the charts.
    """
    # Scaled to size 1 around the origin: xatlas treats areas below an absolute limit as zero, and has float32 coordinates.
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    placed = (mesh.vertices - (low + high) / 2) / max(float((high - low).max()), 1e-30)
    atlas = xatlas.Atlas()
    atlas.add_mesh(placed.astype(np.float32), mesh.faces.astype(np.uint32))
    charts = xatlas.ChartOptions()
    charts.fix_winding = True
    charts.max_cost = 4.0  # twice the default: far fewer small charts without more stretch
    pack = xatlas.PackOptions()
    pack.resolution, pack.padding, pack.bilinear = texture, PADDING, True
    pack.rotate_charts = False  # xatlas rotates by swapping u and v, which mirrors the chart
    atlas.generate(charts, pack)
    source, faces, uvs = atlas[0]
    # One scale for both axes keeps texels square where the atlas is not.
    uvs = uvs * np.array([atlas.width, atlas.height], np.float32) / max(atlas.width, atlas.height)
    uvs = np.clip(uvs, 0, 1).astype(np.float32)
    source, faces, uvs = without_overlap(mesh, source.astype(np.int64), faces.astype(np.int32), uvs, texture, PADDING)
    if tiles == 1:
        return source, faces, uvs
    copied, faces, uvs = packed_in_tiles(faces, uvs, tiles, texture, PADDING)
    return source[copied], faces, uvs


def unwrapped_again(mesh: Mesh, texture: int, tiles: int) -> Mesh:
    """Return a mesh with its charts packed into UDIM tiles, or unwrapped anew into one square; without textures.

    Shape, normals and materials at its vertices stay.

    Args:
        mesh: with any UVs.
        texture: texels along a side, of all tiles together.
        tiles: UDIM tiles along a side.

    Raises:
        InputError: if the tiles have too few texels for the charts.
    """
    if tiles > 1:
        source, faces, uvs = packed_in_tiles(mesh.faces, mesh.uvs, tiles, texture, PADDING, mesh.quads)
    else:  # charts that were cut for tiles are whole again
        place = np.concatenate([mesh.vertices, mesh.normals], -1)
        _, first, welded = np.unique(place, axis=0, return_index=True, return_inverse=True)
        source, faces, uvs = unwrap(Triangles(mesh.vertices[first], welded.reshape(-1)[mesh.faces]), texture)
        source = first[source]
    names = ("vertices", "normals", "albedo", "roughness", "metallic", "confidence", "material_confidence")
    chosen = {name: value[source] for name in names if (value := getattr(mesh, name)) is not None}
    return replace(mesh, **chosen, uvs=uvs, faces=faces, textures={}, quads=joined_quads(faces, mesh.quads))

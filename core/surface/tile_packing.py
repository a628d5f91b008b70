# SPDX-License-Identifier: GPL-3.0-or-later
"""Packing of UV charts into UDIM tiles: no chart crosses the border of a tile, and all keep one scale."""

from __future__ import annotations

import math

import numpy as np
import xatlas
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..errors import InputError

LARGEST = 0.5  # side of a chart over that of a tile, above which it is cut: tiles of few large charts stay half empty
CELLS = 1024  # along a side of a tile, on which charts are packed: more take longer and fill no better
PRECISION = 0.02  # of the scale of the charts
LEAST_SCALE = 1 / 16  # of charts that would fill the tiles


def packed_in_tiles(
    faces: np.ndarray, uvs: np.ndarray, tiles: int, texture: int, padding: int, quads: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pack the charts of a UV map anew so that each lies in one of `tiles` x `tiles` tiles, away from its border.

    Charts are not turned. Those larger than half a tile are cut.

    Args:
        faces: (F, 3).
        uvs: (V, 2) in 0..1, without overlap.
        tiles: along a side, 2 or more.
        texture: texels along the side of all tiles together.
        padding: texels between charts, and from a chart to the border of its tile.
        quads: (F,) bool, which triangles make up quads with the next ones, as in `Mesh.quads`; these are not cut. None without any.

    Returns:
        source: (W,) int64, given vertex that each new one is a copy of.
        faces: (F, 3) int32 in the given order.
        uvs: (W, 2) float32 in 0..1, over all tiles.

    Raises:
        InputError: if the tiles have too few texels for so many charts.
    """
    source, faces, uvs = _cut(faces, uvs.astype(np.float64), LARGEST / tiles, quads)
    chart = chart_of_vertices(faces, len(uvs))
    low, high = _bounds(chart, uvs)
    cells = min(texture // tiles, CELLS)
    border = math.ceil(padding * cells / (texture // tiles))
    pieces = _pieces(faces, chart, uvs - low[chart])
    scale, tile, place = _largest_scale(pieces, float((high - low).max()), cells - 2 * border, border, tiles)
    corner = np.stack([tile % tiles, tile // tiles], -1) + (border + place) / cells
    placed = (corner[chart] + (uvs - low[chart]) * scale / cells) / tiles
    return source, faces.astype(np.int32), placed.astype(np.float32)


def chart_of_vertices(faces: np.ndarray, vertices: int) -> np.ndarray:
    """Return the chart (V,) of each vertex: charts are the parts of a mesh whose faces share vertices.

    Args:
        faces: (F, 3).
        vertices: number V.
    """
    ends = np.concatenate([faces[:, 1], faces[:, 2]])
    graph = coo_array((np.ones(len(ends)), (np.tile(faces[:, 0], 2), ends)), (vertices, vertices))
    return connected_components(graph, directed=False)[1]


def _bounds(chart: np.ndarray, uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest UVs (C, 2) of each chart."""
    low = np.full((chart.max() + 1, 2), np.inf)
    high = -low
    np.minimum.at(low, chart, uvs)
    np.maximum.at(high, chart, uvs)
    return low, high


def _cut(faces: np.ndarray, uvs: np.ndarray, largest: float, quads: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut charts in two, across their longer side, until none is larger or those that are have too few faces."""
    source, before = np.arange(len(uvs)), 0
    while True:
        chart = chart_of_vertices(faces, len(uvs))
        low, high = _bounds(chart, uvs)
        if (high - low).max() <= largest or len(low) == before:
            return source, faces, uvs
        before, owner = len(low), chart[faces[:, 0]]
        centre = uvs[faces].mean(1)[np.arange(len(faces)), (high - low).argmax(1)[owner]]
        middle = np.bincount(owner, centre, before) / np.maximum(np.bincount(owner, minlength=before), 1)
        beyond = (centre > middle[owner]) & ((high - low).max(1) > largest)[owner]
        if quads is not None:
            beyond[np.flatnonzero(quads) + 1] = beyond[quads]
        used, faces = np.unique(faces + len(uvs) * beyond[:, None], return_inverse=True)
        faces, used = faces.reshape(-1, 3), used % len(uvs)
        source, uvs = source[used], uvs[used]


def _pieces(faces: np.ndarray, chart: np.ndarray, uvs: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return UVs (N, 2) float32 and faces (M, 3) uint32 of each chart."""
    owner = chart[faces[:, 0]]
    order = np.argsort(owner, kind="stable")
    pieces = []
    for part in np.split(faces[order], np.searchsorted(owner[order], np.arange(1, chart.max() + 1))):
        used, local = np.unique(part, return_inverse=True)
        pieces.append((uvs[used].astype(np.float32), local.reshape(-1, 3).astype(np.uint32)))
    return pieces


def _largest_scale(
    pieces: list[tuple[np.ndarray, np.ndarray]], extent: float, cells: int, padding: int, tiles: int
) -> tuple[float, np.ndarray, np.ndarray]:
    """Search the largest scale at which charts fit into the tiles.

    Args:
        pieces: C charts.
        extent: of the largest one, UV units.
        cells: along a side of a tile, without the border.
        padding: cells between charts.
        tiles: along a side.

    Returns:
        Cells per UV unit, the tile (C,) of each chart from 0, and the cell (C, 2) of its lower left corner.
    """
    low, high = 0.0, max(cells - 1, 1) / extent  # charts larger than a tile would be shrunk
    scale, best = min(high, float(tiles * cells)), None
    while best is None or high > (1 + PRECISION) * low:
        tile, place = _packed(pieces, scale, cells, padding)
        if tile.max() < tiles**2:
            low, best = scale, (scale, tile, place)
        else:
            high = scale
        if high < LEAST_SCALE * tiles * cells:
            what = f"the UV map's {len(pieces)} charts do not fit into {tiles} x {tiles} tiles of so few texels"
            raise InputError("UDIM tiles", what, "choose larger textures, or fewer tiles")
        scale = (low + high) / 2 if low else 0.85 * scale
    return best


def _packed(pieces: list[tuple[np.ndarray, np.ndarray]], scale: float, cells: int, padding: int) -> tuple[np.ndarray, np.ndarray]:
    """Pack charts at a scale, and return the tile (C,) of each and the cell (C, 2) of its lower left corner."""
    atlas, pack = xatlas.Atlas(), xatlas.PackOptions()
    for uvs, faces in pieces:
        atlas.add_uv_mesh(uvs, faces)
    pack.resolution, pack.padding, pack.texels_per_unit, pack.bilinear = cells, padding, scale, True
    pack.rotate_charts = pack.rotate_charts_to_axis = False  # by swapping u and v, which mirrors the chart
    atlas.generate(pack_options=pack)
    tile, place = np.zeros(len(pieces), np.int64), np.zeros((len(pieces), 2))
    for i in range(len(pieces)):
        page = atlas.get_mesh_vertex_assignment(i)[0].astype(np.int32)
        if page.min() >= 0:  # else without area
            tile[i], place[i] = page[0], atlas[i][2].min(0) * cells
    return tile, place

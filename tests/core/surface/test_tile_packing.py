# SPDX-License-Identifier: GPL-3.0-or-later
"""UV charts in UDIM tiles: none crosses a border or comes near one, all keep one scale, and faces stay where they are in space."""

import numpy as np
import pytest
import trimesh
from irgspp.core.errors import InputError
from irgspp.core.surface.mesh_texels import doubled_area, mesh_texels, texel_owners
from irgspp.core.surface.meshing import Triangles
from irgspp.core.surface.tile_packing import chart_of_vertices, packed_in_tiles
from irgspp.core.surface.unwrap import PADDING, unwrap
from irgspp.core.surface.uv_overlap import covering_faces

TILE = 128  # texels along a side


@pytest.fixture(scope="module")
def body():
    solid = trimesh.creation.icosphere(3)
    vertices = np.array(solid.vertices) * (1 + 0.2 * np.sin(4 * np.array(solid.vertices)[:, :1]))
    return Triangles(vertices, np.array(solid.faces))


@pytest.fixture(scope="module", params=[2, 3])
def packed(body, request):
    return request.param, *unwrap(body, request.param * TILE, request.param)


def test_no_chart_crosses_or_touches_the_border_of_a_tile(packed):
    tiles, _, faces, uvs = packed
    tile = np.floor(uvs * tiles)
    chart = chart_of_vertices(faces, len(uvs))
    assert all(len(np.unique(tile[chart == c], axis=0)) == 1 for c in range(chart.max() + 1))
    inside = (uvs * tiles - tile) * TILE  # texels from the tile's lower left corner
    assert inside.min() >= PADDING and inside.max() <= TILE - PADDING


def test_all_tiles_are_used_at_one_scale(body, packed):
    tiles, source, faces, uvs = packed
    assert len(np.unique(np.floor(uvs * tiles), axis=0)) == tiles**2
    single_source, single_faces, single = unwrap(body, tiles * TILE)
    before, after = (np.abs(doubled_area(points.astype(np.float64))) for points in (single[single_faces], uvs[faces]))
    factor = np.sqrt(after / before)
    assert factor.max() / factor.min() < 1.001  # each triangle grows or shrinks alike
    assert factor.mean() > 0.75  # nearly as fine as one square of as many texels; padding takes a large part of tiles as small as these
    np.testing.assert_array_equal(source[faces], single_source[single_faces])  # the same places of the surface


def test_charts_do_not_overlap_and_are_not_mirrored(packed):
    _, _, faces, uvs = packed
    assert covering_faces(uvs, faces).max() == 1
    assert (doubled_area(uvs[faces].astype(np.float64)) > 0).all()


def test_texels_around_a_chart_take_its_own_values(body, packed):
    tiles, source, faces, uvs = packed
    size, chart = tiles * TILE, chart_of_vertices(faces, len(uvs))
    texels = mesh_texels(body.vertices[source], uvs, faces, size)
    filled = texels.image(chart[faces[texels.face, 0]].astype(np.int32))
    tile_of = np.floor(np.stack([uvs[faces[:, 0], 0], uvs[faces[:, 0], 1]], -1) * tiles) @ [1, tiles]
    owner = texel_owners(uvs, faces, size)[1]
    row, column = np.nonzero(owner >= 0)
    of_chart = {int(chart[faces[f, 0]]): tile_of[f] for f in range(len(faces))}
    for down in (-PADDING // 2, 0, PADDING // 2):  # a margin that bilinear filtering and a smaller size read
        for right in (-PADDING // 2, 0, PADDING // 2):
            near = filled[row + down, column + right]
            here = (column + right) // TILE + tiles * (tiles - 1 - (row + down) // TILE)
            assert all(of_chart[c] == h for c, h in zip(near[::7].tolist(), here[::7].tolist(), strict=True))


def test_quads_are_not_cut():
    n = 12
    u, v = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1))
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1)
    faces = np.stack([a, a + 1, a + n + 2, a, a + n + 2, a + n + 1], -1).reshape(-1, 3)
    quads = np.arange(len(faces)) % 2 == 0
    _, cut, uvs = packed_in_tiles(faces, np.stack([u, v], -1).reshape(-1, 2), 2, 2 * TILE, PADDING, quads)
    chart = chart_of_vertices(cut, len(uvs))
    assert chart.max() >= 4
    assert (cut[::2, 0] == cut[1::2, 0]).all() and (cut[::2, 2] == cut[1::2, 1]).all()


def test_tiles_of_too_few_texels_are_refused(body):
    with pytest.raises(InputError, match=r"UDIM tiles: .* do not fit into 4 x 4 tiles of so few texels; choose larger textures"):
        unwrap(body, 64, 4)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Texels of a mesh: which triangle each lies in, where, and images that are made of their values."""

import numpy as np
import pytest
import trimesh
from irgspp.core.surface import mesh_texels as module
from irgspp.core.surface.mesh_texels import MeshTexels, barycentric, doubled_area, mesh_texels
from irgspp.core.surface.meshing import Triangles
from irgspp.core.surface.unwrap import unwrap

SIZE = 200


@pytest.fixture(scope="module")
def sphere():
    """Vertices, UVs and faces of an unwrapped sphere of radius 1."""
    body = trimesh.creation.icosphere(4)
    source, faces, uvs = unwrap(Triangles(np.array(body.vertices), np.array(body.faces)), 256)
    return np.array(body.vertices)[source], uvs, faces


@pytest.fixture(scope="module")
def texels(sphere) -> MeshTexels:
    return mesh_texels(*sphere, SIZE)


def place(texels: MeshTexels) -> np.ndarray:
    """Centres (P, 2) of texels as UVs."""
    return np.stack([texels.index % SIZE + 0.5, SIZE - (texels.index // SIZE + 0.5)], -1) / SIZE


def test_texels_lie_in_their_triangle(sphere, texels):
    vertices, uvs, faces = sphere
    weights = texels.weights()
    assert weights.min() > -1e-6
    np.testing.assert_allclose(weights.sum(-1), 1)
    np.testing.assert_allclose(texels.interpolate(uvs, faces), place(texels), atol=1e-7)
    assert (np.linalg.norm(texels.interpolate(vertices, faces), axis=-1) > 0.98).all()


def test_chunks_together_are_all_texels(sphere, texels, monkeypatch):
    vertices, _, faces = sphere
    whole = texels.interpolate(vertices, faces)
    monkeypatch.setattr(module, "CHUNK", 1000)
    assert len(list(texels.chunks())) == -(-len(texels.index) // 1000)
    np.testing.assert_array_equal(texels.interpolated(vertices, faces), whole.astype(np.float32))
    again = mesh_texels(*sphere, SIZE)
    np.testing.assert_array_equal(again.barycentric, texels.barycentric)


def test_side_is_that_of_a_texel_on_the_surface(sphere, texels):
    area = (texels.side[texels.face].astype(np.float64) ** 2).sum()
    assert area == pytest.approx(4 * np.pi, rel=0.02)


def test_barycentric_coordinates_weigh_the_corners():
    triangle = np.array([[[0, 0], [4, 0], [0, 2]], [[1, 1], [1, 3], [3, 1]], [[1, 1], [2, 2], [3, 3]]], float)
    weight = np.array([[0.5, 0.25, 0.25], [0.1, 0.2, 0.7]])
    point = (weight[..., None] * triangle[:2]).sum(1)
    np.testing.assert_allclose(barycentric(triangle, np.concatenate([point, [[0, 5]]]))[:2], weight)
    assert np.isfinite(barycentric(triangle[2:], np.array([[0.0, 5.0]]))).all()
    assert doubled_area(triangle).tolist() == [8, -4, 0]


def test_image_fills_every_texel_with_the_nearest_value(texels):
    image = texels.image(np.full(len(texels.index), 7, np.uint8))
    assert image.shape == (SIZE, SIZE) and (image == 7).all()
    colour = texels.image(np.stack([texels.index % SIZE, texels.index // SIZE], -1).astype(np.uint8))
    row, column = texels.index // SIZE, texels.index % SIZE
    np.testing.assert_array_equal(colour[row, column], np.stack([column, row], -1))
    known = np.stack([row, column], -1)
    for place in np.argwhere(~np.isin(np.arange(SIZE * SIZE), texels.index).reshape(SIZE, SIZE))[::500]:
        taken = colour[tuple(place)][::-1].astype(int)
        assert np.hypot(*(taken - place)) == pytest.approx(np.hypot(*(known - place).T).min())

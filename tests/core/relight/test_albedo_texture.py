# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedo texture in views: lookups against known textures, and where it takes the place of the Gaussians' albedo."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.io.srgb import decode_srgb
from irgspp.core.relight.albedo_texture import AlbedoTexture, load_albedo_texture
from irgspp.core.relight.mesh_query import MeshQuery
from irgspp.core.relight.relighter import Relighter
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.textures import save_textures

pytestmark = pytest.mark.usefixtures("engine")
RED = (200, 20, 10)  # sRGB
SIZE = 64  # texels along a side


def square() -> Mesh:
    """Unit square in the plane Z = 0 whose UVs are its X and Y."""
    corners = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    up = np.float32([[0, 0, 1]] * 4)
    return Mesh(
        corners, up, corners[:, :2], np.int32([[0, 1, 2], [1, 3, 2]]), np.full((4, 3), 0.5, np.float32), *np.zeros((2, 4), np.float32)
    )


def lookup(texture: np.ndarray, pixel: float, facing: float = 1.0, count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Look a texture up at random points of the square; return its X and Y, and the albedo."""
    weights = np.random.default_rng(0).dirichlet(np.ones(3), count).astype(np.float32)
    triangle = torch.arange(count) % 2
    place = (square().vertices[square().faces[triangle]] * weights[..., None]).sum(1)
    sizes = (torch.full((count,), value) for value in (pixel, facing))
    return place[:, :2], AlbedoTexture(texture, square()).sample(triangle, torch.from_numpy(weights), *sizes).numpy()


def test_a_fine_pixel_shows_the_texture():
    ramp = np.uint8(np.broadcast_to(np.linspace(60, 180, SIZE)[:, None, None], (SIZE, SIZE, 3)))
    place, found = lookup(ramp, 0.1 / SIZE)
    row = np.clip((1 - place[:, 1]) * SIZE - 0.5, 0, SIZE - 1)
    expected = np.interp(row, np.arange(SIZE), decode_srgb(ramp[:, 0, 0] / 255.0))
    np.testing.assert_allclose(found, np.repeat(expected[:, None], 3, 1), atol=1e-3)


def test_a_coarse_pixel_shows_the_mean_in_linear_light():
    checks = np.uint8(255 * (np.indices((SIZE, SIZE)).sum(0) % 2))[..., None].repeat(3, 2)
    np.testing.assert_allclose(lookup(checks, 4 / SIZE)[1], 0.5, atol=0.01)
    assert lookup(checks, 0.1 / SIZE)[1].std() > 0.1


def test_a_slanted_pixel_is_larger():
    noise = np.random.default_rng(1).integers(0, 255, (SIZE, SIZE, 3)).astype(np.uint8)
    straight, slanted = (lookup(noise, 1.5 / SIZE, facing)[1].std() for facing in (1.0, 0.2))
    assert slanted < 0.8 * straight


@pytest.mark.parametrize("backend", ["mesh", "gaussian"])
def test_pixels_that_see_the_mesh_take_its_albedo(relighter, camera, backend):
    textured, scale = with_texture(relighter("mesh"), 1.0), (0.5, 1.0, 2.0)
    assert textured.mesh is not None
    query = textured.query if backend == "mesh" else relighter("gaussian").query
    scaled = Relighter(textured.reconstruction, query, textured.settings, textured.mesh).with_albedo_scale(scale)
    surface, red = scaled.surface(camera), decode_srgb(np.float32(RED) / 255)
    inside = (surface.alpha > 0.99).numpy()
    shown = np.isclose(surface.mean_albedo().numpy(), red * scale, atol=2e-3).all(1)
    assert inside.sum() > 1000 and shown[inside].mean() > 0.97
    layer = scaled.gbuffer(camera).albedo.reshape(-1, 3)[surface.index[inside]]  # without the factor
    assert np.isclose(layer, red, atol=2e-3).all(1).mean() > 0.97
    assert scaled.gbuffer(camera, surface).albedo == pytest.approx(scaled.gbuffer(camera).albedo)


def test_a_mesh_elsewhere_tells_nothing(relighter, camera):
    plain = relighter("mesh", balls=((np.zeros(3), 1.0),))
    far = with_texture(plain, 0.9)
    for one in (far.surface(camera), plain.surface(camera)):
        assert one.albedo.numpy() == pytest.approx(np.tile(np.float32([0.6, 0.4, 0.2]), (len(one.index), 1)), abs=1e-3)


def with_texture(relighter: Relighter, size: float) -> Relighter:
    """Return a relighter whose mesh is red, and larger or smaller by a factor than the Gaussians' surface."""
    assert relighter.mesh is not None
    mesh = dataclasses.replace(relighter.mesh._mesh, vertices=np.float32(size) * relighter.mesh._mesh.vertices)
    query = MeshQuery(mesh, 2.0, albedo=AlbedoTexture(np.full((SIZE, SIZE, 3), RED, np.uint8), mesh))
    return Relighter(relighter.reconstruction, query, relighter.settings, query)


@pytest.mark.parametrize(("state", "expected"), [({}, False), ({"applied": False}, False), ({"applied": True}, True)])
def test_only_textures_with_detail_are_loaded(tmp_path, state, expected):
    (tmp_path / "run.json").write_text(json.dumps({"phases": {}, "settings": {}, "albedo_detail": state}))
    assert load_albedo_texture(tmp_path, square()) is None  # none was baked
    save_textures({"albedo": np.full((SIZE, SIZE, 3), RED, np.uint8)}, tmp_path / "textures")
    assert (load_albedo_texture(tmp_path, square()) is not None) == expected


def test_a_damaged_texture_is_named(tmp_path):
    (tmp_path / "run.json").write_text(json.dumps({"phases": {}, "settings": {}, "albedo_detail": {"applied": True}}))
    (tmp_path / "textures").mkdir()
    (tmp_path / "textures" / "albedo.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"albedo\.png: not a readable image"):
        load_albedo_texture(tmp_path, square())

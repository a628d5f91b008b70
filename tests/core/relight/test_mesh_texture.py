# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures of a mesh in views: lookups against known textures, and where they take the place of what the Gaussians show."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.io.srgb import decode_srgb
from irgspp.core.relight.mesh_query import MeshQuery
from irgspp.core.relight.mesh_texture import MeshTexture, NormalTexture, load_albedo_texture, load_normal_texture
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
    return place[:, :2], MeshTexture(texture, square()).sample(triangle, torch.from_numpy(weights), *sizes).numpy()


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
    query = MeshQuery(mesh, 2.0, albedo=MeshTexture(np.full((SIZE, SIZE, 3), RED, np.uint8), mesh))
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


def codes(normal: tuple[float, float, float]) -> np.ndarray:
    """Return a normal texture of one normal in tangent space."""
    return np.round(255 * (0.5 + 0.5 * np.broadcast_to(np.float32(normal), (SIZE, SIZE, 3)))).astype(np.uint8)


@pytest.mark.parametrize("mirrored", [False, True])
def test_normals_follow_the_directions_of_u_and_v(mirrored):
    mesh = square()
    if mirrored:
        mesh = dataclasses.replace(mesh, uvs=mesh.uvs * np.float32([-1, 1]) + np.float32([1, 0]))
    texture = NormalTexture(codes((0.6, 0.0, 0.8)), mesh)
    triangle, weights = torch.tensor([0, 1]), torch.full((2, 3), 1 / 3)
    found = texture.sample(triangle, weights, torch.full((2,), 0.01), torch.ones(2))
    expected = np.tile([-0.6 if mirrored else 0.6, 0.0, 0.8], (2, 1))
    np.testing.assert_allclose(found, expected, atol=0.01)  # 8 bits


@pytest.mark.parametrize("weight", [0.0, 0.5, 1.0])
def test_pixels_are_shaded_by_the_normals_of_the_texture(relighter, camera, weight):
    plain = relighter("mesh", mesh_normals=weight)
    assert plain.mesh is not None
    mesh = plain.mesh._mesh
    across = np.stack([mesh.vertices[:, 0], mesh.vertices[:, 1]], 1) / 8 + 0.5  # seen from above, u grows along X
    mesh = dataclasses.replace(mesh, uvs=across.astype(np.float32))
    query = MeshQuery(mesh, 2.0, normal=NormalTexture(codes((0.6, 0.0, 0.8)), mesh))
    textured = Relighter(plain.reconstruction, query, plain.settings, query)
    surface, before = textured.surface(camera), plain.surface(camera)
    inside = (surface.alpha > 0.99) & (before.normal[:, 2] > 0.5)
    turned = torch.rad2deg(torch.arccos((surface.normal * before.normal).sum(1).clamp(-1, 1)))[inside]
    expected = np.degrees(np.arctan2(weight * 0.6, 1 - weight * 0.2))
    assert float(turned.median()) == pytest.approx(expected, abs=1.5)
    layer = textured.gbuffer(camera).normal.reshape(-1, 3)[surface.index]
    np.testing.assert_allclose(layer, surface.normal, atol=1e-6)


def test_a_run_without_textures_has_no_normal_texture(tmp_path):
    assert load_normal_texture(tmp_path, square()) is None
    save_textures({"normal": codes((0, 0, 1))}, tmp_path / "textures")
    assert load_normal_texture(tmp_path, square()) is not None

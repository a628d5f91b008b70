# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures as PNG files."""

import numpy as np
import pytest
from irgspp.core.errors import InputError
from irgspp.core.scene.textures import load_textures, occlusion_roughness_metallic, save_textures


def test_round_trip_is_exact(mesh, tmp_path):
    save_textures(mesh.textures, tmp_path / "textures")
    loaded = load_textures(tmp_path / "textures")
    assert loaded.keys() == mesh.textures.keys()
    for name, texture in mesh.textures.items():
        np.testing.assert_array_equal(loaded[name], texture)
    assert sorted(p.name for p in (tmp_path / "textures").iterdir()) == [f"{n}.png" for n in sorted(mesh.textures)]


def test_missing_textures_are_left_out(mesh, tmp_path):
    save_textures({"albedo": mesh.textures["albedo"]}, tmp_path)
    assert list(load_textures(tmp_path)) == ["albedo"]


def test_a_broken_image_is_one_clear_line(mesh, tmp_path):
    save_textures(mesh.textures, tmp_path)
    (tmp_path / "normal.png").write_bytes((tmp_path / "normal.png").read_bytes()[:50])
    with pytest.raises(InputError, match=r"normal\.png: not a readable image"):
        load_textures(tmp_path)


def test_packed_channels(mesh):
    packed = occlusion_roughness_metallic(mesh.textures)
    assert (packed[..., 0] == 255).all()
    np.testing.assert_array_equal(packed[..., 1], mesh.textures["roughness"])
    np.testing.assert_array_equal(packed[..., 2], mesh.textures["metallic"])


def test_heights_keep_sixteen_bits(mesh, tmp_path):
    heights = np.random.default_rng(0).integers(0, 65536, (16, 16), dtype=np.uint16)
    save_textures({**mesh.textures, "height": heights}, tmp_path)
    loaded = load_textures(tmp_path)
    np.testing.assert_array_equal(loaded["height"], heights)
    assert loaded["height"].dtype == np.uint16 and loaded["roughness"].dtype == np.uint8
    save_textures({"height": mesh.textures["roughness"]}, tmp_path)
    with pytest.raises(InputError, match=r"height\.png: not a readable image \(its values are L, not 16 bits\)"):
        load_textures(tmp_path)


def test_sixteen_bits_come_back_exactly(mesh, tmp_path):
    rng = np.random.default_rng(0)
    deep = {name: rng.integers(0, 65536, texture.shape, dtype=np.uint16) for name, texture in mesh.textures.items()}
    save_textures(deep, tmp_path)
    loaded = load_textures(tmp_path)
    for name, texture in deep.items():
        np.testing.assert_array_equal(loaded[name], texture)
    packed = occlusion_roughness_metallic(loaded)
    assert packed.dtype == np.uint16 and (packed[..., 0] == 65535).all()


def test_a_truncated_texture_of_sixteen_bits_is_refused(tmp_path):
    noise = np.random.default_rng(0).integers(0, 65536, (64, 64, 3), dtype=np.uint16)
    save_textures({"albedo": noise}, tmp_path)
    (tmp_path / "albedo.png").write_bytes((tmp_path / "albedo.png").read_bytes()[:9000])
    with pytest.raises(InputError, match=r"albedo\.png: not a readable image"):
        load_textures(tmp_path)


def test_a_texture_with_other_channels_is_refused(tmp_path):
    save_textures({"roughness": np.zeros((8, 8, 3), np.uint16)}, tmp_path)
    with pytest.raises(InputError, match=r"roughness\.png: not a readable image \(it has the shape \(8, 8, 3\), not 1 channels"):
        load_textures(tmp_path)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures made smaller: averages over areas in linear light, unit normals, and nothing from outside the charts."""

from __future__ import annotations

import numpy as np
import pytest
from irgspp.core.io.srgb import decode_srgb, encode_srgb
from irgspp.core.scene.mesh import Mesh
from irgspp.core.surface.texture_reduction import reduced_textures

SIZE = 64


def square(low: float, high: float, **textures: np.ndarray) -> Mesh:
    """Return two triangles that cover the square from `low` to `high` in both directions of the texture."""
    corners = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
    place = np.concatenate([corners, np.zeros((4, 1), np.float32)], -1)
    normals, faces = np.tile(np.float32([0, 0, 1]), (4, 1)), np.int32([[0, 1, 2], [0, 2, 3]])
    grey, half = np.full((4, 3), 0.5, np.float32), np.full(4, 0.5, np.float32)
    return Mesh(place, normals, corners, faces, grey, half, half, textures)


def stripes(one: int, other: int, channels: int = 3) -> np.ndarray:
    """Return columns of two values in turn, (SIZE, SIZE, channels) uint8."""
    image = np.full((SIZE, SIZE, channels), one, np.uint8)
    image[:, 1::2] = other
    return image


def test_colour_is_averaged_in_linear_light_and_roughness_as_it_is() -> None:
    mesh = square(0, 1, albedo=stripes(40, 200), roughness=stripes(40, 200)[..., 0])
    small = reduced_textures(mesh, SIZE // 2)
    mean = decode_srgb(np.array([40, 200]) / 255).mean()
    assert np.abs(small["albedo"].astype(float) - 255 * encode_srgb(mean)).max() <= 0.5 + 1e-3
    assert (small["roughness"] == 120).all() and small["roughness"].shape == (SIZE // 2, SIZE // 2)
    assert small["albedo"].dtype == small["roughness"].dtype == np.uint8


def test_normals_stay_of_unit_length() -> None:
    tilted = np.full((SIZE, SIZE, 3), 0, np.uint8)
    tilted[:, 0::2] = np.round(255 * (0.5 + 0.5 * np.array([0.8, 0, 0.6])))
    tilted[:, 1::2] = np.round(255 * (0.5 + 0.5 * np.array([-0.8, 0, 0.6])))
    small = reduced_textures(square(0, 1, albedo=stripes(9, 9), normal=tilted), SIZE // 2)["normal"]
    assert (np.abs(small.astype(int) - [128, 128, 255]) <= 1).all()  # their plain average is .6 long


def test_what_lies_outside_the_charts_is_left_out() -> None:
    albedo = np.full((SIZE, SIZE, 3), 250, np.uint8)
    first = round(0.25 * SIZE) + 1  # the chart's edge lies inside a texel of the small texture
    albedo[first:-first, first:-first] = 60
    small = reduced_textures(square(first / SIZE, 1 - first / SIZE, albedo=albedo), SIZE // 4)["albedo"]
    assert (small == 60).all()


@pytest.mark.parametrize("size", [SIZE, 48, 24, 1])
def test_any_smaller_size_keeps_an_even_colour(size: int) -> None:
    small = reduced_textures(square(0.1, 0.9, albedo=stripes(77, 77)), size)
    assert small["albedo"].shape == (size, size, 3) and (small["albedo"] == 77).all()


def test_heights_are_averaged_in_sixteen_bits() -> None:
    heights = np.full((SIZE, SIZE), 30_001, np.uint16)
    heights[:, 1::2] = 30_101
    small = reduced_textures(square(0, 1, albedo=stripes(9, 9), height=heights), SIZE // 2)["height"]
    assert small.dtype == np.uint16 and (np.abs(small.astype(int) - 30_051) <= 1).all()


def test_sixteen_bits_are_averaged_as_finely() -> None:
    deep = {"albedo": 257 * stripes(40, 200).astype(np.uint16), "roughness": stripes(0, 1)[..., 0].astype(np.uint16)}
    small = reduced_textures(square(0, 1, **deep, normal=np.full((SIZE, SIZE, 3), 40000, np.uint16)), SIZE // 2)
    assert {texture.dtype for texture in small.values()} == {np.dtype(np.uint16)}
    mean = decode_srgb(np.array([40, 200]) / 255).mean()
    assert np.abs(small["albedo"] - 65535 * encode_srgb(mean)).max() <= 1
    assert np.abs(small["normal"] / 65535 - (0.5 + 0.5 / np.sqrt(3))).max() < 1e-4

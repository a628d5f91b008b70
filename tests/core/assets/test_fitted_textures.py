# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures that were made large for detail of the photographs, and hold some or none."""

from __future__ import annotations

import numpy as np
import pytest
from irgspp.core.assets.fitted_textures import fitted_textures, texture_line
from irgspp.core.detail.report import DetailReport
from irgspp.core.scene.mesh import Mesh


@pytest.fixture
def mesh() -> Mesh:
    """A square of side 3 whose chart covers a quarter of textures of 64 texels."""
    uvs = np.float32([[0, 0], [0.5, 0], [0.5, 0.5], [0, 0.5]])
    place = np.concatenate([6 * uvs, np.zeros((4, 1), np.float32)], -1)
    half = np.full(4, 0.5, np.float32)
    textures = {"albedo": np.full((64, 64, 3), 100, np.uint8), "roughness": np.full((64, 64), 50, np.uint8)}
    return Mesh(place, np.float32([[0, 0, 1]] * 4), uvs, np.int32([[0, 1, 2], [0, 2, 3]]), np.full((4, 3), 0.5), half, half, textures)


def test_textures_without_detail_are_reduced(mesh: Mesh) -> None:
    fitted, state = fitted_textures(mesh, DetailReport(False, "photographs disagree"), 16, "many pixels")
    assert {name: texture.shape for name, texture in fitted.textures.items()} == {"albedo": (16, 16, 3), "roughness": (16, 16)}
    assert state == {"tiles": 1, "size": 16, "baked": 16, "texel": 0.375, "why": "no detail of the photographs: photographs disagree"}
    assert texture_line(state).startswith("textures of 16 texels, 0.375 world units each: no detail")


@pytest.mark.parametrize(("applied", "plain"), [(True, 16), (False, 64)])
def test_others_stay(mesh: Mesh, applied: bool, plain: int) -> None:
    fitted, state = fitted_textures(mesh, DetailReport(applied, "a reason"), plain, "many pixels")
    assert fitted is mesh and state == {"tiles": 1, "size": 64, "baked": 64, "texel": 0.09375, "why": "many pixels"}

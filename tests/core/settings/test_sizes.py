# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers of Gaussians, voxels and triangles that follow from the object's pixels, within the bounds of the settings."""

from __future__ import annotations

import pytest
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import PRESETS, FirstStageSettings, Settings, SurfaceSettings, preset
from irgspp.core.settings.sizes import (
    FEWEST_GAUSSIANS,
    FEWEST_TRIANGLES,
    FEWEST_VOXELS,
    gaussians_at_start,
    triangles_of_mesh,
    voxels_along,
    with_sizes,
)


@pytest.mark.parametrize(("pixels", "count"), [(1_000, 40_000), (16_000, 60_000), (28_282, 106_058), (200_000, 120_000), (None, 40_000)])
def test_balanced_takes_gaussians_for_each_pixel(pixels: float | None, count: int) -> None:
    assert gaussians_at_start(FirstStageSettings(), pixels) == count


@pytest.mark.parametrize(("pixels", "count"), [(1_000, 40_000), (28_000, 70_000), (200_000, 100_000), (None, 40_000)])
def test_balanced_takes_triangles_for_each_pixel(pixels: float | None, count: int) -> None:
    assert triangles_of_mesh(SurfaceSettings(), pixels) == count
    assert with_sizes(Settings(), pixels).surface.triangles == count


def test_settings_are_never_exceeded() -> None:
    few = FirstStageSettings(gaussians=500)
    assert gaussians_at_start(few, 1e6) == gaussians_at_start(few, None) == gaussians_at_start(few, 1) == 500
    assert triangles_of_mesh(SurfaceSettings(triangles=500), 1e6) == triangles_of_mesh(SurfaceSettings(triangles=500), None) == 500
    assert voxels_along(SurfaceSettings(voxels=40), 1e4) == voxels_along(SurfaceSettings(voxels=40), 1) == 40


def test_presets_of_fixed_size_stay() -> None:
    for pixels in (None, 10.0, 1e7):
        assert with_sizes(preset("paper"), pixels) == preset("paper")
    assert voxels_along(preset("paper").surface, 1.0) == preset("paper").surface.voxels


def test_high_is_as_fine_as_large_photographs_and_no_finer_than_small_ones() -> None:
    high, small, unmasked = (with_sizes(preset("high"), pixels) for pixels in (3e5, 3e3, None))
    assert high == preset("high") == unmasked and high.first.gaussians == 200_000 and high.surface.triangles == 150_000
    assert small.first.gaussians == FEWEST_GAUSSIANS and small.surface.triangles == FEWEST_TRIANGLES


@pytest.mark.parametrize("name", PRESETS)
def test_applied_twice_the_same(name: str) -> None:
    once = with_sizes(preset(name), 17_000.0)
    assert with_sizes(once, 17_000.0) == once


@pytest.mark.parametrize(("pixels", "count"), [(50.0, FEWEST_VOXELS), (150.0, 250.0), (1000.0, 384)])
def test_voxels_have_a_fixed_size_in_pixels(pixels: float, count: float) -> None:
    assert voxels_along(SurfaceSettings(), pixels) == pytest.approx(count)


def test_zero_turns_the_rules_off() -> None:
    settings = with_overrides(Settings(), ["first.gaussians_per_pixel=0", "surface.voxel_pixels=0", "surface.triangles_per_pixel=0"])
    assert triangles_of_mesh(settings.surface, 10.0) == settings.surface.triangles > FEWEST_TRIANGLES
    assert gaussians_at_start(settings.first, 10.0) == settings.first.gaussians > FEWEST_GAUSSIANS
    assert voxels_along(settings.surface, 10.0) == settings.surface.voxels > FEWEST_VOXELS

# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture size of a job: as fine as the photographs' pixels on the object where detail can be taken from them, and no more than fits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import InputError
from irgspp.core.machine import texture_size
from irgspp.core.machine.cpu_memory import FreeMemory
from irgspp.core.machine.texture_size import choose_texture_size, size_by_pixels
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.scene.dataset import Dataset
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings, preset


@pytest.fixture(scope="module")
def demo() -> Dataset:
    return load_dataset(DEMO_DATA)


def reduced(data: Dataset, reduction: float) -> Dataset:
    """Return a dataset whose photographs are larger by a factor than its views."""
    return replace(data, train=[replace(view, reduction=reduction) for view in data.train])


def reduction_for(data: Dataset, pixels: float) -> float:
    """Return the factor with which so many pixels of a full-size photograph show the object."""
    return (pixels / data.object_pixels) ** 0.5


def test_small_photographs_keep_the_least_size(demo: Dataset) -> None:
    assert demo.reduction == 1
    assert {name: size_by_pixels(preset(name), demo).size for name in ("draft", "balanced", "high", "paper")} == {
        "draft": 512, "balanced": 1024, "high": 4096, "paper": 2048
    }  # fmt: skip


@pytest.mark.parametrize(("pixels", "size"), [(120_000, 1024), (400_000, 2048), (1_900_000, 4096), (9e6, 4096)])
def test_texels_are_about_as_fine_as_pixels(demo: Dataset, pixels: float, size: int) -> None:
    settings = with_overrides(Settings(), ["data.resolution=64"])  # that of the demo
    chosen = size_by_pixels(settings, reduced(demo, reduction_for(demo, pixels)))
    assert chosen.size == size and f"{pixels:,.0f} pixels of a full-size photograph" in chosen.why


@pytest.mark.parametrize(("pixels", "tiles", "size"), [(1_900_000, 2, 2048), (9e6, 2, 4096), (9e6, 4, 4096), (9e6, 3, 4096)])
def test_sizes_count_for_each_tile(demo: Dataset, pixels: float, tiles: int, size: int) -> None:
    settings = with_overrides(Settings(), ["data.resolution=64", f"surface.udim_tiles={tiles}"])
    assert size_by_pixels(settings, reduced(demo, reduction_for(demo, pixels))).size == size


def test_tiles_together_have_no_more_texels_than_one_texture_may(demo: Dataset) -> None:
    settings = with_overrides(preset("high"), ["data.resolution=64", "surface.udim_tiles=3"])
    assert size_by_pixels(settings, reduced(demo, reduction_for(demo, 9e7))).size == 4096  # 3 x 8192 would be too many
    with pytest.raises(InputError, match="4 x 4 tiles of 8192 texels are more than 16384 texels along a side"):
        with_overrides(Settings(), ["surface.texture=8192", "surface.udim_tiles=4"])


def test_presets_have_bounds_of_their_own(demo: Dataset) -> None:
    large = reduced(demo, reduction_for(demo, 5e6))
    assert [size_by_pixels(preset(name), large).size for name in ("draft", "high")] == [1024, 8192]


def test_without_detail_of_photographs_the_least_size_is_enough(demo: Dataset) -> None:
    large = reduced(demo, reduction_for(demo, 5e6))
    assert size_by_pixels(with_overrides(Settings(), ["surface.albedo_detail=off"]), large).size == 1024
    side = max(demo.train[0].camera.width, demo.train[0].camera.height) * large.reduction
    overrides = [f"data.resolution={round(side)}", "first.gaussians=10000000", "first.gaussians_per_pixel=2"]
    assert size_by_pixels(with_overrides(Settings(), overrides), large).size == 1024


def test_more_pixels_than_gaussians_are_detail_too(demo: Dataset) -> None:
    large = reduced(demo, reduction_for(demo, 5e6))
    side = max(demo.train[0].camera.width, demo.train[0].camera.height) * large.reduction
    assert size_by_pixels(with_overrides(Settings(), [f"data.resolution={round(side)}"]), large).size == 4096


def test_a_size_that_is_set_is_taken(demo: Dataset, tmp_path: Path) -> None:
    large = reduced(demo, reduction_for(demo, 5e6))
    chosen = choose_texture_size(with_overrides(Settings(), ["surface.texture=300"]), large, tmp_path)
    assert (chosen.size, chosen.why) == (300, "as set")


def test_without_masks_the_bounding_sphere_counts(demo: Dataset) -> None:
    bare = replace(demo, train=[replace(view, alpha=None) for view in demo.train])
    camera = bare.train[0].camera
    assert demo.object_pixels < bare.outline_pixels < camera.width * camera.height
    near = replace(bare, bound=replace(bare.bound, radius=100 * bare.bound.radius))
    assert near.outline_pixels == pytest.approx(camera.width * camera.height)


@pytest.mark.parametrize(("lack", "words"), [("memory", "memory"), ("disk", "disk space"), ("time", "the time budget")])
def test_less_is_chosen_where_something_is_short(
    demo: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lack: str, words: str
) -> None:
    large, settings = reduced(demo, reduction_for(demo, 1.9e6)), Settings()
    assert choose_texture_size(settings, large, tmp_path).size == 4096
    monkeypatch.setattr(texture_size, "resident_memory", lambda: 0)  # that of the tests' process may be anything
    if lack == "memory":
        monkeypatch.setattr(texture_size, "free_memory", lambda: FreeMemory(1 << 30, "a test"))
    elif lack == "disk":
        monkeypatch.setattr(texture_size, "free_disk_space", lambda run: 600_000_000)
    else:
        settings = replace(settings, time=30.0)
    chosen = choose_texture_size(settings, large, tmp_path)
    assert 512 <= chosen.size < 4096 and f"would take too much {'of ' if lack == 'time' else ''}{words}" in chosen.why


def test_readers_note_how_much_they_reduce(tmp_path: Path) -> None:
    whole, half = (load_dataset(DEMO_DATA, replace(Settings().data, resolution=size)) for size in (640, 32))
    assert (whole.reduction, half.reduction) == (1, 2)
    assert (whole.full_size_ratio(32), half.full_size_ratio(32), half.full_size_ratio(640)) == (2, 2, 1)
    assert half.full_size_pixels == whole.full_size_pixels
    assert np.isclose(half.object_pixels * half.reduction**2, whole.object_pixels, rtol=0.05)

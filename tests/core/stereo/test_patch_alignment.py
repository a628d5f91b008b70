# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches are found where they are, whatever the brightness, to the fraction of a pixel that the noise allows."""

import numpy as np
import pytest
from irgspp.core.kernels.reference.patch_alignment import aligned
from irgspp.core.stereo.patch_alignment import align_patches, sampled

SIZE, SAMPLES = 96, 9
_draw = np.random.default_rng(2)
WAVES = _draw.normal(size=(2, 30)) * 0.25  # radians for each pixel
PHASES = _draw.uniform(0, 2 * np.pi, 30)


def pattern(places: np.ndarray) -> np.ndarray:
    """Smooth values (...,) of places (..., 2)."""
    return 0.5 + 0.03 * np.sin(places @ WAVES + PHASES).sum(-1)


def image() -> np.ndarray:
    x, y = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    return pattern(np.stack([x, y], -1)).astype(np.float32)


def grids(count: int) -> np.ndarray:
    """Places (count, 81, 2) of square patches away from the border."""
    beside = np.arange(SAMPLES) - SAMPLES // 2
    grid = np.stack(np.meshgrid(beside, beside), -1).reshape(1, -1, 2)
    return np.random.default_rng(0).uniform(15, SIZE - 15, (count, 1, 2)) + grid


def test_sampled_values_are_those_of_a_smooth_image():
    places = grids(20)
    assert sampled(image(), places) == pytest.approx(pattern(places), abs=0.004)
    outside = np.array([[[-5.0, 0.5], [SIZE + 5.0, SIZE - 0.5]]])
    assert sampled(image(), outside)[0] == pytest.approx(image()[[0, -1], [0, -1]])


def test_shifts_are_found_under_another_brightness_and_contrast():
    places = grids(40)
    shift = np.random.default_rng(1).uniform(-1.5, 1.5, (40, 2))
    values = 0.3 * pattern(places + shift[:, None]) - 0.1
    found = align_patches(image(), places, values)
    assert found.settled.mean() > 0.9
    assert np.abs(found.shift - shift)[found.settled].max() < 0.01
    assert found.correlation[found.settled].min() > 0.999


def test_noisy_patches_are_placed_as_the_reference_places_them():
    places, rng = grids(30), np.random.default_rng(6)
    values = pattern(places) + rng.normal(scale=0.01, size=places.shape[:2])
    found = align_patches(image(), places, values)
    assert found.settled.mean() > 0.9
    for i in np.flatnonzero(found.settled):
        shift, correlation = aligned(image(), places[i], values[i])
        assert found.shift[i] == pytest.approx(shift, abs=0.1 * found.deviation[i] + 0.005)
        assert found.correlation[i] == pytest.approx(correlation, abs=1e-3)


def test_the_stated_deviation_is_that_of_noise():
    places, rng = grids(400), np.random.default_rng(5)
    values = pattern(places) + rng.normal(scale=0.01, size=places.shape[:2])
    found = align_patches(image(), places, values)
    error = np.linalg.norm(found.shift, axis=1)[found.settled]
    assert np.sqrt(np.mean((error / found.deviation[found.settled]) ** 2)) == pytest.approx(1, rel=0.15)


def test_what_an_image_does_not_show_is_not_found():
    places = grids(50)
    flat = align_patches(np.full((SIZE, SIZE), 0.5, np.float32), places, pattern(places))
    assert not (flat.correlation > 0.9).any()
    noise = np.random.default_rng(7).uniform(size=(SIZE, SIZE)).astype(np.float32)
    other = align_patches(noise, places, pattern(places))
    assert not (other.settled & (other.correlation > 0.9)).any()
    assert np.isfinite(flat.shift).all() and np.isfinite(flat.deviation).all()
    assert len(align_patches(noise, places[:0], pattern(places[:0])).shift) == 0

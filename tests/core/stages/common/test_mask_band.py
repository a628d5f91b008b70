# SPDX-License-Identifier: GPL-3.0-or-later
"""Band at the edge of a mask that may be wrong, against an object and a background that are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from irgspp.core.datasets.mask_limits import narrowest_mask, widest_mask
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.dataset import View
from irgspp.core.stages.common.mask_band import find_mask_band
from irgspp.core.stages.common.training_view import BAND_WEIGHT, make_training_view

HEIGHT, WIDTH, EDGE = 40, 60, 30.5  # the object covers the columns left of EDGE
OBJECT, BACKGROUND = np.array([0.6, 0.2, 0.1]), np.array([0.05, 0.1, 0.4])  # linear


def coverage():
    return np.tile(np.clip(EDGE - np.arange(WIDTH), 0, 1).astype(np.float32), (HEIGHT, 1))


def view(camera_ring, shift=0, error=3.0):
    """Photograph of the object over the background; its mask is wrong by `shift` columns."""
    camera = Camera(WIDTH, HEIGHT, 60.0, 60.0, 30.0, 20.0, camera_ring(3)[0].to_world)
    alpha = coverage()[..., None]
    colour = encode_srgb(alpha * OBJECT + (1 - alpha) * BACKGROUND).astype(np.float32)
    return View("a", camera, Path("a.png"), colour, np.roll(coverage(), shift, 1) * (np.arange(WIDTH) < 50), mask_error=error)


def test_band_lies_on_both_sides_of_the_edge(camera_ring):
    one = view(camera_ring)
    band = find_mask_band(one)
    assert np.flatnonzero(band.pixels[20]).tolist() == list(range(28, 34))
    assert (widest_mask(one)[20] >= 0.5).sum() == 34 and (narrowest_mask(one)[20] >= 0.5).sum() == 28


def test_masks_with_known_edges_have_no_band(camera_ring):
    exact = view(camera_ring, error=0.0)
    assert find_mask_band(exact) is None and find_mask_band(replace(exact, alpha=None, mask_error=3.0)) is None
    assert find_mask_band(view(camera_ring)) is not None and find_mask_band(replace(view(camera_ring), cut_by_colours=True)) is None
    assert widest_mask(exact) is exact.alpha and narrowest_mask(exact) is exact.alpha


@pytest.mark.parametrize("shift", [-2, 0, 2])
def test_background_is_continued_behind_the_object(camera_ring, shift):
    band = find_mask_band(view(camera_ring, shift))
    assert np.allclose(band.background[band.pixels], BACKGROUND, atol=2e-3)
    assert not band.background[~band.pixels].any()


@pytest.mark.parametrize("shift", [-2, 2])
def test_true_outline_is_the_best_whatever_the_mask_says(camera_ring, shift):
    """The object rendered with its true coverage matches the photograph; rendered with the mask's, it does not."""
    one = view(camera_ring, shift)
    prepared = make_training_view(one)
    straight = torch.tensor(OBJECT, dtype=torch.float32)[:, None, None].expand(3, HEIGHT, WIDTH)

    def error(alpha):
        on_black = encode_srgb(straight) * alpha
        return float((prepared.completed(on_black, straight, alpha) - prepared.image)[:, 10:30, :48].abs().mean())

    assert error(torch.from_numpy(coverage())) < 1e-3 < 0.01 < error(torch.from_numpy(one.alpha))


def test_mask_counts_less_in_its_band_than_elsewhere(camera_ring):
    prepared = make_training_view(view(camera_ring))
    inside, outside = prepared.alpha.clone(), prepared.alpha.clone()
    inside[:, 30], outside[:, 40] = 0, 1
    weight = float(prepared.alpha[0, 30])
    assert float(prepared.mask_difference(inside)) == pytest.approx(BAND_WEIGHT * weight / WIDTH)
    assert float(prepared.mask_difference(outside)) == pytest.approx(1 / WIDTH)


def test_crop_and_reduction_keep_the_layers_together(camera_ring):
    small = make_training_view(view(camera_ring), 2)
    assert small.band.shape == small.background.shape[1:] == small.alpha.shape == (20, 30)
    cut = make_training_view(view(camera_ring), crop=True)
    assert cut.band.shape == cut.alpha.shape == (HEIGHT, 43) and cut.background.shape == (3, HEIGHT, 43)
    assert float(cut.band.sum()) == float(make_training_view(view(camera_ring)).band.sum())


def test_clipped_values_in_the_band_are_bounded_by_one(camera_ring):
    one = view(camera_ring)
    one.colour[20, 31] = 1.0
    prepared = make_training_view(one)
    assert prepared.saturated[:, 20, 31].all()
    assert prepared.bounded(torch.full_like(prepared.image, 1.5))[:, 20, 31].tolist() == [1, 1, 1]

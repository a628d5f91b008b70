# SPDX-License-Identifier: GPL-3.0-or-later
"""Adaptive sampling reaches the requested error with fewer samples than uniform sampling."""

import numpy as np
import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.relight.adaptive_sampling import PILOT, Noise, srgb_derivative
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.shading.procedural_lights import sunset_light


def noise_of(variance: torch.Tensor) -> Noise:
    count = len(variance)
    return Noise(
        variance, torch.full((count,), torch.inf), torch.full((count,), float(PILOT)), torch.full((count,), 64.0), torch.arange(count)
    )


def test_noisy_tiles_get_more_and_all_together_get_as_few_as_will_do():
    noise = noise_of(torch.tensor([1e-6] * 90 + [1e-2] * 10))
    needed = noise.needed(0.01)
    assert needed[:90].max() == PILOT and needed[90:].min() >= 8 * PILOT
    assert (noise.error2(needed) * noise.pixels).sum() <= 0.01**2 * noise.pixels.sum()
    fewer = torch.where(needed > PILOT, needed // 2, needed)
    assert (noise.error2(fewer) * noise.pixels).sum() > 0.01**2 * noise.pixels.sum()
    assert (noise.needed(1.0) == PILOT).all()


def test_what_a_filter_errs_by_bounds_what_is_left_of_the_noise():
    noise = noise_of(torch.full((4,), 1e-2))
    filtered = Noise(noise.variance, torch.full((4,), 1e-4), noise.samples, noise.pixels, noise.tile)
    assert filtered.error() < 0.3 * noise.error()
    assert filtered.needed(0.005).sum() < noise.needed(0.005).sum()


def test_slope_of_the_encoding():
    x = torch.tensor([0.001, 0.01, 0.2, 0.9], dtype=torch.float64)
    expected = (encode_srgb((x + 1e-6).numpy()) - encode_srgb((x - 1e-6).numpy())) / 2e-6
    np.testing.assert_allclose(srgb_derivative(x).numpy(), expected, rtol=1e-3)
    assert srgb_derivative(torch.tensor([1.5])) == 0


def test_the_error_is_about_what_was_asked_for(relighter, camera):
    light = prepare_light(sunset_light(32, 64))
    one, true = (relighter("mesh", denoise="off", **how) for how in ({"error": 0.01}, {"samples": 2048}))
    surface = one.surface(camera)
    seen, expected = (encode_srgb(r.relit(surface, light)[..., :3].clamp(0, 1).numpy()).reshape(-1, 3)[surface.index] for r in (one, true))
    error = float(np.sqrt(np.square(seen - expected).mean()))
    assert one.estimated_error <= 0.0101 and 0.5 < one.estimated_error / error < 1.6
    assert PILOT < one.tally["samples"] / one.tally["pixels"] < 512


def test_the_paper_s_filter_has_an_error_of_its_own(relighter):
    with pytest.raises(InputError, match="--error"):
        relighter("mesh", error=0.01, denoise="paper")

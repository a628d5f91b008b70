# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimated noise of an image tells how many samples a requested error needs."""

import numpy as np
import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.relight.image_noise import PILOT_SAMPLES, SAMPLE_STEPS, Noise
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.shading.procedural_lights import sunset_light


def noise_of(variance: torch.Tensor, bias2: float = torch.inf, samples: int = PILOT_SAMPLES) -> Noise:
    return Noise(variance, torch.full_like(variance, bias2), torch.zeros_like(variance), torch.full_like(variance, 64.0), samples)


def test_as_few_samples_as_will_do():
    noise = noise_of(torch.tensor([1e-6] * 90 + [1e-2] * 10))
    needed = noise.needed(0.01)
    assert noise.error(needed) <= 0.01 < noise.error(needed // 2)
    assert noise.needed(1.0) == 2 * PILOT_SAMPLES
    assert noise.needed(1e-9) == SAMPLE_STEPS[-1] == noise_of(noise.variance, samples=SAMPLE_STEPS[-1]).needed(1e-9)


def test_what_a_filter_errs_by_bounds_what_is_left_of_the_noise():
    noise, filtered = (noise_of(torch.full((4,), 1e-2), bias2) for bias2 in (torch.inf, 1e-4))
    assert filtered.error() < 0.4 * noise.error()
    assert filtered.needed(0.005) < noise.needed(0.005)


@pytest.mark.parametrize("denoise", ["demodulated", "off"])
def test_small_lamps_in_metal_are_not_missed(relighter, camera, denoise):
    """Few pixels of a smooth ball reflect a small lamp, and few of 16 samples meet it: both halves of them may agree on none."""
    lamp = np.full((64, 128, 3), 0.05, np.float32)
    lamp[14:16, 95:97] = 40.0
    light, scene = prepare_light(lamp), ("mesh", (0.9, 0.8, 0.6, 0.2, 1.0), ((np.zeros(3), 1.0),))
    one, few, many = (relighter(*scene, denoise=denoise, **how) for how in ({"error": 0.01}, {"samples": PILOT_SAMPLES}, {"samples": 4096}))
    surface = one.surface(camera)
    image, noisy, true = (
        encode_srgb(r.relit(surface, light)[..., :3].clamp(0, 1).numpy()).reshape(-1, 3)[surface.index] for r in (one, few, many)
    )
    assert np.sqrt(np.square(image - true).mean()) < 0.01 < 0.5 * np.sqrt(np.square(noisy - true).mean())


def test_the_error_is_about_what_was_asked_for(relighter, camera):
    light = prepare_light(sunset_light(32, 64))
    one, true = (relighter("mesh", denoise="off", **how) for how in ({"error": 0.01}, {"samples": 2048}))
    surface = one.surface(camera)
    seen, expected = (encode_srgb(r.relit(surface, light)[..., :3].clamp(0, 1).numpy()).reshape(-1, 3)[surface.index] for r in (one, true))
    error = float(np.sqrt(np.square(seen - expected).mean()))
    assert one.estimated_error <= 0.0101 and 0.5 < one.estimated_error / error < 1.6
    assert PILOT_SAMPLES < one.tally["samples"] / one.tally["pixels"] < 512


def test_the_paper_s_filter_has_an_error_of_its_own(relighter):
    with pytest.raises(InputError, match="--error"):
        relighter("mesh", error=0.01, denoise="paper")

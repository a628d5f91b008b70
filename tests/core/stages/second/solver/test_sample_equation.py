# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance of a sample as a function of the albedo, its encoded difference, and the robust error of points."""

import math

import numpy as np
import torch
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.stages.second.solver.multi_view_samples import MultiViewSamples
from irgspp.core.stages.second.solver.sample_equation import CAUCHY_SCALE, approximate_srgb_derivative, robust_error, view_terms


def samples(colour, saturated=None):
    """Two points, with two samples and one."""
    colour = torch.tensor(colour)[:, None].expand(3, 3)
    saturated = torch.zeros(3, 3, dtype=torch.bool) if saturated is None else torch.tensor(saturated)[:, None].expand(3, 3)
    position = torch.zeros(2, 3)
    return MultiViewSamples(position, position, torch.tensor([0, 0, 1]), torch.zeros(3, 3), colour, saturated)


def test_dielectric_and_metal():
    """E = 2, S = 3, S' = 0.5, 1 - E_s = 0.9: the albedo scales the diffuse part of the one and the lobe of the other."""
    terms = [torch.tensor([[v]]) for v in (0.9, 2.0, 3.0, 0.5)]
    for metallic, factor, rest in ((0.0, 1.8, 0.62), (1.0, 3.0, 0.5), (0.5, 2.4, 0.56)):
        found = view_terms(torch.tensor(metallic), *terms)
        np.testing.assert_allclose([float(v) for v in found], [factor, rest], rtol=1e-5)


def test_derivative_is_about_that_of_the_encoding():
    colour = torch.linspace(0.02, 1, 50)
    exact = (encode_srgb(colour + 1e-3) - encode_srgb(colour - 1e-3)) / 2e-3
    np.testing.assert_allclose(approximate_srgb_derivative(colour), exact, rtol=0.06)
    assert approximate_srgb_derivative(torch.zeros(1)) == approximate_srgb_derivative(torch.tensor([3e-3]))


def test_error_is_summed_over_samples_and_channels():
    seen = samples([0.5, 0.5, 0.2])
    radiance = seen.colour + torch.tensor([CAUCHY_SCALE, 0.0, 2 * CAUCHY_SCALE])[:, None]
    found = robust_error(seen, radiance, torch.ones(3, 3))
    np.testing.assert_allclose(found, [3 * math.log(2), 3 * math.log(5)], rtol=1e-4)


def test_clipped_sample_is_a_lower_bound():
    seen = samples([1.0, 1.0, 1.0], [True, False, True])
    above, below = (robust_error(seen, seen.colour + sign * 0.1, torch.ones(3, 3)) for sign in (1, -1))
    one = 3 * math.log1p((0.1 / CAUCHY_SCALE) ** 2)
    np.testing.assert_allclose(above, [one, 0], rtol=1e-4)
    np.testing.assert_allclose(below, [2 * one, one], rtol=1e-4)

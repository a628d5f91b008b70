# SPDX-License-Identifier: GPL-3.0-or-later
"""Minimum cut by convex relaxation against cuts whose cost is known."""

import numpy as np
import pytest
from irgspp.core.capture.convex_cut import minimum_cut


def disc(radius: float, size: int = 64) -> np.ndarray:
    y, x = np.mgrid[:size, :size] + 0.5 - size / 2
    return (x * x + y * y < radius * radius).astype(np.float32)


def test_a_noisy_disc_is_recovered():
    truth, rng = disc(20), np.random.default_rng(0)
    cost = (1 - 2 * truth) + rng.normal(0, 1.5, truth.shape)
    u = minimum_cut(cost, np.full_like(truth, 2.0), np.full_like(truth, 0.5), 400)
    inside = u > 0.5
    assert (inside & (truth > 0)).sum() / (inside | (truth > 0)).sum() > 0.95
    assert ((u > 0.1) & (u < 0.9)).mean() < 0.05


@pytest.mark.parametrize(("radius", "kept"), [(12, True), (5, False)])
def test_a_disc_is_kept_where_its_area_outweighs_its_edge(radius, kept):
    """Cost -1 on a disc and +1 elsewhere: with weight w the disc is worth its edge if pi r^2 > 2 pi r w, so from r = 2 w on."""
    cost = 1 - 2 * disc(radius)
    u = minimum_cut(cost, np.full_like(cost, 4.0), disc(radius), 800)
    assert (u.max() > 0.5) == kept


def test_without_weight_each_pixel_decides_for_itself():
    cost = np.random.default_rng(1).normal(size=(9, 7)).astype(np.float32)
    u = minimum_cut(cost, np.zeros_like(cost), np.full_like(cost, 0.5), 400)
    clear = np.abs(cost) > 0.05
    assert ((u > 0.5) == (cost < 0))[clear].all()

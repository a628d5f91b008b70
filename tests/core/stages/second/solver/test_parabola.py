# SPDX-License-Identifier: GPL-3.0-or-later
"""Minimum of sampled functions."""

import numpy as np
import pytest
import torch
from irgspp.core.stages.second.solver.parabola import parabola_minimum


def test_the_minimum_of_a_parabola_is_its_vertex():
    knots = torch.arange(6.0)
    vertices = torch.tensor([0.0, 0.4, 1.0, 2.3, 3.5, 4.9, 5.0])
    cost = 2 * (knots - vertices[:, None]) ** 2 + 1
    np.testing.assert_allclose(parabola_minimum(knots, cost), vertices, atol=1e-5)


def test_the_minimum_stays_within_the_knots():
    knots = torch.tensor([0.1, 0.2, 0.4, 0.8])
    falling, rising, flat = torch.tensor([4.0, 3.0, 2.0, 1.0]), torch.tensor([1.0, 2.0, 3.0, 4.0]), torch.ones(4)
    hollow = torch.tensor([5.0, 1.0, 2.0, 5.0])  # knots are not evenly spread: towards 0.4 steps are longer
    found = parabola_minimum(knots, torch.stack([falling, rising, flat, hollow]))
    assert found[:2].tolist() == pytest.approx([0.8, 0.1])
    assert 0.1 <= found[2] <= 0.4 and 0.2 < found[3] < 0.3

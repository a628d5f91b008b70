# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers of samples per strategy, and their shifts over the image."""

import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.relight.sample_counts import pixel_shifts, sample_counts


@pytest.mark.parametrize(
    ("samples", "metallic", "counts"),
    [
        ("hq", False, (128, 128, 256)),
        ("hq", True, (64, 256, 192)),
        ("efficient", False, (8, 8, 16)),
        ("efficient", True, (2, 8, 6)),
        ("64", False, (16, 16, 32)),
        (30, False, (8, 7, 15)),
        (30, True, (4, 15, 11)),
        (1, False, (1, 0, 0)),
    ],
)
def test_counts(samples, metallic, counts):
    assert sample_counts(samples, metallic) == counts


@pytest.mark.parametrize("samples", ["0", "-3", "many", "1e3", "1000000", ""])
def test_counts_that_are_none(samples):
    with pytest.raises(InputError, match="hq, efficient"):
        sample_counts(samples, False)


def test_shifts_are_a_pixel_s_own_and_even():
    shifts = pixel_shifts(torch.arange(64 * 64), 64)
    assert torch.equal(shifts[100:200], pixel_shifts(torch.arange(100, 200), 64))
    assert shifts.min() >= 0 and shifts.max() < 1
    cells = torch.histogramdd(shifts, [8, 8], range=[0.0, 1.0, 0.0, 1.0]).hist
    assert cells.min() > 0.7 * 64 and cells.max() < 1.3 * 64
    # Neighbours lie far apart on the torus.
    gap = (shifts.view(64, 64, 2)[:, 1:] - shifts.view(64, 64, 2)[:, :-1]).abs()
    assert torch.minimum(gap, 1 - gap).norm(dim=-1).min() > 0.2

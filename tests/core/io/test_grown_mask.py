# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks whose edge is moved outwards or inwards."""

import numpy as np
import pytest
from irgspp.core.io.grown_mask import grown_mask


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize("pixels", [-3.2, -2.0, 1.6, 5.0])
def test_a_disc_grows_and_shrinks_by_its_radius(dtype, pixels):
    row, column = np.indices((61, 61)) - 30
    disc = (np.hypot(row, column) < 15.5).astype(dtype)
    grown = grown_mask(disc, pixels)
    assert grown.dtype == dtype
    np.testing.assert_array_equal(grown[30] > 0, np.abs(column[0]) < 15.5 + round(pixels))
    assert grown.sum() == pytest.approx(np.pi * (15.5 + round(pixels)) ** 2, rel=0.06)


def test_less_than_half_a_pixel_changes_nothing():
    mask = np.eye(5, dtype=np.float32)
    assert grown_mask(mask, 0.4) is mask and grown_mask(mask, -0.4) is mask

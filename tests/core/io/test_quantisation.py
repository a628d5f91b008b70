# SPDX-License-Identifier: GPL-3.0-or-later
"""Quantisation of images to 8 and 16 bits."""

import numpy as np
import pytest
from irgspp.core.io.quantisation import eight_bits, in_eight_bits, quantised, srgb_quantised


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_values_are_rounded_and_clipped(dtype):
    values = np.array([[-1, 0, 0.49 / 255, 0.51 / 255], [254.4 / 255, 1, 7, np.nan]], dtype)
    assert eight_bits(values).tolist() == [[0, 0, 0, 1], [254, 255, 255, 0]] and eight_bits(values).dtype == np.uint8


def test_all_levels_are_kept():
    levels = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(eight_bits(levels / np.float32(255)), levels)


def test_linear_values_are_encoded():
    linear = np.array([0, 0.0031308, 0.2, 1, 2])
    assert srgb_quantised(linear, 8).tolist() == [0, 10, 124, 255, 255]
    assert srgb_quantised(linear, 16).tolist() == [0, 2651, 31754, 65535, 65535]


def test_sixteen_bits_become_the_nearest_of_eight():
    levels = np.arange(65536, dtype=np.uint16)
    np.testing.assert_array_equal(in_eight_bits(levels), eight_bits(levels / 65535))
    shallow = np.arange(256, dtype=np.uint8)
    assert in_eight_bits(shallow) is shallow and (in_eight_bits(quantised(shallow / 255, 16)) == shallow).all()

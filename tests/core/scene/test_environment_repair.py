# SPDX-License-Identifier: GPL-3.0-or-later
"""Environment maps with impossible texels are repaired, with a remark for each repair."""

import numpy as np
import pytest
from irgspp.core.scene.environment_files import repair_environment


def light_map():
    return np.random.default_rng(0).random((4, 8, 3), np.float32) + 0.5


def test_a_valid_light_is_left_unchanged():
    light = light_map()
    result, remarks = repair_environment(light, "light map")
    assert not remarks
    np.testing.assert_array_equal(result, light)


def test_every_fault_is_repaired_and_counted():
    light = light_map()
    light[0, 0], light[0, 1, 2] = np.nan, np.nan
    light[0, 2, 0], light[0, 3] = -1, -np.inf
    light[1, 0, 1], light[1, 4] = np.inf, np.inf
    before = light.copy()
    result, remarks = repair_environment(light, "light map")
    message = "; ".join(remarks)
    assert "2 texels are not a number, set to 0" in message
    assert "2 texels are negative, set to 0" in message
    assert f"2 texels are infinite, set to {before[np.isfinite(before)].max():g}" in message
    assert np.isfinite(result).all() and result.min() == 0 and result.dtype == np.float32
    valid = np.isfinite(before) & (before >= 0)
    np.testing.assert_array_equal(result[valid], before[valid])
    np.testing.assert_array_equal(light, before)  # the input is not changed


@pytest.mark.parametrize("value", [0.0, -3.0, np.nan, -np.inf, np.inf])
def test_a_light_without_any_power_becomes_a_dim_grey(value):
    result, remarks = repair_environment(np.full((4, 8, 3), value, np.float32), "light map")
    np.testing.assert_allclose(result, 1e-4)
    assert "all 32 texels are black, set to a grey of 0.0001" in "; ".join(remarks)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Launches of warp's kernels on torch's tensors: repeated ones read the arguments of their own call."""

import pytest
import torch

wp = pytest.importorskip("warp")

from irgspp.core.kernels.warp.runtime import launch  # noqa: E402


@wp.kernel
def fill(
    factor: float, shift: int, turn: wp.vec2, rows: wp.array2d(dtype=float), places: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)
):
    i = wp.tid()
    out[i] = factor * rows[i, 1] + float(shift) + places[i][2] + turn[1]


@pytest.mark.parametrize("turn", [0.0, 100.0])
def test_each_launch_has_its_own_arguments(turn):
    for count, factor, shift in ((3, 2.0, 1), (5, 0.5, -4)):
        rows, places, out = torch.rand(count, 2), torch.rand(count, 3), torch.zeros(count)
        launch(fill, count, factor, shift, wp.vec2(0.0, turn), rows, places, out)
        torch.testing.assert_close(out, factor * rows[:, 1] + shift + places[:, 2] + turn)


def test_without_threads_nothing_happens():
    launch(fill, 0, 1.0, 0, wp.vec2(0.0, 0.0), torch.zeros(0, 2), torch.zeros(0, 3), torch.zeros(0))


@pytest.mark.parametrize("wrong", [torch.zeros(4, dtype=torch.float64), torch.zeros(8)[::2]])
def test_a_tensor_that_a_kernel_cannot_read_is_an_error(wrong):
    with pytest.raises(ValueError, match="contiguous tensor of"):
        launch(fill, 4, 1.0, 0, wp.vec2(0.0, 0.0), torch.zeros(4, 2), torch.zeros(4, 3), wrong)


def test_rows_may_be_apart():
    rows, places, out = torch.rand(4, 6)[:, 2:4], torch.rand(4, 3), torch.zeros(4)
    launch(fill, 4, 2.0, 1, wp.vec2(0.0, 0.0), rows, places, out)
    torch.testing.assert_close(out, 2 * rows[:, 1] + 1 + places[:, 2])

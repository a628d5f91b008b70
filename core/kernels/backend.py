# SPDX-License-Identifier: GPL-3.0-or-later
"""Which kernels work on a tensor: numba's on the CPU, warp's on a GPU, and in tests warp's on the CPU."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

_forced: list[bool] = []


def by_warp(tensor: torch.Tensor) -> bool:
    """True where the device's kernels are to do the work."""
    return tensor.device.type != "cpu" or bool(_forced)


@contextmanager
def warp_on_cpu() -> Iterator[None]:
    """Within it, warp's CPU device stands in for numba: the way to test the device's kernels where there is no GPU. It is slow."""
    _forced.append(True)
    try:
        yield
    finally:
        _forced.pop()

# SPDX-License-Identifier: GPL-3.0-or-later
"""Which kernels work on a tensor: numba's on the CPU, warp's on a GPU, and in tests warp's on the CPU."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import torch

_forced: list[bool] = []


def by_warp(tensor: torch.Tensor) -> bool:
    """True where the device's kernels are to do the work."""
    return tensor.device.type != "cpu" or (bool(_forced) and _forced[-1])


def wait_for(device: torch.device) -> None:
    """Until a GPU has done all that it was given, as who measures time has to."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def incomplete_images() -> int:
    """Pictures of optimisations that lacked some splats so far, as more came into view at once than there was room for on the device."""
    module = sys.modules.get(__package__.rpartition(".")[0] + ".kernels.warp.rasterize")  # not loaded: nothing was drawn by it
    return sum(room.overflowed for room in module.ROOMS.values()) if module else 0


@contextmanager
def warp_on_cpu(wanted: bool = True) -> Iterator[None]:
    """Within it, warp's CPU device stands in for numba, where `wanted`: the way to test the device's kernels without a GPU. It is slow."""
    _forced.append(wanted)
    try:
        yield
    finally:
        _forced.pop()

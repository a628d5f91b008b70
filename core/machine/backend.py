# SPDX-License-Identifier: GPL-3.0-or-later
"""Choice of the kernels by a tensor's device: numba on the CPU, warp on a GPU, and in tests warp on the CPU."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch

_forced: list[bool] = []


def by_warp(tensor: torch.Tensor) -> bool:
    """Return True where warp's kernels are to process a tensor (...,) of any shape, False where numba's are."""
    return tensor.device.type != "cpu" or (bool(_forced) and _forced[-1])


def send(values: np.ndarray, device: torch.device | str) -> torch.Tensor:
    """Copy an array (...,) to a device without waiting for the work queued there; on the CPU the tensor shares the array's memory.

    The driver takes the values of ordinary memory before the call returns, so that the array may change afterwards.
    """
    return torch.from_numpy(values).to(device, non_blocking=True)


def random_generator(device: torch.device, seed: int) -> torch.Generator:
    """Return a generator of random numbers for tensors of a device, on that device if it is a GPU: copying numbers there would wait.

    Args:
        device: the device.
        seed: seed of the generator; CPU and GPU make different numbers of it.
    """
    return torch.Generator(device if device.type == "cuda" else "cpu").manual_seed(seed)


def wait_for(device: torch.device) -> None:
    """Wait until a GPU has finished all queued work, which measuring time requires; return at once for the CPU."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def incomplete_images() -> int:
    """Count the images rendered by warp so far that lack some splats, because more were visible than its buffers on the device hold."""
    module = sys.modules.get(__name__.rsplit(".", 2)[0] + ".kernels.warp.rasterize")  # not loaded: it has rendered nothing
    return sum(buffers.overflowed for buffers in module.ROOMS.values()) if module else 0


@contextmanager
def warp_on_cpu(enabled: bool = True) -> Iterator[None]:
    """Use warp's CPU device in place of numba within the block if `enabled`: it tests the GPU's kernels without a GPU, slowly."""
    _forced.append(enabled)
    try:
        yield
    finally:
        _forced.pop()

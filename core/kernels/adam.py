# SPDX-License-Identifier: GPL-3.0-or-later
"""One step of Adam on any number of tensors, in one pass over the threads or one launch; `torch.optim.Adam` defines it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ..machine.backend import by_warp
from ..machine.thread_pool import run_ranges
from .adam_tensor import AdamTensor
from .cpu.adam import adam_range


def adam_step(tensors: Sequence[AdamTensor], betas: tuple[float, float], epsilon: float) -> bool:
    """Do one step of Adam (Kingma and Ba 2015).

    Args:
        tensors: what to step on, on one device.
        betas: decay of the two moments.
        epsilon: added to the root of the second moment.

    Returns:
        True where all new values are known to be finite; False also where their sum overflows, and on a GPU, which would have to be
        waited for.
    """
    if tensors and by_warp(tensors[0].value):
        from .warp import adam  # Warp is an optional dependency

        adam.adam_step(tensors, betas, epsilon)
        return False
    pieces = [piece for tensor in tensors for piece in tensor.pieces(betas, epsilon)]
    sums = run_ranges(_step_on, [(i, i + 1) for i in range(len(pieces))], pieces)
    return all(map(math.isfinite, sums))


def _step_on(begin: int, _end: int, pieces: list[tuple[Any, ...]]) -> float:
    """Step on one piece and return the sum of its new values."""
    return adam_range(*pieces[begin])

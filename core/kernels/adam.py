# SPDX-License-Identifier: GPL-3.0-or-later
"""One step of Adam on any number of tensors, in one pass over the threads or one launch; `torch.optim.Adam` defines it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ..machine.backend import by_warp
from ..machine.thread_pool import run_ranges
from .cpu.adam import adam_range

_PIECE = 1 << 16  # values that a thread takes at a time: enough that the calls from Python do not count


@dataclass(frozen=True)
class AdamTensor:
    """A tensor to step on; all of its tensors are float32, contiguous and of the same shape.

    Attributes:
        value: parameters, which are updated.
        gradient: their gradient.
        mean: first moment, which is updated.
        square: second moment, which is updated.
        number: of this step, from 1 on.
        rate: learning rate.
        count: leading values to step on.
    """

    value: torch.Tensor
    gradient: torch.Tensor
    mean: torch.Tensor
    square: torch.Tensor
    number: int
    rate: float
    count: int

    def pieces(self, betas: tuple[float, float], epsilon: float) -> list[tuple[Any, ...]]:
        """Return the arguments of `adam_range` for each piece."""
        arrays = [t.detach().view(-1).numpy() for t in (self.value, self.gradient, self.mean, self.square)]
        step, unbias = self.rate / (1 - betas[0] ** self.number), 1 / math.sqrt(1 - betas[1] ** self.number)
        scalars = [np.float32(s) for s in (1 - betas[0], betas[1], 1 - betas[1], step, unbias, epsilon)]
        return [(begin, min(begin + _PIECE, self.count), *arrays, *scalars) for begin in range(0, self.count, _PIECE)]


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

# SPDX-License-Identifier: GPL-3.0-or-later
"""Tensor that Adam steps on, for the CPU's and the GPU's kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

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

# SPDX-License-Identifier: GPL-3.0-or-later
"""One step of Adam on any number of tensors on the GPU, a thread per value; see core/kernels/adam.py."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate

import warp as wp

from ..adam_tensor import AdamTensor
from .runtime import POINTERS, Addresses, Pointers, launch

_COUNT = wp.constant(POINTERS)
Floats = wp.types.vector(length=POINTERS, dtype=wp.float32)
Ends = wp.types.vector(length=POINTERS, dtype=wp.int32)


@wp.kernel
def step_on(
    values: Pointers, gradients: Pointers, means: Pointers, squares: Pointers, begins: Ends, steps: Floats, unbias: Floats,
    mean_rate: float, square_decay: float, square_rate: float, epsilon: float,
):  # fmt: skip
    """Do one step on value i of all tensors in a row; begins: of each tensor in that row, beyond its end for tensors that are missing.

    steps: learning rate over the bias of the mean; unbias: factor of the root of the square.
    """
    i = wp.tid()
    at, step, scale = i, steps[0], unbias[0]
    value, gradient, mean, square = values[0], gradients[0], means[0], squares[0]
    for k in range(1, _COUNT):  # unrolled: an index known to the compiler keeps the vectors out of local memory
        if i >= begins[k]:
            at = i - begins[k]
            step = steps[k]
            scale = unbias[k]
            value = values[k]
            gradient = gradients[k]
            mean = means[k]
            square = squares[k]
    x, m = wp.array(ptr=value, shape=(at + 1,), dtype=float), wp.array(ptr=mean, shape=(at + 1,), dtype=float)
    v, slope = wp.array(ptr=square, shape=(at + 1,), dtype=float), wp.array(ptr=gradient, shape=(at + 1,), dtype=float)
    g = slope[at]
    first = m[at] + (g - m[at]) * mean_rate
    second = v[at] * square_decay + g * g * square_rate
    m[at] = first
    v[at] = second
    x[at] = x[at] - first * step / (wp.sqrt(second) * scale + epsilon)


def adam_step(tensors: Sequence[AdamTensor], betas: tuple[float, float], epsilon: float) -> None:
    """Do one step of Adam (Kingma and Ba 2015) without making the host wait.

    Args:
        tensors: what to step on, on one device.
        betas: decay of the two moments.
        epsilon: added to the root of the second moment.
    """
    filled = [t for t in tensors if t.count]
    for first in range(0, len(filled), POINTERS):
        some = filled[first : first + POINTERS]
        missing = POINTERS - len(some)
        ends = list(accumulate(t.count for t in some))
        addresses = [Addresses([getattr(t, name).detach() for t in some]) for name in ("value", "gradient", "mean", "square")]
        steps = Floats(*[t.rate / (1 - betas[0] ** t.number) for t in some], *[0.0] * missing)
        unbias = Floats(*[1 / math.sqrt(1 - betas[1] ** t.number) for t in some], *[0.0] * missing)
        begins = Ends(0, *ends[:-1], *ends[-1:] * missing)
        launch(step_on, ends[-1], *addresses, begins, steps, unbias, 1 - betas[0], betas[1], 1 - betas[1], epsilon)

# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernel of Adam; see core/kernels/adam.py."""

from __future__ import annotations

import math

import numpy as np

from .jit import kernel
from .reductions import total
from .simd import load, splat, sqrt, store


@kernel
def adam_range(begin, end, value, gradient, mean, square, mean_rate, square_decay, square_rate, step, unbias, epsilon):
    """Do one step on values begin..end; all arrays are flat, all scalars float32, and the moments are updated too.

    Returns: the sum of the new values; it is not finite where one of them is not.
    """
    sums, rest = splat(0.0), np.float32(0.0)
    whole = end - (end - begin) % 8
    for i in range(begin, whole, 8):
        g, m = load(gradient, i), load(mean, i)
        m = m + (g - m) * mean_rate
        v = load(square, i) * square_decay + g * g * square_rate
        store(mean, i, m)
        store(square, i, v)
        x = load(value, i) - m * step / (sqrt(v) * unbias + epsilon)
        store(value, i, x)
        sums = sums + x
    for i in range(whole, end):
        mean[i] += (gradient[i] - mean[i]) * mean_rate
        square[i] = square[i] * square_decay + gradient[i] * gradient[i] * square_rate
        value[i] -= mean[i] * step / (math.sqrt(square[i]) * unbias + epsilon)
        rest += value[i]
    return total(sums) + rest

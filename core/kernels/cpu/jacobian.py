# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernel of the light's Jacobian: see core/kernels/jacobian.py."""

from __future__ import annotations

import numpy as np

from .jit import kernel
from .simd import load, splat, store

_ZERO = np.float32(0.0)


@kernel
def jacobian_range(begin, end, texels, start, root, share, diffuse, metal, irradiance, scaled, rest, rows, coupling):
    """Points begin..end: rows of their views, (K, texels) flat, and the coupling of light and albedo, (P, texels) flat."""
    for p in range(begin, end):
        for texel in range(0, texels, 8):
            store(coupling, p * texels + texel, splat(_ZERO))
        for k in range(start[p], start[p + 1]):
            for texel in range(0, texels, 8):
                at, to = k * texels + texel, p * texels + texel
                row = load(irradiance, to) * diffuse[k] + load(rest, at)
                if metal[k] != _ZERO:
                    row = row + load(scaled, at) * metal[k]
                store(rows, at, row * root[k])
                store(coupling, to, load(coupling, to) + row * share[k])

# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernel of the Jacobian of views by the light's texels, see core/kernels/jacobian.py."""

from __future__ import annotations

import numpy as np

from .jit import kernel
from .simd import load, splat, store

_ZERO = np.float32(0.0)


@kernel
def jacobian_range(begin, end, texels, start, root_weight, coupling_weight, diffuse, specular, irradiance, scaled, rest, rows, coupling):
    """Write, for points begin..end, the rows of their views, (K, texels) flat, and the coupling of light and albedo, (P, texels) flat."""
    for p in range(begin, end):
        for texel in range(0, texels, 8):
            store(coupling, p * texels + texel, splat(_ZERO))
        for k in range(start[p], start[p + 1]):
            for texel in range(0, texels, 8):
                at, to = k * texels + texel, p * texels + texel
                row = load(irradiance, to) * diffuse[k] + load(rest, at)
                if specular[k] != _ZERO:
                    row = row + load(scaled, at) * specular[k]
                store(rows, at, row * root_weight[k])
                store(coupling, to, load(coupling, to) + row * coupling_weight[k])

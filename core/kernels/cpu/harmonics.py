# SPDX-License-Identifier: GPL-3.0-or-later
"""Real spherical harmonics up to degree 3, values and gradients, for 8 directions at a time (order and signs of 3DGS)."""

from __future__ import annotations

import numpy as np

from ...scene.spherical_harmonics import SH_C0, SH_C1, SH_C2, SH_C3
from .jit import helper
from .simd import splat, store

_a, _b, _d, _e, _f = (np.float32(c) for c in (SH_C2[0], SH_C2[1], SH_C2[2], SH_C2[3], SH_C2[4]))
_g, _h, _i, _j, _k, _l, _m = (np.float32(c) for c in SH_C3)
_0, _1 = np.float32(SH_C0), np.float32(SH_C1)


@helper
def basis(x, y, z, count, out):
    """Write the first `count` (1, 4, 9 or 16) basis functions at 8 unit directions to `out` (16 x 8,), 8 floats per function."""
    store(out, 0, splat(_0))
    if count > 1:
        store(out, 8, y * -_1)
        store(out, 16, z * _1)
        store(out, 24, x * -_1)
    if count > 4:
        store(out, 32, x * y * _a)
        store(out, 40, y * z * _b)
        store(out, 48, (z * z * 2.0 - x * x - y * y) * _d)
        store(out, 56, x * z * _e)
        store(out, 64, (x * x - y * y) * _f)
    if count > 9:
        store(out, 72, y * (x * x * 3.0 - y * y) * _g)
        store(out, 80, x * y * z * _h)
        store(out, 88, y * (z * z * 4.0 - x * x - y * y) * _i)
        store(out, 96, z * (z * z * 2.0 - x * x * 3.0 - y * y * 3.0) * _j)
        store(out, 104, x * (z * z * 4.0 - x * x - y * y) * _k)
        store(out, 112, z * (x * x - y * y) * _l)
        store(out, 120, x * (x * x - y * y * 3.0) * _m)


@helper
def basis_gradient(x, y, z, count, out):
    """Write the derivatives of `basis` by x, y and z, as free coordinates, to `out` (3 x 16 x 8,)."""
    for i in range(3 * 128):
        out[i] = 0.0
    dx, dy, dz = 0, 128, 256
    if count > 1:
        store(out, dy + 8, splat(-_1))
        store(out, dz + 16, splat(_1))
        store(out, dx + 24, splat(-_1))
    if count > 4:
        store(out, dx + 32, y * _a)
        store(out, dy + 32, x * _a)
        store(out, dy + 40, z * _b)
        store(out, dz + 40, y * _b)
        store(out, dx + 48, x * (-2.0 * _d))
        store(out, dy + 48, y * (-2.0 * _d))
        store(out, dz + 48, z * (4.0 * _d))
        store(out, dx + 56, z * _e)
        store(out, dz + 56, x * _e)
        store(out, dx + 64, x * (2.0 * _f))
        store(out, dy + 64, y * (-2.0 * _f))
    if count > 9:
        store(out, dx + 72, x * y * (6.0 * _g))
        store(out, dy + 72, (x * x - y * y) * (3.0 * _g))
        store(out, dx + 80, y * z * _h)
        store(out, dy + 80, x * z * _h)
        store(out, dz + 80, x * y * _h)
        store(out, dx + 88, x * y * (-2.0 * _i))
        store(out, dy + 88, (z * z * 4.0 - x * x - y * y * 3.0) * _i)
        store(out, dz + 88, y * z * (8.0 * _i))
        store(out, dx + 96, x * z * (-6.0 * _j))
        store(out, dy + 96, y * z * (-6.0 * _j))
        store(out, dz + 96, (z * z * 2.0 - x * x - y * y) * (3.0 * _j))
        store(out, dx + 104, (z * z * 4.0 - x * x * 3.0 - y * y) * _k)
        store(out, dy + 104, x * y * (-2.0 * _k))
        store(out, dz + 104, x * z * (8.0 * _k))
        store(out, dx + 112, x * z * (2.0 * _l))
        store(out, dy + 112, y * z * (-2.0 * _l))
        store(out, dz + 112, (x * x - y * y) * _l)
        store(out, dx + 120, (x * x - y * y) * (3.0 * _m))
        store(out, dy + 120, x * y * (-6.0 * _m))

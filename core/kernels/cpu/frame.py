# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera-space frames of 8 surfels (centre and axes), gradients of their quaternions, and small 3-vector algebra."""

from __future__ import annotations

from ..constants import BEHIND, COSINE_MIN
from .jit import helper
from .simd import load, maximum, select, splat, sqrt


@helper
def cross(a, b):
    """Return the cross product of two 3-vectors."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@helper
def dot(a, b):
    """Return the dot product of two 3-vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@helper
def add(a, b):
    """Return the sum of two 3-vectors."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@helper
def scaled(a, s):
    """Return a 3-vector times a scalar."""
    return (a[0] * s, a[1] * s, a[2] * s)


@helper
def rotate(m, v):
    """Return matrix m (row-major, 9 scalars) times v."""
    return (
        v[0] * m[0] + v[1] * m[1] + v[2] * m[2],
        v[0] * m[3] + v[1] * m[4] + v[2] * m[5],
        v[0] * m[6] + v[1] * m[7] + v[2] * m[8],
    )


@helper
def rotate_back(m, v):
    """Return the transpose of matrix m (row-major, 9 scalars) times v."""
    return (
        v[0] * m[0] + v[1] * m[3] + v[2] * m[6],
        v[0] * m[1] + v[1] * m[4] + v[2] * m[7],
        v[0] * m[2] + v[1] * m[5] + v[2] * m[8],
    )


@helper
def _rotation(q, n, i):
    """Return the columns of the rotation of quaternions i..i+7, the unit quaternions and the inverse of their lengths."""
    w, x, y, z = load(q, i), load(q, n + i), load(q, 2 * n + i), load(q, 3 * n + i)
    length = sqrt(maximum(w * w + x * x + y * y + z * z, splat(1e-20)))
    inv = 1.0 / length
    w, x, y, z = w * inv, x * inv, y * inv, z * inv
    r0 = (1.0 - (y * y + z * z) * 2.0, (x * y + w * z) * 2.0, (x * z - w * y) * 2.0)
    r1 = ((x * y - w * z) * 2.0, 1.0 - (x * x + z * z) * 2.0, (y * z + w * x) * 2.0)
    r2 = ((x * z + w * y) * 2.0, (y * z - w * x) * 2.0, 1.0 - (x * x + y * y) * 2.0)
    return r0, r1, r2, (w, x, y, z), inv


@helper
def frame(position, quaternion, n, i, cam):
    """Return centre and axes of surfels i..i+7 in camera space, and what the projection needs of them.

    The foreshortening n.c is clamped away from 0; `free` is set where it was not clamped. `facing` is 1, or -1 where a surfel is seen from
    behind.
    """
    world = (load(position, i), load(position, n + i), load(position, 2 * n + i))
    offset = (world[0] - cam[13], world[1] - cam[14], world[2] - cam[15])
    c = rotate(cam, offset)
    r0, r1, r2, q, inv = _rotation(quaternion, n, i)
    tu, tv, normal = rotate(cam, r0), rotate(cam, r1), rotate(cam, r2)
    nc = dot(normal, c)
    side = select(nc > 0.0, splat(1.0), splat(-1.0))
    distance = sqrt(maximum(dot(c, c), splat(cam[18] * cam[18])))
    floor = distance * COSINE_MIN
    free = nc * side > floor
    facing = select(nc > distance * BEHIND, splat(-1.0), splat(1.0))
    return offset, c, r2, tu, tv, normal, select(free, nc, side * floor), facing, free, q, inv


@helper
def quaternion_gradient(q, inv, g0, g1, g2):
    """Convert gradients of the rotation's columns to that of the raw quaternion."""
    w, x, y, z = q
    gw = (z * (g0[1] - g1[0]) + y * (g2[0] - g0[2]) + x * (g1[2] - g2[1])) * 2.0
    gx = (y * (g0[1] + g1[0]) + z * (g0[2] + g2[0]) + w * (g1[2] - g2[1]) - x * (g1[1] + g2[2]) * 2.0) * 2.0
    gy = (x * (g0[1] + g1[0]) + z * (g1[2] + g2[1]) + w * (g2[0] - g0[2]) - y * (g0[0] + g2[2]) * 2.0) * 2.0
    gz = (x * (g0[2] + g2[0]) + y * (g1[2] + g2[1]) + w * (g0[1] - g1[0]) - z * (g0[0] + g1[1]) * 2.0) * 2.0
    radial = gw * w + gx * x + gy * y + gz * z
    return (gw - w * radial) * inv, (gx - x * radial) * inv, (gy - y * radial) * inv, (gz - z * radial) * inv

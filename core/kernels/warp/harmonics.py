# SPDX-License-Identifier: GPL-3.0-or-later
"""Real spherical harmonics up to degree 3, and the rotations of surfels with their gradient."""

import warp as wp

from ...scene.spherical_harmonics import SH_C0, SH_C1, SH_C2, SH_C3

Basis = wp.types.vector(length=16, dtype=wp.float32)
_C0, _C1 = wp.constant(SH_C0), wp.constant(SH_C1)
_A, _B, _D, _E, _F = (wp.constant(c) for c in SH_C2)
_G, _H, _I, _J, _K, _L, _M = (wp.constant(c) for c in SH_C3)


@wp.func
def basis(d: wp.vec3, count: int) -> Basis:
    """Return the first `count` (1, 4, 9 or 16) basis functions in unit direction d, 0 beyond."""
    x, y, z = d[0], d[1], d[2]
    b = Basis(0.0)
    b[0] = _C0
    if count > 1:
        b[1] = -_C1 * y
        b[2] = _C1 * z
        b[3] = -_C1 * x
    if count > 4:
        b[4] = _A * x * y
        b[5] = _B * y * z
        b[6] = _D * (2.0 * z * z - x * x - y * y)
        b[7] = _E * x * z
        b[8] = _F * (x * x - y * y)
    if count > 9:
        b[9] = _G * y * (3.0 * x * x - y * y)
        b[10] = _H * x * y * z
        b[11] = _I * y * (4.0 * z * z - x * x - y * y)
        b[12] = _J * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y)
        b[13] = _K * x * (4.0 * z * z - x * x - y * y)
        b[14] = _L * z * (x * x - y * y)
        b[15] = _M * x * (x * x - 3.0 * y * y)
    return b


@wp.func
def basis_pull(d: wp.vec3, count: int, g: Basis) -> wp.vec3:
    """Return the gradient of x, y, z, as free coordinates, from the gradients `g` of the basis functions."""
    x, y, z = d[0], d[1], d[2]
    gx, gy, gz = float(0.0), float(0.0), float(0.0)
    if count > 1:
        gx = -_C1 * g[3]
        gy = -_C1 * g[1]
        gz = _C1 * g[2]
    if count > 4:
        gx += _A * y * g[4] - 2.0 * _D * x * g[6] + _E * z * g[7] + 2.0 * _F * x * g[8]
        gy += _A * x * g[4] + _B * z * g[5] - 2.0 * _D * y * g[6] - 2.0 * _F * y * g[8]
        gz += _B * y * g[5] + 4.0 * _D * z * g[6] + _E * x * g[7]
    if count > 9:
        gx += 6.0 * _G * x * y * g[9] + _H * y * z * g[10] - 2.0 * _I * x * y * g[11] - 6.0 * _J * x * z * g[12]
        gx += _K * (4.0 * z * z - 3.0 * x * x - y * y) * g[13] + 2.0 * _L * x * z * g[14] + 3.0 * _M * (x * x - y * y) * g[15]
        gy += 3.0 * _G * (x * x - y * y) * g[9] + _H * x * z * g[10] + _I * (4.0 * z * z - x * x - 3.0 * y * y) * g[11]
        gy += -6.0 * _J * y * z * g[12] - 2.0 * _K * x * y * g[13] - 2.0 * _L * y * z * g[14] - 6.0 * _M * x * y * g[15]
        gz += _H * x * y * g[10] + 8.0 * _I * y * z * g[11] + 3.0 * _J * (2.0 * z * z - x * x - y * y) * g[12]
        gz += 8.0 * _K * x * z * g[13] + _L * (x * x - y * y) * g[14]
    return wp.vec3(gx, gy, gz)


@wp.func
def unit_quaternion(q: wp.vec4) -> wp.vec4:
    """Return w x y z normalised to length 1."""
    return q / wp.sqrt(wp.max(wp.dot(q, q), 1.0e-20))


@wp.func
def tangent_u(q: wp.vec4) -> wp.vec3:
    """Return the first column of the rotation of a unit quaternion."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return wp.vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y))


@wp.func
def tangent_v(q: wp.vec4) -> wp.vec3:
    """Return the second column of the rotation of a unit quaternion."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return wp.vec3(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x))


@wp.func
def normal_of(q: wp.vec4) -> wp.vec3:
    """Return the third column of the rotation of a unit quaternion, the surfel's normal."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return wp.vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))


@wp.func
def quaternion_gradient(raw: wp.vec4, g0: wp.vec3, g1: wp.vec3, g2: wp.vec3) -> wp.vec4:
    """Convert gradients of the rotation's columns to that of the raw quaternion, of any length."""
    inverse = 1.0 / wp.sqrt(wp.max(wp.dot(raw, raw), 1.0e-20))
    q = raw * inverse
    w, x, y, z = q[0], q[1], q[2], q[3]
    g = wp.vec4(
        2.0 * (z * (g0[1] - g1[0]) + y * (g2[0] - g0[2]) + x * (g1[2] - g2[1])),
        2.0 * (y * (g0[1] + g1[0]) + z * (g0[2] + g2[0]) + w * (g1[2] - g2[1]) - 2.0 * x * (g1[1] + g2[2])),
        2.0 * (x * (g0[1] + g1[0]) + z * (g1[2] + g2[1]) + w * (g2[0] - g0[2]) - 2.0 * y * (g0[0] + g2[2])),
        2.0 * (x * (g0[2] + g2[0]) + y * (g1[2] + g2[1]) + w * (g0[1] - g1[0]) - 2.0 * z * (g0[0] + g1[1])),
    )
    return (g - q * wp.dot(g, q)) * inverse

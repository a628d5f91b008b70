# SPDX-License-Identifier: GPL-3.0-or-later
"""Specular lobe at a point, as GPU functions shared by lobes.py and light.py; definitions are in core/kernels/cpu/reflection.py."""

import math

import warp as wp

from ..constants import SHORTEST2
from . import runtime  # noqa: F401  (sets warp up)

_SHORTEST2, _HALF_PI = wp.constant(SHORTEST2), wp.constant(0.5 / math.pi)


@wp.struct
class Point:
    """Shading point: normal, view, alpha^2, n.v and root = sqrt(n.v^2 (1 - alpha^2) + alpha^2)."""

    n: wp.vec3
    v: wp.vec3
    a2: float
    n_v: float
    root: float


@wp.func
def point_of(n: wp.vec3, v: wp.vec3, n_v: float, alpha: float) -> Point:
    """Return a shading point with n.v > 0 and GGX width alpha."""
    point = Point()
    point.n = n
    point.v = v
    point.a2 = alpha * alpha
    point.n_v = n_v
    point.root = wp.sqrt(n_v * n_v * (1.0 - point.a2) + point.a2)
    return point


@wp.func
def spread(point: Point, d: wp.vec3, n_l: float) -> float:
    """Return sin^2 (n, h) + alpha^2, about: the lobe of D falls with its square."""
    h = d + point.v
    t = h - point.n * (n_l + point.n_v)
    return point.a2 + wp.dot(t, t) / wp.max(wp.dot(h, h), _SHORTEST2) * (1.0 - point.a2)


@wp.func
def lobe(point: Point, d: wp.vec3, n_l: float) -> wp.vec2:
    """Return the two parts of D V for n_l > 0: the one that F0 scales and the one that Fresnel adds."""
    h = d + point.v
    length2 = wp.max(wp.dot(h, h), _SHORTEST2)
    k = spread(point, d, n_l)
    both = n_l * point.root + point.n_v * wp.sqrt(n_l * n_l * (1.0 - point.a2) + point.a2)
    value = point.a2 * _HALF_PI / (k * k * both)
    x = wp.max(1.0 - 0.5 * wp.sqrt(length2), 0.0)
    bias = value * (x * x) * (x * x) * x
    return wp.vec2(value - bias, bias)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Specular lobe at a point, as GPU functions shared by lobes.py and light.py; definitions are in core/kernels/cpu/reflection.py."""

import math

import warp as wp

from ..constants import FRESNEL, IRGS_DENOMINATOR, IRGS_FRESNEL, SHORTEST2
from . import runtime  # noqa: F401  (sets warp up)

_SHORTEST2, _HALF_PI, _FOUR_PI = wp.constant(SHORTEST2), wp.constant(0.5 / math.pi), wp.constant(4 * math.pi)
_LEAST, _LARGEST = (wp.constant(float(bound)) for bound in IRGS_DENOMINATOR)
_A0, _A1, _A2, _A3, _A4 = (wp.constant(factor) for factor in FRESNEL)
_SQUARE, _LINEAR = (wp.constant(factor) for factor in IRGS_FRESNEL)


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
def fresnel_weight(x: float) -> float:
    """Return w of F = F0 + (1 - F0) w at x = 1 - v.h, see `constants.FRESNEL`."""
    return x * x * x * ((((x * _A4 + _A3) * x + _A2) * x + _A1) * x + _A0)


@wp.func
def lobe(point: Point, d: wp.vec3, n_l: float) -> wp.vec2:
    """Return the two parts of D V for n_l > 0: the one that F0 scales and the one that Fresnel adds."""
    h = d + point.v
    length2 = wp.max(wp.dot(h, h), _SHORTEST2)
    k = spread(point, d, n_l)
    both = n_l * point.root + point.n_v * wp.sqrt(n_l * n_l * (1.0 - point.a2) + point.a2)
    value = point.a2 * _HALF_PI / (k * k * both)
    bias = value * fresnel_weight(wp.max(1.0 - 0.5 * wp.sqrt(length2), 0.0))
    return wp.vec2(value - bias, bias)


@wp.func
def irgs_lobe(point: Point, d: wp.vec3, n_l: float, alpha: float) -> wp.vec2:
    """Return the two parts of IRGS' specular lobe for n_l > 0; alpha has no lower bound, unlike that of the point."""
    h = d + point.v
    length2 = wp.max(wp.dot(h, h), _SHORTEST2)
    t = h - point.n * (n_l + point.n_v)
    a2 = alpha * alpha
    k = a2 + wp.dot(t, t) / length2 * (1.0 - a2)
    grown = wp.sqrt(alpha) + 1.0
    share = grown * grown * 0.125
    masks = (point.n_v * (1.0 - share) + share) * (n_l * (1.0 - share) + share)
    value = a2 / wp.clamp(_FOUR_PI * k * k * masks, _LEAST, _LARGEST)
    v_h = 0.5 * wp.sqrt(length2)
    bias = value * wp.pow(2.0, (_SQUARE * v_h + _LINEAR) * v_h)
    return wp.vec2(value - bias, bias)

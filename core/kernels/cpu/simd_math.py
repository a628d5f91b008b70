# SPDX-License-Identifier: GPL-3.0-or-later
"""Exponential and logarithm of the vectors of core/kernels/cpu/simd.py."""

from __future__ import annotations

from llvmlite import ir
from numba.core import types

from .jit import helper
from .simd import FLOATS, INTS, WIDTH, f32x8, floor, intrinsic, maximum, minimum, splat


@intrinsic
def _power_of_two(typing, exponent):
    """Return 2^n for whole n in -126..127, by writing the exponent bits."""

    def emit(context, builder, sig, args):
        whole = builder.fptosi(args[0], INTS)
        biased = builder.add(whole, ir.Constant(INTS, [127] * WIDTH))
        return builder.bitcast(builder.shl(biased, ir.Constant(INTS, [23] * WIDTH)), FLOATS)

    return f32x8(f32x8), emit


@intrinsic
def _split(typing, value):
    """Return mantissa in sqrt(1/2)..sqrt(2) and exponent of positive values, x = m 2^n."""

    def emit(context, builder, sig, args):
        constant = lambda i: ir.Constant(INTS, [i] * WIDTH)  # noqa: E731
        whole = builder.bitcast(args[0], INTS)
        exponent = builder.ashr(builder.sub(whole, constant(0x3F3504F3)), constant(23))  # the bits of sqrt(1/2)
        mantissa = builder.bitcast(builder.sub(whole, builder.shl(exponent, constant(23))), FLOATS)
        return context.make_tuple(builder, sig.return_type, (mantissa, builder.sitofp(exponent, FLOATS)))

    return types.UniTuple(f32x8, 2)(f32x8), emit


@helper
def log2(x):
    """Return the logarithm to base 2 of positive values that are no denormals, with an error under 2e-7 of it plus 6e-8."""
    m, n = _split(x)
    s = (m - 1.0) / (m + 1.0)
    s2 = s * s
    p = s2 * 4.1219859e-1 + 5.7707802e-1
    p = p * s2 + 9.6179669e-1
    return n + (p * s2 + 2.8853901) * s


@helper
def exp(x):
    """Return e^x with a relative error under 3e-7; the argument is clamped to -87..88."""
    x = minimum(maximum(x, splat(-87.0)), splat(88.0))
    n = floor(x * 1.44269504 + 0.5)
    r = x - n * 0.693359375 + n * 2.12194440e-4
    p = r * 1.9875691500e-4 + 1.3981999507e-3
    p = p * r + 8.3334519073e-3
    p = p * r + 4.1665795894e-2
    p = p * r + 1.6666665459e-1
    p = p * r + 5.0000001201e-1
    return (p * (r * r) + r + 1.0) * _power_of_two(n)


@helper
def bounded_exp(x):
    """Return e^x for x in -8..8 with a relative error under 1e-6, in fewer instructions than `exp`, which takes any x."""
    x = x * 1.44269504
    n = floor(x + 0.5)
    r = x - n
    p = r * 1.5461455e-4 + 1.3390887e-3
    p = p * r + 9.618057e-3
    p = p * r + 5.550357e-2
    p = p * r + 2.4022651e-1
    p = p * r + 6.9314718e-1
    return (p * r + 1.0) * _power_of_two(n)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Reductions over the lanes of the 8-wide vectors of `simd.py`."""

from __future__ import annotations

from llvmlite import ir
from numba.core import types

from .simd import INTS, WIDTH, f32x8, intrinsic


def _across(combine, doc):
    """Return a function that reduces the 8 lanes of a vector by an LLVM operation."""

    @intrinsic
    def function(typing, value):
        def emit(context, builder, sig, args):
            v = args[0]
            for half in (4, 2, 1):
                shuffle = ir.Constant(INTS, [(i + half) % WIDTH for i in range(WIDTH)])
                v = getattr(builder, combine)(v, builder.shuffle_vector(v, v, shuffle))
            return builder.extract_element(v, ir.Constant(ir.IntType(32), 0))

        return types.float32(f32x8), emit

    function.__doc__ = doc
    return function


total, product = _across("fadd", "Return the sum of the 8 lanes."), _across("fmul", "Return the product of the 8 lanes.")


@intrinsic
def totals(typing, v0, v1, v2, v3, v4, v5, v6, v7):
    """Return the vector of the sums of 8 vectors' lanes: a fifth of the instructions of 8 `total`s.

    Args:
        typing: numba's typing context, passed by `intrinsic`.
        v0: vector whose sum becomes lane 0.
        v1: of lane 1; the others follow.
        v2: of lane 2.
        v3: of lane 3.
        v4: of lane 4.
        v5: of lane 5.
        v6: of lane 6.
        v7: of lane 7.
    """

    def emit(context, builder, sig, args):
        vectors = list(args)
        # Each round adds lanes of two vectors that lie next to each other, two apart, and in different halves.
        for lanes in ((0, 8, 2, 10, 4, 12, 6, 14), (0, 1, 8, 9, 4, 5, 12, 13), (0, 1, 2, 3, 8, 9, 10, 11)):
            step = WIDTH // len(vectors)
            low, high = (ir.Constant(INTS, [i + shift for i in lanes]) for shift in (0, step))
            pairs = zip(vectors[::2], vectors[1::2], strict=True)
            vectors = [builder.fadd(builder.shuffle_vector(a, b, low), builder.shuffle_vector(a, b, high)) for a, b in pairs]
        return vectors[0]

    return f32x8(*[f32x8] * WIDTH), emit

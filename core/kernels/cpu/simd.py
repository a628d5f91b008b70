# SPDX-License-Identifier: GPL-3.0-or-later
"""8-wide float vector type for numba kernels: numba's own vectoriser leaves gather-and-mask loops scalar.

`f32x8` is a numba type whose data model is LLVM's `<8 x float>`, `b8` its comparison mask. Scalars broadcast in every operator.
"""

from __future__ import annotations

import operator
from typing import Any

import numba.extending
from llvmlite import ir
from numba.core import types
from numba.core.typing.templates import ConcreteTemplate, signature
from numba.core.typing.templates import infer_global as _infer_global
from numba.extending import lower_builtin, models, register_model

# Declared Any: their annotations do not describe the decorated functions.
intrinsic: Any = numba.extending.intrinsic
infer_global: Any = _infer_global

WIDTH = 8
FLOATS = ir.VectorType(ir.FloatType(), WIDTH)
INTS = ir.VectorType(ir.IntType(32), WIDTH)
_BITS, _SHORTS = ir.VectorType(ir.IntType(1), WIDTH), ir.VectorType(ir.IntType(16), WIDTH)


class _Vector(types.Type):
    """Numba type that is one LLVM vector."""


f32x8, b8 = _Vector("f32x8"), _Vector("b8")


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    """Data model of a vector: the LLVM vector itself."""

    def __init__(self, manager, numba_type):
        super().__init__(manager, numba_type, FLOATS if numba_type.name == "f32x8" else _BITS)


def _broadcast(builder, scalar):
    """Return an LLVM vector of 8 copies of a scalar."""
    first = builder.insert_element(ir.Constant(FLOATS, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, first, ir.Constant(INTS, [0] * WIDTH))


def _operator(symbol, result, emit, operands=(f32x8, types.float32)):
    """Define operator `symbol` on vectors; a scalar on either side is broadcast."""
    vector, scalar = operands
    pairs = [(vector, vector)] + ([(vector, scalar), (scalar, vector)] if scalar is not None else [])
    infer_global(symbol)(type(f"{symbol.__name__}_f32x8", (ConcreteTemplate,), {"cases": [signature(result, *p) for p in pairs]}))
    for pair in pairs:

        def lower(context, builder, sig, args):
            wide = [_broadcast(builder, a) if t == scalar else a for a, t in zip(args, sig.args, strict=True)]
            return emit(builder, *wide)

        lower_builtin(symbol, *pair)(lower)


for _symbol, _name in [(operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv")]:
    _operator(_symbol, f32x8, lambda b, x, y, name=_name: getattr(b, name)(x, y))
for _symbol, _name in [(operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">=")]:
    _operator(_symbol, b8, lambda b, x, y, name=_name: b.fcmp_ordered(name, x, y))
_operator(operator.and_, b8, lambda b, x, y: b.and_(x, y), (b8, None))
_operator(operator.or_, b8, lambda b, x, y: b.or_(x, y), (b8, None))


def _pointer(context, builder, array_type, array, index, vector):
    """Return the address of element `index` as a pointer to a vector, and the size of an element in bytes."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), vector.as_pointer()), array_type.dtype.bitwidth // 8


def _read(context, builder, sig, args, vector):
    """Read a vector from the elements of an array that begin at an index, the two arguments."""
    pointer, size = _pointer(context, builder, sig.args[0], *args, vector=vector)
    value = builder.load(pointer)
    value.align = size
    return value


def _write(context, builder, sig, args, value):
    """Write a vector to the elements of an array that begin at an index, the first two arguments."""
    pointer, size = _pointer(context, builder, sig.args[0], *args[:2], vector=value.type)
    builder.store(value, pointer).align = size
    return context.get_dummy_value()


@intrinsic
def load(typing, array, index):
    """Load 8 consecutive floats.

    Args:
        typing: numba's typing context, passed by `intrinsic`.
        array: (N,) contiguous float32 array.
        index: first element.
    """
    return f32x8(array, types.intp), lambda context, builder, sig, args: _read(context, builder, sig, args, FLOATS)


@intrinsic
def store(typing, array, index, value):
    """Store 8 consecutive floats.

    Args:
        typing: numba's typing context, passed by `intrinsic`.
        array: (N,) contiguous float32 array.
        index: first element.
        value: vector to write.
    """
    return types.void(array, types.intp, f32x8), lambda context, builder, sig, args: _write(context, builder, sig, args, args[2])


@intrinsic
def load_uint16(typing, array, index):
    """Load 8 consecutive whole numbers as floats.

    Args:
        typing: numba's typing context, passed by `intrinsic`.
        array: (N,) contiguous uint16 array.
        index: first element.
    """

    def emit(context, builder, sig, args):
        return builder.sitofp(builder.zext(_read(context, builder, sig, args, _SHORTS), INTS), FLOATS)

    return f32x8(array, types.intp), emit


@intrinsic
def store_uint16(typing, array, index, value):
    """Store 8 floats as consecutive whole numbers.

    Args:
        typing: numba's typing context, passed by `intrinsic`.
        array: (N,) contiguous uint16 array.
        index: first element.
        value: vector of numbers in 0..65535, which are rounded down.
    """

    def emit(context, builder, sig, args):
        return _write(context, builder, sig, args, builder.trunc(builder.fptosi(args[2], INTS), _SHORTS))

    return types.void(array, types.intp, f32x8), emit


@intrinsic
def prefetch(typing, table, row, column):
    """Prefetch the cache line of one element.

    Args:
        typing: numba's typing context, passed by `intrinsic`.
        table: (M, N) array.
        row: row of the element.
        column: column of the element.
    """

    def emit(context, builder, sig, args):
        array = context.make_array(sig.args[0])(context, builder, args[0])
        steps = [builder.mul(i, builder.extract_value(array.strides, axis)) for axis, i in enumerate(args[1:])]
        byte = builder.gep(builder.bitcast(array.data, ir.IntType(8).as_pointer()), [builder.add(*steps)])
        read, keep, data = (ir.Constant(ir.IntType(32), i) for i in (0, 3, 1))
        _llvm(builder, "llvm.prefetch.p0i8", ir.VoidType(), [byte, read, keep, data])
        return context.get_dummy_value()

    return types.void(table, types.intp, types.intp), emit


@intrinsic
def splat(typing, value):
    """Return a vector of 8 equal values.

    Args:
        typing: numba's typing context, passed by `intrinsic`.
        value: float32 scalar.
    """
    return f32x8(types.float32), lambda context, builder, sig, args: _broadcast(builder, args[0])


@intrinsic
def ramp(typing):
    """Return the vector 0, 1, ... 7."""
    return f32x8(), lambda context, builder, sig, args: ir.Constant(FLOATS, [float(i) for i in range(WIDTH)])


@intrinsic
def select(typing, mask, yes, no):
    """Select between two vectors lane by lane.

    Args:
        typing: numba's typing context, passed by `intrinsic`.
        mask: result of a comparison.
        yes: vector whose lanes are taken where the mask is set.
        no: vector whose lanes are taken elsewhere.
    """
    return f32x8(b8, f32x8, f32x8), lambda context, builder, sig, args: builder.select(*args)


@intrinsic
def bits(typing, mask):
    """Return a mask as an integer, lane 0 in bit 0; 0 where no lane is set.

    Args:
        typing: numba's typing context, passed by `intrinsic`.
        mask: result of a comparison.
    """

    def emit(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(8)), ir.IntType(32))

    return types.uint32(b8), emit


def _llvm(builder, name, result, arguments):
    """Call an LLVM intrinsic, declared by hand: llvmlite's own helper refuses vector types."""
    function = builder.module.globals.get(name) or ir.Function(builder.module, ir.FunctionType(result, [a.type for a in arguments]), name)
    return builder.call(function, arguments)


def _unary(name):
    """Return a function of one vector that calls an LLVM intrinsic."""

    @intrinsic
    def function(typing, value):
        return f32x8(f32x8), lambda context, builder, sig, args: _llvm(builder, f"llvm.{name}.v8f32", FLOATS, [args[0]])

    return function


def _choice(sign):
    """Return a function that selects, lane by lane, the left of two vectors where the comparison holds, else the right."""

    @intrinsic
    def function(typing, left, right):
        return f32x8(f32x8, f32x8), lambda context, builder, sig, args: builder.select(builder.fcmp_ordered(sign, *args), *args)

    return function


sqrt, floor = _unary("sqrt"), _unary("floor")
# The right operand where either is NaN: one instruction, where LLVM's minnum and maxnum take three.
minimum, maximum = _choice("<"), _choice(">")


@intrinsic
def first_bit(typing, mask):
    """Return the number of the lowest bit set.

    Args:
        typing: numba's typing context, passed by `intrinsic`.
        mask: integer that is not 0.
    """

    def emit(context, builder, sig, args):
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.uint64), emit

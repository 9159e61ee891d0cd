"""Vectors of 16 float32 or 32 int16 as values in kernels, for loops that the compiler does not vectorize well itself.

In a loop over a few dozen floats of several arrays, the compiler's checks whether the arrays overlap take longer than
the arithmetic, and sums over rows are loaded and stored at every row. With these values sums stay in registers. They
become LLVM vectors, for which LLVM emits the vector instructions of the processor.

Values are made by :func:`load` and :func:`splat`, added, subtracted, multiplied and divided by the operators, and
written by :func:`store`. Vectors of int16, made by :func:`load_shorts` and :func:`splat_shorts`, are only added and
subtracted. Indices are not checked against the bounds of an array.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir

from depthcli.kernels.jit import intrinsic, jit, models, overload, register_model, types

LANES = 16
"""Values in a vector of float32."""
SHORT_LANES = 32
"""Values in a vector of int16."""

_WORD = ir.IntType(32)
_FLOATS = ir.VectorType(ir.FloatType(), LANES)
_INTEGERS = ir.VectorType(_WORD, LANES)
_SHORTS = ir.VectorType(ir.IntType(16), SHORT_LANES)
_BYTE = ir.IntType(8)
_FLAGS = ("reassoc", "contract", "arcp", "nsz")  # as in all kernels


class _Lanes(types.Type):
    def __init__(self, name: str, vector: Any) -> None:
        self.vector = vector
        super().__init__(name=name)


_lanes = _Lanes("Lanes", _FLOATS)
_short_lanes = _Lanes("ShortLanes", _SHORTS)


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, kind.vector)


def _address(context: Any, builder: Any, kind: Any, array: Any, index: Any, vector: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())


@intrinsic
def load(typingctx: Any, array: Any, index: Any) -> Any:
    """Return ``array[index : index + LANES]`` of a flat float32 or uint8 array as a vector of float32."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        if array.dtype == types.float32:
            return builder.load(_address(context, builder, array, args[0], args[1], _FLOATS), align=4)
        bytes_ = builder.load(_address(context, builder, array, args[0], args[1], ir.VectorType(_BYTE, LANES)), align=1)
        return builder.uitofp(builder.zext(bytes_, _INTEGERS), _FLOATS)

    return _lanes(array, types.intp), codegen


@intrinsic
def store(typingctx: Any, array: Any, index: Any, value: Any) -> Any:
    """Assign a vector to ``array[index : index + its lanes]`` of a flat array.

    float32 values are stored as float32, or cut off to uint8; int16 values as int16, or their low halves as uint8.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        content, align = args[2], array.dtype.bitwidth // 8
        if value == _lanes and array.dtype == types.uint8:
            content = builder.fptosi(content, _INTEGERS)
        if array.dtype == types.uint8:
            content = builder.trunc(content, ir.VectorType(_BYTE, value.vector.count))
        builder.store(content, _address(context, builder, array, args[0], args[1], content.type), align=align)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


@intrinsic
def load_shorts(typingctx: Any, array: Any, index: Any) -> Any:
    """Return ``array[index : index + SHORT_LANES]`` of a flat int16 or uint8 array as a vector of int16."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        if array.dtype == types.uint8:
            kind = ir.VectorType(_BYTE, SHORT_LANES)
            return builder.zext(
                builder.load(_address(context, builder, array, args[0], args[1], kind), align=1), _SHORTS
            )
        return builder.load(_address(context, builder, array, args[0], args[1], _SHORTS), align=2)

    return _short_lanes(array, types.intp), codegen


def _constant(value: float) -> Any:
    return ir.Constant(_FLOATS, [value] * LANES)


def _splat(builder: Any, value: Any, vector: Any) -> Any:
    nothing = ir.Constant(vector, ir.Undefined)
    single = builder.insert_element(nothing, value, ir.Constant(_WORD, 0))
    return builder.shuffle_vector(single, nothing, ir.Constant(ir.VectorType(_WORD, vector.count), [0] * vector.count))


@intrinsic
def splat(typingctx: Any, value: Any) -> Any:
    """Return a vector with one float32 in all lanes."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _splat(builder, args[0], _FLOATS)

    return _lanes(types.float32), codegen


@intrinsic
def splat_shorts(typingctx: Any, value: Any) -> Any:
    """Return a vector with one int16 in all lanes."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _splat(builder, args[0], _SHORTS)

    return _short_lanes(types.int16), codegen


@intrinsic
def shifted_right(typingctx: Any, value: Any, count: Any) -> Any:
    """Return the int16 lanes of ``value``, all >= 0, divided by 2^``count``."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.lshr(args[0], _splat(builder, args[1], _SHORTS))

    return _short_lanes(_short_lanes, types.int16), codegen


@intrinsic
def truncated(typingctx: Any, value: Any) -> Any:
    """Return the float32 lanes of ``value`` without their fractions; they are less than 2^31."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.sitofp(builder.fptosi(args[0], _INTEGERS), _FLOATS)

    return _lanes(_lanes), codegen


@intrinsic
def halves(typingctx: Any, value: Any) -> Any:
    """Return the int16 lanes of ``value`` as two vectors of float32."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        parts = []
        for first in (0, LANES):
            order = ir.Constant(_INTEGERS, list(range(first, first + LANES)))
            half = builder.shuffle_vector(args[0], args[0], order)
            parts.append(builder.sitofp(builder.sext(half, _INTEGERS), _FLOATS))
        return context.make_tuple(builder, signature.return_type, parts)

    return types.UniTuple(_lanes, 2)(_short_lanes), codegen


@intrinsic
def where_at_most(typingctx: Any, a: Any, b: Any, chosen: Any, other: Any) -> Any:
    """Return ``chosen`` in the lanes where ``a <= b``, ``other`` elsewhere; all are float32."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<=", args[0], args[1]), args[2], args[3])

    return _lanes(_lanes, _lanes, _lanes, _lanes), codegen


def _binary(build: Callable[[Any, Any, Any], Any]) -> Any:
    @intrinsic
    def operation(typingctx: Any, a: Any, b: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return build(builder, *args)

        return a(a, b), codegen

    return operation


def _is_integer(value: Any) -> bool:
    return isinstance(value.type.element, ir.IntType)


def _chosen(symbol: str) -> Callable[[Any, Any, Any], Any]:
    def build(builder: Any, a: Any, b: Any) -> Any:
        compare = builder.icmp_signed if _is_integer(a) else builder.fcmp_ordered
        return builder.select(compare(symbol, a, b), a, b)

    return build


_minimum, _maximum = _chosen("<"), _chosen(">")
minimum = _binary(_minimum)
"""Return the minimum of two values, lane by lane."""
maximum = _binary(_maximum)
"""Return the maximum of two values, lane by lane."""


def _operator(symbol: Callable[[Any, Any], Any], build: Callable[[Any, Any, Any], Any]) -> None:
    operation = _binary(build)

    def compute(a: Any, b: Any) -> Any:
        return operation(a, b)

    def choose(a: Any, b: Any) -> Any:
        return compute if a == b and isinstance(a, _Lanes) else None

    overload(symbol)(choose)


def _add(builder: Any, a: Any, b: Any) -> Any:
    return builder.add(a, b) if _is_integer(a) else builder.fadd(a, b, flags=_FLAGS)


def _subtract(builder: Any, a: Any, b: Any) -> Any:
    return builder.sub(a, b) if _is_integer(a) else builder.fsub(a, b, flags=_FLAGS)


for _symbol in (operator.add, operator.iadd):
    _operator(_symbol, _add)
_operator(operator.sub, _subtract)
_operator(operator.truediv, lambda builder, a, b: builder.fdiv(a, b, flags=_FLAGS))
_operator(operator.mul, lambda builder, a, b: builder.fmul(a, b, flags=_FLAGS))


def _reduction(build: Callable[[Any, Any, Any], Any]) -> Any:
    @intrinsic
    def operation(typingctx: Any, value: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            # Halves on halves: the same order of additions on every processor.
            reduced, width = args[0], LANES
            while width > 1:
                width //= 2
                order = [(k + width) % LANES for k in range(LANES)]
                moved = builder.shuffle_vector(reduced, reduced, ir.Constant(_INTEGERS, order))
                reduced = build(builder, reduced, moved)
            return builder.extract_element(reduced, ir.Constant(_WORD, 0))

        return types.float32(_lanes), codegen

    return operation


lane_sum = _reduction(lambda builder, a, b: builder.fadd(a, b))
"""Return the sum of the lanes."""
lane_min = _reduction(_minimum)
"""Return the smallest of the lanes."""
lane_max = _reduction(_maximum)
"""Return the largest of the lanes."""


@intrinsic
def exp_minus(typingctx: Any, value: Any) -> Any:
    """Return exp(-x) of x >= 0 in every lane, relative error below 1e-6; x above 80 counts as 80.

    As :func:`depthcli.kernels.exponential.exp_minus`.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        x = _minimum(builder, args[0], _constant(80.0))
        x = builder.fmul(x, _constant(-1.4426950408889634), flags=_FLAGS)
        whole = builder.fptosi(x, _INTEGERS)
        rest = builder.fsub(x, builder.sitofp(whole, _FLOATS), flags=_FLAGS)
        t = builder.fmul(rest, _constant(0.6931471805599453), flags=_FLAGS)
        p = _constant(1 / 5040)
        for term in (1 / 720, 1 / 120, 1 / 24, 1 / 6, 1 / 2, 1.0, 1.0):  # Taylor series of exp on (-0.694, 0]
            p = builder.fadd(builder.fmul(p, t, flags=_FLAGS), _constant(term), flags=_FLAGS)
        bias, bits = (ir.Constant(_INTEGERS, [number] * LANES) for number in (127, 23))
        power = builder.bitcast(builder.shl(builder.add(whole, bias), bits), _FLOATS)
        return builder.fmul(p, power, flags=_FLAGS)

    return _lanes(_lanes), codegen


@jit
def lane_exp_minus_16(z):
    """Return exp(-16 z) of z >= 0 in every lane, as :func:`depthcli.kernels.exponential.exp_minus_16`."""
    one = splat(np.float32(1))
    z = minimum(z, one)
    power = one - z * (one - z * (splat(np.float32(0.5)) - z * splat(np.float32(1 / 6))))
    power = power * power
    power = power * power
    power = power * power
    return power * power


@jit
def absolute_difference(a, b):
    """Return ``|a - b|`` of two vectors, lane by lane."""
    return maximum(a - b, b - a)

"""Vectors of 16 float32 or 32 int16 as values in kernels, for loops that the compiler does not vectorize well.

In a loop over a few dozen floats of several arrays, the compiler's checks whether the arrays overlap take longer than
the arithmetic, and sums over rows are loaded and stored at every row. With vectors as values, sums stay in registers.
The values become LLVM vectors, for which LLVM emits the processor's vector instructions.

:func:`load` and :func:`splat` create values, the operators add, subtract, multiply and divide them, and :func:`store`
writes them. :func:`load_shorts`, :func:`load_like` and :func:`splat` create vectors of int16 and uint8, which can only
be added and subtracted; uint8 saturates at 0 and 255. Arrays are contiguous and have any shape. An index counts their
elements in memory and is not checked.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir

from depthcli.kernels.jit import cgutils, helper, intrinsic, lower_builtin, models, register_model, type_callable, types

LANES = 16
"""Values in a vector of float32."""
SHORT_LANES = 32
"""Values in a vector of int16 or uint8."""
# Two wide vectors fill 8 registers of 512 bit, or of 256 bit.
WIDE = 64 if llvm.get_host_cpu_features().get("avx512f", False) else 32
"""Values in a wide vector of float32, for loops with two of them."""

_FLAGS = ("reassoc", "contract", "arcp", "nsz")  # as in all kernels


class Lanes(types.Type):
    """numba's type of a vector of ``count`` values."""

    def __init__(self, element: Any, count: int) -> None:
        self.vector = ir.VectorType(element, count)
        super().__init__(name=f"Lanes({self.vector})")


FLOATS = Lanes(ir.FloatType(), LANES)
_WIDE_FLOATS = Lanes(ir.FloatType(), WIDE)
_SHORTS = Lanes(ir.IntType(16), SHORT_LANES)
_BYTES = Lanes(ir.IntType(8), SHORT_LANES)
_FEW_BYTES = Lanes(ir.IntType(8), LANES)
_LANES_OF = {types.float32: FLOATS, types.int16: _SHORTS, types.uint8: _BYTES}
_INTEGERS = ir.VectorType(ir.IntType(32), LANES)


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, kind.vector)


def _operation(signature: Any) -> Callable[[Any], Any]:
    # Return a decorator that makes a function (builder, *values) -> value an operation of this signature in kernels.
    # Signature None: all values have the type of the first.
    def decorate(build: Any) -> Any:
        @functools.wraps(build)  # numba reads the parameters, too
        def define(typingctx, *kinds):
            own = kinds[0](*kinds) if signature is None else signature
            return own, lambda context, builder, signature, args: build(builder, *args)

        return intrinsic(define)

    return decorate


def address(context: Any, builder: Any, kind: Any, array: Any, index: Any, vector: Any) -> Any:
    """Return the pointer to a vector that begins at ``index`` of an array with numba's type ``kind``."""
    if kind.layout != "C":
        raise TypeError(f"vectors are of contiguous arrays, not of {kind}")
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())


def spread(builder: Any, value: Any, vector: Any) -> Any:
    """Return an LLVM vector with ``value`` in all lanes."""
    nothing, word = ir.Constant(vector, ir.Undefined), ir.IntType(32)
    single = builder.insert_element(nothing, value, ir.Constant(word, 0))
    return builder.shuffle_vector(single, nothing, ir.Constant(ir.VectorType(word, vector.count), [0] * vector.count))


def _loader(result: Lanes) -> Any:
    # Array elements of another type than the result's are unsigned and have fewer bits.
    def define(typingctx, array, index):
        def codegen(context, builder, signature, args):
            element, count = context.get_data_type(array.dtype), result.vector.count
            place = address(context, builder, array, args[0], args[1], ir.VectorType(element, count))
            value = builder.load(place, align=array.dtype.bitwidth // 8)
            if element == result.vector.element:
                return value
            if isinstance(result.vector.element, ir.IntType):
                return builder.zext(value, result.vector)
            return builder.uitofp(builder.zext(value, ir.VectorType(ir.IntType(32), count)), result.vector)

        return result(array, types.intp), codegen

    return intrinsic(define)


load = _loader(FLOATS)
"""Return ``array[index : index + LANES]`` of an array of float32, uint8 or uint16 as a vector of float32."""
load_shorts = _loader(_SHORTS)
"""Return ``array[index : index + SHORT_LANES]`` of an int16 or uint8 array as a vector of int16."""


@intrinsic
def load_like(typingctx, like, array, index):
    """Return values of an array, from ``index`` on, as a vector of the same type as ``like``."""

    def codegen(context, builder, signature, args):
        place = address(context, builder, array, args[1], args[2], like.vector)
        return builder.load(place, align=array.dtype.bitwidth // 8)

    return like(like, array, types.intp), codegen


@_operation(_WIDE_FLOATS())
def wide_zero(builder):
    """Return a wide vector of zeros."""
    return ir.Constant(_WIDE_FLOATS.vector, [0.0] * WIDE)


@intrinsic
def splat_like(typingctx, like, value):
    """Return a float32 ``value`` in all lanes of a vector of the same type as ``like``."""
    return like(like, types.float32), lambda context, builder, signature, args: spread(builder, args[1], like.vector)


@intrinsic
def scaled(typingctx, value, array, index):
    """Return float32 lanes times ``array[index]`` of a float32 array."""

    def codegen(context, builder, signature, args):
        factor = builder.load(address(context, builder, array, args[1], args[2], ir.FloatType()))
        return builder.fmul(args[0], spread(builder, factor, value.vector))

    return value(value, array, types.intp), codegen


@_operation(None)
def fused(builder, a, b, c):
    """Return ``a * b + c`` of float32 lanes, rounded once if the processor supports it."""
    return builder.fadd(builder.fmul(a, b, flags=("contract",)), c, flags=("contract",))


@_operation(None)
def ordered_sum(builder, a, b):
    """Return ``a + b`` of float32 lanes; the compiler does not reorder this addition."""
    return builder.fadd(a, b)


@intrinsic
def store(typingctx, array, index, value):
    """Assign a vector to ``array[index : index + its lanes]``.

    float32 values are stored as float32, int16 values as int16, or their low halves as uint8, uint8 values as uint8.
    """

    def codegen(context, builder, signature, args):
        content = args[2]
        if array.dtype == types.uint8:
            content = builder.trunc(content, ir.VectorType(ir.IntType(8), value.vector.count))
        place = address(context, builder, array, args[0], args[1], content.type)
        builder.store(content, place, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


@intrinsic
def splat(typingctx, value):
    """Return a vector with one float32, int16 or uint8 in all lanes; other numbers become float32."""
    result = _LANES_OF.get(value, FLOATS)
    element = value if value in _LANES_OF else types.float32
    return result(element), lambda context, builder, signature, args: spread(builder, args[0], result.vector)


@intrinsic
def shifted_right(typingctx, value, count):
    """Return the lanes of ``value``, integers >= 0, divided by 2^``count``, an integer of their type."""

    def codegen(context, builder, signature, args):
        return builder.lshr(args[0], spread(builder, args[1], value.vector))

    return value(value, count), codegen


@_operation(_FEW_BYTES(FLOATS))
def as_bytes(builder, value):
    """Return the float32 lanes of ``value``, 0 <= value < 256, truncated to uint8."""
    return builder.trunc(builder.fptosi(value, _INTEGERS), _FEW_BYTES.vector)


@_operation(types.UniTuple(FLOATS, 2)(_SHORTS))
def halves(builder, value):
    """Return the int16 lanes of ``value`` as two vectors of float32."""
    orders = (ir.Constant(_INTEGERS, list(range(first, first + LANES))) for first in (0, LANES))
    parts = [builder.sext(builder.shuffle_vector(value, value, order), _INTEGERS) for order in orders]
    return cgutils.pack_array(builder, [builder.sitofp(part, FLOATS.vector) for part in parts])


@_operation(FLOATS(FLOATS, FLOATS, FLOATS, FLOATS))
def where_at_most(builder, a, b, chosen, other):
    """Return ``chosen`` in the lanes where ``a <= b``, ``other`` elsewhere; all are float32."""
    return builder.select(builder.fcmp_ordered("<=", a, b), chosen, other)


def saturated(builder: Any, name: str, a: Any, b: Any) -> Any:
    """Return the sum ("add") or difference ("sub") of two vectors of unsigned integers, cut to their range."""
    function = f"llvm.u{name}.sat.v{a.type.count}i{a.type.element.width}"
    kind = ir.FunctionType(a.type, [a.type, a.type])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, function), (a, b))


def _has_integers(value: Any) -> bool:
    return isinstance(value.type.element, ir.IntType)


def _has_bytes(value: Any) -> bool:
    return _has_integers(value) and value.type.element.width == 8


def _chosen(builder: Any, symbol: str, a: Any, b: Any) -> Any:
    compare = builder.icmp_signed if _has_integers(a) else builder.fcmp_ordered
    compare = builder.icmp_unsigned if _has_bytes(a) else compare
    return builder.select(compare(symbol, a, b), a, b)


minimum = _operation(None)(lambda builder, a, b: _chosen(builder, "<", a, b))
"""Return the minimum of two values, lane by lane."""
maximum = _operation(None)(lambda builder, a, b: _chosen(builder, ">", a, b))
"""Return the maximum of two values, lane by lane."""


def _computed(builder: Any, name: str, a: Any, b: Any) -> Any:
    if _has_bytes(a):  # sums are at most 255, differences at least 0
        return saturated(builder, name, a, b)
    if _has_integers(a):
        return getattr(builder, {"div": "sdiv"}.get(name, name))(a, b)
    return getattr(builder, f"f{name}")(a, b, flags=_FLAGS)


def _operator(symbol: Callable[[Any, Any], Any], name: str) -> None:
    type_callable(symbol)(lambda context: lambda a, b: a if a == b and isinstance(a, Lanes) else None)
    lower_builtin(symbol, Lanes, Lanes)(lambda context, builder, signature, args: _computed(builder, name, *args))


for _symbol, _name in ((operator.add, "add"), (operator.iadd, "add"), (operator.sub, "sub"), (operator.mul, "mul")):
    _operator(_symbol, _name)
_operator(operator.truediv, "div")


@_operation(None)
def absolute_difference(builder, a, b):
    """Return ``|a - b|`` of two vectors, lane by lane."""
    return _chosen(builder, ">", _computed(builder, "sub", a, b), _computed(builder, "sub", b, a))


@_operation(types.float32(FLOATS))
def lane_max(builder, value):
    """Return the largest of the lanes."""
    width = LANES
    while width > 1:
        width //= 2
        order = ir.Constant(_INTEGERS, [(k + width) % LANES for k in range(LANES)])
        value = _chosen(builder, ">", value, builder.shuffle_vector(value, value, order))
    return builder.extract_element(value, ir.Constant(ir.IntType(32), 0))


@helper
def lane_exp_minus_16(z):
    """Return exp(-16 z) of z >= 0 in every lane, like :func:`depthcli.kernels.exponential.exp_minus_16`."""
    one = splat(np.float32(1))
    z = minimum(z, one)
    power = one - z * (one - z * (splat(np.float32(0.5)) - z * splat(np.float32(1 / 6))))
    power = power * power
    power = power * power
    power = power * power
    return power * power

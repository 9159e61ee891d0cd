"""Vectors of sixteen float32 as values in kernels, for loops that the compiler does not vectorize well itself.

In a loop over a few dozen floats of several arrays, the compiler's checks whether the arrays overlap take longer than
the arithmetic, and sums over rows are loaded and stored at every row. With these values sums stay in registers. They
become LLVM vectors, for which LLVM emits the vector instructions of the processor.

Values are made by :func:`load` and :func:`splat`, added, subtracted and multiplied by the operators, and written by
:func:`store`. Indices are not checked against the bounds of an array.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir

from depthcli.kernels.jit import intrinsic, models, overload, register_model, types

LANES = 16

_WORD = ir.IntType(32)
_FLOATS = ir.VectorType(ir.FloatType(), LANES)
_INTEGERS = ir.VectorType(_WORD, LANES)
_FLAGS = ("reassoc", "contract", "arcp", "nsz")  # as in all kernels


class _Lanes(types.Type):
    def __init__(self) -> None:
        super().__init__(name="Lanes")


_lanes = _Lanes()


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _FLOATS)


def _address(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _FLOATS.as_pointer())


@intrinsic
def load(typingctx: Any, array: Any, index: Any) -> Any:
    """Return ``array[index : index + LANES]`` of a flat float32 array."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(_address(context, builder, signature.args[0], args[0], args[1]), align=4)

    return _lanes(array, types.intp), codegen


@intrinsic
def store(typingctx: Any, array: Any, index: Any, value: Any) -> Any:
    """Assign ``array[index : index + LANES] = value`` in a flat float32 array."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.store(args[2], _address(context, builder, signature.args[0], args[0], args[1]), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, _lanes), codegen


def _constant(value: float) -> Any:
    return ir.Constant(_FLOATS, [value] * LANES)


@intrinsic
def splat(typingctx: Any, value: Any) -> Any:
    """Return a vector with one float32 in all lanes."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        nothing = ir.Constant(_FLOATS, ir.Undefined)
        single = builder.insert_element(nothing, args[0], ir.Constant(_WORD, 0))
        return builder.shuffle_vector(single, nothing, ir.Constant(_INTEGERS, [0] * LANES))

    return _lanes(types.float32), codegen


def _binary(build: Callable[[Any, Any, Any], Any]) -> Any:
    @intrinsic
    def operation(typingctx: Any, a: Any, b: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return build(builder, *args)

        return _lanes(_lanes, _lanes), codegen

    return operation


def _minimum(builder: Any, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered("<", a, b), a, b)


minimum = _binary(_minimum)
"""Return the minimum of two values, lane by lane."""


def _operator(symbol: Callable[[Any, Any], Any], build: Callable[[Any, Any, Any], Any]) -> None:
    operation = _binary(build)

    def compute(a: Any, b: Any) -> Any:
        return operation(a, b)

    def choose(a: Any, b: Any) -> Any:
        return compute if a == b == _lanes else None

    overload(symbol)(choose)


for _symbol in (operator.add, operator.iadd):
    _operator(_symbol, lambda builder, a, b: builder.fadd(a, b, flags=_FLAGS))
_operator(operator.sub, lambda builder, a, b: builder.fsub(a, b, flags=_FLAGS))
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

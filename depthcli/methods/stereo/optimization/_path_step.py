"""One pixel of several scanline paths, in explicit vectors of LLVM IR.

The loop over disparities reads and writes so many arrays that the compiler cannot prove that they do not overlap, and
would not vectorize it.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from depthcli.kernels.jit import cgutils, intrinsic, types

LANES = 16
"""Number of 16-bit values in a vector; a volume needs at least as many disparities."""


@intrinsic
def path_step(
    typingctx: Any, costs: Any, cost_at: Any, state: Any, before: Any, after: Any,
    minima: Any, minima_before: Any, minima_after: Any, p1: Any, p2: Any, total: Any, total_at: Any, n_disparities: Any,
) -> Any:  # fmt: skip
    """Compute ``L(d) = C(d) + min(B(d), B(d +- 1) + P1, min B + P2) - min B`` for K paths.

    Parameters
    ----------
    costs : flat uint8 or uint16; the pixel's D costs start at ``cost_at``
    state : flat uint16 path costs. ``before`` and ``after`` (K offsets each) point at D + 2 cells: D path costs
        between two guard cells
    minima : flat uint16 minima of the path costs, read at ``minima_before``, written at ``minima_after``
    p1, p2 : K penalties
    total : flat uint16; the pixel's D sums over the K paths are written from ``total_at`` on
    n_disparities : D, at least LANES
    """
    paths = len(before)
    signature = types.void(
        costs, types.intp, state, types.UniTuple(types.intp, paths), types.UniTuple(types.intp, paths),
        minima, types.UniTuple(types.intp, paths), types.UniTuple(types.intp, paths),
        types.UniTuple(types.uint16, paths), types.UniTuple(types.uint16, paths), total, types.intp, types.intp,
    )  # fmt: skip

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        half, word = ir.IntType(16), ir.IntType(64)
        vector = ir.VectorType(half, LANES)

        def data(k: int) -> Any:
            return context.make_array(signature.args[k])(context, builder, args[k]).data

        def member(k: int, path: int) -> Any:
            return builder.extract_value(args[k], path)

        def at(pointer: Any, offset: Any, kind: Any) -> Any:
            return builder.bitcast(builder.gep(pointer, [offset]), kind.as_pointer())

        def splat(value: Any) -> Any:
            single = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
            mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
            return builder.shuffle_vector(single, ir.Constant(vector, ir.Undefined), mask)

        def minimum(a: Any, b: Any) -> Any:
            return builder.select(builder.icmp_unsigned("<", a, b), a, b)

        cost_data, state_data, minima_data, total_data = data(0), data(2), data(5), data(10)
        depth_value = args[12]
        lanes = ir.Constant(word, LANES)
        path_minima = [builder.load(builder.gep(minima_data, [member(6, k)])) for k in range(paths)]
        offsets = [splat(value) for value in path_minima]
        steps = [splat(member(8, k)) for k in range(paths)]
        jumps = [splat(builder.add(path_minima[k], member(9, k))) for k in range(paths)]
        lowest = [cgutils.alloca_once(builder, vector) for _ in range(paths)]
        for slot in lowest:
            builder.store(ir.Constant(vector, [0xFFFF] * LANES), slot)
        chunks = builder.sdiv(builder.add(depth_value, ir.Constant(word, LANES - 1)), lanes)
        last = builder.sub(depth_value, lanes)
        with cgutils.for_range(builder, chunks) as loop:
            # The last chunk is moved back to end at D: cells done twice are done alike.
            start = builder.mul(loop.index, lanes)
            start = builder.select(builder.icmp_signed("<", start, last), start, last)
            place = builder.add(args[1], start)
            if signature.args[0].dtype.bitwidth == 8:
                narrow = builder.load(at(cost_data, place, ir.VectorType(ir.IntType(8), LANES)), align=1)
                cost = builder.zext(narrow, vector)
            else:
                cost = builder.load(at(cost_data, place, vector), align=2)
            summed = None
            for k in range(paths):
                origin = builder.add(member(3, k), start)
                lower, same, upper = (
                    builder.load(at(state_data, builder.add(origin, ir.Constant(word, n)), vector), align=2)
                    for n in range(3)
                )
                best = minimum(builder.add(minimum(lower, upper), steps[k]), jumps[k])
                best = minimum(best, same)
                value = builder.add(builder.sub(best, offsets[k]), cost)
                target = builder.add(builder.add(member(4, k), start), ir.Constant(word, 1))
                builder.store(value, at(state_data, target, vector), align=2)
                builder.store(minimum(builder.load(lowest[k]), value), lowest[k])
                summed = value if summed is None else builder.add(summed, value)
            builder.store(summed, at(total_data, builder.add(args[11], start), vector), align=2)
        reduce = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(half, [vector]), f"llvm.vector.reduce.umin.v{LANES}i16"
        )
        for k in range(paths):
            smallest = builder.call(reduce, [builder.load(lowest[k])])
            builder.store(smallest, builder.gep(minima_data, [member(7, k)]))
        return context.get_dummy_value()

    return signature, codegen

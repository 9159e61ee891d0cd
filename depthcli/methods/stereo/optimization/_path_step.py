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
BYTE_LANES = 32
"""The same of 8-bit values."""


@intrinsic
def path_step(
    typingctx: Any, costs: Any, cost_at: Any, state: Any, before: Any, after: Any,
    minima: Any, minima_before: Any, minima_after: Any, p1: Any, p2: Any, total: Any, total_at: Any, adds: Any,
    n_disparities: Any,
) -> Any:  # fmt: skip
    """Compute ``L(d) = C(d) + min(B(d), B(d +- 1) + P1, min B + P2) - min B`` for K paths.

    Parameters
    ----------
    costs : flat uint8 or uint16; the pixel's D costs start at ``cost_at``
    state : flat uint16 path costs; uint8 where the largest cost and P2 together are less than 256, which gives the
        same sums in half of the time. ``before`` and ``after`` (K offsets each) point at D + 2 cells: D path costs
        between two guard cells, whose value is not reached by any path
    minima : flat minima of the path costs, read at ``minima_before``, written at ``minima_after``; typed as ``state``
    p1, p2 : K penalties, typed as ``state``
    total : flat uint16; the pixel's D sums over the K paths are written from ``total_at`` on, or added to what is there
    adds : bool, whether they are added
    n_disparities : D, at least LANES, or BYTE_LANES
    """
    paths = len(before)
    bits = state.dtype.bitwidth
    lane_count = LANES if bits == 16 else BYTE_LANES
    kind = types.uint16 if bits == 16 else types.uint8
    signature = types.void(
        costs, types.intp, state, types.UniTuple(types.intp, paths), types.UniTuple(types.intp, paths),
        minima, types.UniTuple(types.intp, paths), types.UniTuple(types.intp, paths),
        types.UniTuple(kind, paths), types.UniTuple(kind, paths), total, types.intp, types.boolean, types.intp,
    )  # fmt: skip

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        cell, word = ir.IntType(bits), ir.IntType(64)
        vector, sums = ir.VectorType(cell, lane_count), ir.VectorType(ir.IntType(16), lane_count)
        align = bits // 8

        def data(k: int) -> Any:
            return context.make_array(signature.args[k])(context, builder, args[k]).data

        def member(k: int, path: int) -> Any:
            return builder.extract_value(args[k], path)

        def at(pointer: Any, offset: Any, kind: Any) -> Any:
            return builder.bitcast(builder.gep(pointer, [offset]), kind.as_pointer())

        def splat(value: Any) -> Any:
            single = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
            mask = ir.Constant(ir.VectorType(ir.IntType(32), lane_count), [0] * lane_count)
            return builder.shuffle_vector(single, ir.Constant(vector, ir.Undefined), mask)

        add_saturating = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(vector, [vector, vector]), f"llvm.uadd.sat.v{lane_count}i{bits}"
        )

        def minimum(a: Any, b: Any) -> Any:
            return builder.select(builder.icmp_unsigned("<", a, b), a, b)

        cost_data, state_data, minima_data, total_data = data(0), data(2), data(5), data(10)
        adds, depth_value = args[12], args[13]
        lanes = ir.Constant(word, lane_count)
        path_minima = [builder.load(builder.gep(minima_data, [member(6, k)])) for k in range(paths)]
        offsets = [splat(value) for value in path_minima]
        steps = [splat(member(8, k)) for k in range(paths)]
        jumps = [splat(builder.add(path_minima[k], member(9, k))) for k in range(paths)]
        lowest = [cgutils.alloca_once(builder, vector) for _ in range(paths)]
        for slot in lowest:
            builder.store(ir.Constant(vector, [(1 << bits) - 1] * lane_count), slot)
        chunks = builder.sdiv(builder.add(depth_value, ir.Constant(word, lane_count - 1)), lanes)
        last = builder.sub(depth_value, lanes)

        def total_pointer(start: Any) -> Any:
            return at(total_data, builder.add(args[11], start), sums)

        # The last chunk is moved back to end at D: cells done twice are done alike, and are read before any is written.
        earlier = cgutils.alloca_once(builder, sums)
        earlier_last = cgutils.alloca_once(builder, sums)
        builder.store(ir.Constant(sums, [0] * lane_count), earlier)
        with builder.if_then(adds):
            builder.store(builder.load(total_pointer(last), align=2), earlier_last)
        with cgutils.for_range(builder, chunks) as loop:
            start = builder.mul(loop.index, lanes)
            is_last = builder.icmp_signed(">=", start, last)
            start = builder.select(is_last, last, start)
            with builder.if_then(adds):
                there = builder.load(total_pointer(start), align=2)
                builder.store(builder.select(is_last, builder.load(earlier_last), there), earlier)
            place = builder.add(args[1], start)
            if signature.args[0].dtype.bitwidth == 8:
                cost = builder.load(at(cost_data, place, ir.VectorType(ir.IntType(8), lane_count)), align=1)
                if bits == 16:
                    cost = builder.zext(cost, vector)
            else:
                cost = builder.load(at(cost_data, place, vector), align=2)
            summed = builder.load(earlier)
            for k in range(paths):
                origin = builder.add(member(3, k), start)
                lower, same, upper = (
                    builder.load(at(state_data, builder.add(origin, ir.Constant(word, n)), vector), align=align)
                    for n in range(3)
                )
                best = minimum(builder.call(add_saturating, [minimum(lower, upper), steps[k]]), jumps[k])
                best = minimum(best, same)
                value = builder.add(builder.sub(best, offsets[k]), cost)
                target = builder.add(builder.add(member(4, k), start), ir.Constant(word, 1))
                builder.store(value, at(state_data, target, vector), align=align)
                builder.store(minimum(builder.load(lowest[k]), value), lowest[k])
                wide = value if bits == 16 else builder.zext(value, sums)
                summed = builder.add(summed, wide)
            builder.store(summed, total_pointer(start), align=2)
        reduce = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(cell, [vector]), f"llvm.vector.reduce.umin.v{lane_count}i{bits}"
        )
        for k in range(paths):
            smallest = builder.call(reduce, [builder.load(lowest[k])])
            builder.store(smallest, builder.gep(minima_data, [member(7, k)]))
        return context.get_dummy_value()

    return signature, codegen

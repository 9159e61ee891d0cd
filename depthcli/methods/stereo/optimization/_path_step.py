"""One pixel of several scanline paths, in explicit vectors of LLVM IR.

The compiler would not vectorize the loop over disparities, because it cannot prove that its many arrays do not overlap.
"""

from __future__ import annotations

from llvmlite import ir

from depthcli.kernels.jit import cgutils, intrinsic, types
from depthcli.kernels.lanes import address, saturated, spread

LANES = 16
"""Number of 16-bit values in a vector; a volume needs at least as many disparities."""
BYTE_LANES = 32
"""Number of 8-bit values in a vector."""


@intrinsic
def path_step(
    typingctx, costs, cost_at, state, before, after, minima, minima_before, minima_after, p1, p2, total, total_at, adds,
    n_disparities,
):  # fmt: skip
    """Compute ``L(d) = C(d) + min(B(d), B(d +- 1) + P1, min B + P2) - min B`` for K paths.

    Parameters
    ----------
    costs : uint8 or uint16; the pixel's D costs start at ``cost_at``
    state : flat uint16 path costs; uint8 if the largest cost plus P2 is less than 256, which gives the same sums in
        half the time. ``before`` and ``after`` (K offsets each) point at D + 2 cells: D path costs between two guard
        cells, whose value no path reaches
    minima : flat minima of the path costs, read at ``minima_before``, written at ``minima_after``; typed as ``state``
    p1, p2 : K penalties, typed as ``state``
    total : uint16; the pixel's D sums over the K paths are written from ``total_at`` on, or added to the values there
    adds : bool, whether they are added
    n_disparities : D, at least LANES, or BYTE_LANES
    """
    paths = len(before)
    bits = state.dtype.bitwidth
    n_lanes, kind = (LANES, types.uint16) if bits == 16 else (BYTE_LANES, types.uint8)
    places, penalties = types.UniTuple(types.intp, paths), types.UniTuple(kind, paths)
    signature = types.void(
        costs, types.intp, state, places, places, minima, places, places, penalties, penalties, total, types.intp,
        types.boolean, types.intp,
    )  # fmt: skip

    def codegen(context, builder, signature, args):
        cell, word = ir.IntType(bits), ir.IntType(64)
        vector, sums = ir.VectorType(cell, n_lanes), ir.VectorType(ir.IntType(16), n_lanes)
        align = bits // 8
        adds, depth = args[12], args[13]

        def at(k, index, kind):
            return address(context, builder, signature.args[k], args[k], index, kind)

        def members(k):
            return [builder.extract_value(args[k], path) for path in range(paths)]

        def minimum(a, b):
            return builder.select(builder.icmp_unsigned("<", a, b), a, b)

        before, after = members(3), members(4)
        path_minima = [builder.load(at(5, place, cell)) for place in members(6)]
        offsets = [spread(builder, value, vector) for value in path_minima]
        steps = [spread(builder, value, vector) for value in members(8)]
        sums_of_jumps = (builder.add(*each) for each in zip(path_minima, members(9), strict=True))
        jumps = [spread(builder, value, vector) for value in sums_of_jumps]
        lowest = [cgutils.alloca_once(builder, vector) for _ in range(paths)]
        for slot in lowest:
            builder.store(ir.Constant(vector, [(1 << bits) - 1] * n_lanes), slot)
        chunks = builder.sdiv(builder.add(depth, ir.Constant(word, n_lanes - 1)), ir.Constant(word, n_lanes))
        last = builder.sub(depth, ir.Constant(word, n_lanes))

        # The last chunk is moved back to end at D. Cells in both get equal values: they are read before any is written.
        earlier, earlier_last = cgutils.alloca_once(builder, sums), cgutils.alloca_once(builder, sums)
        builder.store(ir.Constant(sums, [0] * n_lanes), earlier)
        with builder.if_then(adds):
            builder.store(builder.load(at(10, builder.add(args[11], last), sums), align=2), earlier_last)
        with cgutils.for_range(builder, chunks) as loop:
            start = builder.mul(loop.index, ir.Constant(word, n_lanes))
            is_last = builder.icmp_signed(">=", start, last)
            start = builder.select(is_last, last, start)
            target = at(10, builder.add(args[11], start), sums)
            with builder.if_then(adds):
                there = builder.load(target, align=2)
                builder.store(builder.select(is_last, builder.load(earlier_last), there), earlier)
            cost_bits = signature.args[0].dtype.bitwidth
            place = at(0, builder.add(args[1], start), ir.VectorType(ir.IntType(cost_bits), n_lanes))
            cost = builder.load(place, align=cost_bits // 8)
            if cost_bits < bits:
                cost = builder.zext(cost, vector)
            summed = builder.load(earlier)
            for k in range(paths):
                origin = builder.add(before[k], start)
                lower, same, upper = (
                    builder.load(at(2, builder.add(origin, ir.Constant(word, n)), vector), align=align)
                    for n in range(3)
                )
                best = minimum(saturated(builder, "add", minimum(lower, upper), steps[k]), jumps[k])
                best = minimum(best, same)
                value = builder.add(builder.sub(best, offsets[k]), cost)
                new = builder.add(builder.add(after[k], start), ir.Constant(word, 1))
                builder.store(value, at(2, new, vector), align=align)
                builder.store(minimum(builder.load(lowest[k]), value), lowest[k])
                summed = builder.add(summed, value if bits == 16 else builder.zext(value, sums))
            builder.store(summed, target, align=2)
        reduce = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(cell, [vector]), f"llvm.vector.reduce.umin.v{n_lanes}i{bits}"
        )
        for slot, place in zip(lowest, members(7), strict=True):
            builder.store(builder.call(reduce, [builder.load(slot)]), at(5, place, cell))
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def prefetch(typingctx, array, index):
    """Prefetch the cache line of ``array[index]``, which may be outside the array."""

    def codegen(context, builder, signature, args):
        place = address(context, builder, array, args[0], args[1], ir.IntType(8))
        kind = ir.FunctionType(ir.VoidType(), [place.type, *[ir.IntType(32)] * 3])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        builder.call(function, [place, *(ir.Constant(ir.IntType(32), value) for value in (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(array, types.intp), codegen

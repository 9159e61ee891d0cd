"""The search around every voxel: costs of all displacements, and what their curve says about displacement zero."""

from __future__ import annotations

from typing import Any

import numpy as np

from depthcli.kernels.exponential import exp_minus
from depthcli.kernels.jit import jit, parallel_jit, prange

# Order of the planes written by `search_tiles`.
PLANES = (
    "eshift", "square", "shift_z", "shift_y", "shift_x", "mlm0", "aml0", "shift", "rank0", "cur0", "cost0", "msm",
    "border",
)  # fmt: skip


@jit
def _differences(
    fixed: Any, warped: Any, z: int, y: int, x: int, oz: int, oy: int, ox: int, few: bool, row: Any
) -> None:  # fmt: skip
    """Sum over the channels of |fixed - warped|, into a row of uint16."""
    channels = fixed.shape[0]
    n = row.size
    row[:] = 0
    c = 0
    if few:  # three differences of at most 85 fit a byte: a third of the widening
        while c + 3 <= channels:
            a, b = fixed[c, z, y, x : x + n], warped[c, z + oz, y + oy, x + ox : x + ox + n]
            d, e = fixed[c + 1, z, y, x : x + n], warped[c + 1, z + oz, y + oy, x + ox : x + ox + n]
            f, g = fixed[c + 2, z, y, x : x + n], warped[c + 2, z + oz, y + oy, x + ox : x + ox + n]
            for i in range(n):
                one = np.uint8(max(a[i], b[i]) - min(a[i], b[i]))
                two = np.uint8(max(d[i], e[i]) - min(d[i], e[i]))
                three = np.uint8(max(f[i], g[i]) - min(f[i], g[i]))
                row[i] += np.uint16(np.uint8(one + two + three))
            c += 3
    while c < channels:
        a, b = fixed[c, z, y, x : x + n], warped[c, z + oz, y + oy, x + ox : x + ox + n]
        for i in range(n):
            row[i] += np.uint16(np.uint8(max(a[i], b[i]) - min(a[i], b[i])))
        c += 1


@jit
def _tile_costs(
    fixed: Any, warped: Any, offsets: Any, half: Any, reach: Any, origin: Any, size: Any, shift: Any, few: bool,
    costs: Any, row: Any, columns: Any, layers: Any, volumes: Any,
) -> None:  # fmt: skip
    """Window sums of |fixed - warped| for every displacement, ``shift`` bits coarser, (tz, ty, K, tx) uint16.

    All sums are of integers: they are the same wherever a tile begins.
    """
    tz, ty, tx = size
    hz, hy, hx = half
    nz = 2 * hz + 1
    rounding = np.uint32((1 << shift) >> 1)
    differences = row[: tx + 2 * hx]
    running = columns[0, :tx]
    for k in range(offsets.shape[0]):
        oz, oy, ox = offsets[k, 0] + reach[0], offsets[k, 1] + reach[1], offsets[k, 2] + reach[2]
        volumes[:] = 0
        for z in range(tz + 2 * hz):
            for y in range(ty + 2 * hy):
                _differences(
                    fixed, warped, origin[0] + z, origin[1] + y, origin[2], oz, oy, ox, few, differences
                )  # fmt: skip
                total = columns[1 + y, :tx]
                first = differences[:tx]
                for i in range(tx):
                    total[i] = first[i]
                for j in range(1, 2 * hx + 1, 2):
                    one, other = differences[j : j + tx], differences[j + 1 : j + 1 + tx]
                    for i in range(tx):
                        total[i] += one[i] + other[i]
            running[:] = 0
            for y in range(2 * hy):
                added = columns[1 + y, :tx]
                for i in range(tx):
                    running[i] += added[i]
            for y in range(ty):
                added, removed = columns[1 + y + 2 * hy, :tx], columns[1 + y, :tx]
                kept, volume = layers[z % nz, y, :tx], volumes[y, :tx]
                if z >= nz:
                    for i in range(tx):
                        volume[i] -= np.uint32(kept[i])
                for i in range(tx):
                    v = running[i] + added[i]
                    kept[i] = v
                    running[i] = v - removed[i]
                for i in range(tx):
                    volume[i] += np.uint32(kept[i])
                if z >= 2 * hz:
                    out = costs[z - 2 * hz, y, k, :tx]
                    for i in range(tx):
                        out[i] = np.uint16((volume[i] + rounding) >> shift)


@jit
def _add_scaled(row: Any, factor: Any, out: Any) -> None:
    for i in range(out.size):
        out[i] += row[i] * factor


@jit
def _measure_row(
    costs: Any,
    offsets: Any,
    lengths: Any,
    edge: Any,
    neighbors: Any,
    power: Any,
    scale: Any,
    squared: bool,
    rows: Any,
    out: Any,
) -> None:
    """Measures of one row of curves, (K, n) uint16 costs with displacement zero first, into (planes, n) ``out``.

    Every loop touches few arrays: beyond that the compiler no longer proves them apart, and does not vectorize.
    """
    count = costs.shape[0]
    n = rows.shape[1]
    lowest, sums, squares, rate = rows[0], rows[1], rows[2], rows[3]
    weight, soft, hard, cheaper = rows[4], rows[5], rows[6], rows[7]
    t, e, base = rows[8], rows[9], rows[10]
    first = costs[0]
    for i in range(n):
        base[i] = np.float32(first[i])
        lowest[i] = base[i]
    sums[:] = 0
    squares[:] = 0
    cheaper[:] = 0
    for k in range(count):
        row = costs[k]
        for i in range(n):
            t[i] = np.float32(row[i]) - base[i]
        for i in range(n):
            lowest[i] = min(lowest[i], t[i] + base[i])
            cheaper[i] += np.float32(t[i] < np.float32(0.0))
        for i in range(n):
            sums[i] += t[i]
            squares[i] += t[i] * t[i]
    every = np.float32(1.0 / count)
    for i in range(n):
        mean = sums[i] * every
        variance = max(squares[i] * every - mean * mean, np.float32(0.0))
        # A curve without any variation says nothing against displacement zero.
        rate[i] = np.float32(2.0) / np.sqrt(variance) if variance > 0 else np.float32(0.0)
    weight[:] = 0
    soft[:] = 0
    hard[:] = 0
    out[:5] = 0
    limit = np.float32(80.0 / power)  # no power of the exponential may become denormal
    for k in range(count):
        row = costs[k]
        for i in range(n):
            t[i] = min((np.float32(row[i]) - lowest[i]) * rate[i], limit)
        if squared:
            for i in range(n):
                e[i] = exp_minus(t[i] * t[i])
            for i in range(n):
                hard[i] += e[i]
        for i in range(n):
            t[i] = exp_minus(t[i])
        for i in range(n):
            soft[i] += t[i]
            e[i] = t[i]
        for _ in range(power - 1):
            for i in range(n):
                e[i] *= t[i]
        for i in range(n):
            weight[i] += e[i]
        _add_scaled(e, lengths[k], out[0])
        _add_scaled(e, lengths[k] * lengths[k], out[1])
        for axis in range(3):
            if offsets[k, axis] != 0:
                _add_scaled(e, np.float32(offsets[k, axis]), out[2 + axis])
    for i in range(n):
        flat = rate[i] == 0
        inverse = np.float32(0.0) if flat else np.float32(1.0) / weight[i]
        for m in range(5):
            out[m, i] *= inverse
        away = (base[i] - lowest[i]) * rate[i]
        out[5, i] = np.float32(1.0) if flat else exp_minus(away) / soft[i]
        out[6, i] = np.float32(1.0) if flat else exp_minus(away * away) / max(hard[i], np.float32(1e-30))
        best = 0
        while np.float32(costs[best, i]) != lowest[i]:
            best += 1
        out[7, i] = lengths[best]
        out[8, i] = cheaper[i] * every
        total = np.float32(0.0)
        for j in range(neighbors.size):
            total += np.float32(costs[neighbors[j], i]) - base[i]
        out[9, i] = total * scale
        out[10, i] = base[i] * scale
        out[11, i] = -lowest[i] * scale
        out[12, i] = np.float32(edge[best])


@parallel_jit
def search_tiles(
    fixed: Any, warped: Any, offsets: Any, lengths: Any, edge: Any, neighbors: Any, half: Any, reach: Any,
    tiles: Any, tile: Any, shift: Any, scale: Any, power: Any, few: bool, squared: bool, sums: Any,
    scratch: Any, out: Any,
) -> None:  # fmt: skip
    """Search every tile and write its measures.

    Parameters
    ----------
    fixed : (C, Z + 2 hz, Y + 2 hy, X + 2 hx) uint8; warped : the same, wider by the reach on every side
    offsets : (K, 3) int64, zero first; lengths : (K,) float32, mm
    edge : (K,) bool, on the border of the search; neighbors : indices of the unit displacements
    tiles : (N, 3) int64 first voxels; tile : largest size; shift, scale : bits dropped and what one unit stands for
    power : 0.5 / k; few : no value above 85; squared : AML0 is wanted
    sums : empty array of the type that holds the sum of a window's layer
    scratch : (workers, tz, ty, K, tx or more) uint16; out : (13, Z, Y, X) float32, in the order of PLANES
    """
    workers = scratch.shape[0]
    extent = out.shape
    for w in prange(workers):
        size = np.empty(3, np.int64)
        row = np.empty(tile[2] + 2 * half[2], np.uint16)
        columns = np.empty((1 + tile[1] + 2 * half[1], tile[2]), sums.dtype)
        layers = np.empty((2 * half[0] + 1, tile[1], tile[2]), sums.dtype)
        volumes = np.empty((tile[1], tile[2]), np.uint32)
        work = np.empty((11, scratch.shape[4]), np.float32)
        measured = np.empty((13, scratch.shape[4]), np.float32)
        for t in range(w, tiles.shape[0], workers):
            origin = tiles[t]
            for a in range(3):
                size[a] = min(tile[a], extent[1 + a] - origin[a])
            costs = scratch[w]
            _tile_costs(
                fixed, warped, offsets, half, reach, origin, size, shift, few, costs, row, columns, layers, volumes
            )  # fmt: skip
            for z in range(size[0]):
                for y in range(size[1]):
                    _measure_row(costs[z, y], offsets, lengths, edge, neighbors, power, scale, squared, work, measured)
                    # What lies behind the tile's end is measured with it, and not copied.
                    for m in range(13):
                        target = out[m, origin[0] + z, origin[1] + y, origin[2] : origin[2] + size[2]]
                        target[:] = measured[m, : size[2]]

"""Kernels of the search: costs of all displacements of a voxel, and measures of the cost curve."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.filters import add
from depthcli.kernels.exponential import attainable_likelihood, likelihood
from depthcli.kernels.indices import indices
from depthcli.kernels.jit import empty, helper, jit, zeros

MAX_SMALL_VALUE = 85
"""Largest value of features with many channels: three differences then fit a byte, which makes the search faster."""

# Order of the planes written by `search_tiles`.
PLANES = (
    *("eshift", "square", "shift_z", "shift_y", "shift_x", "mlm0", "aml0", "shift", "rank0", "cur0", "cost0", "msm"),
    *("border", "mlm", "aml", "pkr"),
)
_PLANE = indices(PLANES)
# Rows of the work array of a row of curves; ``best`` is the index of the smallest cost, and until then spare.
_ROW = indices(
    ("lowest", "mean", "squares", "rate", "weight", "soft", "hard", "cheaper", "best", "spare", "base")
)  # fmt: skip


class Curve(NamedTuple):
    """The K searched displacements, zero first."""

    offsets: NDArray[np.int64]  # (K, 3), voxels
    lengths: NDArray[np.float32]  # (K,), mm
    edge: NDArray[np.bool_]  # (K,), on the border of the search
    neighbors: NDArray[np.int64]  # indices of the unit displacements
    before: NDArray[np.int64]  # (K, 13), indices of each displacement's neighbors before it, -1: not searched
    after: NDArray[np.int64]  # and after it


class Window(NamedTuple):
    """Sizes in voxels, (3,) int64 each, z, y, x."""

    half: NDArray[np.int64]  # of the window of a cost, without its center
    reach: NDArray[np.int64]  # of the search
    stride: NDArray[np.int64]  # of the measured voxels, at most the window's size along each axis


class Scale(NamedTuple):
    """How costs are stored and judged."""

    shift: np.uint32  # bits of window sums that are dropped
    unit: np.float32  # cost of one stored unit
    power: int  # 0.5 / k
    small_values: bool  # no feature is above ``MAX_SMALL_VALUE``
    costly: bool  # also compute AML0, AML and PKR


@helper
def _differences(fixed, warped, small_values, row):
    # Write the sums over the channels of |fixed - warped|, (C, n) each, to ``row``, n uint16.
    channels = fixed.shape[0]
    n = row.size
    row[:] = 0
    c = 0
    if small_values:  # three differences of at most 85 fit a byte: a third of the conversions
        while c + 3 <= channels:
            a, b, d = fixed[c, :n], fixed[c + 1, :n], fixed[c + 2, :n]
            e, f, g = warped[c, :n], warped[c + 1, :n], warped[c + 2, :n]
            for i in range(n):
                one = np.uint8(max(a[i], e[i]) - min(a[i], e[i]))
                two = np.uint8(max(b[i], f[i]) - min(b[i], f[i]))
                three = np.uint8(max(d[i], g[i]) - min(d[i], g[i]))
                row[i] += np.uint16(np.uint8(one + two + three))
            c += 3
    while c < channels:
        a, e = fixed[c, :n], warped[c, :n]
        for i in range(n):
            row[i] += np.uint16(np.uint8(max(a[i], e[i]) - min(a[i], e[i])))
        c += 1


@helper
def _window_rows(differences, last, total):
    # Add to ``total`` the sums of last + 1 consecutive differences, from each position on.
    n = total.size
    add(differences, total)
    j = 1
    while j + 1 <= last:
        one, other = differences[j : j + n], differences[j + 1 : j + 1 + n]
        for i in range(n):
            total[i] += one[i] + other[i]
        j += 2
    if j <= last:
        add(differences[j:], total)


@helper
def _tile_costs(fixed, warped, offsets, window, size, scale, costs, row, sums, running, layers, volumes):
    """Write window sums of |fixed - warped| for every displacement, coarser by ``scale``, (tz, ty, K, width) uint16.

    ``fixed`` and ``warped`` are the tile's (Z, sx, C, Y * pitch): rows follow each other at one pitch, so that a slice
    is one long loop. Sums between the end of a row and the next row are unused.

    All sums are integers, so they do not depend on the division into tiles.
    """
    half, reach, stride = window
    shift, small_values = scale.shift, scale.small_values
    tz, ty, pitch = size
    hz, hy, hx = half
    sz, sy, sx = stride
    width = costs.shape[3]
    nz = 2 * hz + 1
    rows = sy * (ty - 1) + 1 + 2 * hy
    rounding = np.uint32((1 << shift) >> 1)
    flat = rows * pitch
    total = sums[:flat]
    for k in range(offsets.shape[0]):
        oz, oy, ox = offsets[k, 0] + reach[0], offsets[k, 1] + reach[1], offsets[k, 2] + reach[2]
        volumes[:] = 0
        for z in range(sz * (tz - 1) + nz):
            total[:] = 0
            for phase in range(min(sx, 2 * hx + 1)):
                start = oy * pitch + (phase + ox) // sx
                last = (2 * hx - phase) // sx
                _differences(
                    fixed[z, phase], warped[z + oz, (phase + ox) % sx, :, start:], small_values, row[: flat + last]
                )
                _window_rows(row, last, total)
            running[:] = 0
            for y in range(2 * hy + 1 - sy):
                add(total[y * pitch : y * pitch + width], running)
            for y in range(ty):
                for step in range(min(sy, 2 * hy + 1)):
                    first = (sy * y + 2 * hy - step) * pitch
                    add(total[first : first + width], running)
                kept, volume = layers[z % nz, y], volumes[y]
                if z >= nz:
                    for i in range(width):
                        volume[i] -= np.uint32(kept[i])
                for i in range(width):
                    kept[i] = running[i]
                for i in range(width):
                    volume[i] += np.uint32(kept[i])
                for step in range(min(sy, 2 * hy + 1)):
                    first = (sy * y + step) * pitch
                    removed = total[first : first + width]
                    for i in range(width):
                        running[i] -= removed[i]
                if z >= 2 * hz and (z - 2 * hz) % sz == 0:
                    out = costs[(z - 2 * hz) // sz, y, k]
                    for i in range(width):
                        out[i] = np.uint16((volume[i] + rounding) >> shift)


@helper
def _take(volume, first, stride, count, pitch, out):
    # Copy part of a volume (C, Z, Y, sx, X) to ``out`` (Z, sx, C, Y * pitch).
    for z in range(count[0]):
        for p in range(stride[2]):
            for c in range(volume.shape[0]):
                target = out[z, p, c]
                for y in range(count[1]):
                    source = volume[c, first[0] * stride[0] + z, first[1] * stride[1] + y, p]
                    source = source[first[2] : first[2] + pitch]
                    for i in range(source.size):
                        target[y * pitch + i] = source[i]


@helper
def _add_scaled(row, factor, out):
    for i in range(out.size):
        out[i] += row[i] * factor


@helper
def _spread(costs, rows):
    # For (K, n) curves, write smallest and mean cost, 1 / deviation (rate), number of displacements cheaper than zero,
    # and the costs of displacement zero (base) to the rows of these names.
    count, n = costs.shape[0], rows.shape[1]
    lowest, sums, squares, rate = rows[_ROW.lowest], rows[_ROW.mean], rows[_ROW.squares], rows[_ROW.rate]
    cheaper, t, base = rows[_ROW.cheaper], rows[_ROW.best], rows[_ROW.base]
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
    share = np.float32(1.0 / count)
    for i in range(n):
        mean = sums[i] * share
        variance = max(squares[i] * share - mean * mean, np.float32(0.0))
        sums[i] = mean + base[i]
        # A constant curve is no evidence against displacement zero.
        rate[i] = np.float32(1.0) / np.sqrt(variance) if variance > 0 else np.float32(0.0)


@helper
def _raise(values, power, out):
    # out = values ** power, by repeated squaring
    for i in range(out.size):
        out[i] = values[i]
    bit = 1
    while 2 * bit <= power:
        bit *= 2
    bit //= 2
    while bit > 0:
        for i in range(out.size):
            out[i] *= out[i]
        if power & bit:
            for i in range(out.size):
                out[i] *= values[i]
        bit //= 2


@helper
def _likelihoods(costs, curve, power, costly, rows, out):
    # Write sums of likelihoods to the rows weight, soft and hard, and sums of lengths, squared lengths and
    # displacements, weighted by powers of the likelihoods, to the first five planes.
    offsets, lengths, n = curve.offsets, curve.lengths, rows.shape[1]
    lowest, rate, weight = rows[_ROW.lowest], rows[_ROW.rate], rows[_ROW.weight]
    soft, hard, t, e = rows[_ROW.soft], rows[_ROW.hard], rows[_ROW.best], rows[_ROW.spare]
    weight[:] = 0
    soft[:] = 0
    hard[:] = 0
    out[:5] = 0
    tiny = np.float32(np.exp(-80.0 / power))  # no power of the likelihood may become denormal
    for k in range(costs.shape[0]):
        row = costs[k]
        for i in range(n):
            t[i] = (np.float32(row[i]) - lowest[i]) * rate[i]
        if costly:
            for i in range(n):
                e[i] = attainable_likelihood(t[i])
            add(e, hard)
        for i in range(n):
            t[i] = likelihood(t[i])
        for i in range(n):
            soft[i] += t[i]
            t[i] = max(t[i], tiny)
        _raise(t, power, e)
        add(e, weight)
        _add_scaled(e, lengths[k], out[_PLANE.eshift])
        _add_scaled(e, lengths[k] * lengths[k], out[_PLANE.square])
        for axis in range(3):
            if offsets[k, axis] != 0:
                _add_scaled(e, np.float32(offsets[k, axis]), out[_PLANE.shift_z + axis])


@helper
def _measure_row(costs, curve, scale, rows, out):
    """Write the measures of a row of curves, (K, n) uint16 costs with displacement zero first, to (planes, n) ``out``.

    Leaves the mean cost and the index of the smallest cost in the rows ``mean`` and ``best``.

    Every loop uses few arrays: with more, the compiler cannot prove that they do not overlap, and does not vectorize.
    """
    _spread(costs, rows)
    _likelihoods(costs, curve, scale.power, scale.costly, rows, out)
    lengths, edge, neighbors, unit = curve.lengths, curve.edge, curve.neighbors, scale.unit
    lowest, rate, weight, soft = rows[_ROW.lowest], rows[_ROW.rate], rows[_ROW.weight], rows[_ROW.soft]
    hard, cheaper, t, base = rows[_ROW.hard], rows[_ROW.cheaper], rows[_ROW.best], rows[_ROW.base]
    share = np.float32(1.0 / costs.shape[0])
    for i in range(rows.shape[1]):
        flat = rate[i] == 0
        inverse = np.float32(0.0) if flat else np.float32(1.0) / weight[i]
        for m in range(5):
            out[m, i] *= inverse
        away = (base[i] - lowest[i]) * rate[i]
        out[_PLANE.mlm0, i] = np.float32(1.0) if flat else likelihood(away) / soft[i]
        out[_PLANE.aml0, i] = np.float32(1.0) if flat else attainable_likelihood(away) / max(hard[i], np.float32(1e-30))
        best = 0
        while np.float32(costs[best, i]) != lowest[i]:
            best += 1
        t[i] = np.float32(best)
        out[_PLANE.shift, i] = lengths[best]
        out[_PLANE.rank0, i] = cheaper[i] * share
        total = np.float32(0.0)
        for j in range(neighbors.size):
            total += np.float32(costs[neighbors[j], i]) - base[i]
        out[_PLANE.cur0, i] = total * unit
        out[_PLANE.cost0, i] = base[i] * unit
        out[_PLANE.msm, i] = -lowest[i] * unit
        out[_PLANE.border, i] = np.float32(edge[best])
        out[_PLANE.mlm, i] = np.float32(0.0) if flat else np.float32(1.0) / soft[i]
        out[_PLANE.aml, i] = np.float32(0.0) if flat else np.float32(1.0) / max(hard[i], np.float32(1e-30))


@helper
def _peak_row(costs, curve, rows, out):
    """Write the peak ratio of one row of curves: second smallest local minimum over smallest cost.

    As in stereo, a local minimum is below all earlier neighbors and not above any later one. If there is no second
    minimum, the largest cost replaces it. Neighbors are the searched displacements among the 26 around one.
    """
    second, highest, early, late = rows[_ROW.squares], rows[_ROW.rate], rows[_ROW.weight], rows[_ROW.soft]  # now free
    before, after, best, mean, n = curve.before, curve.after, rows[_ROW.best], rows[_ROW.mean], out.size
    far = np.float32(1e30)
    second[:] = far
    highest[:] = 0
    for k in range(costs.shape[0]):
        row = costs[k]
        early[:] = far
        late[:] = far
        for j in range(before.shape[1]):
            if before[k, j] >= 0:
                other = costs[before[k, j]]
                for i in range(n):
                    early[i] = min(early[i], np.float32(other[i]))
            if after[k, j] >= 0:
                other = costs[after[k, j]]
                for i in range(n):
                    late[i] = min(late[i], np.float32(other[i]))
        for i in range(n):
            value = np.float32(row[i])
            highest[i] = max(highest[i], value)
            valley = (value < early[i]) & (value <= late[i]) & (np.float32(k) != best[i])
            second[i] = min(second[i], value if valley else far)
    for i in range(n):
        lowest = np.float32(costs[int(best[i]), i])
        rival = second[i] if second[i] < far else highest[i]
        eps = np.float32(1e-3) * mean[i] if mean[i] > 0 else np.float32(1e-3)
        out[i] = (rival + eps) / (lowest + eps)


@jit
def search_tiles(begin, end, fixed, warped, curve, window, tiles, tile, scale, sums, scratch, out):
    """Search every tile and write its measures, at every ``window.stride``-th voxel.

    Parameters
    ----------
    fixed : (C, Z + 2 hz, Y + 2 hy, sx, Xs) uint8, voxel x at [x % sx, x // sx]; warped : the same, wider by the reach
    tiles : (N, 3) int64, first measured voxels of the tiles; tile : largest size
    sums : empty array with the dtype of the sum of a window's layer
    scratch : (workers, tz, ty, K, tx or more) uint16; out : (16, nz, ny, nx) float32, in the order of PLANES
    """
    half, reach, stride = window
    workers = scratch.shape[0]
    extent = out.shape
    width = scratch.shape[4]
    channels = fixed.shape[0]
    side = stride * (tile - 1) + 1 + 2 * half
    # A row has the tile's width in full vectors, the rest of the window, and the reach.
    pitch = width + (2 * half[2]) // stride[2] + (2 * reach[2] + stride[2] - 1) // stride[2] + 1
    for w in range(begin, end):
        size = empty(3, np.int64)
        count = empty(3, np.int64)
        # Every slice of ``near`` may be read as far as the last slice of ``far``.
        near = zeros((side[0], stride[2], channels, (side[1] + 2) * pitch), np.uint8)
        far = zeros((side[0] + 2 * reach[0], stride[2], channels, (side[1] + 2 * reach[1] + 2) * pitch), np.uint8)
        row = empty((side[1] + 1) * pitch, np.uint16)
        total = empty((side[1] + 1) * pitch, sums.dtype)
        running = empty(width, sums.dtype)
        layers = empty((2 * half[0] + 1, tile[1], width), sums.dtype)
        volumes = empty((tile[1], width), np.uint32)
        work = empty((len(_ROW), width), np.float32)
        measured = empty((len(_PLANE), width), np.float32)
        for t in range(w, tiles.shape[0], workers):
            origin = tiles[t]
            for a in range(3):
                size[a] = min(tile[a], extent[1 + a] - origin[a])
                count[a] = stride[a] * (size[a] - 1) + 1 + 2 * half[a]
            _take(fixed, origin, stride, count, pitch, near)
            _take(warped, origin, stride, count + 2 * reach, pitch, far)
            last = size[2]
            size[2] = pitch
            costs = scratch[w]
            _tile_costs(near, far, curve.offsets, window, size, scale, costs, row, total, running, layers, volumes)
            for z in range(size[0]):
                for y in range(size[1]):
                    _measure_row(costs[z, y], curve, scale, work, measured)
                    if scale.costly:
                        _peak_row(costs[z, y], curve, work, measured[_PLANE.pkr])
                    # Voxels behind the tile's end are measured, but not copied.
                    for m in range(len(PLANES)):
                        target = out[m, origin[0] + z, origin[1] + y, origin[2] : origin[2] + last]
                        for i in range(last):
                            target[i] = measured[m, i]

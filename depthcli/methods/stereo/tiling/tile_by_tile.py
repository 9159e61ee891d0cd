"""A pair matched tile by tile: from the costs of its tiles, or with every tile as a pair of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.core.context import Clock, Context
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Floats
from depthcli.kernels.jit import jit, run_bands
from depthcli.methods.confidence import confidence_maps
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.refinement import Refinement, with_filled
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.refinement.subpixel import Subpixel
from depthcli.methods.stereo.stages import CostStages, PairMatcher
from depthcli.methods.stereo.tiling.plan import Candidates, Margins, Memory, Tile
from depthcli.methods.stereo.volume import CostMinima, CostVolume, FixedPoint, RefinementContext, StereoResult

_PATH_HALO = 32  # pixels after which the paths of a scanline no longer depend on where they begin
_UNLIKELY_COST = 0.2  # added cost of unlikely disparities, in units of a scanline's penalty of a step
_BAND_PIXELS = 1 << 20  # pixels refined at a time
_FLOAT_BARRIER = 1e4  # least cost between the spans of a float volume: no path goes through it
_PIXEL_BYTES = 40  # of a row of a tile: features of the images, states of the paths


@dataclass(frozen=True)
class Prior:
    """Likely disparities of a pair, from its map ``values`` at half the size, (ceil(H / 2), ceil(W / 2))."""

    values: Floats
    candidates: Candidates  # of the pair itself
    low: NDArray[np.int16]  # of the shape of ``values``: the likely disparities at the full size
    high: NDArray[np.int16]
    # (2, ...): smallest and largest disparity, at the full size, of the thin structures around; if there are none, the
    # smallest is larger than any disparity.
    thin: Floats
    levels: int  # number of sizes matched, including the pair's own


class TiledWinners:
    """Winner-takes-all over an (H, W) image whose costs are computed tile by tile, each with its own disparities.

    Attributes
    ----------
    left : (H, W) uint16, the left view's winners; 0 if a tile has no disparity inside the right image
    minima : (H, W) float32, minima of the parabolas through each winner's cost and its two neighbors; or (0, 0)
    """

    def __init__(self, shape: tuple[int, int], minima: bool) -> None:
        self.left: NDArray[np.uint16] = np.zeros(shape, np.uint16)
        self.minima: Floats = np.zeros(shape if minima else (0, 0), np.float32)
        # Smallest costs of the right view so far, columns mirrored: cost and disparity in one key; floats apart.
        self._keys: NDArray[np.uint32] = np.full(shape, 0xFFFFFFFF, np.uint32)
        self._min_costs: Floats = np.zeros((0, 0), np.float32)
        self._right: NDArray[np.uint16] | None = None

    def add(self, costs: NDArray[Any], spans: NDArray[np.int64], tile: Tile) -> None:
        """Add the (h, w, K) costs of a tile, of one dtype and scale for all tiles.

        ``spans`` (n, 3) has the first cell, number of cells and first disparity of runs of disparities, ascending.
        """
        rows, columns = tile.inside
        bounds = (rows.start, rows.stop, columns.start, columns.stop)
        corner, n_rows = (tile.around[0], tile.around[2]), rows.stop - rows.start
        if costs.dtype == np.float32:
            if self._min_costs.size == 0:
                self._min_costs = np.full(self.left.shape, np.inf, np.float32)
            run_bands(_add_floats, n_rows, costs, spans, corner, bounds, self.left, self._min_costs, self._keys)
        else:
            run_bands(_add_integers, n_rows, costs, spans, corner, bounds, self.left, self._keys)
        if self.minima.size:
            run_bands(_add_minima, n_rows, costs, spans, corner, bounds, self.left, self.minima)

    def right(self) -> NDArray[np.uint16]:
        """Return the (H, W) uint16 winners of the right view, and free memory; no tile can be added afterwards."""
        if self._right is None:
            self._right = (self._keys[:, ::-1] & np.uint32(0xFFFF)).astype(np.uint16)
            self._keys, self._min_costs = np.zeros((0, 0), np.uint32), np.zeros((0, 0), np.float32)
        return self._right


def match_by_costs(
    stages: CostStages,
    pair: StereoPair,
    candidates: Candidates,
    prior: Prior | None,
    available: Memory,
    clock: Clock,
) -> tuple[StereoResult, TiledWinners]:
    """Compute costs and winners tile by tile, then refine the whole map; without a ``prior``, over the whole range."""
    clock.start("plan")
    halo = stages.halo()
    path_halo = _PATH_HALO if prior is None else _PATH_HALO // 2  # likely disparities guide paths that begin anew
    margins = Margins(path_halo, path_halo // 2, False) if halo is None else Margins(halo, halo, False)

    def need(tile: Tile) -> int:
        height, width = tile.shape
        beside = _PIXEL_BYTES * width * (height + tile.n_disparities)
        return stages.volume_bytes(tile.shape, tile.n_disparities - 1) + beside

    plan = available.tiles(pair, candidates, margins, need)
    found = TiledWinners(pair.shape, any(isinstance(step, Subpixel) for step in stages.refinement))
    confidence: dict[str, Floats] = {}
    for tile, may_keep in plan:
        memory.release(may_keep)
        volume, spans = _tile_volume(stages, pair, tile, prior, clock)
        clock.start("optimization")
        volume = stages.optimization(volume, tile.cut(pair))
        found.add(volume.costs, spans, tile)
        clock.start("confidence")
        for name, values in confidence_maps(volume.costs, stages.confidence).items():
            confidence.setdefault(name, np.zeros(pair.shape, np.float32))[tile.place] = values[tile.inside]
        del volume
    clock.start("refinement")
    memory.release()
    disparity = refined_map(stages.refinement, found, pair, candidates.max_disparity, prior)
    figures = {"tiles": float(len(plan))}
    return StereoResult(disparity, seconds=clock.seconds, confidence=confidence, figures=figures), found


def match_by_patches(
    matcher: PairMatcher,
    pair: StereoPair,
    candidates: Candidates,
    available: Memory,
    context: Context | None,
    clock: Clock,
) -> StereoResult:
    """Match every tile as a pair of its own, over one range from the smallest to the largest of its ``candidates``."""
    clock.start("plan")
    halo = matcher.tile_halo()
    assert halo is not None, "only the whole pair can be matched"
    plan = available.tiles(
        pair,
        candidates,
        Margins(halo, min(halo, _PATH_HALO // 2), True),
        lambda tile: matcher.peak_bytes(tile.shape, tile.n_disparities - 1),
    )
    values, status = np.zeros(pair.shape, np.float32), np.zeros(pair.shape, np.uint8)
    confidence: dict[str, Floats] = {}
    for tile, may_keep in plan:
        memory.release(may_keep)
        clock.start("tiles")
        (span,) = tile.spans
        part = matcher(tile.cut(pair, span.low), span.n - 1, context)
        values[tile.place] = part.disparity.values[tile.inside] + np.float32(span.low)
        status[tile.place] = part.disparity.status[tile.inside]
        for name, own in part.confidence.items():
            confidence.setdefault(name, np.zeros(pair.shape, np.float32))[tile.place] = own[tile.inside]
        del part
    memory.release()
    figures = {"tiles": float(len(plan))}
    return StereoResult(DisparityMap(values, status), seconds=clock.seconds, confidence=confidence, figures=figures)


def _tile_volume(
    stages: CostStages, pair: StereoPair, tile: Tile, prior: Prior | None, clock: Clock
) -> tuple[CostVolume, NDArray[np.int64]]:
    # Costs of all spans, one after the other, with a cell between that no path passes; and the table of spans.
    spans = np.zeros((len(tile.spans), 3), np.int64)
    joined: CostVolume | None = None
    start = 0
    for k, span in enumerate(tile.spans):
        spans[k] = start, span.n, span.low
        volume = stages.volume(tile.cut(pair, span.low), span.n - 1, clock)
        clock.start("cost")
        n_outside = max(0, span.low - tile.around[2])  # columns whose matches are all outside the right image
        if joined is None and len(tile.spans) == 1 and n_outside == 0:
            joined = volume
            break
        if joined is None:
            joined = CostVolume(memory.empty((*tile.shape, tile.n_disparities), volume.costs.dtype), volume.scale)
        barrier = volume.costs.dtype.type(_largest_cost(volume))
        run_bands(_copy_span, tile.shape[0], volume.costs, joined.costs, start, n_outside, barrier)
        start += span.n + 1
        del volume
    assert joined is not None
    if prior is not None and isinstance(stages.optimization, Scanline):
        clock.start("cost")
        penalty = max(1, round(_UNLIKELY_COST * stages.optimization.p1 * joined.scale))
        corner = (tile.around[0], tile.around[2])
        limits = prior.low, prior.high, corner, penalty, _largest_cost(joined)
        run_bands(_add_penalty, tile.shape[0], joined.costs, spans, *limits)
    return joined, spans


def _largest_cost(volume: CostVolume) -> float:
    if volume.costs.dtype == np.float32:
        return max(_FLOAT_BARRIER, float(volume.costs.max()))
    return 255.0 if volume.costs.dtype == np.uint8 else float(FixedPoint.LARGEST)


@jit
def _copy_span(begin, end, costs, joined, start, n_outside, barrier):
    # Outside the right image, cells get the measure's cost for it, read from pixel 0 at a disparity above 0.
    _, width, count = costs.shape
    outside = costs[0, 0, count - 1]
    for y in range(begin, end):
        for x in range(width):
            source, out = costs[y, x], joined[y, x, start : start + count]
            if x < n_outside:
                out[:] = outside
            else:
                for i in range(out.size):
                    out[i] = source[i]
            if start + count < joined.shape[2]:
                joined[y, x, start + count] = barrier


@jit
def _add_penalty(begin, end, costs, spans, low, high, corner, penalty, largest):
    # Add the penalty to disparities beyond the likely ones of the pixel at half the size.
    width = costs.shape[1]
    kind = costs.dtype.type
    for v in range(begin, end):
        for u in range(width):
            y, x = (corner[0] + v) >> 1, (corner[1] + u) >> 1
            for k in range(spans.shape[0]):
                count = spans[k, 1]
                row = costs[v, u, spans[k, 0] : spans[k, 0] + count]
                first = min(max(low[y, x] - spans[k, 2], 0), count)
                last = min(max(high[y, x] + 1 - spans[k, 2], first), count)
                for part in (row[:first], row[last:]):
                    for i in range(part.size):
                        part[i] = kind(min(np.float32(part[i]) + np.float32(penalty), np.float32(largest)))


def refined_map(
    steps: Sequence[Refinement], found: TiledWinners, pair: StereoPair, max_disparity: int, prior: Prior | None = None
) -> DisparityMap:
    """Return the map of all winners after all ``steps``; the prior fills empty pixels before the first filling step."""
    height, width = pair.shape
    right = found.right()

    def applied(step: Refinement, disparity: DisparityMap) -> DisparityMap:
        # One band of rows at a time, unless the step depends on the whole map.
        halo = step.halo()
        band = height if halo is None else max(4 * halo, _BAND_PIXELS // width, 1)
        values, status = np.empty_like(disparity.values), np.empty_like(disparity.status)
        for y in range(0, height, band):
            rows = slice(max(0, y - (halo or 0)), min(height, y + band + (halo or 0)))
            minima = found.minima[rows] if found.minima.size else found.left[rows].astype(np.float32)
            context = RefinementContext(
                StereoPair(pair.left[rows], pair.right[rows], pair.bits),
                CostMinima(found.left[rows], minima, max_disparity + 1),
                right[rows],
            )
            part = step(DisparityMap(disparity.values[rows], disparity.status[rows]), context)
            inside = slice(y - rows.start, min(y + band, height) - rows.start)
            values[y : y + band], status[y : y + band] = part.values[inside], part.status[inside]
        return DisparityMap(values, status)

    disparity = DisparityMap(found.left.astype(np.float32), np.zeros(pair.shape, np.uint8))
    first_fill = next((k for k, step in enumerate(steps) if step.fills), len(steps))
    for k, step in enumerate(steps):
        if k == first_fill and prior is not None:
            doubled = np.repeat(np.repeat(np.float32(2) * prior.values, 2, 0), 2, 1)[:height, :width]
            disparity = with_filled(disparity, np.where(np.isnan(disparity.values), doubled, disparity.values))
        before, disparity = disparity, applied(step, disparity)
        if k < first_fill and prior is not None and isinstance(step, SpeckleFilter):
            # Speckles are the same parts of the scene at every size, so they have more pixels here than at the
            # smallest size. Thin structures stay. Removed pixels get the value of the smaller image afterwards.
            mild, size = disparity, step.size * 4 ** (prior.levels - 1)
            disparity = applied(step.model_copy(update={"size": size}), before)
            v, u = np.nonzero(mild.valid & ~disparity.valid)
            low, high = prior.thin[:, v // 2, u // 2]
            stays = (mild.values[v, u] >= low) & (mild.values[v, u] <= high)
            v, u = v[stays], u[stays]
            disparity.values[v, u], disparity.status[v, u] = mild.values[v, u], mild.status[v, u]
    return disparity


@jit
def _add_integers(begin, end, costs, spans, corner, bounds, left, right):
    width = left.shape[1]
    for v in range(bounds[0] + begin, bounds[0] + end):
        y = corner[0] + v
        for u in range(bounds[2], bounds[3]):
            x = corner[1] + u
            best = np.uint32(0xFFFFFFFF)
            for k in range(spans.shape[0]):
                start, low = spans[k, 0], spans[k, 2]
                count = min(spans[k, 1], x - low + 1)
                if count <= 0:
                    break
                row = costs[v, u, start : start + count]
                first = width - 1 - x + low
                mirror = right[y, first : first + count]
                d0 = np.uint32(low)
                for i in range(row.size):
                    key = np.uint32((np.uint32(row[i]) << np.uint32(16)) | np.uint32(np.uint32(i) + d0))
                    best = min(best, key)
                    mirror[i] = min(mirror[i], key)
            if best != np.uint32(0xFFFFFFFF):
                left[y, x] = np.uint16(best & np.uint32(0xFFFF))


@jit
def _add_floats(begin, end, costs, spans, corner, bounds, left, min_costs, right):
    width = left.shape[1]
    for v in range(bounds[0] + begin, bounds[0] + end):
        y = corner[0] + v
        for u in range(bounds[2], bounds[3]):
            x = corner[1] + u
            best = np.float32(np.inf)
            for k in range(spans.shape[0]):
                start, low = spans[k, 0], spans[k, 2]
                for i in range(min(spans[k, 1], x - low + 1)):
                    cost, d = costs[v, u, start + i], np.uint32(low + i)
                    if cost < best:
                        best = cost
                        left[y, x] = d
                    mirror = width - 1 - x + low + i
                    if cost < min_costs[y, mirror] or (cost == min_costs[y, mirror] and d < right[y, mirror]):
                        min_costs[y, mirror] = cost
                        right[y, mirror] = d


@jit
def _add_minima(begin, end, costs, spans, corner, bounds, left, minima):
    for v in range(bounds[0] + begin, bounds[0] + end):
        y = corner[0] + v
        for u in range(bounds[2], bounds[3]):
            x = corner[1] + u
            d = int(left[y, x])
            minima[y, x] = np.float32(d)
            for k in range(spans.shape[0]):
                n = d - spans[k, 2]
                if n < 1 or n + 1 >= min(spans[k, 1], x - spans[k, 2] + 1):
                    continue
                i = spans[k, 0] + n
                below, here, above = float(costs[v, u, i - 1]), float(costs[v, u, i]), float(costs[v, u, i + 1])
                curvature = below + above - 2.0 * here
                if below >= here and above >= here and curvature > 0.0:
                    minima[y, x] = np.float32(d + 0.5 * (below - above) / curvature)

"""A pair matched tile by tile: over the costs of its tiles, or every tile as a pair of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.result import Clock
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.confidence import confidence_maps
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.refinement.subpixel import Subpixel
from depthcli.methods.stereo.stages import CostStages, PairMatcher
from depthcli.methods.stereo.tiling.plan import Candidates, Margins, Memory, Tile
from depthcli.methods.stereo.tiling.winners import TiledWinners
from depthcli.methods.stereo.volume import CostMinima, CostVolume, FixedPoint, RefinementContext, StereoResult

_PATH_HALO = 32  # pixels after which the paths of a scanline that begins anew are what they would have been
_UNLIKELY_COST = 0.2  # what unlikely disparities cost more, in units of a scanline's penalty of a step
_BAND_PIXELS = 1 << 20  # pixels that are refined at a time
_FLOAT_BARRIER = 1e4  # cost between the spans of a float volume: no path goes through it
_PIXEL_BYTES = 40  # of a row of a tile: features of the images, states of the paths


@dataclass(frozen=True)
class Prior:
    """Likely disparities of a pair, from its map at half the size.

    Attributes
    ----------
    values : (ceil(H / 2), ceil(W / 2)) float32, the map of the pair at half its size
    candidates : disparities by block of the pair itself
    low, high : of the shape of ``values``, int16, the likely disparities at the full size
    thin : (2, ...) float32, smallest and largest disparity of the thin structures around at the full size; where
        there are none, the smallest is larger than any disparity
    levels : number of sizes matched, that of the pair counted
    """

    values: NDArray[np.float32]
    candidates: Candidates
    low: NDArray[np.int16]
    high: NDArray[np.int16]
    thin: NDArray[np.float32]
    levels: int


def match_by_costs(
    stages: CostStages,
    pair: StereoPair,
    candidates: Candidates,
    prior: Prior | None,
    halo: int | None,
    available: Memory,
    clock: Clock,
) -> tuple[StereoResult, TiledWinners]:
    """Compute costs and winners tile by tile, then refine the whole map.

    Parameters
    ----------
    candidates : disparities that are searched
    prior : None where the whole range is searched
    halo : pixels around a pixel that its optimized costs depend on; None: on the whole image
    """
    clock.start("plan")
    path_halo = _PATH_HALO if prior is None else _PATH_HALO // 2  # likely disparities hold paths that begin anew
    margins = Margins(path_halo, path_halo // 2, False) if halo is None else Margins(halo, halo, False)

    def need(tile: Tile) -> int:
        height, width = tile.shape
        return (
            stages.volume_bytes(tile.shape, tile.n_disparities - 1)
            + _recycled(tile)
            + _PIXEL_BYTES * width * (height + tile.n_disparities)
        )

    plan = available.tiles(pair, candidates, margins, need)
    found = TiledWinners(pair.shape, any(isinstance(step, Subpixel) for step in stages.refinement))
    confidence: dict[str, NDArray[np.float32]] = {}
    for tile in plan:
        volume, spans = _tile_volume(stages, pair, tile, prior, clock)
        clock.start("optimization")
        volume = stages.optimization(volume, tile.cut(pair))
        found.add(volume.costs, spans, (tile.around[0], tile.around[2]), tile.inside)
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
    matcher: PairMatcher, pair: StereoPair, candidates: Candidates, available: Memory, clock: Clock
) -> StereoResult:
    """Match every tile as a pair of its own, over one range from the smallest to the largest of its ``candidates``."""
    clock.start("plan")
    halo = matcher.tile_halo()
    assert halo is not None, "only the whole pair can be matched"
    plan = available.tiles(
        pair,
        candidates,
        Margins(halo, min(halo, _PATH_HALO // 2), True),
        lambda tile: matcher.peak_bytes(tile.shape, tile.n_disparities - 1) + _recycled(tile),
    )
    values, status = np.zeros(pair.shape, np.float32), np.zeros(pair.shape, np.uint8)
    confidence: dict[str, NDArray[np.float32]] = {}
    for tile in plan:
        clock.start("tiles")
        (span,) = tile.spans
        part = matcher(tile.cut(pair, span.low), span.count - 1)
        values[tile.place] = part.disparity.values[tile.inside] + np.float32(span.low)
        status[tile.place] = part.disparity.status[tile.inside]
        for name, own in part.confidence.items():
            confidence.setdefault(name, np.zeros(pair.shape, np.float32))[tile.place] = own[tile.inside]
        del part
    memory.release()
    figures = {"tiles": float(len(plan))}
    return StereoResult(DisparityMap(values, status), seconds=clock.seconds, confidence=confidence, figures=figures)


def _recycled(tile: Tile) -> int:
    """Return the size of the pool's blocks that only the next tile can use, bytes."""
    return 2 * tile.shape[0] * tile.shape[1] * tile.n_disparities


def _tile_volume(
    stages: CostStages, pair: StereoPair, tile: Tile, prior: Prior | None, clock: Clock
) -> tuple[CostVolume, NDArray[np.int64]]:
    # Costs of all spans, one behind the other, with a cell between that no path goes through; and the table of spans.
    spans = np.zeros((len(tile.spans), 3), np.int64)
    joined: CostVolume | None = None
    start = 0
    for k, span in enumerate(tile.spans):
        spans[k] = start, span.count, span.low
        volume = stages.volume(tile.cut(pair, span.low), span.count - 1, clock)
        clock.start("cost")
        n_outside = max(0, span.low - tile.around[2])  # columns whose matches all lie outside the right image
        if joined is None and len(tile.spans) == 1 and n_outside == 0:
            joined = volume
            break
        if joined is None:
            joined = CostVolume(memory.empty((*tile.shape, tile.n_disparities), volume.costs.dtype), volume.scale)
        barrier = volume.costs.dtype.type(_largest_cost(volume))
        _copy_span(volume.costs, joined.costs, start, n_outside, barrier)
        start += span.count + 1
        del volume
    assert joined is not None
    if prior is not None and isinstance(stages.optimization, Scanline):
        clock.start("cost")
        penalty = max(1, round(_UNLIKELY_COST * stages.optimization.p1 * joined.scale))
        corner = (tile.around[0], tile.around[2])
        _add_penalty(joined.costs, spans, prior.low, prior.high, corner, penalty, _largest_cost(joined))
    return joined, spans


def _largest_cost(volume: CostVolume) -> float:
    return {1: 255.0, 2: float(FixedPoint.LARGEST)}.get(volume.costs.itemsize, _FLOAT_BARRIER)


@parallel_jit
def _copy_span(costs, joined, start, n_outside, barrier):
    # What the right image does not have costs what the measure says: the cell of pixel 0 at any disparity but 0.
    height, width, count = costs.shape
    outside = costs[0, 0, count - 1]
    for y in prange(height):
        for x in range(width):
            source, out = costs[y, x], joined[y, x, start : start + count]
            if x < n_outside:
                out[:] = outside
            else:
                for i in range(out.size):
                    out[i] = source[i]
            if start + count < joined.shape[2]:
                joined[y, x, start + count] = barrier


@parallel_jit
def _add_penalty(costs, spans, low, high, corner, penalty, largest):
    # To disparities beyond the likely ones of the pixel at half the size.
    height, width, _ = costs.shape
    kind = costs.dtype.type
    for v in prange(height):
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
    """Return the map of all winners after all ``steps``, in order.

    Where ``prior`` is given, pixels that are empty before the first step that fills have the value of the pair at half
    its size.
    """
    disparity = DisparityMap(found.left.astype(np.float32), np.zeros(pair.shape, np.uint8))
    first = next((k for k, step in enumerate(steps) if step.fills), len(steps))
    for k, step in enumerate(steps):
        if k == first and prior is not None:
            disparity = _filled(disparity, prior.values)
        disparity = _refined_in_bands(step, disparity, found, pair, max_disparity, prior if k < first else None)
    return disparity


def _refined_in_bands(
    step: Refinement,
    disparity: DisparityMap,
    found: TiledWinners,
    pair: StereoPair,
    max_disparity: int,
    prior: Prior | None,
) -> DisparityMap:
    """Return the map after one step, applied to one band of rows at a time where the step looks no farther."""
    height, width = pair.shape
    right = found.right()
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
        part = DisparityMap(disparity.values[rows], disparity.status[rows])
        if prior is not None and isinstance(step, SpeckleFilter):
            part = _without_speckles(step, part, context, prior)
        else:
            part = step(part, context)
        inside = slice(y - rows.start, min(y + band, height) - rows.start)
        values[y : y + band], status[y : y + band] = part.values[inside], part.status[inside]
    return DisparityMap(values, status)


def _without_speckles(
    step: SpeckleFilter, disparity: DisparityMap, context: RefinementContext, prior: Prior
) -> DisparityMap:
    # Speckles are the same parts of the scene at every size, so they have more pixels here than at the smallest one.
    # Thin structures stay; what is removed has the value of the smaller image afterwards.
    mild = step(disparity, context)
    strict = step.model_copy(update={"size": step.size * 4 ** (prior.levels - 1)})(disparity, context)
    y, x = np.nonzero(mild.valid & ~strict.valid)
    low, high = prior.thin[:, y // 2, x // 2]
    stays = (mild.values[y, x] >= low) & (mild.values[y, x] <= high)
    y, x = y[stays], x[stays]
    strict.values[y, x], strict.status[y, x] = mild.values[y, x], mild.status[y, x]
    return strict


def _filled(disparity: DisparityMap, half: NDArray[np.float32]) -> DisparityMap:
    values = disparity.values.copy()
    doubled = np.float32(2) * half
    for dy in range(2):
        for dx in range(2):
            own = values[dy::2, dx::2]
            own[:] = np.where(np.isnan(own), doubled[: own.shape[0], : own.shape[1]], own)
    filled = np.where(~disparity.valid & ~np.isnan(values), np.uint8(Status.FILLED), np.uint8(0))
    return DisparityMap(values, disparity.status | filled)

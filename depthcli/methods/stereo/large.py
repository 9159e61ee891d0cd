"""Pairs whose costs do not fit into the memory that is allowed: matched tile by tile.

Where costs depend on the pixels around alone (no optimizer), tiles search the whole range and look as far around them
as the method does: the result has the same bytes as that of the whole pair. Otherwise the way is coarse to fine
(Rothermel, Wenzel, Fritsch and Haala, "SURE: photogrammetric surface reconstruction from imagery", 2012): the pair is
matched at half its size first, itself coarse to fine. What was found there says which disparities a tile searches and
which of them are likely, and it is the value of pixels that the two views do not agree on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from depthcli.core import memory
from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.result import Clock
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.kernels.winners import Gathered
from depthcli.methods.confidence import confidence_maps
from depthcli.methods.stereo.adjustment import Adjust, adjusted
from depthcli.methods.stereo.coarse import Prior, glimpses_of, halved
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.fixed_point import FixedPoint
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.optimization.winner_takes_all import WinnerTakesAll
from depthcli.methods.stereo.pipeline.local import Local
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.refinement.background_fill import BackgroundFill
from depthcli.methods.stereo.refinement.left_right_check import LeftRightCheck
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.refinement.subpixel import Subpixel
from depthcli.methods.stereo.tiles import Candidates, Margins, Tile
from depthcli.methods.stereo.volume import CostMinima, CostVolume, RefinementContext, StereoResult

PROCESS = 256 << 20
"""Memory of the interpreter and the libraries, bytes."""
_NARROW = 256  # ranges of fewer disparities are searched whole
_HALO = 32  # pixels after which the paths of a scanline that begins anew are what they would have been
_FAR_HALO = 64  # the same for methods of which nothing is known
_UNLIKELY = 0.2  # what the others cost more, in units of a scanline's penalty of a step
_ISLAND = 20  # pixels that must belong together to be a candidate at half the size
_BAND = 1 << 20  # pixels that are refined at a time
_SMALL = 128  # pixels; smaller images are not halved
_DEAR = 1e4  # cost between the spans of a float volume
_A_PIXEL, _MADE = 26, 48  # bytes a pixel while tiles are matched, and while the map is refined and written

_FINDER = Local(
    cost=Census(window=(7, 7)),
    optimization=Scanline(p1=25, p2=120, edge_threshold=15, edge_divisor=6),
    refinement=(LeftRightCheck(), SpeckleFilter(size=50), BackgroundFill()),
)


class Matcher(Protocol):
    """Anything that matches a pair and can say what memory it takes."""

    def __call__(self, pair: StereoPair, max_disparity: int, /) -> StereoResult:
        """Match over disparities 0 .. ``max_disparity`` inclusive."""

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate of the peak working memory, bytes."""


def match_in_tiles(matcher: Matcher, pair: StereoPair, max_disparity: int, allowed: int) -> StereoResult:
    """Match ``pair`` over disparities 0 .. ``max_disparity`` inclusive in a process of at most ``allowed`` bytes.

    Local pipelines give costs tile by tile; the right view's map, and every step that looks at maps alone, is that of
    the whole image. Any other method matches every tile for itself, over one range from its smallest to its largest
    candidate; pictures and tables that it would write are left out.

    Returns
    -------
    StereoResult
        ``figures`` has ``tiles``, their number, ``levels``, the number of sizes that were matched, and ``exact``:
        1 where the map is that of the whole pair, else 0.

    Raises
    ------
    InputError
        Not even the smallest tiles fit.
    """
    clock = Clock()
    what: Adjust = getattr(matcher, "adjust", ())
    held = 0
    if what and isinstance(matcher, BaseModel):
        given = pair
        pair = adjusted(given, max_disparity, what, clock)
        held = 0 if pair is given else given.right.nbytes + pair.shape[0] * pair.shape[1]  # the caller has it
        matcher = cast(Matcher, matcher.model_copy(update={"adjust": ()}))
    local = None
    if isinstance(matcher, Local) and not any(step.needs_costs for step in matcher.refinement):
        local = _halo(matcher)
        prior = _prior(matcher, pair, max_disparity, allowed - held, clock) if local is None else None
        margins = _margins(prior) if local is None else Margins(local, local, False)
        result = _level(matcher, pair, max_disparity, prior, margins, allowed, clock, held)[0]
    else:
        prior = _prior(_FINDER, pair, max_disparity, allowed - held, clock)
        result = _patched(matcher, pair, max_disparity, prior, allowed, clock, held)
    result.figures |= {"levels": 1.0 if prior is None else float(prior.levels), "exact": float(local is not None)}
    return result


def _halo(matcher: Local) -> int | None:
    """Pixels around a pixel that its costs depend on; None: the whole image."""
    if not isinstance(matcher.optimization, WinnerTakesAll):
        return None
    halos = [matcher.cost.halo(), 0 if matcher.aggregation is None else matcher.aggregation.halo()]
    known = [halo for halo in halos if halo is not None]
    return sum(known) if len(known) == len(halos) else None


def _prior(matcher: Local, pair: StereoPair, top: int, allowed: int, clock: Clock) -> Prior | None:
    """Of the pair at half its size; None where the range is narrow enough to be searched whole."""
    if top + 1 < _NARROW or min(pair.shape) < _SMALL:
        return None
    coarse, last = halved(pair), -(-top // 2)
    # Below this level the images of those above wait.
    left = allowed - pair.left.nbytes - pair.right.nbytes
    prior = _prior(matcher, coarse, last, left, Clock())
    result, gathered = _level(matcher, coarse, last, prior, _margins(prior), left, Clock())
    raw = DisparityMap(gathered.left.astype(np.float32), np.zeros(coarse.shape, np.uint8))
    seen = _refined(raw, (LeftRightCheck(), SpeckleFilter(size=_ISLAND)), gathered, coarse, last)
    levels = 1 + (1 if prior is None else prior.levels)
    made = Prior.of(result.disparity, seen.values, glimpses_of(pair, top), pair.shape, top, levels)
    clock.stop("coarse")
    return made


def _margins(prior: Prior | None) -> Margins:
    halo = _HALO if prior is None else _HALO // 2  # what is likely holds paths that begin anew
    return Margins(halo, halo // 2, False)


def _level(
    matcher: Local,
    pair: StereoPair,
    top: int,
    prior: Prior | None,
    margins: Margins,
    allowed: int,
    clock: Clock,
    held: int = 0,
) -> tuple[StereoResult, Gathered]:
    """One size: costs and winners by tile, then refinement of the whole map."""
    plan = _plan(matcher, pair, top, prior, margins, allowed, held)
    clock.stop("plan")
    gathered = Gathered(pair.shape, any(isinstance(step, Subpixel) for step in matcher.refinement))
    confidence: dict[str, NDArray[np.float32]] = {}
    for tile in plan:
        volume, spans = _tile_volume(matcher, pair, tile, prior, clock)
        volume = matcher.optimization(volume, tile.cut(pair))
        gathered.add(volume.costs, spans, (tile.around[0], tile.around[2]), tile.inside)
        clock.stop("optimization")
        for name, values in confidence_maps(volume.costs, matcher.confidence).items():
            confidence.setdefault(name, np.zeros(pair.shape, np.float32))[tile.place] = values[tile.inside]
        clock.stop("confidence")
        del volume
    memory.release()
    steps = matcher.refinement
    first = next((k for k, step in enumerate(steps) if step.fills), len(steps))
    disparity = DisparityMap(gathered.left.astype(np.float32), np.zeros(pair.shape, np.uint8))
    disparity = _refined(disparity, steps[:first], gathered, pair, top, prior)
    if prior is not None and first < len(steps):
        disparity = _filled(disparity, prior.values)
    disparity = _refined(disparity, steps[first:], gathered, pair, top)
    clock.stop("refinement")
    figures = {"tiles": float(len(plan.tiles))}
    return StereoResult(disparity, seconds=clock.seconds, confidence=confidence, figures=figures), gathered


@dataclass(frozen=True)
class _Plan:
    """Tiles that fit into ``free`` bytes each."""

    tiles: list[Tile]
    need: Callable[[Tile], int]
    free: int

    def __iter__(self) -> Iterator[Tile]:
        for tile in self.tiles:
            if memory.kept() + self.need(tile) > self.free:
                memory.release()  # blocks of other sizes, which the next tile cannot use
            yield tile


def _without_speckles(
    step: SpeckleFilter, disparity: DisparityMap, evidence: RefinementContext, prior: Prior
) -> DisparityMap:
    """Speckles are the same parts of the scene at every size, but for what was glimpsed: it may be thin.

    What is removed has the value of the smaller image then.
    """
    few = step(disparity, evidence)
    many = step.model_copy(update={"size": step.size * 4 ** (prior.levels - 1)})(disparity, evidence)
    y, x = np.nonzero(few.valid & ~many.valid)
    low, high = prior.glimpsed[:, y // 2, x // 2]
    stays = (few.values[y, x] >= low) & (few.values[y, x] <= high)
    y, x = y[stays], x[stays]
    many.values[y, x], many.status[y, x] = few.values[y, x], few.status[y, x]
    return many


def _plan(
    matcher: Matcher, pair: StereoPair, top: int, prior: Prior | None, margins: Margins, allowed: int, held: int
) -> _Plan:
    waiting = PROCESS + pair.left.nbytes + pair.right.nbytes + held
    pixels = pair.shape[0] * pair.shape[1]
    free = allowed - waiting - _A_PIXEL * pixels

    def need(tile: Tile) -> int:
        height, width = tile.shape
        recycled = 2 * height * width * tile.depth  # blocks that only the next tile can use
        if margins.whole or not isinstance(matcher, Local):
            return matcher.peak_bytes(tile.shape, tile.depth - 1) + recycled
        # Beside the volumes: features of the images, states of the paths.
        return matcher.volume_bytes(tile.shape, tile.depth - 1) + recycled + 40 * (height + tile.depth) * width

    candidates = Candidates.all(pair.shape, top) if prior is None else prior.candidates
    tiles = candidates.tiles(margins, lambda tile: need(tile) <= free)
    if tiles is None or waiting + _MADE * pixels > allowed:
        least = need(candidates.tile(0, 1, 0, 1, margins))
        least = waiting + max(_MADE * pixels, _A_PIXEL * pixels + least)
        raise InputError(
            f"needs at least {-(-least >> 20)} MiB of memory even in tiles, {allowed >> 20} MiB may be used"
        )
    return _Plan(tiles, need, free)


def _tile_volume(
    matcher: Local, pair: StereoPair, tile: Tile, prior: Prior | None, clock: Clock
) -> tuple[CostVolume, NDArray[np.int64]]:
    """Costs of all spans, one behind the other, with a cell between that no path goes through; and what lies where."""
    spans = np.zeros((len(tile.spans), 3), np.int64)
    joined: CostVolume | None = None
    start = 0
    for k, span in enumerate(tile.spans):
        spans[k] = start, span.count, span.low
        volume = matcher.volume(tile.cut(pair, span.low), span.count - 1, clock)
        beyond = max(0, span.low - tile.around[2])  # columns whose matches all lie outside the right image
        if joined is None and len(tile.spans) == 1 and beyond == 0:
            joined = volume
            break
        if joined is None:
            joined = CostVolume(memory.empty((*tile.shape, tile.depth), volume.costs.dtype), volume.scale)
        _place(volume.costs, joined.costs, start, beyond, volume.costs.dtype.type(_largest(volume)))
        start += span.count + 1
        del volume
        clock.stop("cost")
    assert joined is not None
    if prior is not None and isinstance(matcher.optimization, Scanline):
        penalty = max(1, round(_UNLIKELY * matcher.optimization.p1 * joined.scale))
        corner = (tile.around[0], tile.around[2])
        _discourage(joined.costs, spans, prior.low, prior.high, corner, penalty, _largest(joined))
        clock.stop("cost")
    return joined, spans


def _largest(volume: CostVolume) -> float:
    return {1: 255.0, 2: float(FixedPoint.LARGEST)}.get(volume.costs.itemsize, _DEAR)


@parallel_jit
def _place(costs: Any, joined: Any, start: int, beyond: int, dear: Any) -> None:
    # What the right image does not have costs what the measure says: the cell of pixel 0 at any disparity but 0.
    height, width, count = costs.shape
    outside = costs[0, 0, count - 1]
    for y in prange(height):
        for x in range(width):
            source, out = costs[y, x], joined[y, x, start : start + count]
            if x < beyond:
                out[:] = outside
            else:
                for i in range(out.size):
                    out[i] = source[i]
            if start + count < joined.shape[2]:
                joined[y, x, start + count] = dear


@parallel_jit
def _discourage(costs: Any, spans: Any, low: Any, high: Any, corner: Any, penalty: int, largest: Any) -> None:
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


def _patched(
    matcher: Matcher, pair: StereoPair, top: int, prior: Prior | None, allowed: int, clock: Clock, held: int
) -> StereoResult:
    """Every tile by itself."""
    plan = _plan(matcher, pair, top, prior, Margins(_FAR_HALO, _HALO // 2, True), allowed, held)
    clock.stop("plan")
    values, status = np.zeros(pair.shape, np.float32), np.zeros(pair.shape, np.uint8)
    confidence: dict[str, NDArray[np.float32]] = {}
    for tile in plan:
        (span,) = tile.spans
        part = matcher(tile.cut(pair, span.low), span.count - 1)
        values[tile.place] = part.disparity.values[tile.inside] + np.float32(span.low)
        status[tile.place] = part.disparity.status[tile.inside]
        for name, own in part.confidence.items():
            confidence.setdefault(name, np.zeros(pair.shape, np.float32))[tile.place] = own[tile.inside]
        clock.stop("tiles")
        del part
    memory.release()
    figures = {"tiles": float(len(plan.tiles))}
    return StereoResult(DisparityMap(values, status), seconds=clock.seconds, confidence=confidence, figures=figures)


def _filled(disparity: DisparityMap, coarse: NDArray[np.float32]) -> DisparityMap:
    """Empty pixels have the value of the map of half the size."""
    values = disparity.values.copy()
    doubled = np.float32(2) * coarse
    for dy in range(2):
        for dx in range(2):
            own = values[dy::2, dx::2]
            own[:] = np.where(np.isnan(own), doubled[: own.shape[0], : own.shape[1]], own)
    filled = np.where(~disparity.valid & ~np.isnan(values), np.uint8(Status.FILLED), np.uint8(0))
    return DisparityMap(values, disparity.status | filled)


def _refined(
    disparity: DisparityMap,
    steps: Sequence[Refinement],
    gathered: Gathered,
    pair: StereoPair,
    top: int,
    prior: Prior | None = None,
) -> DisparityMap:
    """The map after all ``steps``, in order, with the memory of a band of rows where a step looks no farther."""
    height, width = pair.shape
    right = gathered.right()
    for step in steps:
        halo = step.halo()
        band = height if halo is None else max(4 * halo, _BAND // width, 1)
        around = 0 if halo is None else halo
        values, status = np.empty_like(disparity.values), np.empty_like(disparity.status)
        for y in range(0, height, band):
            rows = slice(max(0, y - around), min(height, y + band + around))
            minima = gathered.minima[rows] if gathered.minima.size else gathered.left[rows].astype(np.float32)
            evidence = RefinementContext(
                StereoPair(pair.left[rows], pair.right[rows], pair.bits),
                CostMinima(gathered.left[rows], minima, top + 1),
                right[rows],
            )
            part = DisparityMap(disparity.values[rows], disparity.status[rows])
            if prior is not None and isinstance(step, SpeckleFilter):
                part = _without_speckles(step, part, evidence, prior)
            else:
                part = step(part, evidence)
            inside = slice(y - rows.start, min(y + band, height) - rows.start)
            values[y : y + band], status[y : y + band] = part.values[inside], part.status[inside]
        disparity = DisparityMap(values, status)
    return disparity

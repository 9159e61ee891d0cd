"""Disparity maps from any program: probability that each pixel is correct, hidden pixels, and fusion of several maps.

In: a pair and maps of its left view. Out: a :class:`MapJudgment` of the first map, with the others as witnesses; or one
map from :mod:`.fusion`. :func:`judge` computes the costs of the pair with the preset ``stereo fast`` (``Evidence``),
and then planes of features from the costs, the map's shape and the other maps (``_planes``). A small network converts
the planes to log odds (``algorithms.pixel_network``). A table (``algorithms.error_table``) converts log odds to a
probability and an error bound. It has a margin for new data, which counts in bounds but not in probabilities. Single
planes also serve as measures. ``scripts/train_confidence.py`` trains the network on tuning scenes, and
``scripts/train_bounds.py`` makes the table.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.error_table import ErrorTable
from depthcli.algorithms.pixel_network import TrainedNetwork, log_odds, of_first
from depthcli.core.context import Clock, Context
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.result import Result
from depthcli.methods.given_maps import _planes
from depthcli.methods.given_maps._planes import ALONE, INPUTS, ONE_VIEW, OTHERS, Evidence
from depthcli.methods.stereo.refinement.background_fill import fill_background

Plane = NDArray[np.float32]
THRESHOLDS = (0.5, 1.0, 2.0, 4.0)
"""Thresholds in pixels; the first layer of the network has a row of offsets for each."""
HIDDEN = "hidden"
"""Name of the offsets of the network for hidden pixels."""
RIGHT_NAMES = tuple(f"within {threshold:g}" for threshold in THRESHOLDS)
Filled = NDArray[np.bool_] | np.bool_
_NOWHERE = np.False_
FILLED_DOUBT = np.float32(0.75)
"""Reduction of the log odds of values that a program marks as filled (scripts/train_bounds.py)."""
GIVEN_DOUBT = np.float32(0.5)
"""Reduction of the log odds of maps of other programs, which may be smoothed or enlarged (scripts/train_bounds.py)."""
_MAX_DIFFERENCE = np.float32(16.0)  # largest difference between the views, pixels
_DISTINCT = 0.6  # a match of the pair is distinct if log(second smallest cost / smallest cost) exceeds this
# Share of the distinct matches that a map may contradict; reduction of the log odds of all its values per share above;
# largest reduction. Maps of stereo methods contradict fewer matches, maps of another scene more.
_CONTRADICTED, _DOUBT, _MOST_DOUBT = 0.45, 70.0, 16.0
# A map is rounded if this share of its values are multiples of a step. Only steps between levels that this many values
# have are tried, largest first; with fewer levels than that, only whole numbers.
_ON_STEPS, _PER_LEVEL, _MIN_LEVELS, _MAX_STEP = 0.95, 10, 5, 4.0
_NEAR = 0.02  # distance from a multiple, in steps
_N_LOOKED_AT = 100_000  # values of a map, for its step


class Networks(NamedTuple):
    """Networks for the log odds that a pixel is correct, that it is hidden, and that it is correct without right image.

    ``errors`` are those of maps of depthcli at the log odds of ``right``, and, with ``GIVEN_DOUBT``, of given maps at
    the log odds of ``right`` and ``one_view``.
    """

    right: TrainedNetwork
    hidden: TrainedNetwork
    one_view: TrainedNetwork
    errors: ErrorTable


@dataclass(frozen=True)
class Judged:
    """A map and its planes."""

    values: NDArray[np.float32]  # (H, W) float32 disparities without gaps, pixels
    missing: NDArray[np.bool_]  # (H, W) bool, where the map has no value
    # planes of the map itself, and of its relation to other maps, (F, H, W) float32
    alone: NDArray[np.float32]
    others: NDArray[np.float32]

    def plane(self, name: str) -> Plane:
        """Return one of the planes, (H, W)."""
        plane: Plane = self.alone[ALONE.index(name)] if name in ALONE else self.others[OTHERS.index(name)]
        return plane

    @property
    def has_others(self) -> bool:
        """Return whether it was compared with other maps; if not, the plane ``maps``, the log of their number, is 0."""
        return bool(self.plane("maps")[0, 0])


@dataclass(kw_only=True)
class MapJudgment(Result):
    """Probability, error bound and status of every pixel of a map.

    Attributes
    ----------
    probability : (H, W) float32 in [0, 1], calibrated: a share p of the pixels with p is correct; 0 if no value
    bound : (H, W) float32, pixels, with the requested coverage; NaN if the map has no value
    status : (H, W) uint8, bits of :class:`depthcli.core.maps.Status`: ``OCCLUDED``, hidden in the right view;
        ``OUT_OF_RANGE``, the match is outside the right image; ``MISMATCH``, visible and probably incorrect;
        ``NO_DATA``, the map has no value; 0, none of these
    """

    probability: NDArray[np.float32]
    bound: NDArray[np.float32]
    status: NDArray[np.uint8]


def _left_right(judged: Judged, evidence: Evidence, right: Plane | None) -> Plane:
    other = evidence.right.astype(np.float32) if right is None else right
    columns = np.rint(np.arange(judged.values.shape[1], dtype=np.float32) - judged.values).astype(np.int64)
    match = np.take_along_axis(other, columns.clip(0), axis=1)
    difference = np.where((columns < 0) | ~np.isfinite(match), _MAX_DIFFERENCE, np.abs(judged.values - match))
    return np.asarray(-np.minimum(difference, _MAX_DIFFERENCE), np.float32)


def _gradient(judged: Judged, evidence: Evidence, right: Plane | None) -> Plane:
    left, other = (cv2.Sobel(image, cv2.CV_32F, 1, 0) / 8 for image in evidence.grey)
    height, width = judged.values.shape
    rows = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], judged.values.shape)
    columns = np.arange(width, dtype=np.float32) - judged.values
    warped = cv2.remap(other, columns, np.ascontiguousarray(rows), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(-np.abs(left - warped), np.float32)


def _agreement(judged: Judged, evidence: Evidence, right: Plane | None) -> Plane:
    disagreeing = "disagreement_narrow" if judged.has_others else "other_reference_narrow"
    return np.asarray(1 - judged.plane(disagreeing), np.float32)


@dataclass(frozen=True)
class Measure:
    """A confidence measure: a plane, or a function of a map, its evidence and the right view's map."""

    about: str  # definition of the measure; larger values mean more confidence
    source: str | Callable[[Judged, Evidence, Plane | None], Plane]  # name of the plane, or the function
    sign: int = 1  # factor of the plane

    def of(self, judged: Judged, evidence: Evidence, right: Plane | None) -> Plane:
        """Return the measure of a map, (H, W); ``right`` is the right view's map from the same program."""
        if callable(self.source):
            return self.source(judged, evidence, right)
        return self.sign * judged.plane(self.source)


MEASURES = {
    "left_right": Measure(
        "-|difference from the map of the right view at the match|, pixels; without such a map, from that of the costs",
        _left_right,
    ),
    "census": Measure("-mean census difference over pixels of similar color, 1 from 30 of 48 on", "cost_narrow", -1),
    "zncc": Measure("-(1 - correlation of 7 x 7 pixels with the warped right image)", "decorrelation", -1),
    "gradient": Measure("-|difference of the gradients along the row|, grey levels", _gradient),
    "rank": Measure("-share of the disparities whose costs, with smoothness, are smaller", "rank", -1),
    "margin": Measure("log(smallest cost elsewhere / cost), with smoothness", "margin"),
    "smoothness": Measure("-standard deviation of the map in 11 x 11 pixels", "deviation_of_map_11", -1),
    "texture": Measure("standard deviation of 5 x 5 pixels of the left image, at most 40 levels", "deviation_5"),
    "discontinuity": Measure("distance to the next step of the map, at most 30 pixels", "edge_distance"),
    "border": Measure("distance to the border of the image, at most 20 pixels", "border_distance"),
    "agreement": Measure(
        "share of the witnesses that agree, over pixels of similar color; without any, agreement with stereo fast",
        _agreement,
    ),
}
"""Measures by name; a measure whose plane is in ``ONE_VIEW`` needs no right image."""


def judge(
    networks: Networks,
    pair: StereoPair,
    maps: Sequence[Plane],
    max_disparity: int,
    within: float = 1.0,
    measures: Iterable[str] = (),
    right: Plane | None = None,
    level: float = 0.9,
) -> MapJudgment:
    """Judge the first of the ``maps`` of a pair, (H, W) float32, pixels, NaN = no value; the others are witnesses.

    Costs are computed up to ``max_disparity``. A value is correct if its error is up to ``within`` pixels, 0.25 to 8.
    ``level`` is the coverage of the bound, 0.5 to 0.99. ``measures`` are names in ``MEASURES``. ``right`` is the right
    view's map from the same program, for ``left_right``. ValueError: there is no map, or a map does not have the size
    of the images.
    """
    clock = Clock()
    evidence = Evidence.of(pair, max_disparity, clock)
    clock.start("planes")
    judged = judged_maps(evidence, maps)[0]
    clock.start("network")
    probability, bound = promised_of(networks, judged, within, level)
    hidden = odds_hidden(networks, judged) > 0
    status = with_reasons(judged.values, judged.missing, probability, hidden)
    confidence = {name: _known(MEASURES[name].of(judged, evidence, right), judged.missing) for name in measures}
    seconds = clock.seconds
    return MapJudgment(seconds=seconds, confidence=confidence, probability=probability, bound=bound, status=status)


def bounds(
    networks: Networks,
    pair: StereoPair,
    values: Plane,
    filled: Filled,
    max_disparity: int,
    within: float = 1.0,
    level: float = 0.9,
    context: Context | None = None,
) -> tuple[Plane, Plane]:
    """Return probability and bound of a map of depthcli, faster than :func:`judge`, as nothing else is computed.

    ``filled`` values, (H, W) bool, are less certain than measured values.
    """
    judged = judged_maps(Evidence.of(pair, max_disparity, Clock(), context), [values])[0]
    return promised_of(networks, judged, within, level, filled, np.float32(0))


def judge_by_one_view(
    networks: Networks,
    left: Image,
    values: Plane,
    max_disparity: int,
    within: float = 1.0,
    measures: Iterable[str] = (),
    level: float = 0.9,
) -> MapJudgment:
    """Judge a map by its shape and the left image alone, which is far less evidence than a pair.

    No pixels are marked as hidden, and measures that need the right image are left out. ValueError: the map does not
    have the size of the image.
    """
    clock, network = Clock(), networks.one_view
    if values.shape != left.shape[:2]:
        raise ValueError(f"expected a map of the image's size {left.shape[:2]}, got {values.shape}")
    clock.start("planes")
    whole, missing = without_gaps(values, max_disparity)
    planes = _planes.one_view_planes(whole, StereoPair(left, left).grey8[0].astype(np.float32), max_disparity)
    clock.start("network")
    odds = odds_within(network, 1.0, planes, planes[:0]) - GIVEN_DOUBT
    probability, bound = promised(networks.errors, odds, values, missing, within, level)
    confidence = {}
    for name in measures:
        if (measure := MEASURES[name]).source in ONE_VIEW:
            confidence[name] = _known(measure.sign * planes[ONE_VIEW.index(measure.source)], missing)
    status = with_reasons(whole, missing, probability)
    seconds = clock.seconds
    return MapJudgment(seconds=seconds, confidence=confidence, probability=probability, bound=bound, status=status)


def peak_bytes(shape: tuple[int, int], max_disparity: int, count: int) -> int:
    """Estimate the peak working memory for ``count`` maps of (H, W) ``shape``, bytes."""
    # raw costs, two sums of paths, optimized costs; then images and planes
    per_pixel = 7 * (max_disparity + 1) + 400 + 4 * count * (len(INPUTS) + 4)
    return shape[0] * shape[1] * per_pixel + (64 << 20)


def judged_maps(evidence: Evidence, maps: Sequence[Plane], known: Sequence[Judged] = ()) -> list[Judged]:
    """Return ``known`` maps and further ``maps`` of a pair with their planes; planes of ``known`` ones are reused.

    Gaps are filled from the background. ValueError: there is no map, or a map does not have the size of the images.
    """
    shape, largest = evidence.pair.shape, evidence.volume.n_disparities - 1
    if not (maps or known) or any(one.shape != shape for one in maps):
        raise ValueError(f"expected maps of the images' size {shape}, got {[one.shape for one in maps]}")
    judged, shared = list(known), _planes.pixel_planes(evidence)
    for one in maps:
        whole, missing = without_gaps(one, largest)
        alone = _planes.alone_planes(whole, missing, evidence, shared)
        judged.append(Judged(whole, missing, alone, others=alone[:0]))
    values = np.stack([one.values for one in judged])
    others = _planes.other_planes(values, [one.alone for one in judged], evidence)
    return [replace(one, others=planes) for one, planes in zip(judged, others, strict=True)]


def without_gaps(values: Plane, max_disparity: int) -> tuple[Plane, NDArray[np.bool_]]:
    """Return a map (H, W) with its gaps filled from the background, and the mask of the gaps."""
    missing = ~np.isfinite(values)
    holed = DisparityMap(np.where(missing, np.float32(np.nan), values), np.zeros(values.shape, np.uint8))
    return np.nan_to_num(fill_background(holed).values).clip(0, max_disparity), missing


def odds_of(networks: Networks, judged: Judged, within: float) -> Plane:
    """Return the log odds (H, W) that the values of a map have errors up to ``within`` pixels."""
    if judged.has_others:
        return odds_within(networks.right, within, judged.alone, judged.others)
    return odds_within(of_first(networks.right, len(ALONE)), within, judged.alone, judged.others[:0])


def odds_hidden(networks: Networks, judged: Judged) -> Plane:
    """Return the log odds (H, W) that the pixels of a map are hidden in the right view."""
    offsets = networks.hidden.layers[0][1]  # (1, ...): a row for ``HIDDEN``
    return log_odds(networks.hidden, offsets[0], judged.alone, judged.others[:0])


def odds_within(network: TrainedNetwork, within: float, alone: Plane, others: Plane) -> Plane:
    """Return the log odds of an error up to ``within`` pixels, a non-decreasing function of ``within``.

    The network gives log odds at its trained thresholds, and halfway between them with the mean of their offsets. The
    result is interpolated over the logarithm of ``within``. The network's log odds may decrease as the threshold grows;
    therefore, from 1 px outwards, each threshold's log odds are bounded by the previous ones.
    """
    rows = network.layers[0][1]
    rows = np.insert(rows, range(1, len(rows)), (rows[1:] + rows[:-1]) / 2, axis=0)
    at = float(np.interp(np.log2(within), np.log2(THRESHOLDS), np.arange(0, len(rows), 2)))
    start = 2 * THRESHOLDS.index(1.0)
    step, bound, end = (1, np.maximum, math.ceil(at)) if at > start else (-1, np.minimum, math.floor(at))
    before = odds = log_odds(network, rows[start], alone, others)
    for k in range(start + step, end + step, step):
        before, odds = odds, bound(odds, log_odds(network, rows[k], alone, others))
    between: Plane = odds + np.float32(abs(end - at)) * (before - odds)
    return between.clip(np.minimum(before, odds), np.maximum(before, odds))


def promised_of(
    networks: Networks, judged: Judged, within: float, level: float, filled: Filled = _NOWHERE,
    given_doubt: np.float32 = GIVEN_DOUBT,
) -> tuple[Plane, Plane]:  # fmt: skip
    """Return probability and bound (H, W) of a judged map; ``filled`` values, (H, W) bool, are less certain."""
    odds = odds_of(networks, judged, 1.0) - doubt(judged) - FILLED_DOUBT * filled - given_doubt
    return promised(networks.errors, odds, judged.values, judged.missing, within, level)


def rounding_step(values: NDArray[np.float32]) -> float:
    """Return the step, pixels, to which the values of a map are rounded; NaN = no value. 0: they are not rounded.

    Some values may lie between the steps, such as filled ones. Steps far below a pixel may count as 0.
    """
    known = values[np.isfinite(values)]
    known = known[:: max(1, known.size // _N_LOOKED_AT)]
    levels, counts = np.unique(known.astype(np.float64), return_counts=True)
    frequent = levels[counts >= _PER_LEVEL]
    steps = (
        np.array([1.0])
        if frequent.size < _MIN_LEVELS
        else np.quantile(np.diff(frequent), (0.75, 0.5, 0.25), method="nearest")
    )
    for step in steps[steps <= _MAX_STEP]:
        places = levels / step
        if counts[np.abs(places - np.rint(places)) < _NEAR].sum() >= _ON_STEPS * max(known.size, 1):
            return float(step)
    return 0.0


def rounded(table: ErrorTable, step: float) -> ErrorTable:
    """Return the table of errors of values that are rounded to multiples of a step, pixels.

    Rounding adds errors that are uniform up to half a step; quantiles of both are added in quadrature.
    """
    if not step:
        return table
    return replace(table, log2_errors=np.log2(np.hypot(np.exp2(table.log2_errors), table.levels * (step / 2))))


def doubt(judged: Judged) -> np.float32:
    """Return the reduction of all log odds if the pair's own distinct matches contradict the map.

    Such a map probably belongs to another pair or has another scale, and its seemingly correct values are by chance.
    """
    distinct = (judged.plane("peak") > _DISTINCT) & ~judged.missing
    wrong = np.count_nonzero(distinct & (judged.plane("winner_difference") > 1))
    share = wrong / (np.count_nonzero(distinct) + 0.01 * distinct.size)  # a few matches are no evidence
    return np.float32(np.clip(_DOUBT * (share - _CONTRADICTED), 0, _MOST_DOUBT))


def promised(
    table: ErrorTable, odds: Plane, values: Plane, missing: NDArray[np.bool_], within: float, level: float
) -> tuple[Plane, Plane]:
    """Return probability and bound (H, W) of a map from its log odds of an error up to 1 pixel.

    Rounding counts in all maps: the table is of sub-pixel maps, and some methods of depthcli give whole pixels.
    """
    step = rounding_step(values[~missing])
    probability = np.where(missing, np.float32(0), rounded(table.unbiased, step).probability(odds, within))
    return probability, _known(rounded(table, step).bound(odds, level), missing)


def with_reasons(
    values: Plane, missing: NDArray[np.bool_], probability: Plane, hidden: NDArray[np.bool_] | None = None
) -> NDArray[np.uint8]:
    """Return the status (H, W) of a map without gaps; ``hidden`` are pixels hidden in the right view, None: unknown."""
    status = np.where(probability < 0.5, Status.MISMATCH, Status.MEASURED)
    if hidden is not None:
        outside = np.arange(values.shape[1], dtype=np.float32) - values < -0.5
        status = np.where(outside, Status.OUT_OF_RANGE, np.where(hidden, Status.OCCLUDED, status))
    return np.where(missing, Status.NO_DATA, status).astype(np.uint8)


def _known(plane: Plane, missing: NDArray[np.bool_]) -> Plane:
    return np.where(missing, np.float32(np.nan), plane).astype(np.float32)

"""Error bounds: their coverage, P(|error| <= bound), compared with their level, and their sharpness."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from depthcli.core.bound import Bound, DepthBound, VolumeBound
from depthcli.core.errors import ConfigError
from depthcli.core.yaml_source import parse_config
from depthcli.evaluation.curves import ConfidenceCurve, reliability
from depthcli.evaluation.map_files import PROBABILITY
from depthcli.evaluation.protocols import AnyProtocol, shown_pixels
from depthcli.evaluation.scores import ESTIMATED_ONLY, Key, Metric, Score, Tally, mean_of_scenes, percent

COVERAGE, WORST, COVERING = "bound coverage", "bound coverage, worst map", "bound coverage, maps"
"""Share of pixels inside the bound; smallest share of all maps; share of maps near or above the level."""
BAD = "bad of surest"
"""Share of incorrect pixels among the pixels with the smallest bounds, whose share is the threshold."""
_SUREST = (100, 90, 80, 50)  # percent of the pixels, smallest bounds first
_TOLERANCE = 10.0  # percentage points below the level from which on a map covers too little


def promised(text: str) -> Bound | None:
    """Return level and limit of a run from the key ``bound`` of its config, or None if there is no such key."""
    given = None
    with contextlib.suppress(ConfigError):
        given = parse_config(text, "").data.get("bound")
    for model in (Bound, DepthBound, VolumeBound) if given is not None else ():
        with contextlib.suppress(ValidationError):
            return model.model_validate(given)
    return None


def judged(
    protocol: AnyProtocol,
    estimate: Any,
    truth: Any,
    confidences: Mapping[str, NDArray[Any]],
    bound: NDArray[Any] | None,
    status: NDArray[np.uint8] | None,
    promise: Bound | None,
) -> tuple[list[ConfidenceCurve], list[Score], NDArray[np.bool_] | None]:
    """Return the curves of a map's confidences, the scores of its bound, and a mask of errors beyond the bound.

    A value without a bound exceeds it. Regions are the regions of the ground truth, and ``said NAME`` for each status
    of the map. The bound has a curve, too. For the confidence ``PROBABILITY``, a value is correct if its error is
    within the run's limit.

    Parameters
    ----------
    bound : array of the regions' shape, in the unit of the run's maps; None: the map has no bound
    promise : level and limit of the run; None: the default level, and the protocol's threshold
    """
    curves = protocol.curves(estimate, truth, {**confidences, **({} if bound is None else {"bound": -bound})})
    if bound is None and PROBABILITY not in confidences:
        return curves, [], None
    error, wrong, regions = protocol.bounded_error(estimate, truth), protocol.wrong(estimate, truth), {**truth.regions}
    within = protocol.map_unit * (protocol.within if promise is None else promise.within)
    for k, curve in enumerate(curves):
        if (curve.confidence, curve.of) == (PROBABILITY, "bad") and not math.isnan(within):
            region = regions[curve.region] & ~np.isnan(error)
            right = reliability(confidences[PROBABILITY][region], error[region] <= within)
            curves[k] = replace(curve, reliability=right)
    if bound is None:
        return curves, [], None
    if status is not None and status.shape == error.shape:
        rest = shown_pixels(protocol, truth)[0]
        for name, bits in protocol.status_groups.items():
            regions[f"said {name}"] = rest & ((status & bits) != 0) if bits else rest
            rest = rest & ~regions[f"said {name}"]
    bound, unit, scores = protocol.map_unit * bound.astype(np.float64), protocol.presentation.unit, list[Score]()
    level = (promise or Bound()).level
    for name, region in regions.items():
        scores += bound_scores(Tally(name, error[region]), bound[region], wrong[region], level, unit)
    return curves, scores, ~np.isnan(error) & ~(error <= bound)


def bound_scores(
    tally: Tally, bound: NDArray[np.floating[Any]], wrong: NDArray[np.bool_], level: float, unit: str
) -> list[Score]:
    """Return coverage, median, sharpness, and incorrect pixels among the most certain, of one region with values.

    Open bounds are left out of the coverage, which is NaN if all are open or the region is empty. The sharpness is the
    mean of the finite bounds over the smallest constant bound that covers as many of their pixels. If this constant is
    0, there is no sharpness.

    Parameters
    ----------
    bound : (N,) in the unit of the errors; NaN: there is none, so that nothing is covered; +inf: it is open
    wrong : (N,) bool, incorrect pixels by the headline's rule
    """
    valued = ~np.isnan(tally.error)
    error, bound, wrong = tally.valid, bound[valued], wrong[valued]
    if not error.size:
        return []
    finite, known, closed = np.isfinite(bound), bound[~np.isnan(bound)], ~np.isposinf(bound)
    n_closed, covered = int(np.count_nonzero(closed)), int(np.count_nonzero((error <= bound) & closed))
    promised = Metric(COVERAGE, "%", round(100 * level, 6), ESTIMATED_ONLY, larger_is_better=True)
    share, median, sharpness = (
        Metric(f"bound{name}", of, None, ESTIMATED_ONLY)
        for name, of in ((" finite", "%"), (" median", unit), (" / constant", ""))
    )
    coverage = replace(tally.number(promised, percent(covered, n_closed), n_closed), wrong=n_closed - covered)
    scores = [
        coverage if n_closed else replace(coverage, density=math.nan),
        tally.number(share, 100 * float(finite.mean()), error.size),
    ]
    if known.size:
        scores.append(tally.number(median, float(np.median(known)), known.size))
    limited, bounds = error[finite], bound[finite]
    inside = int(np.count_nonzero(limited <= bounds))
    constant = float(np.partition(limited, inside - 1)[inside - 1]) if inside else 0.0
    if constant > 0:
        scores.append(tally.number(sharpness, float(bounds.mean()) / constant, bounds.size))
    bound = np.where(np.isnan(bound), np.inf, bound)
    for surest in _SUREST:
        size = max(1, round(error.size * surest / 100))
        limit = np.partition(bound, size - 1)[size - 1]
        below = bound < limit  # of equal bounds, pixels count with their mean
        n_wrong = np.count_nonzero(wrong & below) + (size - np.count_nonzero(below)) * wrong[bound == limit].mean()
        metric = Metric(BAD, "%", float(surest), ESTIMATED_ONLY)
        scores.append(tally.number(metric, 100 * float(n_wrong) / size, size))
    return scores


def bound_means(maps: Sequence[Sequence[Score]]) -> list[Score]:
    """Return the means over the scores of several maps, all of one weight, with the worst coverage."""
    groups: dict[Key, list[Score]] = {}
    for score in itertools.chain(*maps):
        groups.setdefault(score.key, []).append(score)
    means, of_maps = [], []
    for (metric, _), scores in groups.items():
        mean = mean_of_scenes(scores, [1.0] * len(scores))
        means.append(mean)
        if metric.name == COVERAGE:
            values = [score.value for score in scores if not math.isnan(score.value)]
            enough = sum(value >= (metric.threshold or 0) - _TOLERANCE for value in values)
            covering = Metric(COVERING, "% of maps", metric.threshold, ESTIMATED_ONLY, larger_is_better=True)
            of_maps.append(replace(mean, metric=replace(metric, name=WORST), value=min(values, default=math.nan)))
            of_maps.append(replace(mean, metric=covering, value=percent(enough, len(values)), pixels=len(values)))
    return means + of_maps

"""The built-in confidence measures: a function of the curves for each, and its line in the documentation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit, run_bands, zeros
from depthcli.kernels.winners import left_right_difference
from depthcli.methods.confidence._curves import CostCurves, CurveStatistics

Map = NDArray[np.float32]
"""One value per curve, in the shape of the curves."""

_PEAK_RADIUS, _AGREEMENT_RADIUS, _MUTUAL_RADIUS = 2, 12, 6  # half the side of the windows, pixels


def _ratio(numerator: Callable[[CurveStatistics], Map], denominator: str) -> Callable[[CostCurves], Map]:
    def ratio(curves: CostCurves) -> Map:
        known = curves.statistics
        result: Map = numerator(known) * (np.float32(1) / (getattr(known, denominator) + known.eps))
        return result

    return ratio


def _average_peak_ratio(curves: CostCurves) -> Map:
    known = curves.statistics
    out = np.empty(known.winner.shape, np.float32)
    winners = known.winner, known.second_winner
    run_bands(
        _fill_peak_ratio, len(curves.costs), curves.costs, curves.valid, *winners, np.float32(known.eps),
        _PEAK_RADIUS, out,
    )  # fmt: skip
    return out


def _left_right_difference(curves: CostCurves) -> Map:
    known = curves.statistics
    left, right = curves.stereo_winners
    rows, partner = np.arange(left.shape[0])[:, None], np.arange(left.shape[1]) - left.astype(np.int64)
    best = right[rows, partner].astype(np.int64)
    cheapest = curves.costs[rows, partner + best, best].astype(np.float32)
    difference: Map = (known.second_lowest - known.lowest) / (known.lowest - cheapest + known.eps)
    return difference


def _agreement(curves: CostCurves, radius: int = _AGREEMENT_RADIUS) -> Map:
    winner = curves.statistics.winner
    out = np.empty(winner.shape, np.float32)
    run_bands(_fill_agreement, len(winner), winner, radius, out)
    return out


def _agreement_and_peak(curves: CostCurves) -> Map:
    winner = curves.statistics.winner
    mutual = np.empty(winner.shape, np.float32)
    run_bands(_fill_mutual_agreement, len(winner), winner, curves.stereo_winners[1], _MUTUAL_RADIUS, mutual)
    distinct = np.sqrt(np.maximum(1 - 1 / _average_peak_ratio(curves), 0))
    return (_agreement(curves, _MUTUAL_RADIUS) * mutual * distinct).astype(np.float32)


MEASURES: dict[str, tuple[str, Callable[[CostCurves], Map]]] = {
    "aml": (
        "Attainable maximum likelihood: 1 / sum of exp(-8 ((c - c1) / s)^2); 0 .. 1.",
        lambda curves: curves.statistics.attainable_likelihood,
    ),
    "apkr": (
        "Average peak ratio: mean of c(d2m) / c(d1) in 5 x 5 pixels, at the disparities of the center; > 0, 1 where "
        "there is no d2m.",
        _average_peak_ratio,
    ),
    "cur": (
        "Curvature at the minimum: c(d1 - 1) + c(d1 + 1) - 2 c1; >= 0, costs.",
        lambda curves: curves.statistics.curvature,
    ),
    "da": (
        "Disparity agreement: share of a 25 x 25 window whose d1 is within 1 pixel of the center's; 0 .. 1.",
        _agreement,
    ),
    "dap": (
        "Disparity agreement and peak: agreement in both views of a stereo volume times sqrt(1 - 1 / apkr), in windows "
        "of 13 x 13 pixels around the pixel and around its match; 0 .. 1.",
        _agreement_and_peak,
    ),
    "lrc": (
        "Left-right consistency: -abs(d1 - disparity of its match in the right view), of a stereo volume; <= 0, "
        "pixels.",
        lambda curves: -left_right_difference(*curves.stereo_winners),
    ),
    "lrd": (
        "Left-right difference: (c2 - c1) / (c1 - smallest cost of the right pixel), of a stereo volume; >= 0.",
        _left_right_difference,
    ),
    "mlm": (
        "Maximum likelihood: 1 / sum of exp(-2 (c - c1) / s); 0 .. 1.",
        lambda curves: curves.statistics.likelihood,
    ),
    "mm": (
        "Maximum margin: c2m - c1; >= 0, costs.",
        lambda curves: curves.statistics.second_minimum - curves.statistics.lowest,
    ),
    "mmn": (
        "Naive maximum margin: c2 - c1; >= 0, costs.",
        lambda curves: curves.statistics.second_lowest - curves.statistics.lowest,
    ),
    "msm": ("Matching score: -c1; <= 0, costs.", lambda curves: -curves.statistics.lowest),
    "nem": (
        "Negative entropy: sum of p log p for p = softmax(-4 c / s); -log D .. 0.",
        lambda curves: curves.statistics.negative_entropy,
    ),
    "noi": (
        "Number of inflections (Hu and Mordohai's name): -(number of local minima of the smoothed curve); <= -1.",
        lambda curves: -curves.statistics.n_minima,
    ),
    "pkr": ("Peak ratio: c2m / c1; >= 1.", _ratio(lambda s: s.second_minimum + s.eps, "lowest")),
    "pkrn": ("Naive peak ratio: c2 / c1; >= 1.", _ratio(lambda s: s.second_lowest + s.eps, "lowest")),
    "wmn": (
        "Winner margin: (c2m - c1) / sum of c; 0 .. 1.",
        _ratio(lambda s: s.second_minimum - s.lowest, "total"),
    ),
    "wmnn": (
        "Naive winner margin: (c2 - c1) / sum of c; 0 .. 1.",
        _ratio(lambda s: s.second_lowest - s.lowest, "total"),
    ),
}
"""Name -> (full name, formula and range for costs >= 0, with the symbols of the package's docstring; function)."""


@jit
def _fill_peak_ratio(begin, end, costs, valid, winner, second, eps, radius, out):
    height, width, _ = costs.shape
    for y in range(begin, end):
        for x in range(width):
            if second[y, x] < 0:
                out[y, x] = 1.0
                continue
            first, rival = winner[y, x], second[y, x]
            total = np.float32(0.0)
            count = 0
            for q in range(max(0, y - radius), min(height, y + radius + 1)):
                for p in range(max(0, x - radius), min(width, x + radius + 1)):
                    if first < valid[q, p] and rival < valid[q, p]:
                        total += (np.float32(costs[q, p, rival]) + eps) / (np.float32(costs[q, p, first]) + eps)
                        count += 1
            out[y, x] = total / np.float32(count)


@jit
def _fill_agreement(begin, end, winner, radius, out):
    # Write the share of the window around each pixel whose winner is within 1 of the pixel's winner.
    height, width = winner.shape
    for y in range(begin, end):
        top, bottom = max(0, y - radius), min(height, y + radius + 1)
        count = zeros(width, np.int32)
        for q in range(top, bottom):
            for dx in range(-radius, radius + 1):
                start, stop = max(0, -dx), min(width, width - dx)
                if stop <= start:
                    continue
                tally = count[start:stop]
                center = winner[y, start:stop]
                other = winner[q, start + dx : stop + dx]
                for i in range(tally.size):
                    tally[i] += np.int32(abs(other[i] - center[i]) <= 1)
        for x in range(width):
            columns = min(width, x + radius + 1) - max(0, x - radius)
            out[y, x] = np.float32(count[x]) / np.float32(columns * (bottom - top))


@jit
def _fill_mutual_agreement(begin, end, winner, right, radius, out):
    # Write the share of the window around the match, in the right view's map, that is within 1 of the disparity.
    height, width = winner.shape
    for y in range(begin, end):
        top, bottom = max(0, y - radius), min(height, y + radius + 1)
        for x in range(width):
            d = winner[y, x]
            left, stop = max(0, x - d - radius), min(width, x - d + radius + 1)
            count = np.int32(0)
            for q in range(top, bottom):
                row = right[q, left:stop]
                for i in range(row.size):
                    count += np.int32(abs(row[i] - d) <= 1)
            out[y, x] = np.float32(count) / np.float32((stop - left) * (bottom - top))

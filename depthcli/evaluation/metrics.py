"""Error measures of the stereo benchmarks, each by its own benchmark's conventions.

They differ in what counts as an error, and above all in what a missing value counts as. A
:class:`Score` therefore carries its mask, threshold, denominator, density and convention.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

V2_THRESHOLDS = (0.5, 0.75, 1.0, 1.5, 2.0)
V3_THRESHOLDS = (0.5, 1.0, 2.0, 4.0)
KITTI_THRESHOLDS = (2.0, 3.0, 4.0, 5.0)
QUANTILES = (50, 90, 95, 99)

MISSING_IS_BAD = "missing counts as bad"
ESTIMATED_ONLY = "estimated pixels only"
MISSING_APART = "missing counted apart (invalid)"
INTERPOLATED = "background-interpolated"

Disparity = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Score:
    """One number and what it stands on.

    Attributes
    ----------
    metric : ``bad``, ``D1``, ``avgerr`` ...
    mask : region the rate is taken in
    threshold : pixels, or None where the measure has none
    value : percent or pixels; NaN where there is no pixel to take it over
    unit : ``%`` or ``px``
    wrong : number of wrong pixels, or None where the measure counts none
    pixels : denominator
    density : percent of the region's pixels with known truth that the map answers
    convention : what a missing value counts as
    """

    metric: str
    mask: str
    threshold: float | None
    value: float
    unit: str
    wrong: int | None
    pixels: int
    density: float
    convention: str


def middlebury_v2(
    estimate: Disparity, truth: Disparity, masks: Mapping[str, Mask], thresholds: Iterable[float] = V2_THRESHOLDS
) -> list[Score]:
    """Bad-pixel rates of the Middlebury v2 evaluation.

    A pixel is bad if ``|d - d_true| > t`` or if it has no value (Scharstein & Szeliski, IJCV 2002,
    eq. 2; the online evaluation's rule for missing values). The average and root-mean-square errors
    beside them are over the estimated pixels.

    Parameters
    ----------
    estimate, truth : (H, W) float32, pixels, NaN = none
    masks : name -> (H, W) bool, True = evaluate
    thresholds : pixels
    """
    scores = []
    for name, region in _regions(masks, truth):
        error, density = _errors(estimate, truth, region)
        n = error.size
        valid = ~np.isnan(error)
        for t in thresholds:
            bad = int(np.count_nonzero(~(error <= t)))
            scores.append(Score("bad", name, t, _percent(bad, n), "%", bad, n, density, MISSING_IS_BAD))
        scores += _mean_errors(error[valid], name, density)
    return scores


def middlebury_v3(
    estimate: Disparity,
    truth: Disparity,
    masks: Mapping[str, Mask],
    max_disparity: float | None = None,
    round_disparity: bool = False,
    thresholds: Iterable[float] = V3_THRESHOLDS,
) -> list[Score]:
    """Measures of the Middlebury v3 and ETH3D evaluations, as the SDK's ``evaldisp`` takes them.

    Maps of half or quarter size are scaled up (see :func:`fit_size`); values are clipped to
    [0, max_disparity] at that size, and rounded where the truth is whole pixels. ``bad`` counts
    wrong values and ``invalid`` missing ones, both over all pixels; ``totbad`` is their sum.
    ``avgerr``, ``rms`` and the quantiles ``A50`` ... are over the valid ones; the quantile A_q is the
    smallest error that at least q percent of the valid pixels do not exceed.

    Parameters
    ----------
    estimate : (H, W), (H/2, W/2) or (H/4, W/4) float32, pixels of its own grid, NaN = none
    truth : (H, W) float32, pixels, NaN = unknown
    masks : name -> (H, W) bool, True = evaluate
    max_disparity : pixels of the truth's grid, or None for no upper limit
    round_disparity : round values to whole pixels first (the scene's ``isint``)

    Raises
    ------
    ValueError
        The size fits no factor.
    """
    estimate = np.maximum(fit_size(estimate, (truth.shape[0], truth.shape[1])), np.float32(0))
    if max_disparity is not None:
        estimate = np.minimum(estimate, np.float32(max_disparity))
    if round_disparity:
        estimate = np.floor(estimate + np.float32(0.5))
    scores = []
    for name, region in _regions(masks, truth):
        error, density = _errors(estimate, truth, region)
        n = error.size
        valid = error[~np.isnan(error)]
        invalid = n - valid.size
        for t in thresholds:
            bad = int(np.count_nonzero(valid > t))
            scores.append(Score("bad", name, t, _percent(bad, n), "%", bad, n, density, MISSING_APART))
            total = bad + invalid
            scores.append(Score("totbad", name, t, _percent(total, n), "%", total, n, density, MISSING_IS_BAD))
        scores.append(Score("invalid", name, None, _percent(invalid, n), "%", invalid, n, density, MISSING_APART))
        scores += _mean_errors(valid, name, density)
        ordered = np.sort(valid)
        for q in QUANTILES:
            value = float(ordered[max(0, -(-q * valid.size // 100) - 1)]) if valid.size else float("nan")
            scores.append(Score(f"A{q}", name, None, value, "px", None, valid.size, density, ESTIMATED_ONLY))
    return scores


def kitti(estimate: Disparity, truth: Disparity, masks: Mapping[str, Mask]) -> list[Score]:
    """Measures of KITTI 2012 and 2015, on the background-interpolated map and on the map as it is.

    ``D1``: ``|e| > 3 px and |e| / d_true > 5 %``; ``out``: ``|e| > t``. Interpolated: see
    :func:`interpolate_background`; a value still missing counts as bad. Estimated: over the pixels
    that the map answers.

    Parameters
    ----------
    estimate, truth : (H, W) float32, pixels, NaN = none
    masks : name -> (H, W) bool, True = evaluate (``noc``, ``occ``, also ``bg``, ``fg``)
    """
    filled = interpolate_background(estimate)
    scores = []
    for name, region in _regions(masks, truth):
        size = truth[region].astype(np.float64)
        as_is, density = _errors(estimate, truth, region)
        for error, convention in ((_errors(filled, truth, region)[0], INTERPOLATED), (as_is, ESTIMATED_ONLY)):
            if convention == ESTIMATED_ONLY:
                valid = ~np.isnan(error)
                error, size = error[valid], size[valid]
            n = error.size
            bad = int(np.count_nonzero(~((error <= 3) | (error <= 0.05 * size))))
            scores.append(Score("D1", name, 3.0, _percent(bad, n), "%", bad, n, density, convention))
            for t in KITTI_THRESHOLDS:
                bad = int(np.count_nonzero(~(error <= t)))
                scores.append(Score("out", name, t, _percent(bad, n), "%", bad, n, density, convention))
            scores += _mean_errors(error[~np.isnan(error)], name, density, convention)
    return scores


def wrong_pixels(estimate: Disparity, truth: Disparity, metric: str) -> Mask:
    """(H, W) bool: the estimate is there, the truth is known, and they disagree.

    ``kitti``: by the D1 rule; otherwise by more than 1 px.
    """
    with np.errstate(invalid="ignore"):
        error = np.abs(estimate.astype(np.float64) - truth)
        wrong: Mask = error > 1
        if metric == "kitti":
            wrong = (error > 3) & (error > 0.05 * truth.astype(np.float64))
    return wrong


def fit_size(estimate: Disparity, shape: tuple[int, int]) -> Disparity:
    """Bring a map of half or quarter size to the truth's size, as Middlebury's ``evaldisp`` does.

    Nearest neighbour, values multiplied by the factor. A map of the right size is returned as is.

    Raises
    ------
    ValueError
        ``shape`` is not 1, 2 or 4 times the map's size (up to the odd pixel).
    """
    for factor in (1, 2, 4):
        fits = [full // factor <= size <= -(-full // factor) for size, full in zip(estimate.shape, shape, strict=True)]
        if all(fits):
            if factor == 1:
                return estimate
            rows = np.minimum(np.arange(shape[0]) // factor, estimate.shape[0] - 1)
            cols = np.minimum(np.arange(shape[1]) // factor, estimate.shape[1] - 1)
            with np.errstate(over="ignore"):
                return estimate[np.ix_(rows, cols)] * np.float32(factor)
    raise ValueError(
        f"the map is {estimate.shape[1]} x {estimate.shape[0]}, the truth {shape[1]} x {shape[0]} "
        "(the same, half or quarter size can be evaluated)"
    )


def interpolate_background(disparity: Disparity) -> Disparity:
    """Fill missing values as the KITTI development kit does before it takes D1.

    Along rows, a run between two values gets the smaller of them; then the first and last value of a
    row are extended to its borders; then the first and last filled row of a column to top and bottom.
    Only a row without any value that lies between others stays empty.

    Parameters
    ----------
    disparity : (H, W) float32, NaN = none
    """
    known = ~np.isnan(disparity)
    width = disparity.shape[1]
    column = np.arange(width)
    left = np.maximum.accumulate(np.where(known, column, -1), axis=1)
    right = np.minimum.accumulate(np.where(known, column, width)[:, ::-1], axis=1)[:, ::-1]
    from_left = np.take_along_axis(disparity, np.maximum(left, 0), axis=1)
    from_right = np.take_along_axis(disparity, np.minimum(right, width - 1), axis=1)
    filled = np.fmin(np.where(left >= 0, from_left, np.nan), np.where(right < width, from_right, np.nan))
    rows = np.flatnonzero(~np.isnan(filled[:, 0]))
    if rows.size:
        filled[: rows[0]] = filled[rows[0]]
        filled[rows[-1] + 1 :] = filled[rows[-1]]
    return filled.astype(np.float32)


_HINTS = {
    256.0: "KITTI codes read as pixels?",
    16.0: "OpenCV's fixed-point disparities, or Middlebury codes?",
    64.0: "fixed-point codes read as pixels?",
    2.0: "a map of twice the size?",
    0.5: "computed at half size?",
    0.25: "computed at quarter size?",
}


def scale_warning(estimate: Disparity, truth: Disparity) -> str | None:
    """Say so where the estimate looks like the truth in another unit, the most frequent mistake.

    Looks at the ratio estimate / truth: a warning needs half of the pixels within 8 % of one of the usual
    factors (16, 4, 256, 1/2 ...; -1 for a swapped sign).

    Parameters
    ----------
    estimate, truth : (H, W) float32, pixels, NaN = none
    """
    with np.errstate(invalid="ignore"):
        both = ~np.isnan(estimate) & (truth > 0.5)
    if np.count_nonzero(both) < 50:
        return None
    ratio = estimate[both].astype(np.float64) / truth[both]
    middle = float(np.median(ratio))
    factors = [float(f) for f in (2, 3, 4, 8, 16, 32, 64, 128, 256)]
    for factor in [-1.0, *factors, *(1 / f for f in factors)]:
        near = np.abs(ratio / factor - 1) < 0.08
        if abs(middle / factor - 1) < 0.08 and np.mean(near) >= 0.5:
            if factor == -1:
                return "the values are about -1 times the truth: the sign is swapped"
            said = f"{factor:g}" if factor >= 1 else f"1/{1 / factor:g}"
            hint = _HINTS.get(factor, "")
            return (
                f"the values are about {said} times the truth (median ratio {middle:.3g}): "
                f"a wrong scale?{' ' + hint if hint else ''}"
            )
    return None


def _regions(masks: Mapping[str, Mask], truth: Disparity) -> list[tuple[str, Mask]]:
    known = ~np.isnan(truth)
    return [(name, mask & known) for name, mask in masks.items()]


def _errors(estimate: Disparity, truth: Disparity, region: Mask) -> tuple[NDArray[np.float64], float]:
    """Absolute errors of the region's pixels (NaN: no value) and the density in percent."""
    error = np.abs(estimate[region].astype(np.float64) - truth[region])
    return error, _percent(int(np.count_nonzero(~np.isnan(error))), error.size)


def _mean_errors(
    valid: NDArray[np.float64], mask: str, density: float, convention: str = ESTIMATED_ONLY
) -> list[Score]:
    n = valid.size
    mean = float(valid.mean()) if n else float("nan")
    rms = float(np.sqrt(np.mean(valid * valid))) if n else float("nan")
    return [
        Score("avgerr", mask, None, mean, "px", None, n, density, convention),
        Score("rms", mask, None, rms, "px", None, n, density, convention),
    ]


def _percent(part: int, whole: int) -> float:
    return 100.0 * part / whole if whole else float("nan")

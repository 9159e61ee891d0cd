"""How good a confidence is: sparsification curves, and whether probabilities and masks of hidden pixels are right.

A sparsification curve is the error of the most confident pixels against their share.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import Status

PERCENTAGES = (5, *range(10, 101, 5))
"""Shares of the most confident pixels at which curves are drawn."""


@dataclass(frozen=True)
class Sparsification:
    """A sparsification curve and its areas; the errors are error rates in [0, 1], or lengths.

    Areas are integrals over the whole range of shares, (0, 1], of the exact curve, so that a perfect ranking
    has exactly the optimal one. For error rates that is e + (1 - e) ln(1 - e) (Hu & Mordohai, PAMI 2012). Beside
    them the trapezoid over the shares of ``PERCENTAGES`` alone, the figure of LAF-Net's program and of the survey of
    Poggi et al. (PAMI 2021): compare it only with an optimum that was computed the same way.

    Attributes
    ----------
    percentages : shares of the most confident pixels, percent
    errors, best : mean error among them, and that of the best possible ranking
    mean : mean error of all pixels, which is the area of a random ranking
    auc, optimal : areas of ``errors`` and ``best``
    auc_5_100, optimal_5_100 : areas by the trapezoid from 5 to 100 %
    pixels : number of pixels
    """

    percentages: tuple[int, ...]
    errors: tuple[float, ...]
    best: tuple[float, ...]
    mean: float
    auc: float
    optimal: float
    auc_5_100: float
    optimal_5_100: float
    pixels: int

    @property
    def ratio(self) -> float:
        """AUC / optimal: 1 for a perfect ranking; NaN without errors."""
        return self.auc / self.optimal if self.optimal > 0 else math.nan

    @property
    def ause(self) -> float:
        """Area between the curve and the optimal one (Ilg et al., ECCV 2018): 0 is perfect."""
        return self.auc - self.optimal

    @property
    def aurg(self) -> float:
        """Area between the curve and that of a random ranking (Poggi et al., CVPR 2020): more is better."""
        return self.mean - self.auc

    def areas(self) -> dict[str, float]:
        """Return all areas by name."""
        names = ("auc", "optimal", "mean", "ratio", "ause", "aurg", "auc_5_100", "optimal_5_100")
        return {name: getattr(self, name) for name in names}


def sparsification(confidence: NDArray[Any], error: NDArray[Any]) -> Sparsification:
    """Compute the sparsification curve of one confidence measure; see :func:`sparsifications`."""
    return sparsifications({"": confidence}, {"": error})["", ""]


def sparsifications(
    confidences: Mapping[str, NDArray[Any]], errors: Mapping[str, NDArray[Any]]
) -> dict[tuple[str, str], Sparsification]:
    """Compute the sparsification curves of confidence measures, each for every kind of error.

    Pixels of equal confidence have no order among themselves: a share that ends inside such a group gets the
    group's mean error for its part, so the curve does not depend on the order of the pixels.

    Parameters
    ----------
    confidences : (N,) higher is more confident, +inf the most; NaN less confident than any number
    errors : (N,) bool, wrong or right; or float, absolute errors

    Raises
    ------
    ValueError
        The lengths differ, or there is no pixel.
    """
    shapes = {array.shape for array in (*confidences.values(), *errors.values())}
    if any(len(shape) != 1 or not shape[0] for shape in shapes) or len(shapes) > 1:
        raise ValueError(f"want (N,) arrays of one length N > 0, got {sorted(shapes)}")
    amounts = {name: error.astype(np.float64) for name, error in errors.items()}
    best = {name: _curve(_groups(-amount), amount) for name, amount in amounts.items()}
    made = {}
    for confidence, values in confidences.items():
        groups = _groups(values)
        for name, amount in amounts.items():
            (curve, auc), (lowest, optimal) = _curve(groups, amount), best[name]
            made[confidence, name] = Sparsification(
                percentages=PERCENTAGES,
                errors=tuple(curve.tolist()),
                best=tuple(lowest.tolist()),
                mean=float(amount.mean()),
                auc=auc,
                optimal=optimal,
                auc_5_100=float(np.trapezoid(curve, dx=0.05)),
                optimal_5_100=float(np.trapezoid(lowest, dx=0.05)),
                pixels=int(amount.size),
            )
    return made


def _groups(confidence: NDArray[Any]) -> NDArray[np.intp]:
    """Number of every pixel's group of equal confidence, the most confident first."""
    # numpy sorts NaN behind everything and takes all of them for one value.
    return np.unique(-confidence.astype(np.float64), return_inverse=True)[1]


def _curve(group: NDArray[np.intp], error: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Mean error at ``PERCENTAGES``, and its integral over all shares in (0, 1]."""
    n = error.size
    share = np.append(0, np.cumsum(np.bincount(group))) / n
    total = np.append(0.0, np.cumsum(np.bincount(group, weights=error))) / n
    at = np.array(PERCENTAGES) / 100
    # Within a group the total is a + b p, so that the mean error is a / p + b (and a = 0 in the first).
    slope = np.diff(total) / np.diff(share)
    offset = total[:-1] - slope * share[:-1]
    area = total[-1] + float(np.sum(offset[1:] * np.log(share[2:] / share[1:-1])))
    return np.interp(at, share, total) / at, float(area)


N_BINS = 20
"""Number of equally wide bins that probabilities are put into."""


@dataclass(frozen=True)
class Reliability:
    """How often pixels of a confidence are right.

    Attributes
    ----------
    pixels : number of pixels in every bin of confidences, 0 .. 1 in steps of 1 / ``N_BINS``
    confidence : mean confidence of every bin; NaN where it is empty
    right : share of right pixels of every bin; NaN where it is empty
    """

    pixels: tuple[int, ...]
    confidence: tuple[float, ...]
    right: tuple[float, ...]

    @property
    def ece(self) -> float:
        """Expected calibration error: mean over the pixels of |confidence - share right| of their bins, 0 .. 1."""
        total = sum(self.pixels)
        if not total:
            return math.nan
        parts = zip(self.pixels, self.confidence, self.right, strict=True)
        return math.fsum(n * abs(c - r) for n, c, r in parts if n) / total

    @classmethod
    def pooled(cls, parts: Iterable[Reliability]) -> Reliability:
        """Return the reliability of the pixels of all parts together."""
        parts = list(parts)
        counts = np.array([part.pixels for part in parts], np.int64)
        sums = (
            np.nansum(counts * np.array([getattr(part, name) for part in parts]), axis=0)
            for name in ("confidence", "right")
        )
        return _of_sums(counts.sum(axis=0), *sums)


@dataclass(frozen=True)
class ConfidenceCurve:
    """The sparsification curve of one confidence measure in one region.

    Attributes
    ----------
    region, confidence : names of the region and of the confidence measure
    of : what falls along the curve: ``bad``, the share of wrong pixels, or ``error``, the mean absolute error
    line : the sparsification curve with its areas
    reliability : of ``bad``, how often pixels of a confidence are right; None where it is no probability
    """

    region: str
    confidence: str
    of: str
    line: Sparsification
    reliability: Reliability | None = None

    @property
    def areas(self) -> dict[str, float]:
        """All areas by name, and the expected calibration error ``ece``."""
        return {**self.line.areas(), "ece": math.nan if self.reliability is None else self.reliability.ece}


def reliability(confidence: NDArray[Any], right: NDArray[np.bool_]) -> Reliability | None:
    """Compute how often pixels are right, by their confidence.

    Parameters
    ----------
    confidence : (N,) any float
    right : (N,) bool

    Returns
    -------
    None where the confidences are no probabilities: not all within 0 .. 1, or there is no pixel.

    Raises
    ------
    ValueError
        The lengths differ.
    """
    if confidence.shape != right.shape or confidence.ndim != 1:
        raise ValueError(f"want (N,) arrays of one length, got {confidence.shape} and {right.shape}")
    values = confidence.astype(np.float64)
    if not values.size or not ((values >= 0) & (values <= 1)).all():  # NaN is not, either
        return None
    bins = np.minimum((values * N_BINS).astype(np.int64), N_BINS - 1)
    counts = np.bincount(bins, minlength=N_BINS)
    return _of_sums(counts, np.bincount(bins, values, N_BINS), np.bincount(bins, right, N_BINS))


def _of_sums(counts: NDArray[np.int64], confidence: NDArray[Any], right: NDArray[Any]) -> Reliability:
    with np.errstate(invalid="ignore"):
        mean_confidence, share_right = confidence / counts, right / counts
    return Reliability(tuple(counts.tolist()), tuple(mean_confidence.tolist()), tuple(share_right.tolist()))


@dataclass(frozen=True)
class HiddenPixels:
    """How well a map's status says what the right view does not see; numbers of pixels with known truth.

    Attributes
    ----------
    both : said to be hidden, and hidden in truth
    said : said to be hidden
    true : hidden in truth
    pixels : all
    """

    both: int
    said: int
    true: int
    pixels: int

    @classmethod
    def of(cls, said: NDArray[np.bool_], true: NDArray[np.bool_]) -> HiddenPixels:
        """Count pixels (N,)."""
        both, n_said, n_true = (int(np.count_nonzero(pixels)) for pixels in (said & true, said, true))
        return cls(both, n_said, n_true, said.size)

    @classmethod
    def pooled(cls, parts: Iterable[HiddenPixels]) -> HiddenPixels:
        """Return the numbers of all parts together."""
        return cls(*(sum(each) for each in zip(*((p.both, p.said, p.true, p.pixels) for p in parts), strict=True)))

    def shares(self) -> dict[str, float]:
        """Return precision, recall and F1, and the shares of pixels said to be hidden and hidden, percent."""

        def share(part: float, whole: int) -> float:
            return 100 * part / whole if whole else math.nan

        return {
            "precision": share(self.both, self.said),
            "recall": share(self.both, self.true),
            "F1": share(2 * self.both, self.said + self.true),
            "said": share(self.said, self.pixels),
            "true": share(self.true, self.pixels),
        }


def hidden_pixels(status: NDArray[np.uint8], regions: Mapping[str, NDArray[np.bool_]]) -> HiddenPixels | None:
    """Compare what a status map says about what the right view does not see with the truth: ``all`` less ``nonocc``.

    None if that is not known, nothing is hidden, or the status has another size.
    """
    if not {"all", "nonocc"} <= set(regions) or status.shape != regions["all"].shape:
        return None
    known, hidden = regions["all"], regions["all"] & ~regions["nonocc"]
    if not hidden.any():
        return None
    said = (status & int(Status.OCCLUDED | Status.OUT_OF_RANGE)) != 0
    return HiddenPixels.of(said[known], hidden[known])

"""Quality of confidences: sparsification curves, calibration of probabilities, and scores of masks of hidden pixels.

A sparsification curve is the error of the most confident pixels against their share.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import Status

PERCENTAGES = (5, *range(10, 101, 5))
"""Shares of the most confident pixels at which curves are drawn."""

N_BINS = 20
"""Number of equally wide bins that probabilities are put into."""


@dataclass(frozen=True)
class Sparsification:
    """A sparsification curve and its areas; the errors are error rates in [0, 1], or lengths.

    Areas are integrals over the whole range of shares, (0, 1], of the exact curve, so that a perfect ranking has
    exactly the optimal one. For error rates that is e + (1 - e) ln(1 - e) (Hu & Mordohai, PAMI 2012). The trapezoid
    over the shares of ``PERCENTAGES`` is given, too: the program of LAF-Net and the survey of Poggi et al. (PAMI 2021)
    use it. Compare it only with an optimum that was computed in the same way.
    """

    percentages: tuple[int, ...]
    errors: tuple[float, ...]  # mean error among these shares of the pixels
    best: tuple[float, ...]  # of the best possible ranking
    mean: float  # error of all pixels, which is the area of a random ranking
    auc: float  # area of ``errors``
    optimal: float  # area of ``best``
    auc_5_100: float  # the areas by the trapezoid from 5 to 100 %
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
        """Area between the curve and the curve of a random ranking (Poggi et al., CVPR 2020): more is better."""
        return self.mean - self.auc


def sparsification(confidence: NDArray[Any], error: NDArray[Any]) -> Sparsification:
    """Compute the sparsification curve of one confidence measure; see :func:`sparsifications`."""
    return sparsifications({"": confidence}, {"": error})["", ""]


def sparsifications(
    confidences: Mapping[str, NDArray[Any]], errors: Mapping[str, NDArray[Any]]
) -> dict[tuple[str, str], Sparsification]:
    """Compute the sparsification curves of confidence measures, each for every kind of error.

    Pixels of equal confidence have no order among themselves: a share that ends inside such a group gets the
    group's mean error for its part, so the curve does not depend on the order of the pixels. ValueError if the lengths
    differ, or there is no pixel.

    Parameters
    ----------
    confidences : (N,) higher is more confident, +inf the most; NaN less confident than any number
    errors : (N,) bool, True = incorrect; or float, absolute errors
    """
    shapes = {array.shape for array in (*confidences.values(), *errors.values())}
    if any(len(shape) != 1 or not shape[0] for shape in shapes) or len(shapes) > 1:
        raise ValueError(f"expected (N,) arrays of one length N > 0, got {sorted(shapes)}")
    amounts = {name: error.astype(np.float64) for name, error in errors.items()}
    best = {name: _curve(_groups(-amount), amount) for name, amount in amounts.items()}
    curves = {}
    for confidence, values in confidences.items():
        groups = _groups(values)
        for name, amount in amounts.items():
            (curve, auc), (lowest, optimal) = _curve(groups, amount), best[name]
            curves[confidence, name] = Sparsification(
                PERCENTAGES,
                errors=tuple(curve.tolist()),
                best=tuple(lowest.tolist()),
                mean=float(amount.mean()),
                auc=auc,
                optimal=optimal,
                auc_5_100=float(np.trapezoid(curve, dx=0.05)),
                optimal_5_100=float(np.trapezoid(lowest, dx=0.05)),
                pixels=int(amount.size),
            )
    return curves


def _groups(confidence: NDArray[Any]) -> NDArray[np.intp]:
    """Return the number of every pixel's group of equal confidence, the most confident first."""
    # numpy sorts NaN behind everything and takes all of them for one value.
    return np.unique(-confidence.astype(np.float64), return_inverse=True)[1]


def _curve(group: NDArray[np.intp], error: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return the mean error at ``PERCENTAGES``, and its integral over all shares in (0, 1]."""
    n = error.size
    share = np.append(0, np.cumsum(np.bincount(group))) / n
    total = np.append(0.0, np.cumsum(np.bincount(group, weights=error))) / n
    at = np.array(PERCENTAGES) / 100
    # Within a group the total is a + b p, so that the mean error is a / p + b (and a = 0 in the first).
    slope = np.diff(total) / np.diff(share)
    offset = total[:-1] - slope * share[:-1]
    area = total[-1] + float(np.sum(offset[1:] * np.log(share[2:] / share[1:-1])))
    return np.interp(at, share, total) / at, float(area)


@dataclass(frozen=True)
class Reliability:
    """The share of correct pixels in ``N_BINS`` bins of confidences from 0 to 1."""

    pixels: tuple[int, ...]
    confidence: tuple[float, ...]  # mean of every bin; NaN where it is empty
    right: tuple[float, ...]  # share of right pixels of every bin; NaN where it is empty

    @property
    def ece(self) -> float:
        """Expected calibration error: mean over pixels of |confidence - share correct| of their bins, 0 .. 1."""
        parts = zip(self.pixels, self.confidence, self.right, strict=True)
        return math.fsum(n * abs(c - r) for n, c, r in parts if n) / sum(self.pixels)

    @classmethod
    def of_sums(cls, counts: NDArray[np.int64], confidence: NDArray[Any], right: NDArray[Any]) -> Reliability:
        """Return the reliability from each bin's pixels, sum of confidences and correct pixels, (N_BINS,) each."""
        with np.errstate(invalid="ignore"):
            means = (tuple((total / counts).tolist()) for total in (confidence, right))
            return cls(tuple(counts.tolist()), *means)

    @classmethod
    def pooled(cls, parts: Iterable[Reliability]) -> Reliability:
        """Return the reliability of the pixels of all parts together."""
        counts, *means = map(np.array, zip(*((p.pixels, p.confidence, p.right) for p in parts), strict=True))
        return cls.of_sums(counts.sum(axis=0), *(np.nansum(counts * mean, axis=0) for mean in means))


def is_probability(name: str) -> bool:
    """Return whether the name of a confidence map means the probability of being correct.

    The name is ``confidence``, of ``confidence.pfm``, or has the word ``probability``. Other measures are no
    probabilities, even if their values are within 0 .. 1.
    """
    return name == "confidence" or "probability" in name.split("_")


def reliability(confidence: NDArray[Any], right: NDArray[np.bool_]) -> Reliability | None:
    """Compute the reliability of confidences, (N,) float, of pixels that are correct or not, (N,) bool.

    Return None if there is no pixel, or if the confidences are no probabilities: not all are within 0 .. 1.
    """
    values = confidence.astype(np.float64)
    if not values.size or not ((values >= 0) & (values <= 1)).all():  # NaN is not, either
        return None
    bins = np.minimum((values * N_BINS).astype(np.int64), N_BINS - 1)
    return Reliability.of_sums(*(np.bincount(bins, weights, N_BINS) for weights in (None, values, right)))


@dataclass(frozen=True)
class ConfidenceCurve:
    """The sparsification curve of one confidence measure in one region."""

    region: str
    confidence: str
    of: str  # ``bad``, the share of incorrect pixels, or ``error``, the mean absolute error
    line: Sparsification
    reliability: Reliability | None = None  # of ``bad``; None where the confidence is no probability

    @property
    def areas(self) -> dict[str, float]:
        """All areas by name, and the expected calibration error ``ece``."""
        names = ("auc", "optimal", "mean", "ratio", "ause", "aurg", "auc_5_100", "optimal_5_100")
        ece = math.nan if self.reliability is None else self.reliability.ece
        return {**{name: getattr(self.line, name) for name in names}, "ece": ece}


class HiddenPixels(NamedTuple):
    """Counts of pixels that a map marks as hidden from the right view, compared with the ground truth."""

    both: int  # marked as hidden, and hidden in truth
    marked: int
    true: int
    pixels: int

    @classmethod
    def pooled(cls, parts: Iterable[HiddenPixels]) -> HiddenPixels:
        """Return the numbers of all parts together."""
        return cls(*map(sum, zip(*parts, strict=True)))

    def shares(self) -> dict[str, float]:
        """Return precision, recall, F1, and the shares of marked and of truly hidden pixels, percent."""
        parts = {"precision": (self.both, self.marked), "recall": (self.both, self.true),
                 "F1": (2 * self.both, self.marked + self.true), "said": (self.marked, self.pixels),
                 "true": (self.true, self.pixels)}  # fmt: skip
        return {name: 100 * part / whole if whole else math.nan for name, (part, whole) in parts.items()}


def hidden_pixels(status: NDArray[np.uint8], regions: Mapping[str, NDArray[np.bool_]]) -> HiddenPixels | None:
    """Compare the pixels that a status map marks as hidden with the pixels of ``all`` outside ``nonocc``.

    Return None if the truth is unknown, no pixel is hidden, or the status has another size.
    """
    if not {"all", "nonocc"} <= set(regions) or status.shape != regions["all"].shape:
        return None
    known, hidden = regions["all"], regions["all"] & ~regions["nonocc"]
    if not hidden.any():
        return None
    marked = ((status & int(Status.OCCLUDED | Status.OUT_OF_RANGE)) != 0) & known
    both = int(np.sum(marked & hidden))
    return HiddenPixels(both, int(np.sum(marked)), int(np.sum(hidden)), int(np.sum(known)))

"""Whether probabilities are calibrated, and whether masks of hidden pixels are right."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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

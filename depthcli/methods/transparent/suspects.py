"""Where the sensor is not to be believed: it says something else than stereo, over a region that color bounds."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from depthcli.algorithms.graph_cut import STEPS, edge_ends, grid_cut
from depthcli.algorithms.plane_fitting.sample_planes import Samples

_CLIPPED = 4.0  # standard deviations that one sample may add to a region's evidence
_EXPECTED = 4.0  # samples that a piece of a region should hold, by its area, before one alone is too few


def noise_of(samples: Samples, sensor: NDArray[np.float32]) -> float:
    """Standard deviation of good samples about a sensor that is right at most of them.

    1.4826 times the median of the absolute differences, then of those within 2.5 of it until it settles. Where the
    sensor knows none of the samples' pixels, a hundredth of their median.

    Parameters
    ----------
    sensor : (H, W), in the unit of the samples' values, NaN = unknown
    """
    difference = samples.values - sensor[samples.rows, samples.columns]
    difference = difference[np.isfinite(difference)]
    if difference.size == 0:
        return 0.01 * float(np.median(samples.values)) if samples.values.size else 1.0
    noise = 1.4826 * float(np.median(np.abs(difference)))
    for _ in range(5):
        near = difference[np.abs(difference) <= 2.5 * noise]
        # What a Gaussian loses beyond 2.5 standard deviations takes 3 % off the deviation of the rest.
        noise = float(np.sqrt(np.mean(near**2.0))) / 0.97 if near.size else noise
    return max(noise, 1e-6 * float(np.median(np.abs(samples.values))))


class Suspicion(BaseModel):
    """A two-sided test: a region is suspect where samples contradict the sensor, all in all and one by one.

    Every pixel is scored by how far the sensor lies from the fit to the samples, in standard deviations of both. One
    minimum cut finds regions, whose outlines cost less along edges of color. Regions whose own samples do not
    contradict the sensor are dropped: there the fit was drawn out beyond its samples.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    doubt: float = Field(0.5, ge=0, description="score that evidence has to exceed, in half squared deviations")
    model_error: float = Field(0.5, ge=0, description="share of the fit's own standard deviation that counts")
    systematic: float = Field(
        0.0, ge=0, description="error that neighboring samples may share, in standard deviations: no evidence below it"
    )
    contradiction: float = Field(
        0.2, gt=0, le=0.5, description="mean contradiction of the fit's samples that is no evidence yet; twice it: full"
    )
    reach: float = Field(
        0.011, gt=0, description="distance from a sample at which its evidence fades to exp(-1/2), over the width"
    )
    outline: float = Field(5.0, ge=0, description="what a pixel of outline costs in a region of one color")
    outline_least: float = Field(0.1, ge=0, le=1, description="share of it that remains along a strong edge")
    color_scale: float = Field(12.0, gt=0, description="color difference at which it falls by exp(-1/2), grey levels")
    region_evidence: float = Field(
        2.0, ge=0, description="least evidence of a region's samples together, in standard deviations of their mean"
    )
    least_area: float = Field(0.0, ge=0, le=1, description="smaller regions are dropped, share of the image")
    sample_evidence: float = Field(0.5, ge=0, description="least mean evidence of its samples, in standard deviations")

    def __call__(
        self,
        sensor: NDArray[np.float32],
        fit: NDArray[np.float32],
        sigma: NDArray[np.float32],
        confidence: NDArray[np.float32],
        contradiction: NDArray[np.float32],
        samples: Samples,
        noise: float,
        image: NDArray[np.uint8],
    ) -> NDArray[np.bool_]:
        """Pixels that the sensor knows and is not believed at.

        Parameters
        ----------
        sensor : (H, W) inverse depth, NaN = unknown
        fit, sigma, confidence : (H, W) what the samples say, as :class:`Fit` has it
        contradiction : (H, W) in [0, 1], how far those samples contradict the sensor at their own pixels
        samples : those that the fit was made from
        noise : their standard deviation
        image : (H, W, 3) uint8

        Returns
        -------
        (H, W) bool
        """
        if samples.values.size == 0:
            return np.zeros(sensor.shape, np.bool_)
        score = self._score(sensor, fit, sigma, confidence, contradiction, samples, noise)
        region = grid_cut(score, self._weights(image))
        region = self._contradicted(region, sensor, samples, noise) & np.isfinite(sensor)
        return _witnessed(region, samples)

    def beyond(self, deviations: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """What is left of differences, in standard deviations, without the error that samples may share."""
        left: NDArray[np.floating[Any]] = np.sign(deviations) * np.maximum(np.abs(deviations) - self.systematic, 0)
        return left

    def _score(
        self, sensor: Any, fit: Any, sigma: Any, confidence: Any, contradiction: Any, samples: Samples, noise: float
    ) -> NDArray[np.float64]:
        blank = np.ones(sensor.shape, np.uint8)
        blank[samples.rows, samples.columns] = 0
        away = cv2.distanceTransform(blank, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        fading = np.exp(-(away**2.0) / (2 * (self.reach * sensor.shape[1]) ** 2))
        off = self.beyond((sensor - fit) / np.sqrt(noise**2 + (self.model_error * sigma) ** 2.0))
        score = np.clip(confidence * off * off / 2 - self.doubt, -2, 4) * fading
        # A surface that the sensor sees, too, says nothing of the surface beside it, however far the fit is drawn out.
        gain = np.clip((contradiction - self.contradiction) / self.contradiction, 0, 1)
        score = np.where(score > 0, score * gain, score)
        # Glass lets the sensor see farther, never nearer.
        score = np.where(off > 0, np.minimum(score, -self.doubt), score)
        known: NDArray[np.float64] = np.where(np.isfinite(off), score, 0.0)
        return known

    def _weights(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float64], ...]:
        color = image.astype(np.float64)
        weights = []
        for step in STEPS:
            here, there = edge_ends((image.shape[0], image.shape[1]), step)
            change = ((color[here] - color[there]) ** 2).sum(axis=2)
            likeness = np.exp(-change / (2 * self.color_scale**2))
            share = self.outline_least + (1 - self.outline_least) * likeness
            weights.append(self.outline * share / np.hypot(*step))
        return tuple(weights)

    def _contradicted(self, region: Any, sensor: Any, samples: Samples, noise: float) -> NDArray[np.bool_]:
        count, labels, facts, _ = cv2.connectedComponentsWithStats(region.astype(np.uint8), connectivity=8)
        nearer = self.beyond((samples.values - sensor[samples.rows, samples.columns]) / noise)
        known = np.isfinite(nearer)
        at = labels[samples.rows, samples.columns][known]
        total = np.bincount(at, np.clip(nearer[known], -_CLIPPED, _CLIPPED), count)
        number = np.bincount(at, minlength=count)
        keep = (number > 0) & (total >= self.region_evidence * np.sqrt(number))
        keep &= total >= self.sample_evidence * number
        keep &= facts[:, cv2.CC_STAT_AREA] >= self.least_area * region.size
        keep[0] = False
        kept: NDArray[np.bool_] = keep[labels]
        return kept


def _witnessed(region: NDArray[np.bool_], samples: Samples) -> NDArray[np.bool_]:
    """Without the pieces that hold one sample or none where, by their area, several were to be expected.

    Pixels that the sensor does not know join such a piece to others; its own evidence may be a single wrong sample.
    """
    count, labels, facts, _ = cv2.connectedComponentsWithStats(region.astype(np.uint8), connectivity=8)
    number = np.bincount(labels[samples.rows, samples.columns], minlength=count)
    expected = facts[:, cv2.CC_STAT_AREA] * (samples.values.size / region.size)
    keep = (number > 1) | (expected < _EXPECTED)
    keep[0] = False
    kept: NDArray[np.bool_] = keep[labels]
    return kept

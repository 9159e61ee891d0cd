"""Regions where the sensor is unreliable: its depth contradicts the samples, within outlines along color edges."""

from __future__ import annotations

from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.graph_cut import STEPS, edge_ends, grid_cut
from depthcli.algorithms.plane_fitting.least_squares import MAD_TO_SIGMA
from depthcli.algorithms.plane_fitting.sample_planes import SamplePlanes, Samples
from depthcli.core.maps import Doubles, Floats, Image8, Ints, Mask
from depthcli.core.method import ConfigModel

# The first three are the values of chapter 5 in scripts/thesis, which varies none of them.
_MAX_SAMPLE_EVIDENCE = 4.0  # largest evidence of one sample for a region, standard deviations
_MIN_EXPECTED_SAMPLES = 4.0  # a piece is dropped if its area should have this many samples, but has one or none
_SCORE_RANGE = -2, 4  # smallest and largest score of a pixel, half squared deviations
_OUTLIER = 2.5  # standard deviations beyond which samples do not count for the noise
_TRUNCATION_LOSS = 0.97  # deviation of a normal distribution cut at 2.5 deviations / deviation of the whole


def sample_noise(samples: Samples, sensor: Floats) -> float:
    """Estimate the standard deviation of good samples about the sensor, which is correct at most samples.

    Start with 1.4826 times the median absolute difference. Five times, replace it by the deviation of the differences
    within 2.5 times the estimate. If the sensor has no value at any sample, return a hundredth of their median.
    """
    difference = samples.values - sensor[samples.rows, samples.columns]
    difference = difference[np.isfinite(difference)]
    if difference.size == 0:
        return 0.01 * float(np.median(samples.values)) if samples.values.size else 1.0
    noise = MAD_TO_SIGMA * float(np.median(np.abs(difference)))
    for _ in range(5):
        near = difference[np.abs(difference) <= _OUTLIER * noise]
        noise = float(np.sqrt(np.mean(near**2.0))) / _TRUNCATION_LOSS if near.size else noise
    return max(noise, 1e-6 * float(np.median(np.abs(samples.values))))


class UnreliableRegions(ConfigModel):
    """Regions where samples contradict the sensor, computed by one minimum cut.

    All values are inverse depths: nearer is larger. Through glass the sensor measures a farther surface, so only a
    sensor value farther than the samples contradicts them.

    - The *deviation* of a pixel is (sensor - plane) / standard deviation of this difference, negative if the sensor
      is farther. ``systematic`` is subtracted from its absolute value.
    - The *evidence* of a pixel is confidence * deviation^2 / 2. The confidence is the share of samples on the plane.
    - The *score* of a pixel is its evidence - ``score_threshold``, within [-2, 4], and fades with the distance to the
      nearest sample. The cut maximizes the sum of scores inside regions minus the cost of their outlines. A sensor
      value nearer than the plane (deviation above 0) is no contradiction: its score is at most -``score_threshold``.
    - The *evidence of a sample* is (sample - sensor) / noise, positive if the sensor is farther. ``systematic`` is
      subtracted from its absolute value. In sums over a region it is limited to [-4, 4].
    - The *contradiction* of a sample is its evidence / 2.5 within [0, 1], or 0.5 if the sensor has no value. Its
      weighted mean over the samples of a pixel's plane is ``planes.averaged``.
    - The *gain* multiplies positive scores. It rises from 0 at a mean contradiction of ``contradiction`` to 1 at twice
      this value.

    Outlines of regions cost less along color edges. Regions are dropped if their own samples do not contradict the
    sensor: there the planes are extrapolations.
    """

    renamed: ClassVar[dict[str, str]] = {
        "doubt": "score_threshold",
        "outline_least": "min_outline_share",
        "region_evidence": "min_region_evidence",
        "least_area": "min_area",
        "sample_evidence": "min_sample_evidence",
    }

    score_threshold: float = Field(0.5, ge=0, description="evidence of an unreliable pixel, half squared deviations")
    model_error: float = Field(0.5, ge=0, description="share of the planes' deviation that is added to the noise")
    systematic: float = Field(0.0, ge=0, description="error that samples may share, standard deviations")
    contradiction: float = Field(
        0.2, gt=0, le=0.5, description="mean contradiction of a plane's samples from which the gain of scores rises"
    )
    reach: float = Field(
        0.011, gt=0, description="distance to samples at which scores fall to exp(-1/2), share of the image width"
    )
    outline: float = Field(5.0, ge=0, description="cost per pixel of outlines without a color edge")
    min_outline_share: float = Field(0.1, ge=0, le=1, description="share of outline along a strong color edge")
    color_scale: float = Field(
        12.0, gt=0, description="color difference at which outline falls to exp(-1/2), grey levels"
    )
    min_region_evidence: float = Field(
        2.0, ge=0, description="smallest evidence of a region's samples, standard deviations of their sum"
    )
    min_area: float = Field(0.0, ge=0, le=1, description="smallest area of a region, share of the image")
    min_sample_evidence: float = Field(
        0.5, ge=0, description="smallest mean evidence of a region's samples, standard deviations"
    )

    def __call__(self, sensor: Floats, planes: SamplePlanes, samples: Samples, noise: float, image: Image8) -> Mask:
        """Select the unreliable pixels of the sensor, (H, W) bool, among the pixels with a value.

        ``planes`` are fitted to ``samples`` at all pixels, row by row; ``planes.averaged`` is the samples' mean
        contradiction. ``noise`` is the samples' standard deviation.
        """
        if samples.values.size == 0:
            return np.zeros(sensor.shape, np.bool_)
        region = grid_cut(self._scores(sensor, planes, samples, noise), self._outline_costs(image))
        region = self._contradicted(region, sensor, samples, noise) & np.isfinite(sensor)
        # Drop pieces with at most one sample if their area should contain several. Such a piece was joined to others by
        # pixels without a sensor value, and its own evidence may be a single incorrect sample.
        labels, area = _pieces(region)
        number = np.bincount(labels[samples.rows, samples.columns], minlength=area.size)
        keep = (number > 1) | (area * (samples.values.size / region.size) < _MIN_EXPECTED_SAMPLES)
        return np.asarray(keep[labels] & region, np.bool_)

    def _scores(self, sensor: Floats, planes: SamplePlanes, samples: Samples, noise: float) -> Doubles:
        """Return the gain of assigning each pixel to an unreliable region, (H, W)."""
        distance = samples.distance((sensor.shape[0], sensor.shape[1])).ravel()
        fading = np.exp(-(distance**2.0) / (2 * (self.reach * sensor.shape[1]) ** 2))
        spread = np.sqrt(noise**2 + (self.model_error * planes.sigma) ** 2.0)
        deviation = self.beyond_systematic((sensor.ravel() - planes.values) / spread)
        score = np.clip(planes.confidence * deviation * deviation / 2 - self.score_threshold, *_SCORE_RANGE) * fading
        # A plane whose samples agree with the sensor is no evidence next to their surface, where it is extrapolated.
        gain = np.clip((planes.averaged - self.contradiction) / self.contradiction, 0, 1)
        score = np.where(score > 0, score * gain, score)
        # Through glass the sensor measures a farther surface, never a nearer one.
        score = np.where(deviation > 0, np.minimum(score, -self.score_threshold), score)
        return np.where(np.isfinite(deviation), score, 0.0).reshape(sensor.shape)

    def _outline_costs(self, image: Image8) -> tuple[Doubles, ...]:
        """Return the cost of an outline between two pixels, for each step in ``STEPS``."""
        color, costs = image.astype(np.float64), []
        for step in STEPS:
            here, there = edge_ends((image.shape[0], image.shape[1]), step)
            change = ((color[here] - color[there]) ** 2).sum(axis=2)
            similarity = np.exp(-change / (2 * self.color_scale**2))
            share = self.min_outline_share + (1 - self.min_outline_share) * similarity
            costs.append(self.outline * share / np.hypot(*step))
        return tuple(costs)

    def _contradicted(self, region: Mask, sensor: Floats, samples: Samples, noise: float) -> Mask:
        """Select the pieces of a region whose own samples contradict the sensor, (H, W) bool."""
        labels, area = _pieces(region)
        evidence = self.beyond_systematic((samples.values - sensor[samples.rows, samples.columns]) / noise)
        known = np.isfinite(evidence)
        at = labels[samples.rows, samples.columns][known]
        total = np.bincount(at, np.clip(evidence[known], -_MAX_SAMPLE_EVIDENCE, _MAX_SAMPLE_EVIDENCE), area.size)
        number = np.bincount(at, minlength=area.size)
        keep = (number > 0) & (total >= self.min_region_evidence * np.sqrt(number))
        keep &= (total >= self.min_sample_evidence * number) & (area >= self.min_area * region.size)
        return np.asarray(keep[labels] & region, np.bool_)

    def beyond_systematic(self, deviations: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """Return deviations moved towards 0 by the error that samples may share, in standard deviations."""
        return np.asarray(np.sign(deviations) * np.maximum(np.abs(deviations) - self.systematic, 0))


def _pieces(region: Mask) -> tuple[Ints, Ints]:
    # Return the 8-connected pieces of a region: (H, W) labels, 0 outside, and the area of each.
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(region.astype(np.uint8), connectivity=8)
    return np.asarray(labels, np.int32), np.asarray(statistics[:, cv2.CC_STAT_AREA], np.int32)

"""A fully connected CRF over depth labels, after section 5.1.2 of the thesis, whose text is missing."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import cv2
import numpy as np
from pydantic import Field

from depthcli.algorithms.dense_crf import GaussianKernel, mean_field
from depthcli.algorithms.plane_fitting.sample_planes import SamplePlaneFit, Samples
from depthcli.core.context import Clock
from depthcli.core.frames import SparseFrame
from depthcli.core.maps import Floats, Mask
from depthcli.core.result import DepthResult
from depthcli.methods.transparent.fitted_frame import FittedFrame, fit_frame, inverse_depth, refined_depth
from depthcli.methods.transparent.pipeline import TransparentPipeline
from depthcli.methods.transparent.unreliable import UnreliableRegions


class DenseCrf(TransparentPipeline):
    """A dense CRF whose labels are steps of inverse depth, with costs from sensor, samples and planes.

    Similar pixels get similar labels. With ``unreliable``, the sensor's costs are dropped at unreliable pixels. Only
    these pixels, the gaps and a band around them are labelled, and the sensor's value is kept elsewhere. Without
    ``unreliable``, every pixel is labelled, as in ``thesis/ch5``.
    """

    renamed: ClassVar[dict[str, str]] = {"suspicion": "unreliable", "flag": "separation"}

    fit: SamplePlaneFit = Field(default_factory=SamplePlaneFit, description="planes through the samples")
    unreliable: UnreliableRegions | None = Field(
        default_factory=UnreliableRegions, description="regions where the sensor is unreliable; null: none"
    )
    labels: int = Field(64, ge=2, le=512, description="number of labels: steps of inverse depth")
    sensor_weight: float = Field(1.0, ge=0, description="cost per label of distance from the sensor's value")
    sample_weight: float = Field(2.0, ge=0, description="cost per label of distance from a sample")
    fit_weight: float = Field(1.0, ge=0, description="cost per label of distance from the planes; needs unreliable")
    dense_weight: float = Field(
        1.0, ge=0, description="cost per label of distance from the dense map of stereo, if any"
    )
    truncation: float = Field(
        6.0, gt=0, description="distance from a value beyond which its costs are constant, labels"
    )
    smooth_truncation: int = Field(
        8, ge=1, description="difference of two pixels beyond which their cost is constant, labels"
    )
    bilateral_weight: float = Field(
        1.0, ge=0, description="weight of smoothness between pixels of similar position and color"
    )
    bilateral_distance: float = Field(
        20.0, gt=0, description="distance at which bilateral_weight falls to exp(-1/2), pixels"
    )
    bilateral_color: float = Field(
        20.0, gt=0, description="color difference at which bilateral_weight falls to exp(-1/2), grey levels"
    )
    near_weight: float = Field(0.3, ge=0, description="weight of smoothness between pixels of similar position")
    near_distance: float = Field(3.0, gt=0, description="distance at which near_weight falls to exp(-1/2), pixels")
    separation: float = Field(4.0, ge=0, description="distance of unreliable pixels from others, standard deviations")
    band: int = Field(8, ge=0, description="width of the band around them that is labelled, too, pixels")
    iterations: int = Field(2, ge=0, le=100, description="iterations of mean field inference")

    def __call__(self, frame: SparseFrame) -> DepthResult:
        clock = Clock()
        if self.unreliable is None:  # every sample agrees, no pixel counts as unreliable, and all are labelled
            sensor, samples = inverse_depth(frame.depth), Samples.of(inverse_depth(frame.sparse))
            blank = np.full(frame.shape, np.nan, np.float32)
            fitted = FittedFrame(sensor, samples, np.inf, blank, np.zeros(frame.shape, np.bool_))
            region = replaced = set_by_labels = np.ones(frame.shape, np.bool_)
            frame, separation = replace(frame, dense=None), 0.0
        else:
            fitted, separation = fit_frame(frame, self.fit, self.unreliable, clock), self.separation
            replaced, set_by_labels = fitted.unreliable, fitted.unreliable | np.isnan(fitted.sensor)
            square = np.ones((2 * self.band + 1,) * 2, np.uint8)
            region = cv2.dilate(set_by_labels.astype(np.uint8), square) > 0
        values = fitted.sensor.astype(np.float64)
        if region.any():
            clock.start("crf")
            first, step, unary = self._unary(frame, fitted, region)
            kernels = self._kernels(frame, region, fitted.unreliable, separation)
            q = mean_field(unary, kernels, self.smooth_truncation, self.iterations)
            label, chosen = np.arange(self.labels, dtype=np.float32), set_by_labels[region]
            mean = (q @ label).astype(np.float64)
            values[set_by_labels] = (first + step * mean)[chosen]
        clock.start("decode")
        figures = {"labelled": float(region.mean()), "samples": float(fitted.samples.values.size)}
        return refined_depth(frame, values, replaced, clock, fitted.sampled(values), **figures)

    def _unary(self, frame: SparseFrame, fitted: FittedFrame, region: Mask) -> tuple[float, float, Floats]:
        """Return the inverse depth of the first label, the step between labels, and the costs of the region's pixels.

        The costs are (n, labels). The dense map counts only at gaps and unreliable pixels of the sensor.
        """
        samples, nothing = np.full(frame.shape, np.nan, np.float32), np.float32(np.nan)
        samples[fitted.samples.rows, fitted.samples.columns] = fitted.samples.values
        reliable = np.where(fitted.unreliable, nothing, fitted.sensor)
        votes = [(reliable, self.sensor_weight), (samples, self.sample_weight), (fitted.fit, self.fit_weight)]
        if frame.dense is not None:
            votes.append((np.where(np.isnan(reliable), inverse_depth(frame.dense), nothing), self.dense_weight))
        evidence = np.concatenate([part[np.isfinite(part)] for part, _ in votes])
        low, high = (float(value) for value in np.quantile(evidence, [0.005, 0.995]))
        margin = 0.05 * (high - low) or 0.05 * high
        first = max(low - margin, 0.1 * low)
        step = (high + margin - first) / (self.labels - 1)
        unary = np.zeros((int(region.sum()), self.labels), np.float32)

        def distances(part: Floats) -> tuple[Mask, Floats]:
            """Return which pixels of the region have a value, and the distance of these values from each label."""
            at = (part[region] - first) / step
            known = np.isfinite(at)
            distance = np.abs(np.arange(self.labels, dtype=np.float32) - at[known, None].astype(np.float32))
            return known, np.minimum(distance, np.float32(self.truncation))

        for part, weight in votes:
            known, distance = distances(part)
            unary[known] += np.float32(weight) * distance
        if frame.sparse_confidence is not None:
            # Undo the samples' costs in proportion to their lack of confidence.
            known, distance = distances(samples)
            share = np.nan_to_num(1 - np.clip(frame.sparse_confidence[region][known], 0, 1))
            unary[known] -= np.float32(self.sample_weight) * share[:, None] * distance
        return first, step, unary

    def _kernels(
        self, frame: SparseFrame, region: Mask, unreliable: Mask, separation: float
    ) -> tuple[GaussianKernel, GaussianKernel]:
        """Return two kernels for the region's pixels: by position and color, and by position alone."""
        rows, columns = (axis.astype(np.float32) for axis in np.nonzero(region))
        place = np.stack([columns, rows], axis=1)
        color = frame.color[region].astype(np.float32) / np.float32(self.bilateral_color)
        flag = np.float32(separation) * unreliable[region, None].astype(np.float32)
        if not separation:
            flag = flag[:, :0]
        wide, near = place / np.float32(self.bilateral_distance), place / np.float32(self.near_distance)
        return (
            GaussianKernel(np.concatenate([wide, color, flag], axis=1), self.bilateral_weight),
            GaussianKernel(np.concatenate([near, flag], axis=1), self.near_weight),
        )

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        # energies, marginals and intermediate arrays of all labels; the lattices; the fit
        pixels = shape[0] * shape[1]
        return pixels * (20 * self.labels + 4 * self.fit.neighbors + 1200) + (64 << 20)

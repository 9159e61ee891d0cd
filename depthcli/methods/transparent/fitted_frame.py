"""Removal of outliers among a frame's samples, planes through the others, and results from inverse depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.sample_planes import SamplePlaneFit, Samples
from depthcli.core.context import Clock
from depthcli.core.frames import SparseFrame
from depthcli.core.maps import DepthMap, DepthStatus, Floats, Mask
from depthcli.core.result import DepthResult
from depthcli.methods.transparent.unreliable import UnreliableRegions, sample_noise

# Values of the published presets; nothing in the repository varies them.
_FIT_TOLERANCE = 3.0  # standard deviations within which a sample agrees with its neighbors
_SENSOR_TOLERANCE = 2.5  # standard deviations within which a sample agrees with the sensor


@dataclass(frozen=True)
class FittedFrame:
    """A frame in inverse depth, (H, W), 1 / m, NaN = unknown, with planes through its samples."""

    sensor: Floats
    samples: Samples  # samples that agree with their neighbors or with the sensor
    noise: float  # standard deviation of the samples
    fit: Floats  # planes through the samples
    unreliable: Mask  # the sensor has a value that contradicts the samples

    def sampled(self, values: NDArray[np.floating[Any]]) -> Mask:
        """Select the pixels, (H, W) bool, where a sample at the pixel itself agrees with ``values`` (H, W)."""
        agrees = np.zeros(self.sensor.shape, np.bool_)
        at = self.samples.rows, self.samples.columns
        agrees[at] = np.abs(values[at] - self.samples.values) <= _FIT_TOLERANCE * self.noise
        return agrees


def fit_frame(frame: SparseFrame, fit: SamplePlaneFit, regions: UnreliableRegions, clock: Clock) -> FittedFrame:
    """Return the frame with outliers removed from its samples, planes through the others, and unreliable regions.

    A sample is an outlier if it agrees neither with the sensor nor with a plane through the samples around it.
    """
    clock.start("samples")
    sensor = inverse_depth(frame.depth)
    samples = Samples.of(inverse_depth(frame.sparse))
    noise = sample_noise(samples, sensor)
    own = fit(samples, frame.color, noise, (samples.rows, samples.columns), skip_own=True)
    measured = sensor[samples.rows, samples.columns]
    agrees = np.abs(samples.values - own.values) <= _FIT_TOLERANCE * noise
    agrees |= np.abs(samples.values - measured) <= _SENSOR_TOLERANCE * noise
    samples, measured = samples.chosen(agrees), measured[agrees]
    # Positive if the sensor measures a farther surface, as through glass; 0.5 if it has no value.
    nearer = regions.beyond_systematic((samples.values - measured) / noise) / _SENSOR_TOLERANCE
    contradiction = np.clip(np.nan_to_num(nearer, nan=0.5), 0, 1)
    clock.start("fit")
    rows, columns = (axis.ravel().astype(np.int32) for axis in np.mgrid[: frame.shape[0], : frame.shape[1]])
    planes = fit(samples, frame.color, noise, (rows, columns), to_average=contradiction.astype(np.float32))
    clock.start("unreliable")
    unreliable = regions(sensor, planes, samples, noise, frame.color)
    return FittedFrame(sensor, samples, noise, planes.values.reshape(frame.shape), unreliable)


def inverse_depth(depth: Floats) -> Floats:
    """Return 1 / depth, in which planes are affine in pixel coordinates."""
    return (np.float32(1.0) / depth).astype(np.float32)


def refined_depth(
    frame: SparseFrame,
    values: NDArray[np.floating[Any]],
    unreliable: Mask,
    clock: Clock,
    sampled: Mask | None = None,
    **figures: float,
) -> DepthResult:
    """Convert inverse depths ``values``, (H, W), to the result of a pipeline.

    ``unreliable`` are pixels whose sensor depth was replaced. ``sampled`` are pixels with an agreeing sample; None: all
    pixels with a sample. ``figures`` are for the report.
    """
    known = np.isfinite(frame.depth)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(values > 0, 1.0 / values, np.nan).astype(np.float32)
        depth = np.where(known & (values == inverse_depth(frame.depth)), frame.depth, depth)
    status = np.zeros(frame.shape, np.uint8)
    status[~known] = DepthStatus.GAP_FILLED
    status[known & unreliable] = DepthStatus.CORRECTED
    sampled = np.isfinite(frame.sparse) if sampled is None else sampled
    status[(status != DepthStatus.KEPT) & sampled] |= np.uint8(DepthStatus.SAMPLED)
    status[np.isnan(depth)] = DepthStatus.EMPTY
    pictures = {"unreliable": np.where(unreliable & known, np.uint8(255), np.uint8(0))}
    map_ = DepthMap(depth, status)
    return DepthResult(map_, seconds=clock.seconds, pictures=pictures, figures=figures)

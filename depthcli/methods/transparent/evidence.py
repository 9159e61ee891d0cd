"""What sensor and samples say together: cleaned samples, a fit to them everywhere, and where the sensor is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.sample_planes import Samples
from depthcli.core.frames import SparseFrame
from depthcli.core.maps import DepthMap, DepthStatus
from depthcli.core.result import Clock, RefinedDepth
from depthcli.methods.transparent.fit import RobustFit
from depthcli.methods.transparent.suspects import Suspicion, noise_of

_OF_FIT = 3.0  # standard deviations within which a sample agrees with its neighbors
_OF_SENSOR = 2.5  # ... with the sensor


@dataclass(frozen=True)
class Evidence:
    """Everything in inverse depth, 1 / m; NaN = unknown.

    Attributes
    ----------
    sensor : (H, W) float32
    samples : those that agree with their neighbors or with the sensor
    noise : their standard deviation
    fit, sigma, confidence : (H, W) float32, what the samples say of every pixel
    contradiction : (H, W) float32 in [0, 1], how far the samples of the fit contradict the sensor at their own pixels
    suspect : (H, W) bool, the sensor knows the pixel and is not believed
    """

    sensor: NDArray[np.float32]
    samples: Samples
    noise: float
    fit: NDArray[np.float32]
    sigma: NDArray[np.float32]
    confidence: NDArray[np.float32]
    contradiction: NDArray[np.float32]
    suspect: NDArray[np.bool_]

    def sampled(self, values: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
        """(H, W) bool: a sample at the pixel itself agrees with ``values`` (H, W)."""
        found = np.zeros(self.sensor.shape, np.bool_)
        at = self.samples.rows, self.samples.columns
        found[at] = np.abs(values[at] - self.samples.values) <= _OF_FIT * self.noise
        return found


def gather(frame: SparseFrame, fit: RobustFit, suspicion: Suspicion, clock: Clock) -> Evidence:
    """Clean the samples by a fit that leaves each of them out, fit to the rest everywhere, compare with the sensor."""
    sensor = inverse(frame.depth)
    samples = Samples.of(inverse(frame.sparse))
    noise = noise_of(samples, sensor)
    own = fit(samples, frame.color, noise, (samples.rows, samples.columns), leave_own=True)
    measured = sensor[samples.rows, samples.columns]
    agrees = np.abs(samples.values - own.values) <= _OF_FIT * noise
    agrees |= np.abs(samples.values - measured) <= _OF_SENSOR * noise
    samples, measured = samples.chosen(agrees), measured[agrees]
    # Glass lets the sensor see farther, never nearer. Where it is blind a sample is half a contradiction.
    nearer = suspicion.beyond((samples.values - measured) / noise) / _OF_SENSOR
    marks = np.clip(np.nan_to_num(nearer, nan=0.5), 0, 1)
    clock.stop("samples")
    rows, columns = (axis.ravel().astype(np.int32) for axis in np.mgrid[: frame.shape[0], : frame.shape[1]])
    found = fit(samples, frame.color, noise, (rows, columns), marks=marks.astype(np.float32))
    values, sigma, confidence, contradiction = (
        part.reshape(frame.shape) for part in (found.values, found.sigma, found.confidence, found.mark)
    )
    clock.stop("fit")
    suspect = suspicion(sensor, values, sigma, confidence, contradiction, samples, noise, frame.color)
    clock.stop("suspects")
    return Evidence(sensor, samples, noise, values, sigma, confidence, contradiction, suspect)


def inverse(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """1 / depth, where planes are affine in pixel coordinates."""
    return (np.float32(1.0) / depth).astype(np.float32)


def outcome(
    frame: SparseFrame,
    values: NDArray[np.floating[Any]],
    sigma: NDArray[np.floating[Any]],
    replaced: NDArray[np.bool_],
    sampled: NDArray[np.bool_],
    clock: Clock,
    figures: dict[str, float] | None = None,
) -> RefinedDepth:
    """The result of a pipeline.

    Parameters
    ----------
    values, sigma : (H, W) inverse depths and their standard deviations
    replaced : (H, W) bool, the sensor knows the pixel and is not believed
    sampled : (H, W) bool, a sample at the pixel says the same
    figures : numbers for the report
    """
    known = np.isfinite(frame.depth)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(values > 0, 1.0 / values, np.nan).astype(np.float32)
        depth = np.where(known & (values == inverse(frame.depth)), frame.depth, depth)
        deviation = (sigma * depth.astype(np.float64) ** 2).astype(np.float32)
    status = np.zeros(frame.shape, np.uint8)
    status[~known] = DepthStatus.GAP_FILLED
    status[known & replaced] = DepthStatus.CORRECTED
    status[(status != DepthStatus.KEPT) & sampled] |= np.uint8(DepthStatus.SAMPLED)
    status[np.isnan(depth)] = DepthStatus.EMPTY
    pictures = {"suspect": np.where(replaced & known, np.uint8(255), np.uint8(0))}
    return RefinedDepth(
        DepthMap(depth, status), deviation, seconds=clock.seconds, pictures=pictures, figures=figures or {}
    )

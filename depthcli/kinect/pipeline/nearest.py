"""Nearest known value: the simplest fill, as a peer."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock
from depthcli.kinect.noise import noise_level
from depthcli.kinect.outcome import measured_disparity, outcome
from depthcli.kinect.pipeline import KinectPipeline
from depthcli.kinect.result import RefinedDepth


class Nearest(KinectPipeline):
    """Every gap pixel gets the value of the nearest measured one; the measured ones stay."""

    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        clock = Clock()
        measured = measured_disparity(frame)
        values = nearest_fill(measured)
        clock.stop("fill")
        noise = noise_level(measured)
        sigma = np.where(np.isnan(measured), np.float32(np.nan), np.float32(noise)).astype(np.float32)
        return outcome(frame, values, sigma, noise, clock)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        return 80 * shape[0] * shape[1]


def nearest_fill(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W) float32 whose NaN are replaced by the nearest (Euclidean distance) known value."""
    gap = np.isnan(values)
    _, labels = cv2.distanceTransformWithLabels(
        gap.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(int(labels.max()) + 1, np.float32)
    of_label[labels[~gap]] = values[~gap]
    filled: NDArray[np.float32] = of_label[labels]
    return filled

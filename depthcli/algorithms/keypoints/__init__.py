"""Key points: distinctive points of an image with descriptors for matching. One file per method."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import Floats, Image8
from depthcli.core.method import Method, method_of


@dataclass(frozen=True)
class KeyPoints:
    """Key points of one image, strongest first."""

    # (N,) float32 position, pixels; the center of the first pixel is (0, 0)
    x: Floats
    y: Floats
    scale: Floats  # (N,) float32 standard deviation of the blob's Gaussian, pixels
    response: Floats  # (N,) float32 strength, in the detector's unit
    # (N,) int8 +1 for dark blobs on a light background, -1 for the reverse, 0 if the detector does not distinguish them
    sign: NDArray[np.int8]
    descriptors: Floats  # (N, K) float32, rows of length 1

    def __len__(self) -> int:
        return len(self.x)


class Detector(Method):
    """A detector of key points that also computes their descriptors."""

    @abstractmethod
    def __call__(self, image: Image8) -> KeyPoints:
        """Return the key points of an (H, W) uint8 grey image, possibly none; deterministic."""


Detection = Annotated[Detector, *method_of("depthcli.algorithms.keypoints")]

"""Image segmentation: partitions of a picture into regions. One file a method."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from depthcli.core.method import Method, method_of


class Segmenter(Method):
    """Partitions an image into connected regions."""

    @abstractmethod
    def __call__(self, image: NDArray[np.uint8]) -> NDArray[np.int32]:
        """Labels (H, W) int32, 0 .. n - 1, every label one 4-connected region, of an (H, W, 3) RGB image."""

    def layers(self, image: NDArray[np.uint8], depth: NDArray[np.float32] | None = None) -> list[NDArray[np.int32]]:
        """Partitions from fine to coarse; one, where a method has no levels.

        Parameters
        ----------
        image : (H, W, 3) RGB
        depth : (H, W) float32, NaN = unknown, or None: depth, disparity or inverse depth, for methods that keep its
            edges; others do not look at it
        """
        return [self(image)]


Segmentation = Annotated[Segmenter, *method_of("depthcli.algorithms.segmentation")]

"""Image segmentation: partitions of an image into connected regions. One file per method."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from depthcli.core.method import Method, method_of


class Segmenter(Method):
    """A method that partitions an image into connected regions."""

    @abstractmethod
    def __call__(self, image: NDArray[np.uint8]) -> NDArray[np.int32]:
        """Return (H, W) int32 labels 0 .. n - 1 of the 4-connected regions of an (H, W, 3) RGB image."""

    def layers(self, image: NDArray[np.uint8], depth: NDArray[np.float32] | None = None) -> list[NDArray[np.int32]]:
        """Return partitions from fine to coarse; only one if the method has no levels.

        ``depth`` (depth, disparity or inverse depth, NaN = unknown) is ignored by methods that do not use it.
        """
        return [self(image)]


Segmentation = Annotated[Segmenter, *method_of("depthcli.algorithms.segmentation")]

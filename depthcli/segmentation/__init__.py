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


Segmentation = Annotated[Segmenter, *method_of("depthcli.segmentation")]

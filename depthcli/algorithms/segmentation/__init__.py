"""Image segmentation: partitions of an image into connected regions. One file per method."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

from depthcli.core.maps import Floats, Image8, Ints
from depthcli.core.method import Method, method_of


class Segmenter(Method):
    """A method that partitions an image into connected regions."""

    @abstractmethod
    def __call__(self, image: Image8) -> Ints:
        """Return (H, W) int32 labels 0 .. n - 1 of the 4-connected regions of an (H, W, 3) RGB image."""

    def layers(self, image: Image8, depth: Floats | None = None) -> list[Ints]:
        """Return partitions from fine to coarse; only one if the method has no levels.

        ``depth`` (depth, disparity or inverse depth, NaN = unknown) is ignored by methods that do not use it.
        """
        return [self(image)]


Segmentation = Annotated[Segmenter, *method_of("depthcli.algorithms.segmentation")]

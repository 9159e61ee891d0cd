"""Features that are compared voxel by voxel. One file per feature."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core.method import Method, method_of

VolumeArray = NDArray[np.float32]
"""(Z, Y, X), finite, of cubic voxels."""
Channels = NDArray[np.uint8]
"""(C, Z, Y, X)."""


class VolumeFeature(Method):
    """Turns two volumes into channels of whole numbers, so that sums of differences are exact."""

    channels: ClassVar[int]
    """Largest number of channels, for estimates of memory."""

    @abstractmethod
    def __call__(self, fixed: VolumeArray, warped: VolumeArray) -> tuple[Channels, Channels]:
        """Compute the channels of both volumes, on one scale; the inputs are not modified."""


Feature = Annotated[VolumeFeature, *method_of("depthcli.methods.registration.feature")]

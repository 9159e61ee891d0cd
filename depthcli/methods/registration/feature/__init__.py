"""Features that are compared voxel by voxel. One file a feature."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core.method import Method, method_of


class VolumeFeature(Method):
    """Turns two volumes into channels of whole numbers, so that sums of differences are exact."""

    channels: ClassVar[int]
    """How many at most, for estimates of memory."""

    @abstractmethod
    def __call__(
        self, fixed: NDArray[np.float32], warped: NDArray[np.float32]
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Compute the channels of both volumes, each (C, Z, Y, X) uint8 on one scale; the inputs are not modified.

        Parameters
        ----------
        fixed, warped : (Z, Y, X) float32, finite, isotropic
        """


Feature = Annotated[VolumeFeature, *method_of("depthcli.methods.registration.feature")]

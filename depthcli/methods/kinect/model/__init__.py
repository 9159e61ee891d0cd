"""Models of the depth within a segment. One file per model."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.polynomials import Surfaces
from depthcli.core.method import Method, method_of


class SurfaceModel(Method):
    """Fits a surface to the known values of every segment."""

    @abstractmethod
    def __call__(
        self, values: NDArray[np.float32], labels: NDArray[np.int32], floor: float, start: Surfaces | None = None
    ) -> Surfaces:
        """Fit ``values`` (H, W), NaN = unknown, segment by segment of ``labels`` (H, W) int32, 0 .. n - 1; -1: none.

        ``floor`` is the smallest scale of residuals, what the sensor resolves; ``start`` the surfaces of the same
        segments in the previous frame: a segment of which too little is known in this one keeps its surface.
        """


Model = Annotated[SurfaceModel, *method_of("depthcli.methods.kinect.model")]

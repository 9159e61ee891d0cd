"""Costs of boundaries by an exponential of the color difference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.methods.stereo.boundary import ColorBoundary


class Exponential(ColorBoundary):
    """``beta exp(-tau / sigma)``: lower than ``gaussian`` for differences below sigma, and higher above."""

    def falloff(self, squared: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.exp(-np.sqrt(squared))

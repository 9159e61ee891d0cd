"""Costs of boundaries by a Gaussian of the color difference (thesis, eq. 2.12)."""

from __future__ import annotations

import numpy as np

from depthcli.core.maps import Doubles
from depthcli.methods.stereo.boundary import ColorBoundary


class Gaussian(ColorBoundary):
    """``beta exp(-tau^2 / sigma^2)``: beta is the length of the boundary in pixels, tau the color difference."""

    def falloff(self, squared: Doubles) -> Doubles:
        return np.exp(-squared)

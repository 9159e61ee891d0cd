"""Costs of boundaries by an exponential of the color difference."""

from __future__ import annotations

import numpy as np

from depthcli.core.maps import Doubles
from depthcli.methods.stereo.boundary import ColorBoundary


class Exponential(ColorBoundary):
    """``beta exp(-tau / sigma)``: lower than ``gaussian`` for differences below sigma, and higher above."""

    def falloff(self, squared: Doubles) -> Doubles:
        return np.exp(-np.sqrt(squared))

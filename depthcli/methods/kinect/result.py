"""What every refinement of a depth map gives back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import DepthMap
from depthcli.core.result import Result


@dataclass
class RefinedDepth(Result):
    """A refined depth map and how far its values may be off.

    Attributes
    ----------
    depth : the map, with what was done to every pixel
    sigma : (H, W) float32, meters: residual scale of the model a value comes from, NaN where there is none
    """

    depth: DepthMap
    sigma: NDArray[np.float32]

    def __post_init__(self) -> None:
        if self.sigma.shape != self.depth.values.shape or self.sigma.dtype != np.float32:
            raise ValueError(
                f"want float32 sigma of the depth's size {self.depth.values.shape}, "
                f"got {self.sigma.shape} {self.sigma.dtype}"
            )

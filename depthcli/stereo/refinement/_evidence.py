"""What refinement steps may look at beside the map they refine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import StereoPair
from depthcli.stereo.volume import CostVolume


@dataclass(frozen=True)
class Evidence:
    """The pair and what the map was selected from.

    Attributes
    ----------
    pair : the images
    volume : the volume whose cheapest cells the map holds
    right : (H, W) disparities of the right view, read from the same volume along its diagonals
    """

    pair: StereoPair
    volume: CostVolume
    right: NDArray[Any]

    def __post_init__(self) -> None:
        if self.right.dtype not in (np.uint16, np.float32):
            raise TypeError(f"right disparities must be uint16 or float32, got {self.right.dtype}")

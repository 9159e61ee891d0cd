"""What refinement steps may look at beside the map they refine."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from depthcli.stereo.volume import CostVolume, StereoPair
from depthcli.stereo.winner import winners


@dataclass
class Evidence:
    """The pair and the volume the map was selected from."""

    pair: StereoPair
    volume: CostVolume

    @cached_property
    def right(self) -> NDArray[np.uint16]:
        """(H, W) disparities of the right view, read from the same volume along its diagonals."""
        return winners(self.volume.costs)

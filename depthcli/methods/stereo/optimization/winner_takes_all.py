"""No optimization: the disparity of every pixel is selected independently."""

from __future__ import annotations

from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.optimization import Optimizer
from depthcli.methods.stereo.volume import CostVolume


class WinnerTakesAll(Optimizer):
    """Leave the aggregated costs as they are; each pixel takes the disparity of its smallest cost."""

    aliases = ("WTA",)

    def __call__(self, volume: CostVolume, pair: StereoPair) -> CostVolume:
        return volume

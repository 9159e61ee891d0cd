"""No optimization: every pixel decides alone."""

from __future__ import annotations

from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.optimization import Optimizer
from depthcli.methods.stereo.volume import CostVolume


class WinnerTakesAll(Optimizer):
    """The aggregated costs themselves; their minimum is the answer."""

    aliases = ("WTA",)

    def __call__(self, volume: CostVolume, pair: StereoPair) -> CostVolume:
        return volume

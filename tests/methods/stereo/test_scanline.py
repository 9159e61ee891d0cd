"""What scanline optimization promises beyond all optimizers."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.kernels.winners import winners
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.volume import CostVolume
from tests.methods.stereo._pairs import blocky_pair


@pytest.mark.parametrize("paths", [4, 8])
def test_scanline_overrules_a_single_outlier(paths):
    costs = np.full((15, 30, 12), 100, np.uint8)
    costs[:, :, 5] = 80
    costs[7, 20, 5], costs[7, 20, 9] = 100, 60
    volume = CostVolume(costs, 100.0)
    flat = blocky_pair(1, 1).left
    pair = type(blocky_pair(1, 1))(*(np.tile(flat, (15, 30, 1)),) * 2)
    assert winners(volume.costs)[0][7, 20] == 9
    assert winners(Scanline(paths=paths)(volume, pair).costs)[0][7, 20] == 5


def test_path_sums_of_the_largest_costs_do_not_overflow():
    costs = np.full((12, 25, 9), 255 * 16, np.uint16)
    costs[3::5, ::4] = 0
    pair = blocky_pair(12, 25)
    result = Scanline(p1=1e6, p2=1e6)(CostVolume(costs, 16.0), pair)
    # Every path costs at most its own cell and one capped penalty beyond the cheapest way.
    assert result.costs[costs == 255 * 16].min() >= 255 * 16
    assert result.costs[costs == 0].max() <= 8 * 255 * 16

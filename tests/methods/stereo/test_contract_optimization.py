"""What every optimizer promises: the folder says which there are."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.kernels.winners import winners
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.volume import CostVolume
from tests.methods.stereo._pairs import TINY, assert_pure, blocky_pair, methods, random_volume

OPTIMIZERS = methods("depthcli.methods.stereo.optimization")


@pytest.mark.parametrize("optimize", OPTIMIZERS)
@pytest.mark.parametrize(("height", "width", "disparities"), TINY)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_tiny_images_and_wide_ranges(optimize, height, width, disparities, dtype):
    volume = random_volume(height, width, disparities, dtype)
    result = optimize(volume, blocky_pair(height, width))
    assert result.costs.shape == volume.costs.shape
    assert result.scale > 0
    assert np.isfinite(result.costs).all()


@pytest.mark.parametrize("optimize", OPTIMIZERS)
def test_same_bytes_at_any_thread_count_and_inputs_untouched(optimize):
    pair, volume = blocky_pair(41, 70), random_volume(41, 70, 37, np.uint16)
    assert_pure(lambda: optimize(volume, pair).costs, volume.costs, pair.left, pair.right)


@pytest.mark.parametrize("optimize", OPTIMIZERS)
@pytest.mark.parametrize("scale", [1.0, 85.0, 1360.0])
def test_unanimous_costs_keep_their_winner(optimize, scale):
    costs = np.full((15, 30, 12), 200, np.uint8)
    costs[:, :, 5] = 10
    left, _ = winners(optimize(CostVolume(costs, scale), blocky_pair(15, 30)).costs)
    assert np.all(left[:, 5:] == 5)


@pytest.mark.parametrize("optimize", OPTIMIZERS)
def test_equal_costs_stay_equal(optimize):
    result = optimize(CostVolume(np.full((9, 20, 8), 40, np.uint8)), blocky_pair(9, 20))
    np.testing.assert_array_equal(result.costs.min(axis=2), result.costs.max(axis=2))


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

"""What every aggregation promises: the folder says which there are."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.kernels.winners import winners
from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.volume import CostVolume
from tests.methods.stereo._pairs import TINY, assert_pure, blocky_pair, inside, methods, random_volume, shifted_pair

AGGREGATIONS = methods("depthcli.methods.stereo.aggregation")
# Fixed-point steps lost to rounding, in stored units (16 a cost unit), by iterated integer means.
ROUNDING = 16


@pytest.mark.parametrize("aggregate", AGGREGATIONS)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_mean_of_equal_costs_is_that_cost(aggregate, dtype):
    stored = 77 * 16 if dtype == np.uint16 else 77  # uint16 costs are fixed point
    volume = CostVolume(np.full((20, 30, 18), stored, dtype), 3.0)
    result = aggregate(volume, blocky_pair(20, 30))
    assert result.costs.shape == volume.costs.shape
    np.testing.assert_allclose(result.costs / result.scale, stored / 3, rtol=0.01)


@pytest.mark.parametrize("aggregate", AGGREGATIONS)
@pytest.mark.parametrize(("height", "width", "disparities"), TINY)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_means_lie_between_the_costs(aggregate, height, width, disparities, dtype):
    volume = random_volume(height, width, disparities, dtype, seed=width)
    for color in (False, True):
        result = aggregate(volume, blocky_pair(height, width, color))
        assert result.costs.shape == volume.costs.shape
        assert result.costs.dtype == np.uint16
        ratio = result.scale / volume.scale
        assert result.costs.min() >= volume.costs.min() * ratio - ROUNDING
        assert result.costs.max() <= volume.costs.max() * ratio + 1
        assert result.costs.max() <= 255 * 16


@pytest.mark.parametrize("aggregate", AGGREGATIONS)
def test_same_bytes_at_any_thread_count_and_inputs_untouched(aggregate):
    pair, volume = blocky_pair(41, 70), random_volume(41, 70, 37)
    assert_pure(lambda: aggregate(volume, pair).costs, volume.costs, pair.left, pair.right)


@pytest.mark.parametrize("aggregate", AGGREGATIONS)
def test_means_depend_on_the_pixels_within_the_halo_alone(aggregate):
    """A tile with this margin has the means of the whole image."""
    halo = aggregate.halo()
    if halo is None:
        pytest.skip("depends on the whole image, as it says")
    height, width = 2 * halo + 40, 2 * halo + 60
    pair, volume = blocky_pair(height, width), random_volume(height, width, 8)
    rows, columns = slice(11, height - 9), slice(13, width - 8)
    tile = type(pair)(*(np.ascontiguousarray(image[rows, columns]) for image in (pair.left, pair.right)))
    part = aggregate(CostVolume(np.ascontiguousarray(volume.costs[rows, columns]), volume.scale), tile).costs
    whole = aggregate(volume, pair).costs[rows, columns]
    inner = np.s_[halo : part.shape[0] - halo, 7 + halo : part.shape[1] - halo]
    assert whole[inner].size
    np.testing.assert_array_equal(part[inner], whole[inner])


@pytest.mark.parametrize("aggregate", AGGREGATIONS)
def test_aggregation_helps_against_noise(aggregate):
    shift = 4
    pair = shifted_pair(40, 60, shift, noise=60, seed=3)
    # One flat patch for the supports; the noise is in the costs.
    flat = blocky_pair(1, 1)
    image = np.repeat(np.repeat(flat.left, 40, axis=0), 60, axis=1)
    volume = AbsoluteDifference()(pair, 12)
    result = aggregate(volume, type(pair)(image, image))

    def right(costs):
        return np.mean(winners(costs)[0][8:-8, 16:-8] == shift)

    assert right(result.costs) > max(0.99, right(volume.costs))


@pytest.mark.parametrize("aggregate", AGGREGATIONS)
def test_disparities_do_not_mix(aggregate):
    """A change of the costs of one disparity changes that disparity alone."""
    pair, volume = blocky_pair(16, 30), random_volume(16, 30, 20)
    changed = volume.costs.copy()
    changed[:, :, 7] = 255 - changed[:, :, 7]
    before, after = (aggregate(CostVolume(costs), pair).costs for costs in (volume.costs, changed))
    others = np.arange(20) != 7
    np.testing.assert_array_equal(after[:, :, others], before[:, :, others])
    assert np.any(after[:, :, 7][inside((16, 30, 20))[:, :, 7]] != before[:, :, 7][inside((16, 30, 20))[:, :, 7]])

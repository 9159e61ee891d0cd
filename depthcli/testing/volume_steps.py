"""What every aggregation and every optimization of cost volumes promises."""

from __future__ import annotations

import numpy as np
from numpy.typing import DTypeLike, NDArray

from depthcli.core.frames import StereoPair
from depthcli.kernels.winners import winners
from depthcli.methods.stereo.aggregation import Aggregator
from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.optimization import Optimizer
from depthcli.methods.stereo.volume import CostVolume
from depthcli.testing.inputs import (
    TINY,
    assert_pure,
    blocky_pair,
    changed,
    inside,
    random_volume,
    run_checks,
    shifted_pair,
)

# Fixed-point steps lost to rounding, in stored units (16 a cost unit), by iterated integer means.
_ROUNDING = 16
_TYPES: tuple[DTypeLike, ...] = (np.uint8, np.uint16, np.float32)


def check_aggregation(aggregate: Aggregator) -> None:
    """Raise AssertionError unless an aggregation keeps what pipelines rely on; takes some seconds."""
    run_checks(aggregate, AGGREGATION_CHECKS)


def check_optimization(optimize: Optimizer) -> None:
    """Raise AssertionError unless an optimization keeps what pipelines rely on; takes some seconds."""
    run_checks(optimize, OPTIMIZATION_CHECKS)


def mean_of_equal_costs_is_that_cost(aggregate: Aggregator) -> None:
    """Where all costs are equal, so are the means."""
    for dtype in _TYPES:
        stored = 77 * 16 if dtype == np.uint16 else 77  # uint16 costs are fixed point
        volume = CostVolume(np.full((20, 30, 18), stored, dtype), 3.0)
        result = aggregate(volume, blocky_pair(20, 30))
        assert result.costs.shape == volume.costs.shape, f"want {volume.costs.shape}, got {result.costs.shape}"
        np.testing.assert_allclose(result.costs / result.scale, stored / 3, rtol=0.01)


def means_lie_between_the_costs(aggregate: Aggregator) -> None:
    """The means of uint8 and uint16 costs are uint16, and within the range of the costs."""
    for height, width, disparities in TINY:
        for dtype in _TYPES[:2]:
            volume = random_volume(height, width, disparities, dtype, seed=width)
            for color in (False, True):
                result = aggregate(volume, blocky_pair(height, width, color))
                assert result.costs.shape == volume.costs.shape, f"want {volume.costs.shape}, got {result.costs.shape}"
                assert result.costs.dtype == np.uint16, f"want uint16, got {result.costs.dtype}"
                ratio = result.scale / volume.scale
                assert result.costs.min() >= volume.costs.min() * ratio - _ROUNDING, "a mean is below all costs"
                assert result.costs.max() <= volume.costs.max() * ratio + 1, "a mean is above all costs"
                assert result.costs.max() <= 255 * 16, "a mean is above 255 x 16, the largest that is stored"


def same_means_at_any_number_of_threads(aggregate: Aggregator) -> None:
    """The means do not depend on the number of threads, and the inputs stay as they were."""
    pair, volume = blocky_pair(41, 70), random_volume(41, 70, 37)
    assert_pure(lambda: aggregate(volume, pair).costs, volume.costs, pair.left, pair.right)


def means_depend_on_the_halo_alone(aggregate: Aggregator) -> None:
    """A tile with the margin of ``halo()`` has the means of the whole image; None promises nothing."""
    halo = aggregate.halo()
    if halo is None:
        return
    height, width = 2 * halo + 40, 2 * halo + 60
    pair, volume = blocky_pair(height, width), random_volume(height, width, 8)
    rows, columns = slice(11, height - 9), slice(13, width - 8)
    tile = changed(pair, lambda image: np.ascontiguousarray(image[rows, columns]))
    part = aggregate(CostVolume(np.ascontiguousarray(volume.costs[rows, columns]), volume.scale), tile).costs
    whole = aggregate(volume, pair).costs[rows, columns]
    inner = np.s_[halo : part.shape[0] - halo, 7 + halo : part.shape[1] - halo]
    assert whole[inner].size
    np.testing.assert_array_equal(part[inner], whole[inner])


def it_helps_against_noise(aggregate: Aggregator) -> None:
    """On one flat patch, means of noisy costs find the true disparity nearly everywhere."""
    shift = 4
    pair = shifted_pair(40, 60, shift, noise=60, seed=3)
    # One flat patch for the supports; the noise is in the costs.
    image = np.repeat(np.repeat(blocky_pair(1, 1).left, 40, axis=0), 60, axis=1)
    volume = AbsoluteDifference()(pair, 12)
    result = aggregate(volume, StereoPair(image, image))

    def right(costs: NDArray[np.generic]) -> float:
        return float(np.mean(winners(costs)[0][8:-8, 16:-8] == shift))

    before, after = right(volume.costs), right(result.costs)
    assert after > max(0.99, before), f"{after:.1%} of the pixels are right, {before:.1%} without it"


def disparities_do_not_mix(aggregate: Aggregator) -> None:
    """A change of the costs of one disparity changes the means of that disparity alone."""
    pair, volume = blocky_pair(16, 30), random_volume(16, 30, 20)
    other = volume.costs.copy()
    other[:, :, 7] = 255 - other[:, :, 7]
    before, after = (aggregate(CostVolume(costs), pair).costs for costs in (volume.costs, other))
    others = np.arange(20) != 7
    np.testing.assert_array_equal(after[:, :, others], before[:, :, others])
    within = inside((16, 30, 20))[:, :, 7]
    assert np.any(after[:, :, 7][within] != before[:, :, 7][within]), "the changed costs make no difference"


def volumes_of_all_types(optimize: Optimizer) -> None:
    """Volumes of uint8, uint16 and float32 of any size give finite costs of the same shape."""
    for height, width, disparities in TINY:
        for dtype in _TYPES:
            volume = random_volume(height, width, disparities, dtype)
            result = optimize(volume, blocky_pair(height, width))
            assert result.costs.shape == volume.costs.shape, f"want {volume.costs.shape}, got {result.costs.shape}"
            assert result.scale > 0, f"want a positive scale, got {result.scale}"
            assert np.isfinite(result.costs).all(), "some costs are NaN or infinite"


def same_sums_at_any_number_of_threads(optimize: Optimizer) -> None:
    """The costs do not depend on the number of threads, and the inputs stay as they were."""
    pair, volume = blocky_pair(41, 70), random_volume(41, 70, 37, np.uint16)
    assert_pure(lambda: optimize(volume, pair).costs, volume.costs, pair.left, pair.right)


def unanimous_costs_keep_their_winner(optimize: Optimizer) -> None:
    """A disparity that is cheapest at every pixel stays so, whatever the unit of the costs."""
    for scale in (1.0, 85.0, 1360.0):
        costs = np.full((15, 30, 12), 200, np.uint8)
        costs[:, :, 5] = 10
        left, _ = winners(optimize(CostVolume(costs, scale), blocky_pair(15, 30)).costs)
        assert np.all(left[:, 5:] == 5), f"another disparity wins, at {scale} stored units a cost unit"


def equal_costs_stay_equal(optimize: Optimizer) -> None:
    """Where all costs are equal, no disparity is preferred."""
    result = optimize(CostVolume(np.full((9, 20, 8), 40, np.uint8)), blocky_pair(9, 20))
    np.testing.assert_array_equal(result.costs.min(axis=2), result.costs.max(axis=2))


AGGREGATION_CHECKS = (
    mean_of_equal_costs_is_that_cost,
    means_lie_between_the_costs,
    same_means_at_any_number_of_threads,
    means_depend_on_the_halo_alone,
    it_helps_against_noise,
    disparities_do_not_mix,
)
OPTIMIZATION_CHECKS = (
    volumes_of_all_types,
    same_sums_at_any_number_of_threads,
    unanimous_costs_keep_their_winner,
    equal_costs_stay_equal,
)

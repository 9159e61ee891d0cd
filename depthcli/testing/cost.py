"""What every cost measure promises."""

from __future__ import annotations

import numpy as np

from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.cost import CostMeasure
from depthcli.methods.stereo.volume import CostVolume
from depthcli.testing.inputs import TINY, assert_pure, changed, inside, run_checks, shifted_pair, texture

_MARGIN = 8  # no window reaches beyond the plane's common part from here on


def check_cost_measure(cost: CostMeasure) -> None:
    """Raise AssertionError unless a cost measure keeps all promises to pipelines; takes some seconds."""
    run_checks(cost, CHECKS)


def _checked(cost: CostMeasure, pair: StereoPair, n_disparities: int) -> CostVolume:
    volume = cost.checked_costs(pair, n_disparities)
    size = volume.costs.itemsize
    assert size <= cost.bytes_per_cost, f"costs have {size} bytes; set bytes_per_cost, from which memory is estimated"
    outside = volume.costs[~inside((*pair.shape, n_disparities))]
    if outside.size:
        assert outside.min() == outside.max(), "matches outside the right image have different costs"
    return volume


def true_shift_is_cheapest(cost: CostMeasure) -> None:
    """The cost of the true disparity is the lowest, on random texture."""
    shift = 5
    for color in (False, True):
        costs = cost.checked_costs(shifted_pair(30, 60, shift, color), 12).costs
        costs = costs[_MARGIN:-_MARGIN, shift + _MARGIN : -_MARGIN]
        np.testing.assert_array_equal(costs[..., shift], costs.min(axis=2))
        # Ties are rare on random texture (a single rank or grey level can be met by chance).
        share = np.mean(costs.argmin(axis=2) == shift)
        assert share > 0.6, f"{share:.0%} of the pixels have the true disparity, expected more than 60 %"
        ratio = costs[..., shift].mean() / np.delete(costs, shift, axis=2).mean()
        assert ratio < 0.1, f"the true disparity costs {ratio:.2f} of the others, expected less than 0.1"


def same_at_any_number_of_threads(cost: CostMeasure) -> None:
    """The costs do not depend on the number of threads, and the images stay as they were."""
    pair = shifted_pair(33, 70, 3)
    assert_pure(lambda: cost.checked_costs(pair, 20).costs, pair.left, pair.right)


def costs_depend_on_the_halo_alone(cost: CostMeasure) -> None:
    """A tile with the margin of ``halo()`` has the costs of the whole image; None promises nothing."""
    halo = cost.halo()
    if halo is None:
        return
    top, left, bottom, right = 11, 13, 42, 80
    for color in (False, True):
        pair = shifted_pair(50, 90, 3, color, noise=9)
        tile = changed(pair, lambda image: np.ascontiguousarray(image[top:bottom, left:right]))
        whole = cost.checked_costs(pair, 8).costs[top + halo : bottom - halo, left + 7 + halo : right - halo]
        part = cost.checked_costs(tile, 8).costs[halo : bottom - top - halo, 7 + halo : right - left - halo]
        assert whole.size, f"halo() of {halo} is too large to be checked"
        np.testing.assert_array_equal(part, whole)


def tiny_images_and_wide_ranges(cost: CostMeasure) -> None:
    """Images of a single pixel or row, and ranges wider than the image, have finite costs of the right shape."""
    for height, width, disparities in TINY:
        for color in (False, True):
            pair = shifted_pair(height, width, 1, color, seed=width)
            _checked(cost, pair, disparities)


def compares_levels_is_true(cost: CostMeasure) -> None:
    """``compares_levels`` is true if half the light in the right image raises the costs of true matches."""
    pair = shifted_pair(30, 60, 5)
    pair = StereoPair(pair.left // 2 * 2, pair.right // 2 * 2)
    changed_light = StereoPair(pair.left, pair.right // 2)
    inner = np.s_[_MARGIN:-_MARGIN, 5 + _MARGIN : -_MARGIN]
    true, other = (cost.checked_costs(one, 12).costs[inner][..., 5].mean() for one in (pair, changed_light))
    wrong = cost.checked_costs(pair, 12).costs[inner][..., 4].mean()
    assert (other - true > 0.2 * wrong) == cost.compares_levels, f"expected {not cost.compares_levels}"


def textureless_images_cost_nothing(cost: CostMeasure) -> None:
    """All matches inside two images of one color cost 0."""
    image = np.full((12, 20, 3), 90, np.uint8)
    volume = _checked(cost, StereoPair(image, image), 8)
    assert not volume.costs[inside((12, 20, 8))].any(), "equal pixels have a cost"


def sixteen_bits_mean_the_same(cost: CostMeasure) -> None:
    """Images of 16 bits have the costs of the same images of 8 bits."""
    for color in (False, True):
        pair = shifted_pair(20, 40, 2, color, noise=6)
        wide = StereoPair(pair.left.astype(np.uint16) * 257, pair.right.astype(np.uint16) * 257)
        a, b = cost.checked_costs(pair, 9), cost.checked_costs(wide, 9)
        if color:
            # Luma of 16 bits is finer than luma of 8 bits: rank and census may see what 8 bits round away.
            assert np.abs(a.costs / a.scale - b.costs / b.scale).mean() < 0.1 * (a.costs / a.scale).mean()
        else:
            np.testing.assert_allclose(b.costs / b.scale, a.costs / a.scale, atol=1.01 / a.scale)


def grey_is_color_with_equal_channels(cost: CostMeasure) -> None:
    """A grey image has the costs of the color image whose channels are equal."""
    pair = shifted_pair(20, 40, 2, color=False, noise=6)
    color = changed(pair, lambda image: np.repeat(image[:, :, None], 3, axis=2))
    a, b = cost.checked_costs(pair, 9), cost.checked_costs(color, 9)
    np.testing.assert_allclose(b.costs / b.scale, a.costs / a.scale, atol=1.01 / min(a.scale, b.scale))


def strided_views_are_read_right(cost: CostMeasure) -> None:
    """Images that are views of larger arrays have the costs of their copies."""
    big = texture((40, 80, 3), 4).astype(np.uint8)
    view = StereoPair(big[::2, 5:65], big[::2, 8:68])
    copy = changed(view, np.ascontiguousarray)
    np.testing.assert_array_equal(cost.checked_costs(view, 7).costs, cost.checked_costs(copy, 7).costs)


CHECKS = (
    true_shift_is_cheapest,
    same_at_any_number_of_threads,
    costs_depend_on_the_halo_alone,
    tiny_images_and_wide_ranges,
    compares_levels_is_true,
    textureless_images_cost_nothing,
    sixteen_bits_mean_the_same,
    grey_is_color_with_equal_channels,
    strided_views_are_read_right,
)
"""One function a promise."""

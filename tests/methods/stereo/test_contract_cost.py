"""What every cost measure promises: the folder says which there are."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.volume import CostVolume
from tests.methods.stereo._pairs import TINY, assert_pure, inside, methods, shifted_pair, texture

COSTS = methods("depthcli.methods.stereo.cost")
MARGIN = 8  # no window reaches beyond the plane's common part from here on


def checked(volume: CostVolume, shape: tuple[int, int, int]) -> CostVolume:
    assert volume.costs.shape == shape
    assert volume.costs.flags.c_contiguous
    assert volume.scale > 0
    assert np.isfinite(volume.costs).all()
    outside = volume.costs[~inside(shape)]
    if outside.size:
        assert outside.min() == outside.max()
    return volume


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("color", [False, True])
def test_true_shift_is_cheapest(cost, color):
    shift = 5
    costs = cost(shifted_pair(30, 60, shift, color), 12).costs[MARGIN:-MARGIN, shift + MARGIN : -MARGIN]
    np.testing.assert_array_equal(costs[..., shift], costs.min(axis=2))
    # Ties are rare on random texture (a single rank or grey level can be met by chance).
    assert np.mean(costs.argmin(axis=2) == shift) > 0.6
    assert costs[..., shift].mean() < 0.1 * np.delete(costs, shift, axis=2).mean()


@pytest.mark.parametrize("cost", COSTS)
def test_same_bytes_at_any_thread_count_and_inputs_untouched(cost):
    pair = shifted_pair(33, 70, 3)
    assert_pure(lambda: cost(pair, 20).costs, pair.left, pair.right)


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("color", [False, True])
def test_costs_depend_on_the_pixels_within_the_halo_alone(cost, color):
    """A tile with this margin has the costs of the whole image."""
    halo = cost.halo()
    if halo is None:
        pytest.skip("depends on the whole image, as it says")
    pair, top, left, bottom, right = shifted_pair(50, 90, 3, color, noise=9), 11, 13, 42, 80
    rows, columns = slice(top, bottom), slice(left, right)
    tile = StereoPair(np.ascontiguousarray(pair.left[rows, columns]), np.ascontiguousarray(pair.right[rows, columns]))
    whole = cost(pair, 8).costs[top + halo : bottom - halo, left + 7 + halo : right - halo]
    part = cost(tile, 8).costs[halo : bottom - top - halo, 7 + halo : right - left - halo]
    assert whole.size
    np.testing.assert_array_equal(part, whole)


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize(("height", "width", "disparities"), TINY)
def test_tiny_images_and_wide_ranges(cost, height, width, disparities):
    for color in (False, True):
        pair = shifted_pair(height, width, 1, color, seed=width)
        checked(cost(pair, disparities), (height, width, disparities))


@pytest.mark.parametrize("cost", [cost for cost in COSTS if cost.id != "combined"])
def test_says_whether_it_compares_grey_levels(cost):
    """Half the light in the right image disturbs what does, and nothing else."""
    pair = shifted_pair(30, 60, 5)
    pair = StereoPair(pair.left // 2 * 2, pair.right // 2 * 2)
    dark = StereoPair(pair.left, pair.right // 2)
    true, other = (cost(one, 12).costs[MARGIN:-MARGIN, 5 + MARGIN : -MARGIN, 5].mean() for one in (pair, dark))
    usual = cost(pair, 12).costs[MARGIN:-MARGIN, 5 + MARGIN : -MARGIN, 4].mean()
    assert (other - true > 0.2 * usual) == cost.compares_levels


@pytest.mark.parametrize("cost", COSTS)
def test_textureless_images_cost_nothing(cost):
    image = np.full((12, 20, 3), 90, np.uint8)
    volume = checked(cost(StereoPair(image, image), 8), (12, 20, 8))
    assert not volume.costs[inside(volume.costs.shape)].any()


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("color", [False, True])
def test_sixteen_bits_mean_the_same(cost, color):
    pair = shifted_pair(20, 40, 2, color, noise=6)
    wide = StereoPair(pair.left.astype(np.uint16) * 257, pair.right.astype(np.uint16) * 257)
    a, b = cost(pair, 9), cost(wide, 9)
    if color and pair.left.ndim == 3:
        # Luma of 16 bits is finer than luma of 8 bits: rank and census may see what 8 bits round away.
        assert np.abs(a.costs / a.scale - b.costs / b.scale).mean() < 0.1 * (a.costs / a.scale).mean()
    else:
        np.testing.assert_allclose(b.costs / b.scale, a.costs / a.scale, atol=1.01 / a.scale)


@pytest.mark.parametrize("cost", COSTS)
def test_grey_is_color_with_equal_channels(cost):
    pair = shifted_pair(20, 40, 2, color=False, noise=6)
    color = StereoPair(*(np.repeat(image[:, :, None], 3, axis=2) for image in (pair.left, pair.right)))
    a, b = cost(pair, 9), cost(color, 9)
    np.testing.assert_allclose(b.costs / b.scale, a.costs / a.scale, atol=1.01 / min(a.scale, b.scale))


@pytest.mark.parametrize("cost", COSTS)
def test_strided_views_are_read_right(cost):
    big = texture((40, 80, 3), 4)
    view = StereoPair(big[::2, 5:65], big[::2, 8:68])
    copy = StereoPair(np.ascontiguousarray(view.left), np.ascontiguousarray(view.right))
    np.testing.assert_array_equal(cost(view, 7).costs, cost(copy, 7).costs)

"""Slopes and the median along them against their slow references, and their use at color edges."""

import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.window_slopes import slopes
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap
from depthcli.methods.stereo.refinement.slanted_median import SlantedMedian
from depthcli.methods.stereo.refinement.weighted_median import WeightedMedian
from depthcli.methods.stereo.volume import CostVolume, RefinementContext
from depthcli.testing.inputs import blocky_pair
from tests.naive import stereo as naive

SIZES = [(1, 1), (1, 9), (9, 1), (14, 63), (10, 64), (12, 65), (3, 130)]


def bumpy(height, width, seed=0, empty=0.15):
    """A slanted surface with noise, a step and holes."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    values = 20 + 0.3 * x - 0.1 * y + rng.normal(0, 0.3, (height, width))
    values[:, width // 2 :] -= 8
    values[rng.random((height, width)) < empty] = np.nan
    return np.maximum(values, 0).astype(np.float32), blocky_pair(height, width, seed=seed).color8[0]


@pytest.mark.slow
@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("radius", [4, 9])
def test_slopes_agree_with_the_reference(height, width, radius):
    values, image = bumpy(height, width)
    image //= 8  # similar colors, but not all of them
    np.testing.assert_allclose(slopes(values, image, radius), naive.slopes(values, image, radius), atol=2e-3)


def test_a_plane_has_its_slope_and_a_flat_map_none():
    y, x = np.mgrid[:40, :50]
    image = np.full((40, 50, 3), 90, np.uint8)
    plane = (5 + 0.25 * x + 0.125 * y).astype(np.float32)
    found = slopes(plane, image)[:, 10:-10, 10:-10]
    np.testing.assert_allclose(found, np.broadcast_to([[[0.25]], [[0.125]]], found.shape), atol=0.02)
    assert not any(slopes(np.full((40, 50), value, np.float32), image).any() for value in (7, np.nan))


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_the_median_agrees_with_the_reference(height, width):
    values, image = bumpy(height, width)
    result = SlantedMedian(radius=3, color_scale=20, distance_scale=4).filtered(values, image, 200)
    low, high = naive.slanted_median(values, slopes(values, image, 16), image, 3, 20, 4)
    valid = ~np.isnan(values)
    np.testing.assert_array_equal(np.isnan(result), ~valid)
    # Intervals of 1/16, then steps of 1/8.
    assert np.all(result[valid] >= np.maximum(low[valid], 0) - 0.1)
    assert np.all(result[valid] <= np.maximum(high[valid], 0) + 0.1)


def test_a_slope_at_a_color_edge_is_not_flattened():
    """Half of the window is of another color: a plain median is biased there, a slanted one is not."""
    x = np.tile(np.arange(60), (40, 1))
    truth = (10 + 0.5 * x).astype(np.float32)
    image = np.where((x < 30)[:, :, None], np.uint8(40), np.uint8(200)) * np.ones(3, np.uint8)
    volume, given = CostVolume(np.zeros((40, 60, 64), np.uint8)), DisparityMap(truth, np.zeros(truth.shape, np.uint8))
    context = RefinementContext(StereoPair(image, image), volume, np.zeros((40, 60), np.uint16))
    plain, slanted = (
        np.abs(step(radius=6, color_scale=8, distance_scale=5)(given, context).values - truth)[16:-16, 28:32].max()
        for step in (WeightedMedian, SlantedMedian)
    )
    assert plain > 0.5 and slanted <= 0.15

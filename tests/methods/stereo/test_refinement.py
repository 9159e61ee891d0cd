"""Steps that refine disparities against their slow, obvious references."""

from functools import partial

import cv2
import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.window_slopes import slopes
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.method import Family
from depthcli.kernels.winners import winners
from depthcli.methods.stereo.volume import RefinementContext
from depthcli.testing.inputs import TINY, blocky_pair, random_volume
from tests.contracts.inputs import part
from tests.naive import stereo as naive

refinement = partial(part, "methods.stereo.refinement")
SMALL = [*TINY, (11, 23, 19)]
sizes = pytest.mark.parametrize(("height", "width", "disparities"), SMALL)


def with_context(values, reason, volume):
    """A map whose pixels without a value have a reason, and what a step is given beside it."""
    disparity = DisparityMap(values, np.where(np.isnan(values), reason, 0).astype(np.uint8))
    return disparity, RefinementContext(blocky_pair(*values.shape), volume, winners(volume.costs)[1])


def holes(height, width, disparities):
    """Winners of random costs, a third of them missing, and the upper quarter and the last row."""
    volume = random_volume(height, width, disparities, np.uint16)
    values = winners(volume.costs)[0].astype(np.float32)
    values[np.random.default_rng(5).random((height, width)) < 0.3] = np.nan
    values[: height // 4] = values[-1:] = np.nan
    return with_context(values, Status.MISMATCH, volume)


def fractional_holes(height, width, disparities):
    """Smooth surfaces with steps, fractions, holes and islands."""
    rng = np.random.default_rng(6)
    y, x = np.mgrid[0:height, 0:width]
    values = 0.2 * disparities + 0.06 * x + 0.04 * y + np.where(x > 0.6 * width, 0.4 * disparities, 0)
    values = np.clip(values + rng.normal(0, 0.3, values.shape), 0, disparities - 1).astype(np.float32)
    islands = rng.random(values.shape) < 0.03
    values[islands] = rng.uniform(0, disparities - 1, islands.sum())
    values[rng.random(values.shape) < 0.1] = np.nan
    gap = (x > 0.4 * width) & (x < 0.6 * width + y % 3)
    values[gap | (x < disparities // 5)] = values[height // 2] = np.nan
    return with_context(values, Status.OCCLUDED, random_volume(height, width, disparities, np.uint16))


@sizes
@pytest.mark.parametrize("tolerance", [0.0, 1.0])
def test_left_right_check(height, width, disparities, tolerance):
    disparity, context = holes(height, width, disparities)
    result = refinement("left_right_check", tolerance=tolerance)(disparity, context)
    values, occluded, mismatch = naive.left_right_check(disparity.values, context.right, disparities, tolerance)
    np.testing.assert_array_equal(result.values, values)
    np.testing.assert_array_equal(result.status & Status.OCCLUDED != 0, occluded)
    np.testing.assert_array_equal(result.status & Status.MISMATCH != 0, mismatch | (disparity.status != 0))


STEPS = {
    "background_fill": lambda values, costs: naive.background_fill(values),
    "median-3": lambda values, costs: naive.median(values, 3),
    "median-5": lambda values, costs: naive.median(values, 5),
    "subpixel": lambda values, costs: naive.subpixel(costs, values),
    "discontinuity_adjustment": naive.discontinuity_adjustment,
}


@sizes
@pytest.mark.parametrize("name", STEPS)
def test_steps_without_other_parameters_than_a_window(height, width, disparities, name):
    disparity, context = holes(height, width, disparities)
    method, _, window = name.partition("-")
    step = refinement(method, window=int(window)) if window else refinement(method)
    expected = STEPS[name](disparity.values, context.volume.costs)
    np.testing.assert_allclose(step(disparity, context).values, expected, rtol=1e-6)


@sizes
def test_region_voting(height, width, disparities):
    disparity, context = holes(height, width, disparities)
    few = DisparityMap(np.minimum(disparity.values, 2).astype(np.float32), disparity.status)  # so that supports agree
    rule = {"length": 5, "threshold": 40, "inner_length": 3, "inner_threshold": 20}
    step = refinement("region_voting", **rule, votes=3, iterations=1)
    arms = naive.cross_arms(context.pair.color8[0], *rule.values())
    expected = naive.region_voting(few.values, arms, disparities, 3, step.majority)
    np.testing.assert_array_equal(step(few, context).values, expected)


@sizes
def test_interpolation(height, width, disparities):
    disparity, context = holes(height, width, disparities)
    status = disparity.status.copy()
    status[:, ::2][status[:, ::2] != 0] = Status.OCCLUDED
    result = refinement("interpolation")(DisparityMap(disparity.values, status), context).values
    expected = naive.interpolation(disparity.values, status == Status.OCCLUDED, context.pair.color8[0])
    # Where two values are equally like in color the reference does not decide.
    decided = ~np.isnan(expected)
    np.testing.assert_array_equal(result[decided], expected[decided])


@pytest.mark.parametrize("width", [1, 15, 16, 17, 32, 33, 50])
@pytest.mark.parametrize("filled_weight", [0.0, 0.3, 1.0])
def test_weighted_median_of_fractions_at_every_width(width, filled_weight):
    """The kernel works on 16 pixels at a time and sorts into bins of 1/8."""
    disparity, context = fractional_holes(12, width, 20)
    status, valid = disparity.status.copy(), disparity.valid
    status[::2][valid[::2]] = Status.OCCLUDED | Status.FILLED
    step = refinement("weighted_median", radius=4, color_scale=20, distance_scale=4, filled_weight=filled_weight)
    result = step(DisparityMap(disparity.values, status), context).values
    trust = np.where(status & Status.FILLED, filled_weight, 1.0)
    low, high = naive.weighted_median(disparity.values, context.pair.color8[0], 4, 20, 4, trust)
    np.testing.assert_array_equal(np.isnan(result), ~valid)
    assert np.all((result[valid] >= low[valid]) & (result[valid] <= high[valid]))


@pytest.mark.slow
@pytest.mark.parametrize(("height", "width", "disparities"), [*SMALL, (24, 60, 30)])
def test_surface_fill(height, width, disparities):
    disparity, context = fractional_holes(height, width, disparities)
    for rows, reach, support in ((20, 20, 30), (2, 7, 3), (0, 3, 3)):
        expected = naive.surface_fill(disparity.values, rows, reach, support, disparities - 1)
        result = refinement("surface_fill", rows=rows, reach=reach, support=support)(disparity, context)
        np.testing.assert_allclose(result.values, expected, atol=2e-3)


@pytest.mark.parametrize(("height", "width", "disparities"), [*SMALL, (70, 12, 5)])
@pytest.mark.parametrize(("size", "step"), [(1, 0.0), (4, 1.0), (30, 2.0)])
def test_speckle_filter(height, width, disparities, size, step):
    for disparity, context in (holes(height, width, disparities), fractional_holes(height, width, disparities)):
        rounded = (np.round(disparity.values * 16) / 16).astype(np.float32)  # OpenCV filters sixteenths
        result = refinement("speckle_filter", size=size, step=step)(DisparityMap(rounded, disparity.status), context)
        np.testing.assert_array_equal(result.values, naive.speckle_filter(rounded, size, step))
        assert np.all(result.status[disparity.valid & ~result.valid] & Status.MISMATCH)


@pytest.mark.parametrize(("height", "width", "disparities"), [*SMALL, (26, 61, 40)])
@pytest.mark.parametrize("scales", [(3.0, 40.0), (40.0, 5.0)])
def test_directional_fill(height, width, disparities, scales):
    """Of a map of blocks with gaps that were filled."""
    rng = np.random.default_rng(0)
    blocks = rng.uniform(0, disparities - 1, (height // 6 + 1, width // 6 + 1)).repeat(6, 0).repeat(6, 1)
    gaps = (rng.random((height // 4 + 1, width // 4 + 1)) < 0.4).repeat(4, 0).repeat(4, 1)[:height, :width]
    values = np.where(gaps, np.nan, blocks[:height, :width]).astype(np.float32)
    volume = random_volume(height, width, disparities, np.uint16)
    disparity, context = with_context(values, Status.OCCLUDED, volume)
    disparity = refinement("background_fill")(disparity, context)
    measured = ~np.isnan(disparity.values) & ~disparity.filled
    image = cv2.GaussianBlur(context.pair.color8[0], (7, 7), 1.0)
    expected, decided = naive.directional_fill(disparity.values, measured, image, context.right, *scales)
    result = refinement("directional_fill", color_scale=scales[0], distance_scale=scales[1])(disparity, context)
    np.testing.assert_array_equal(result.values[decided], expected[decided])
    np.testing.assert_array_equal(result.status, disparity.status)
    np.testing.assert_array_equal(result.values[measured], disparity.values[measured])
    assert height < 26 or np.count_nonzero(result.values != disparity.values) > 10


shapes = pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (14, 63), (10, 64), (12, 65), (3, 130)])


def bumpy(shape):
    """A slanted surface with noise, a step and holes."""
    rng, (y, x) = np.random.default_rng(0), np.indices(shape)
    values = 20 + 0.3 * x - 0.1 * y + rng.normal(0, 0.3, shape)
    values[:, shape[1] // 2 :] -= 8
    values[rng.random(shape) < 0.15] = np.nan
    return np.maximum(values, 0).astype(np.float32), blocky_pair(*shape).color8[0]


@pytest.mark.slow
@shapes
@pytest.mark.parametrize("radius", [4, 9])
def test_slopes(shape, radius):
    values, image = bumpy(shape)
    image //= 8  # similar colors, but not all of them
    np.testing.assert_allclose(slopes(values, image, radius), naive.slopes(values, image, radius), atol=2e-3)


@shapes
def test_slanted_median(shape):
    values, image = bumpy(shape)
    result = refinement("slanted_median", radius=3, color_scale=20, distance_scale=4).filtered(values, image, 200)
    low, high = naive.weighted_median(values, image, 3, 20, 4, gradient=slopes(values, image, 16))
    valid = ~np.isnan(values)
    np.testing.assert_array_equal(np.isnan(result), ~valid)
    # Intervals of 1/16, then steps of 1/8.
    assert np.all(result[valid] >= np.maximum(low[valid], 0) - 0.1)
    assert np.all(result[valid] <= np.maximum(high[valid], 0) + 0.1)


def test_only_steps_that_look_at_whole_regions_have_no_halo():
    family = Family.of("depthcli.methods.stereo.refinement")
    wide = {name for name in family.own_names if part("methods.stereo.refinement", name).halo() is None}
    assert wide == {"background_fill", "discontinuity_adjustment", "interpolation", "speckle_filter"}

"""Costs, aggregations, optimizations and refinement steps of stereo against their slow, obvious references."""

from dataclasses import replace
from functools import partial
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.window_slopes import slopes
from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.method import Family
from depthcli.kernels.winners import winners
from depthcli.methods.stereo.aggregation.cross import cross_arms
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.cost.gradient import image_gradient
from depthcli.methods.stereo.optimization import scanline
from depthcli.methods.stereo.volume import CostVolume, RefinementContext, as_fixed_point
from depthcli.testing.inputs import TINY, blocky_pair, random_volume, texture
from tests.contracts.inputs import part
from tests.golden import refused
from tests.naive import stereo as naive

cost, aggregation, optimization, refinement = (
    partial(part, f"methods.stereo.{kind}") for kind in ("cost", "aggregation", "optimization", "refinement")
)
SMALL = [*TINY, (11, 23, 19)]
sizes = pytest.mark.parametrize(("height", "width", "disparities"), SMALL)
in_color = pytest.mark.parametrize("color", [False, True])


def random_pair(height, width, color, dtype=np.uint8):
    shape = (height, width, 3) if color else (height, width)
    return StereoPair(texture(shape, 1, dtype), texture(shape, 2, dtype))


@sizes
@in_color
def test_absolute_difference(height, width, disparities, color):
    pair, channels = random_pair(height, width, color), 3 if color else 1
    limits = min(60 * channels, 255), 20 * channels
    volume = cost("absolute_difference")(pair, disparities)
    assert volume.scale == channels
    np.testing.assert_array_equal(volume.costs, naive.absolute_difference(pair.left, pair.right, disparities, *limits))
    left, right = (image.reshape(height, width, channels) for image in (pair.left, pair.right))
    tolerant = cost("absolute_difference", sampling="tolerant")(pair, disparities)
    np.testing.assert_array_equal(tolerant.costs, naive.tolerant_difference(left, right, disparities, *limits))


@sizes
def test_tolerant_gradient(height, width, disparities):
    pair, measure = random_pair(height, width, False), cost("gradient", sampling="tolerant")
    left, right = (image_gradient(image, measure.sigma).transpose(1, 2, 0) for image in pair.grey)
    expected = naive.tolerant_difference(left, right, disparities, 160, 16, divisor=4)
    np.testing.assert_array_equal(measure(pair, disparities).costs, expected)


WINDOWS = ("census", (9, 7)), ("census", (1, 3)), ("rank", (9, 9)), ("rank", (3, 1))
ZNCC = ((9, 9), 2.0), ((1, 3), 0.5), ((5, 1), 20.0)
GREY_COSTS = [
    *((name, {"window": window}, dtype) for name, window in WINDOWS for dtype in (np.uint8, np.uint16)),
    *(pytest.param("zncc", {"window": w, "noise": n}, np.uint8, marks=pytest.mark.slow) for w, n in ZNCC),
    ("gradient", {"truncation": 40.0}, np.uint8),
]
# The gradient: four rounded sixteenths, then quarters.
ROUNDING = {"census": 0, "rank": 0, "zncc": 0.51 / 250 + 1e-4, "gradient": 4 / 32 + 1 / 8 + 1e-4}


@sizes
@pytest.mark.parametrize(("name", "fields", "dtype"), GREY_COSTS)
def test_costs_of_grey_images(height, width, disparities, name, fields, dtype):
    pair, measure = random_pair(height, width, False, dtype), cost(name, **fields)
    volume = measure(pair, disparities)
    expected = getattr(naive, name)(pair.left, pair.right, disparities, *fields.values(), measure.outside)
    np.testing.assert_allclose(volume.costs / volume.scale, expected, atol=ROUNDING[name])


CHAPTER_3 = [
    {"outside": "border", "filter": filter, "channels": channels, "limits": limits}
    for filter in ("sobel", "dog") for channels in ("grey", "color") for limits in (None, (40, 25))
]  # fmt: skip


@sizes
@pytest.mark.parametrize(("fields", "color", "rtol", "atol"), [
    ({"outside": 7}, False, 1e-6, 0), ({"outside": 7}, True, 1e-6, 0), *((each, True, 1e-4, 1e-3) for each in CHAPTER_3)
])  # fmt: skip
def test_intensity_gradient(height, width, disparities, fields, color, rtol, atol):
    pair, measure = random_pair(height, width, color), cost("intensity_gradient", **fields)
    greys, rule = pair.grey8 if measure.channels == "grey" else pair.color8, (measure.filter, measure.limits)
    expected = naive.intensity_gradient(pair.color8, greys, disparities, measure.outside, *rule)
    np.testing.assert_allclose(measure(pair, disparities).costs, expected, rtol=rtol, atol=atol)


@sizes
def test_combined(height, width, disparities):
    """Without and with the trust in the light of pixels."""
    pair, trust = random_pair(height, width, True), texture((height, width), 7)
    trust[0, 0] = 255
    lambdas = {"absolute_difference": 10.0, "census": 30.0, "rank": 15.0}
    combined = cost("combined", parts=[{"cost": name, "lambda": value} for name, value in lambdas.items()])
    volumes = [(part.cost(pair, disparities), part.lambda_) for part in combined.parts]
    weights = np.stack([trust / 255, *2 * [1 + 0.4 * 0.5 * (1 - trust / 255)]])
    for light_trust, given in ((None, ()), (trust, (weights,))):
        volume = combined(replace(pair, light_trust=light_trust), disparities)
        expected = naive.combined([(v.costs / v.scale, scale) for v, scale in volumes], combined.outside, *given)
        np.testing.assert_allclose(volume.costs / volume.scale, expected, atol=3 * 0.52 / volume.scale)


@sizes
@pytest.mark.parametrize("window", [1, 3, 11])
def test_constant_window(height, width, disparities, window):
    volume = random_volume(height, width, disparities)
    result = aggregation("constant_window", window=window)(volume, blocky_pair(height, width))
    np.testing.assert_allclose(result.costs / result.scale, naive.constant_window(volume.costs, window), atol=0.51 / 16)


@sizes
@in_color
def test_cross_arms(height, width, disparities, color):
    image = np.atleast_3d(blocky_pair(height, width, color, seed=disparities).left)
    for rule in ((7, 20, 3, 6), (34, 12, 34, 12), (1, 255, 0, 0)):
        np.testing.assert_array_equal(cross_arms(image, *rule), naive.cross_arms(image, *rule))
        length, threshold, *_ = rule
        literal = cross_arms(image, length, threshold, length, threshold, consecutive=False)
        np.testing.assert_array_equal(literal, naive.thesis_arms(image, length, threshold))


@pytest.mark.slow
@sizes
@pytest.mark.parametrize("support", ["reference", "intersection"])
def test_cross(height, width, disparities, support):
    pair, volume = blocky_pair(height, width), random_volume(height, width, disparities)
    fields = {"length": 6, "threshold": 40, "inner_length": 3, "inner_threshold": 20, "iterations": 2}
    method = aggregation("cross", **fields, support=support)
    arms, target = (method.arms(view) for view in pair.color8)
    expected = volume.costs.astype(float)
    for horizontal_first in (True, False):
        other = target.astype(int) if support == "intersection" else None
        expected = naive.cross(expected, arms.astype(int), horizontal_first, other)
    result = method(volume, pair)
    np.testing.assert_allclose(result.costs / result.scale, expected, atol=0.6)


@pytest.mark.slow
@sizes
@pytest.mark.parametrize(("norm", "gamma_color"), [("l2", 20.0), ("squared", 900.0)])
def test_adaptive_weight(height, width, disparities, norm, gamma_color):
    pair, volume = blocky_pair(height, width), random_volume(height, width, disparities)
    fields = {"window": 5, "color_space": "rgb", "norm": norm, "gamma_color": gamma_color, "gamma_space": 5.0}
    method = aggregation("adaptive_weight", **fields)
    left, right = (view.astype(float) for view in pair.color8)
    expected = naive.adaptive_weight(volume.costs, left, right, 2, gamma_color, 5.0, norm == "squared")
    result = method(volume, pair)
    np.testing.assert_allclose(result.costs / result.scale, expected, atol=0.51 / 16)
    exact = method(CostVolume(volume.costs.astype(np.float32)), pair)
    np.testing.assert_allclose(exact.costs, expected, rtol=2e-5, atol=1e-4)


@pytest.mark.slow
def test_adaptive_weight_in_lab_with_a_window_beyond_the_image_and_of_far_colors():
    pair, volume = blocky_pair(9, 14), random_volume(9, 14, 21)
    left, right = (cv2.cvtColor(view.astype(np.float32) / 255, cv2.COLOR_RGB2Lab).astype(float) for view in pair.color8)
    expected = naive.adaptive_weight(volume.costs, left, right, 16, 10.0, 36.0)
    result = aggregation("adaptive_weight")(volume, pair)
    np.testing.assert_allclose(result.costs / result.scale, expected, atol=0.51 / 16)
    # Weights that vanish must not turn into zero by zero.
    image = np.indices((9, 14)).sum(axis=0)[..., None].repeat(3, axis=2) % 2
    pair = StereoPair(*[(255 - 255 * image).astype(np.uint8)] * 2)
    result = aggregation("adaptive_weight", window=3, gamma_color=0.5, gamma_space=0.1)(volume, pair)
    np.testing.assert_allclose(result.costs / 16, volume.costs, atol=0.2)


@sizes
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_winners(height, width, disparities, dtype):
    volume = random_volume(height, width, disparities, dtype)
    volume.costs[...] //= 16  # many ties
    minima = np.empty((height, width), np.float32)
    left, right = winners(volume.costs, minima)
    for found, expected in zip((left, right), naive.winners(volume.costs), strict=True):
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_allclose(minima, naive.subpixel(volume.costs, left.astype(np.float32)), rtol=1e-6)


def scan(paths):
    return optimization("scanline", p1=17, p2=70, paths=paths, edge_threshold=20, edge_divisor=3)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("paths", [4, 8])
@pytest.mark.parametrize("disparities", [1, 2, 15, 16, 17, 31, 33, 60])
def test_scanline_at_every_number_of_disparities(disparities, paths, dtype):
    """The kernel works in vectors of 16 disparities; the last one overlaps, and fewer than 16 are padded."""
    for height, width in ((1, 1), (1, 9), (7, 13)):
        pair, volume = blocky_pair(height, width), random_volume(height, width, disparities, dtype)
        result = scan(paths)(volume, pair)
        assert result.scale == paths
        np.testing.assert_array_equal(result.costs, naive.scanline(volume.costs, pair.left, 17, 70, paths, 20, 3))


@pytest.mark.parametrize("paths", [4, 8])
@pytest.mark.parametrize("largest", [90, 183, 184, 255])
@pytest.mark.parametrize("height", [1, 2, 3, 8])
def test_scanline_in_bytes_has_the_same_sums(monkeypatch, height, largest, paths):
    """Where the largest cost and P2 are less than 255 together, path costs fit into bytes."""
    rng = np.random.default_rng(largest)
    image = rng.integers(0, 255, (height, 21, 3)).astype(np.uint8)
    costs = rng.integers(0, largest + 1, (height, 21, 45)).astype(np.uint8)
    costs[0, 0, 0] = largest
    expected = naive.scanline(costs, image, 17, 70, paths, 20, 3)
    for guard in (scanline._BYTE_GUARD, 0):
        monkeypatch.setattr(scanline, "_BYTE_GUARD", guard)
        np.testing.assert_array_equal(scan(paths)(CostVolume(costs), StereoPair(image, image)).costs, expected)


@pytest.mark.parametrize("tile", [(1, 1), (2, 3), (3, 2), (4, 40), (16, 96)])
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (12, 21), (21, 12)])
@pytest.mark.parametrize("paths", [4, 8])
def test_scanline_in_tiles_for_more_than_two_threads_has_the_same_sums(monkeypatch, shape, tile, paths):
    pair, volume = blocky_pair(*shape), random_volume(*shape, 33, np.uint8)
    expected = scan(paths)(volume, pair).costs
    monkeypatch.setattr(scanline, "_TILE", tile)
    monkeypatch.setattr(scanline, "n_threads", lambda: 4)
    np.testing.assert_array_equal(scan(paths)(volume, pair).costs, expected)


@pytest.mark.parametrize("disparities", [9, 16, 40])
def test_scanline_of_the_largest_costs_and_penalties_fits_into_its_numbers(disparities):
    pair, cap = blocky_pair(6, 11), 65535 // 8 - 4080
    costs = np.random.default_rng(3).choice(np.array([0, 4080], np.uint16), (6, 11, disparities))
    method = optimization("scanline", p1=1e6, p2=1e6, paths=8)
    expected = naive.scanline(costs, pair.left, cap, cap, 8, method.edge_threshold, method.edge_divisor)
    np.testing.assert_array_equal(method(CostVolume(costs), pair).costs, expected)


@pytest.mark.parametrize("level", [3, 77, 301])
def test_means_of_small_integers_have_no_bias(level):
    """Sums that are kept in 16 bits are rounded, not cut off: means must not come out too low."""
    costs = (level + np.random.default_rng(level).integers(-2, 3, (60, 80, 6))).astype(np.uint16)
    wide = {"length": 34, "threshold": 90, "inner_length": 17, "inner_threshold": 90, "iterations": 1}
    for method in (
        aggregation("constant_window", window=5), aggregation("cross", **wide),
        aggregation("cross", **wide, support="intersection"),
    ):  # fmt: skip
        means = method(CostVolume(costs), blocky_pair(60, 80)).costs
        assert abs(means.mean() - costs.mean()) < 0.2, method


def test_float_costs_below_zero_become_fixed_points_from_zero():
    fixed = as_fixed_point(CostVolume(np.array([[[-1, 0, 3]]], np.float32), 2.0))
    assert fixed.costs.tolist() == [[[0, 1020, 4080]]] and fixed.scale == 2 * 1020


def test_costs_of_another_shape_or_type_are_refused(monkeypatch):
    costs, pair = np.zeros((6, 9, 4), np.uint8), blocky_pair(6, 9)
    refused(ValueError, CostVolume, costs[:, :, ::2])
    refused(TypeError, CostVolume, costs.astype(np.float64))
    unknown = CostVolume(np.full_like(costs, np.nan, np.float32))
    for made in (costs, CostVolume(costs[1:]), unknown, CostVolume(costs, 0)):
        monkeypatch.setattr(Census, "__call__", Mock(return_value=made))
        refused(InputError, Census().checked_costs, pair, 4)


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

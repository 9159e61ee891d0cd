"""Every stereo kernel against its slow, obvious reference."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.kernels.winners import winners
from depthcli.methods.stereo.aggregation.adaptive_weight import AdaptiveWeight
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.aggregation.cross import Cross, cross_arms
from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.cost.combined import Combined
from depthcli.methods.stereo.cost.gradient import Gradient, image_gradient
from depthcli.methods.stereo.cost.intensity_gradient import IntensityGradient
from depthcli.methods.stereo.cost.rank import Rank
from depthcli.methods.stereo.cost.zncc import Zncc
from depthcli.methods.stereo.optimization import scanline
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.refinement.background_fill import BackgroundFill
from depthcli.methods.stereo.refinement.discontinuity_adjustment import DiscontinuityAdjustment
from depthcli.methods.stereo.refinement.interpolation import Interpolation
from depthcli.methods.stereo.refinement.left_right_check import LeftRightCheck
from depthcli.methods.stereo.refinement.median import Median
from depthcli.methods.stereo.refinement.region_voting import RegionVoting
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.refinement.subpixel import Subpixel
from depthcli.methods.stereo.refinement.surface_fill import SurfaceFill
from depthcli.methods.stereo.refinement.weighted_median import WeightedMedian
from depthcli.methods.stereo.volume import CostVolume, RefinementContext
from depthcli.testing.inputs import TINY, blocky_pair, random_volume, texture
from tests.naive import stereo as naive

SMALL = [*TINY, (11, 23, 19)]
sizes = pytest.mark.parametrize(("height", "width", "disparities"), SMALL)


def random_pair(height, width, color, dtype=np.uint8):
    shape = (height, width, 3) if color else (height, width)
    return StereoPair(texture(shape, 1, dtype), texture(shape, 2, dtype))


@sizes
@pytest.mark.parametrize("color", [False, True])
def test_absolute_difference(height, width, disparities, color):
    pair, channels = random_pair(height, width, color), 3 if color else 1
    limits = min(60 * channels, 255), 20 * channels
    volume = AbsoluteDifference()(pair, disparities)
    assert volume.scale == channels
    np.testing.assert_array_equal(volume.costs, naive.absolute_difference(pair.left, pair.right, disparities, *limits))
    left, right = (image.reshape(height, width, channels) for image in (pair.left, pair.right))
    tolerant = AbsoluteDifference(sampling="tolerant")(pair, disparities)
    np.testing.assert_array_equal(tolerant.costs, naive.tolerant_difference(left, right, disparities, *limits))


@sizes
def test_tolerant_gradient(height, width, disparities):
    pair, cost = random_pair(height, width, False), Gradient(sampling="tolerant")
    left, right = (image_gradient(image, cost.sigma).transpose(1, 2, 0) for image in pair.grey)
    expected = naive.tolerant_difference(left, right, disparities, 160, 16, divisor=4)
    np.testing.assert_array_equal(cost(pair, disparities).costs, expected)


@pytest.mark.parametrize("cost", [AbsoluteDifference(sampling="tolerant"), Gradient(sampling="tolerant")])
def test_tolerant_costs_do_not_see_half_a_pixel(cost):
    """Fine texture seen by two cameras whose pixels lie half a pixel apart."""
    fine = np.repeat(texture((30, 120), 3), 2, axis=1).astype(np.float32)
    views = [((fine[:, k : k + 200 : 2] + fine[:, k + 1 : k + 201 : 2]) / 2).astype(np.uint8) for k in (0, 1)]
    pair = StereoPair(*views)
    plain = type(cost)()(pair, 1).costs[4:-4, 4:-4].mean()
    assert cost(pair, 1).costs[4:-4, 4:-4].mean() < 0.3 * plain


@sizes
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    ("cost", "reference", "window"),
    [
        (Census, naive.census, (9, 7)),
        (Census, naive.census, (1, 3)),
        (Rank, naive.rank, (9, 9)),
        (Rank, naive.rank, (3, 1)),
    ],
)
def test_census_and_rank(height, width, disparities, dtype, cost, reference, window):
    pair = random_pair(height, width, False, dtype)
    expected = reference(pair.left, pair.right, disparities, window, 16)
    np.testing.assert_array_equal(cost(window=window)(pair, disparities).costs, expected)


@pytest.mark.slow
@sizes
@pytest.mark.parametrize(("window", "noise"), [((9, 9), 2.0), ((1, 3), 0.5), ((5, 1), 20.0)])
def test_zncc(height, width, disparities, window, noise):
    pair, cost = random_pair(height, width, False), Zncc(window=window, noise=noise)
    volume = cost(pair, disparities)
    expected = naive.zncc(pair.left, pair.right, disparities, window, noise, cost.outside)
    np.testing.assert_allclose(volume.costs / volume.scale, expected, atol=0.51 / volume.scale + 1e-4)


@sizes
def test_gradient(height, width, disparities):
    pair, cost = random_pair(height, width, False), Gradient()
    volume = cost(pair, disparities)
    expected = naive.gradient(pair.left, pair.right, disparities, cost.truncation, cost.outside)
    # Four rounded sixteenths, then quarters.
    np.testing.assert_allclose(volume.costs / volume.scale, expected, atol=4 / 32 + 1 / 8 + 1e-4)


@sizes
@pytest.mark.parametrize("color", [False, True])
def test_intensity_gradient(height, width, disparities, color):
    pair, cost = random_pair(height, width, color), IntensityGradient(outside=7)
    expected = naive.intensity_gradient(pair.color8, pair.grey8, disparities, cost.outside)
    np.testing.assert_allclose(cost(pair, disparities).costs, expected, rtol=1e-6)


@sizes
@pytest.mark.parametrize("filter", ["sobel", "dog"])
@pytest.mark.parametrize("channels", ["grey", "color"])
@pytest.mark.parametrize("limits", [None, (40, 25)])
def test_intensity_gradient_as_chapter_3_has_it(height, width, disparities, filter, channels, limits):
    pair = random_pair(height, width, True)
    cost = IntensityGradient(filter=filter, channels=channels, limits=limits, outside="border")
    greys = pair.grey8 if channels == "grey" else pair.color8
    expected = naive.intensity_gradient(pair.color8, greys, disparities, "border", filter, limits)
    np.testing.assert_allclose(cost(pair, disparities).costs, expected, rtol=1e-4, atol=1e-3)


@sizes
def test_combined(height, width, disparities):
    pair = random_pair(height, width, True)
    parts = [("absolute_difference", 10.0), ("census", 30.0), ("rank", 15.0)]
    combined = Combined.model_validate({"parts": [{"cost": name, "lambda": value} for name, value in parts]})
    volume = combined(pair, disparities)
    volumes = [(part.cost(pair, disparities), part.lambda_) for part in combined.parts]
    expected = naive.combined([(v.costs / v.scale, scale) for v, scale in volumes], combined.outside)
    np.testing.assert_allclose(volume.costs / volume.scale, expected, atol=len(parts) * 0.52 / volume.scale)
    trust = texture((height, width), 7)
    trust[0, 0] = 255
    volume = combined(replace(pair, light_trust=trust), disparities)
    weights = np.stack([trust / 255, *2 * [1 + 0.4 * 0.5 * (1 - trust / 255)]])
    expected = naive.combined([(v.costs / v.scale, scale) for v, scale in volumes], combined.outside, weights)
    np.testing.assert_allclose(volume.costs / volume.scale, expected, atol=len(parts) * 0.52 / volume.scale)


@sizes
@pytest.mark.parametrize("window", [1, 3, 11])
def test_constant_window(height, width, disparities, window):
    volume = random_volume(height, width, disparities)
    result = ConstantWindow(window=window)(volume, blocky_pair(height, width))
    np.testing.assert_allclose(result.costs / result.scale, naive.constant_window(volume.costs, window), atol=0.51 / 16)


@sizes
@pytest.mark.parametrize("color", [False, True])
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
    method = Cross(length=6, threshold=40, inner_length=3, inner_threshold=20, iterations=2, support=support)
    arms, target = (method.arms(view) for view in pair.color8)
    expected = volume.costs.astype(float)
    for horizontal_first in (True, False):
        expected = naive.cross(
            expected, arms.astype(int), horizontal_first, target.astype(int) if support == "intersection" else None
        )
    result = method(volume, pair)
    np.testing.assert_allclose(result.costs / result.scale, expected, atol=0.6)


@pytest.mark.slow
@sizes
@pytest.mark.parametrize(("norm", "gamma_color"), [("l2", 20.0), ("squared", 900.0)])
def test_adaptive_weight(height, width, disparities, norm, gamma_color):
    pair, volume = blocky_pair(height, width), random_volume(height, width, disparities)
    method = AdaptiveWeight(window=5, color_space="rgb", norm=norm, gamma_color=gamma_color, gamma_space=5.0)
    left, right = (view.astype(float) for view in pair.color8)
    expected = naive.adaptive_weight(volume.costs, left, right, 2, gamma_color, 5.0, norm == "squared")
    result = method(volume, pair)
    np.testing.assert_allclose(result.costs / result.scale, expected, atol=0.51 / 16)
    exact = method(CostVolume(volume.costs.astype(np.float32)), pair)
    np.testing.assert_allclose(exact.costs, expected, rtol=2e-5, atol=1e-4)


@pytest.mark.slow
def test_adaptive_weight_in_lab_and_a_window_beyond_the_image():
    pair, volume = blocky_pair(9, 14), random_volume(9, 14, 21)
    left, right = (cv2.cvtColor(view.astype(np.float32) / 255, cv2.COLOR_RGB2Lab).astype(float) for view in pair.color8)
    expected = naive.adaptive_weight(volume.costs, left, right, 16, 10.0, 36.0)
    result = AdaptiveWeight()(volume, pair)
    np.testing.assert_allclose(result.costs / result.scale, expected, atol=0.51 / 16)


def test_adaptive_weight_of_far_colors_is_the_cost_itself():
    """Weights that vanish must not turn into zero by zero."""
    image = np.zeros((6, 10, 3), np.uint8)
    image[::2, ::2] = image[1::2, 1::2] = 255
    volume = random_volume(6, 10, 4)
    result = AdaptiveWeight(window=3, gamma_color=0.5, gamma_space=0.1)(volume, StereoPair(image, image))
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


def holes(height, width, disparities, seed=5):
    rng = np.random.default_rng(seed)
    volume = random_volume(height, width, disparities, np.uint16)
    left, right = winners(volume.costs)
    values = left.astype(np.float32)
    values[rng.random((height, width)) < 0.3] = np.nan
    values[: height // 4] = np.nan
    values[-1:] = np.nan
    status = np.where(np.isnan(values), Status.MISMATCH, 0).astype(np.uint8)
    return DisparityMap(values, status), RefinementContext(blocky_pair(height, width), volume, right)


@sizes
@pytest.mark.parametrize("tolerance", [0.0, 1.0])
def test_left_right_check(height, width, disparities, tolerance):
    disparity, evidence = holes(height, width, disparities)
    result = LeftRightCheck(tolerance=tolerance)(disparity, evidence)
    values, occluded, mismatch = naive.left_right_check(disparity.values, evidence.right, disparities, tolerance)
    np.testing.assert_array_equal(result.values, values)
    np.testing.assert_array_equal(result.status & Status.OCCLUDED != 0, occluded)
    np.testing.assert_array_equal(result.status & Status.MISMATCH != 0, mismatch | (disparity.status != 0))


@sizes
@pytest.mark.parametrize(
    ("step", "reference"),
    [
        (BackgroundFill(), lambda values, costs: naive.background_fill(values)),
        (Median(window=3), lambda values, costs: naive.median(values, 3)),
        (Median(window=5), lambda values, costs: naive.median(values, 5)),
        (Subpixel(), lambda values, costs: naive.subpixel(costs, values)),
        (DiscontinuityAdjustment(), naive.discontinuity_adjustment),
    ],
    ids=lambda each: each.method_name() if hasattr(each, "method_name") else "",
)
def test_steps_without_parameters(height, width, disparities, step, reference):
    disparity, evidence = holes(height, width, disparities)
    expected = reference(disparity.values, evidence.volume.costs)
    np.testing.assert_allclose(step(disparity, evidence).values, expected, rtol=1e-6)


@sizes
def test_region_voting(height, width, disparities):
    disparity, evidence = holes(height, width, disparities)
    few = DisparityMap(np.minimum(disparity.values, 2).astype(np.float32), disparity.status)  # so that supports agree
    step = RegionVoting(length=5, threshold=40, inner_length=3, inner_threshold=20, votes=3, iterations=1)
    arms = naive.cross_arms(evidence.pair.color8[0], 5, 40, 3, 20)
    expected = naive.region_voting(few.values, arms, disparities, 3, step.majority)
    np.testing.assert_array_equal(step(few, evidence).values, expected)


@sizes
def test_interpolation(height, width, disparities):
    disparity, evidence = holes(height, width, disparities)
    status = disparity.status.copy()
    status[:, ::2][status[:, ::2] != 0] = Status.OCCLUDED
    result = Interpolation()(DisparityMap(disparity.values, status), evidence).values
    expected = naive.interpolation(disparity.values, status == Status.OCCLUDED, evidence.pair.color8[0])
    # Where two values are equally like in color the reference does not decide.
    decided = ~np.isnan(expected)
    np.testing.assert_array_equal(result[decided], expected[decided])
    assert not np.any(np.isnan(result) & decided)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("paths", [4, 8])
@pytest.mark.parametrize("disparities", [1, 2, 15, 16, 17, 31, 33, 60])
def test_scanline_at_every_number_of_disparities(disparities, paths, dtype):
    """The kernel works in vectors of 16 disparities; the last one overlaps, and fewer than 16 are padded."""
    for height, width in ((1, 1), (1, 9), (7, 13)):
        pair, volume = blocky_pair(height, width), random_volume(height, width, disparities, dtype)
        result = Scanline(p1=17, p2=70, paths=paths, edge_threshold=20, edge_divisor=3)(volume, pair)
        assert result.scale == paths
        expected = naive.scanline(volume.costs, pair.left, 17, 70, paths, 20, 3)
        np.testing.assert_array_equal(result.costs, expected)


@pytest.mark.parametrize("paths", [4, 8])
@pytest.mark.parametrize("largest", [90, 183, 184, 255])
@pytest.mark.parametrize("height", [1, 2, 3, 8])
def test_scanline_in_bytes_has_the_same_sums(monkeypatch, height, largest, paths):
    """Where the largest cost and P2 are less than 255 together, path costs fit into bytes."""
    rng = np.random.default_rng(largest)
    image = rng.integers(0, 255, (height, 21, 3)).astype(np.uint8)
    costs = rng.integers(0, largest + 1, (height, 21, 45)).astype(np.uint8)
    costs[0, 0, 0] = largest
    method = Scanline(p1=17, p2=70, paths=paths, edge_threshold=20, edge_divisor=3)
    found = [method(CostVolume(costs), StereoPair(image, image)).costs]
    monkeypatch.setattr(scanline, "_BYTE_GUARD", 0)
    found.append(method(CostVolume(costs), StereoPair(image, image)).costs)
    np.testing.assert_array_equal(*found)
    np.testing.assert_allclose(found[0], naive.scanline(costs, image, 17, 70, paths, 20, 3), atol=1e-3)


@pytest.mark.parametrize("tile", [(1, 1), (2, 3), (3, 2), (4, 40), (16, 96)])
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (12, 21), (21, 12)])
@pytest.mark.parametrize("paths", [4, 8])
def test_scanline_in_tiles_for_more_than_two_threads_has_the_same_sums(monkeypatch, shape, tile, paths):
    pair, volume = blocky_pair(*shape), random_volume(*shape, 33, np.uint8)
    method = Scanline(p1=17, p2=70, paths=paths, edge_threshold=20, edge_divisor=3)
    found = [method(volume, pair).costs]
    monkeypatch.setattr(scanline, "_TILE", tile)
    monkeypatch.setattr(scanline, "n_threads", lambda: 4)
    found.append(method(volume, pair).costs)
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("disparities", [9, 16, 40])
def test_scanline_of_the_largest_costs_and_penalties_fits_into_its_numbers(disparities):
    pair = blocky_pair(6, 11)
    costs = np.random.default_rng(3).choice(np.array([0, 4080], np.uint16), (6, 11, disparities))
    result = Scanline(p1=1e6, p2=1e6, paths=8)(CostVolume(costs), pair)
    method = Scanline()
    cap = 65535 // 8 - 4080
    expected = naive.scanline(costs, pair.left, cap, cap, 8, method.edge_threshold, method.edge_divisor)
    np.testing.assert_array_equal(result.costs, expected)


def fractional_holes(height, width, disparities, seed=6):
    """Smooth surfaces with steps, fractions, holes and islands."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width]
    values = 0.2 * disparities + 0.06 * x + 0.04 * y + np.where(x > 0.6 * width, 0.4 * disparities, 0)
    values = np.clip(values + rng.normal(0, 0.3, values.shape), 0, disparities - 1).astype(np.float32)
    islands = rng.random(values.shape) < 0.03
    values[islands] = rng.uniform(0, disparities - 1, islands.sum())
    values[rng.random(values.shape) < 0.1] = np.nan
    gap = (x > 0.4 * width) & (x < 0.6 * width + y % 3)
    values[gap | (x < disparities // 5)] = np.nan
    values[height // 2] = np.nan
    status = np.where(np.isnan(values), Status.OCCLUDED, 0).astype(np.uint8)
    volume = random_volume(height, width, disparities, np.uint16)
    return DisparityMap(values, status), RefinementContext(blocky_pair(height, width), volume, winners(volume.costs)[1])


@pytest.mark.parametrize("width", [1, 15, 16, 17, 32, 33, 50])
@pytest.mark.parametrize("filled_weight", [0.0, 0.3, 1.0])
def test_weighted_median_of_fractions_at_every_width(width, filled_weight):
    """The kernel works on 16 pixels at a time and sorts into bins of 1/8."""
    disparity, evidence = fractional_holes(12, width, 20)
    status = disparity.status.copy()
    status[::2][disparity.valid[::2]] = Status.OCCLUDED | Status.FILLED
    step = WeightedMedian(radius=4, color_scale=20, distance_scale=4, filled_weight=filled_weight)
    result = step(DisparityMap(disparity.values, status), evidence).values
    trust = np.where(status & Status.FILLED, filled_weight, 1.0)
    low, high = naive.weighted_median(disparity.values, trust, evidence.pair.color8[0], 4, 20, 4)
    valid = disparity.valid
    np.testing.assert_array_equal(np.isnan(result), ~valid)
    assert np.all((result[valid] >= low[valid]) & (result[valid] <= high[valid]))


@pytest.mark.slow
@pytest.mark.parametrize(("height", "width", "disparities"), [*SMALL, (24, 60, 30)])
def test_surface_fill(height, width, disparities):
    disparity, evidence = fractional_holes(height, width, disparities)
    for rows, reach, support in ((20, 20, 30), (2, 7, 3), (0, 3, 3)):
        expected = naive.surface_fill(disparity.values, rows, reach, support, disparities - 1)
        result = SurfaceFill(rows=rows, reach=reach, support=support)(disparity, evidence)
        np.testing.assert_allclose(result.values, expected, atol=2e-3)


@pytest.mark.parametrize(("height", "width", "disparities"), [*SMALL, (70, 12, 5)])
@pytest.mark.parametrize(("size", "step"), [(1, 0.0), (4, 1.0), (30, 2.0)])
def test_speckle_filter(height, width, disparities, size, step):
    for disparity, evidence in (holes(height, width, disparities), fractional_holes(height, width, disparities)):
        # OpenCV filters sixteenths.
        rounded = (np.round(disparity.values * 16) / 16).astype(np.float32)
        disparity = DisparityMap(rounded, disparity.status)
        result = SpeckleFilter(size=size, step=step)(disparity, evidence)
        np.testing.assert_array_equal(result.values, naive.speckle_filter(disparity.values, size, step))
        assert np.all(result.status[disparity.valid & ~result.valid] & Status.MISMATCH)


@pytest.mark.parametrize("level", [3, 77, 301])
def test_means_of_small_integers_have_no_bias(level):
    """Sums that are kept in 16 bits are rounded, not cut off: means must not come out too low."""
    pair = blocky_pair(60, 80)
    rng = np.random.default_rng(level)
    costs = (level + rng.integers(-2, 3, (60, 80, 6))).astype(np.uint16)
    for method in (
        ConstantWindow(window=5),
        Cross(length=34, threshold=90, inner_length=17, inner_threshold=90, iterations=1),
        Cross(length=34, threshold=90, inner_length=17, inner_threshold=90, iterations=1, support="intersection"),
    ):
        means = method(CostVolume(costs), pair).costs
        assert abs(means.mean() - costs.mean()) < 0.2, method

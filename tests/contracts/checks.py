"""What every member of a family promises: a function a promise, beside those of ``depthcli.testing``."""

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import ndimage

from depthcli.core.frames import RgbdFrame, StereoPair
from depthcli.core.maps import DepthStatus, Status
from depthcli.core.volumes import RegisteredPair
from depthcli.kernels.winners import winners
from depthcli.methods.registration.search import search
from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.volume import CostVolume
from depthcli.testing import cost, optimization, refinement
from depthcli.testing.inputs import TINY, assert_pure, blocky_pair, changed, inside, random_volume, shifted_pair
from tests.contracts.inputs import blobs, gaps, glass, random_proposals, soft_volume
from tests.golden import refused

CHECKS: dict[str, list[Callable[[Any], None]]] = {
    "methods.stereo.boundary": list(optimization.BOUNDARY_CHECKS),
    "methods.stereo.cost": list(cost.CHECKS),
    "methods.stereo.optimization": list(optimization.OPTIMIZER_CHECKS),
    "methods.stereo.refinement": list(refinement.CHECKS),
}
"""Package of a family -> what its members promise."""

TYPES = (np.uint8, np.uint16, np.float32)


def of(*packages: str) -> Callable[[Callable[[Any], None]], Callable[[Any], None]]:
    """Return a decorator that makes a function a promise of families."""

    def add(check: Callable[[Any], None]) -> Callable[[Any], None]:
        for package in packages:
            CHECKS.setdefault(package, []).append(check)
        return check

    return add


# Cost volumes: aggregations.


@of("methods.stereo.aggregation")
def mean_of_equal_costs_is_that_cost(aggregate):
    for dtype in TYPES:
        stored = 77 * 16 if dtype == np.uint16 else 77  # uint16 costs are fixed point
        result = aggregate(CostVolume(np.full((20, 30, 18), stored, dtype), 3.0), blocky_pair(20, 30))
        assert result.costs.shape == (20, 30, 18)
        np.testing.assert_allclose(result.costs / result.scale, stored / 3, rtol=0.01)


@of("methods.stereo.aggregation")
def means_lie_between_the_costs_at_any_number_of_threads(aggregate):
    for height, width, disparities in TINY:
        for dtype, color in itertools.product(TYPES[:2], (False, True)):
            volume = random_volume(height, width, disparities, dtype, seed=width)
            result = aggregate(volume, blocky_pair(height, width, color))
            assert result.costs.shape == volume.costs.shape and result.costs.dtype == np.uint16
            ratio = result.scale / volume.scale
            assert result.costs.min() >= volume.costs.min() * ratio - 16  # iterated integer means lose some steps
            assert result.costs.max() <= min(volume.costs.max() * ratio + 1, 255 * 16)
    pair, volume = blocky_pair(41, 70), random_volume(41, 70, 37, np.uint16)
    assert_pure(lambda: aggregate(volume, pair).costs, volume.costs, pair.left, pair.right)


@of("methods.stereo.aggregation")
def means_depend_on_the_halo_alone(aggregate):
    halo = aggregate.halo()
    if halo is None:
        return
    height, width = 2 * halo + 40, 2 * halo + 60
    pair, volume = blocky_pair(height, width), random_volume(height, width, 8)
    rows, columns = slice(11, height - 9), slice(13, width - 8)
    tile = changed(pair, lambda image: np.ascontiguousarray(image[rows, columns]))
    part = aggregate(CostVolume(np.ascontiguousarray(volume.costs[rows, columns]), volume.scale), tile).costs
    inner = np.s_[halo : part.shape[0] - halo, 7 + halo : part.shape[1] - halo]
    assert part[inner].size
    np.testing.assert_array_equal(part[inner], aggregate(volume, pair).costs[rows, columns][inner])


@of("methods.stereo.aggregation")
def means_help_against_noise(aggregate):
    shift = 4
    image = np.repeat(np.repeat(blocky_pair(1, 1).left, 40, axis=0), 60, axis=1)  # flat: the noise is in the costs
    volume = AbsoluteDifference()(shifted_pair(40, 60, shift, noise=60, seed=3), 12)
    found = aggregate(volume, StereoPair(image, image))
    before, after = (np.mean(winners(each.costs)[0][8:-8, 16:-8] == shift) for each in (volume, found))
    assert after > max(0.99, before)


@of("methods.stereo.aggregation")
def disparities_do_not_mix(aggregate):
    pair, volume = blocky_pair(16, 30), random_volume(16, 30, 20)
    other = volume.costs.copy()
    other[:, :, 7] = 255 - other[:, :, 7]
    before, after = (aggregate(CostVolume(costs), pair).costs for costs in (volume.costs, other))
    others = np.arange(20) != 7
    np.testing.assert_array_equal(after[:, :, others], before[:, :, others])
    within = inside((16, 30, 20))[:, :, 7]
    assert np.any(after[:, :, 7][within] != before[:, :, 7][within])


# Pipelines.


def assert_in_range(found, shape, top):
    reasons = Status.OCCLUDED | Status.MISMATCH | Status.OUT_OF_RANGE | Status.NO_DATA
    assert found.values.shape == shape and found.values.dtype == np.float32
    known = found.values[found.valid]
    assert np.all((known >= 0) & (known <= top))
    assert np.all(found.status[~found.valid] & reasons)


@of("methods.stereo.pipeline")
def a_plane_has_its_disparity_at_any_number_of_threads(pipeline):
    for color in (False, True):
        found = pipeline(shifted_pair(60, 100, 6, color), 15).disparity.values[12:-12, 28:-12]
        assert np.mean(np.abs(found - 6) <= 1) >= 0.9
    pair = shifted_pair(41, 70, 3, noise=9)
    assert_pure(lambda: np.nan_to_num(pipeline(pair, 15).disparity.values, nan=-1), pair.left, pair.right)
    assert 0 < pipeline.peak_bytes((60, 100), 15) <= pipeline.peak_bytes((600, 1000), 15)


@of("methods.stereo.pipeline")
def pairs_of_any_size_have_values_within_the_range_or_a_reason(pipeline):
    for height, width, disparities in TINY:
        found = pipeline(shifted_pair(height, width, 1, seed=width), disparities - 1).disparity
        assert_in_range(found, (height, width), disparities - 1)


def assert_depth(result, frame):
    depth = result.depth
    assert depth.values.shape == frame.shape and depth.values.dtype == np.float32
    assert not np.isinf(depth.values).any()
    empty = (depth.status & DepthStatus.EMPTY) > 0
    np.testing.assert_array_equal(empty, np.isnan(depth.values))
    put_in = (depth.status & (DepthStatus.GAP_FILLED | DepthStatus.FALLBACK)) > 0
    np.testing.assert_array_equal(put_in | empty, np.isnan(frame.depth))


@of("methods.kinect.pipeline")
def gaps_are_filled_at_any_number_of_threads(pipeline):
    frame, truth = gaps()
    result = pipeline(frame)
    assert_depth(result, frame)
    gap = np.isnan(frame.depth)
    assert np.isfinite(result.depth.values[gap]).mean() > 0.9
    assert np.mean(np.abs(result.depth.values - truth)[gap] < 0.05 * truth[gap]) > 0.7
    assert_pure(lambda: pipeline(frame).depth.values, frame.color, frame.depth)


@of("methods.kinect.pipeline")
def frames_of_any_size_keep_their_depth(pipeline):
    for shape in ((1, 1), (1, 30), (30, 1), (4, 5)):
        depth = np.full(shape, 2, np.float32)
        if depth.size > 1:
            depth.flat[depth.size // 2] = np.nan
        values = pipeline(RgbdFrame(np.zeros((*shape, 3), np.uint8), depth)).depth.values
        np.testing.assert_allclose(values[~np.isnan(values)], 2, rtol=1e-3)
    refused(ValueError, pipeline, RgbdFrame(np.zeros((8, 9, 3), np.uint8), np.full((8, 9), np.nan, np.float32)))


@of("methods.transparent.pipeline")
def every_pixel_has_a_depth_at_any_number_of_threads(pipeline):
    frame, _, _ = glass()
    result = pipeline(frame)
    assert_depth(result, frame)
    depth, status = result.depth.values, result.depth.status
    assert np.isfinite(depth).all() and result.seconds
    kept, sampled = status == DepthStatus.KEPT, (status & DepthStatus.SAMPLED) > 0
    np.testing.assert_array_equal(depth[kept], frame.depth[kept])
    np.testing.assert_array_equal(result.pictures["unreliable"] > 0, (status & DepthStatus.CORRECTED) > 0)
    assert sampled.any() == (pipeline.needs == "sparse") and not (sampled & (kept | np.isnan(frame.sparse))).any()
    assert_pure(lambda: pipeline(frame).depth.values, frame.color, frame.depth, frame.sparse)


@of("methods.transparent.pipeline")
def no_samples_are_no_error(pipeline):
    frame, _, _ = glass(5)
    nothing = np.full(frame.shape, np.nan, np.float32)
    one = nothing.copy()
    one[3, 4] = frame.depth[3, 4]
    for sparse in (one, nothing):
        values = pipeline(replace(frame, sparse=sparse)).depth.values
        assert values.shape == frame.shape and not np.isinf(values).any()


@of("methods.registration.pipeline")
def expected_errors_are_lengths_within_the_volume(pipeline):
    fixed = soft_volume(3, (16, 20, 24))
    pair = RegisteredPair(fixed, np.roll(fixed, 2, axis=2), (1.0, 1.0, 1.0))
    result = pipeline(pair)
    error = result.expected_error
    assert error.dtype == np.float32 and error.ndim == 3 and np.isfinite(error).all() and error.min() >= 0
    for start, step, count, size in zip(result.start, result.step, error.shape, pair.shape, strict=True):
        assert start >= -1 and start + step * (count - 1) <= size
    assert result.shift is None or result.shift.shape == (3, *error.shape)
    assert "mean_error" in result.figures
    assert_pure(lambda: pipeline(pair).expected_error, pair.fixed, pair.warped)
    assert 0 < pipeline.peak_bytes((20, 20, 20), pair.spacing) <= pipeline.peak_bytes((60, 60, 60), pair.spacing)


# Parts of pipelines.


@of("methods.fusion.choice")
def choices_lie_between_the_proposals(choice):
    for height, width in ((1, 1), (1, 9), (9, 1), (9, 21)):
        given = random_proposals(height, width)
        chosen = choice(given)
        assert chosen.values.shape == (height, width) and chosen.values.dtype == np.float32
        low, high = given.values.min(axis=0) - 1e-4, given.values.max(axis=0) + 1e-4
        assert np.all((chosen.values >= low) & (chosen.values <= high))
        assert chosen.probability is None or np.all((chosen.probability >= 0) & (chosen.probability <= 1))
    given = random_proposals(20, 31, seed=1)
    assert_pure(lambda: choice(given).values, given.values, given.volume.costs, given.right)


@of("methods.registration.feature")
def channels_are_the_same_for_equal_volumes_and_any_number_of_threads(feature):
    fixed, warped = soft_volume(1), soft_volume(2)
    for channels in feature(fixed, warped):
        assert channels.dtype == np.uint8 and channels.shape[1:] == fixed.shape and len(channels) <= feature.channels
    assert_pure(lambda: np.concatenate(feature(fixed, warped)), fixed, warped)
    for shape in ((1, 9, 7), (3, 1, 5), (2, 2, 2)):
        for volume in (np.zeros(shape, np.float32), soft_volume(3, shape)):
            one, other = feature(volume, volume)
            assert one.shape[1:] == shape
            np.testing.assert_array_equal(one, other)


@of("methods.registration.feature")
def the_true_shift_is_found(feature):
    wide = soft_volume(0, (24, 24, 24))
    one, other = feature(wide[2:22, 2:22, 2:22].copy(), wide[3:23, 1:21, 4:24].copy())
    found = search(one, other, 1.0, 3, 2).displacement[:, 7:13, 7:13, 7:13]
    np.testing.assert_allclose(np.median(found, axis=(1, 2, 3)), (-1, 1, -2), atol=0.3)


def assert_points(points, shape):
    n, (height, width) = len(points), shape
    for values in (points.x, points.y, points.scale, points.response):
        assert values.shape == (n,) and values.dtype == np.float32 and np.isfinite(values).all()
    assert points.sign.shape == (n,) and points.sign.dtype == np.int8 and set(np.unique(points.sign)) <= {-1, 0, 1}
    assert np.all((points.x >= -0.5) & (points.x <= width - 0.5) & (points.y >= -0.5) & (points.y <= height - 0.5))
    assert np.all(np.diff(points.response) <= 0)
    assert points.descriptors.shape[:1] == (n,) and points.descriptors.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(points.descriptors, axis=1), 1, atol=1e-3)


@of("algorithms.keypoints")
def points_move_with_the_image_at_any_number_of_threads(detector):
    image = blobs()
    one, other = (detector(np.ascontiguousarray(each)) for each in (image[:, 8:], image[:, :-8]))
    assert_points(one, (120, 152))
    nearest = (one.descriptors @ other.descriptors.T).argmax(axis=1)
    assert np.mean(np.hypot(other.x[nearest] - one.x - 8, other.y[nearest] - one.y) < 1) > 0.5
    for shape in ((1, 1), (1, 40), (40, 1), (7, 9), (33, 31)):
        for small in (np.full(shape, 90, np.uint8), blobs(*shape)):
            assert_points(detector(small), shape)

    def run():
        points = detector(image)
        return np.column_stack([points.x, points.y, points.scale, points.response, points.sign, points.descriptors])

    assert_pure(run, image)


def assert_regions(labels, shape):
    assert labels.shape == shape and labels.dtype == np.int32
    assert np.array_equal(np.unique(labels), np.arange(labels.max() + 1))
    for label, place in enumerate(ndimage.find_objects(labels + 1)):
        assert ndimage.label(labels[place] == label)[1] == 1, "a region is not 4-connected"


@of("algorithms.segmentation")
def regions_are_connected_and_follow_the_edge(segment):
    image = np.full((60, 80, 3), (40, 60, 90), np.uint8)
    image[15:45, 20:50] = (200, 150, 60)
    image = (image + np.random.default_rng(0).integers(-3, 4, image.shape)).astype(np.uint8)
    labels = segment(image)
    assert_regions(labels, (60, 80))
    block = np.zeros(labels.shape, bool)
    block[15:45, 20:50] = True
    assert not set(labels[block]) & set(labels[~block])
    assert_pure(lambda: segment(image), image)
    for shape in ((1, 1), (1, 9), (9, 1), (2, 2), (7, 11)):
        random = np.random.default_rng(1).integers(0, 256, (*shape, 3)).astype(np.uint8)
        for small in (random, np.full_like(random, 7)):
            assert_regions(segment(small), shape)

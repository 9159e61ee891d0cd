"""Dense depth of frames with glass: what every pipeline promises, what the good ones reach, real scenes."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.sample_planes import SamplePlanes, Samples
from depthcli.core.frames import SparseFrame
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.frames import FRAMES
from depthcli.methods.transparent.pipeline.nearest import NearestSample
from depthcli.methods.transparent.pipeline.robust import Smoothing
from depthcli.methods.transparent.unreliable import UnreliableRegions, sample_noise
from depthcli.simulate.transparent_scenes import sparse_samples
from depthcli.testing.inputs import texture
from tests.contracts.inputs import NOISE, glass, preset
from tests.naive import transparent as naive
from tests.scenes import DATA, load, needs_data, true


def pipeline(name):
    return preset("transparent", name).pipeline


def errors(values, truth, mask, sensor):
    """Mean absolute errors in the mask, and outside where the sensor answers; meters."""
    error = np.abs(values - truth)
    return np.nanmean(error[mask]), np.nanmean(error[~mask & np.isfinite(sensor)])


@pytest.mark.parametrize("name", ["sparse", "crf"])
@pytest.mark.parametrize("seed", range(3))
def test_glass_is_found_and_nothing_else_is_touched(name, seed):
    frame, truth, mask = glass(seed)
    inside, outside = errors(pipeline(name)(frame).depth.values, truth, mask, frame.depth)
    _, sensor = errors(frame.depth, truth, mask, frame.depth)
    assert inside < 3 * NOISE and outside < 1.02 * sensor


def test_glass_that_the_sensor_hardly_sees_through_is_found():
    """Samples where it is blind neither contradict it nor agree with it."""
    rng, mask = np.random.default_rng(0), np.zeros((80, 100), bool)
    mask[25:55, 35:70] = True
    wall, true = (1 / (inverse + 0.002 * rng.standard_normal(mask.shape)) for inverse in (0.5, np.where(mask, 1, 0.5)))
    sensor = np.where(mask & (rng.random(mask.shape) < 0.9), np.nan, wall).astype(np.float32)
    sparse = np.where(rng.random(mask.shape) < 0.12, true, np.nan).astype(np.float32)
    color = np.where(mask[..., None], np.uint8([[[140] * 3]]), np.uint8([[[90] * 3]]))
    found = pipeline("sparse")(SparseFrame(color, sensor, sparse=sparse)).pictures["unreliable"] > 0
    assert found[mask & np.isfinite(sensor)].mean() > 0.9 and not found[~mask].any()


def test_little_confidence_makes_samples_count_less():
    frame, truth, mask = glass(7, outliers=0.0)
    plain = np.full(frame.shape, 1, np.float32)
    unknown, sure, unsure = (
        pipeline("thesis/ch5")(replace(frame, sparse_confidence=each)).depth.values for each in (None, plain, 0 * plain)
    )
    np.testing.assert_array_equal(sure, unknown)
    assert np.mean(np.abs(unsure - truth)[mask]) > np.mean(np.abs(sure - truth)[mask])


def test_noise_is_that_of_the_good_samples():
    rng = np.random.default_rng(8)
    inverse = (1.5 + 0.02 * rng.standard_normal((80, 90))).astype(np.float32)
    inverse[rng.random(inverse.shape) < 0.25] = 3.0
    for sensor, noise in ((1.5, 0.02), (np.nan, 0.015)):
        found = sample_noise(Samples.of(inverse), np.full((80, 90), sensor, np.float32))
        assert found == pytest.approx(noise, rel=0.05)


def test_a_region_without_contradicting_samples_is_reliable():
    """The fit is wrong over half of the image, but only because it is an extrapolation from afar."""
    sensor, ones = np.ones((40, 60), np.float32), np.ones(40 * 60, np.float32)
    fit = np.where(np.arange(60) < 30, sensor, np.float32(1.5))
    planes = SamplePlanes(fit.ravel(), np.float32(0.01) * ones, ones, ones)

    def unreliable(rows, columns, *contradicting):
        """Agreeing samples, and some that contradict the sensor."""
        places = np.append(np.mgrid[rows, columns].reshape(2, -1), np.reshape(contradicting, (-1, 2)).T, axis=1)
        values = np.full(places.shape[1], 1, np.float32)
        values[len(values) - len(contradicting) :] = 1.5
        samples = Samples(*places.astype(np.int32), values)
        return UnreliableRegions(reach=10.0)(sensor, planes, samples, 0.01, np.full((40, 60, 3), 80, np.uint8))

    left, right = (slice(0, 40, 2), slice(0, 30, 2)), (slice(0, 40, 4), slice(40, 60, 10))
    assert not unreliable(*left).any()
    assert unreliable(*left, (9, 45), (20, 45), (31, 45))[:, 30:].mean() > 0.9
    assert not unreliable(*left, (9, 45)).any(), "one sample, where 150 were to be expected"
    assert not unreliable(*right, (21, 45)).any(), "one sample, however far off, counts as 4 deviations"


def test_a_sensor_that_measures_nearer_surfaces_stays():
    frame, _, mask = glass(9)
    near = np.where(mask, np.float32(0.5), frame.depth)  # the sensor sees something in front of what stereo sees
    assert not (pipeline("sparse")(replace(frame, depth=near)).pictures["unreliable"][mask] > 0).any()


def sampled(shape, seed, samples):
    """Values with gaps, colors, which pixels to smooth, and samples at some pixels."""
    rng = np.random.default_rng(seed)
    values = (1.5 + 0.1 * rng.standard_normal(shape)).astype(np.float32)
    values[rng.random(shape) < 0.1] = np.nan
    known = np.full(shape, np.nan, np.float32)
    known[samples] = 1
    return values, Samples.of(known), texture((*shape, 3), seed), rng.random(shape) < 0.7


@pytest.mark.parametrize("shape", [(1, 1), (1, 17), (13, 2), (14, 19)])
@pytest.mark.parametrize("radius", [0, 1, 4])
def test_smoothing_agrees_with_the_reference_far_from_samples(shape, radius):
    values, samples, image, wanted = sampled(shape, 1, (0, 0))
    ours = Smoothing(radius=radius, color_scale=40, reach=3.5 / shape[1])(values, samples, image, wanted)
    y, x = np.mgrid[: shape[0], : shape[1]]
    far = wanted & (np.hypot(y, x) > 3.5)
    np.testing.assert_allclose(ours, naive.smoothed(values, image, far, radius, 40), rtol=1e-5)


def test_near_samples_and_elsewhere_values_stay():
    given = sampled((20, 30), 2, np.s_[::2, ::2])
    np.testing.assert_array_equal(Smoothing(reach=0.1)(*given), given[0])
    values, one, image, wanted = sampled((20, 30), 2, (10, 15))
    changed = (Smoothing(reach=0.1)(values, one, image, wanted) != values) & np.isfinite(values)
    assert changed[wanted].sum() > 100 and not changed[~wanted].any()


@needs_data
@pytest.mark.slow
def test_sparse_on_every_real_scene():
    """ClearGrasp at half size, sparse stereo emulated with another seed than the experiments'."""
    for share, outliers, max_error in ((0.02, 0.1, 0.0055), (0.1, 0.1, 0.0036), (0.1, 0.3, 0.0040)):
        ratios = []
        for scene in discover_scenes(DATA / "transparent" / "real_d435", FRAMES):
            frame, truth = load(scene), true(scene)
            color = cv2.resize(frame.color, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            sensor, depth = np.ascontiguousarray(frame.depth[::2, ::2]), truth.depth[::2, ::2]
            mask = truth.masks["transparent"][::2, ::2]
            given = SparseFrame(color, sensor, sparse=sparse_samples(depth, color, share, outliers=outliers, seed=7))
            ours, nearest = (
                errors(pipeline(name)(given).depth.values, depth, mask, sensor) for name in ("sparse", "nearest")
            )
            assert ours[0] < min(max_error, 0.6 * nearest[0])
            ratios.append(ours[1] / errors(sensor, depth, mask, sensor)[1])
        assert len(ratios) == 3 and max(ratios) < 1.04 and np.mean(ratios) < 1.02


def test_the_nearest_sample_s_tolerance_is_the_larger_one():
    color, wall = np.zeros((9, 9, 3), np.uint8), np.ones((9, 9), np.float32)
    for depth, near, far in ((0.5, 0.514, 0.516), (2, 2.039, 2.041)):  # 15 mm, 2 %
        frame = SparseFrame(color, depth * wall, sparse=depth * wall)
        assert [NearestSample().unreliable(frame, other * wall).all() for other in (near, far)] == [False, True]

"""The state that a sequence carries from frame to frame."""

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.frames import RgbdFrame
from depthcli.methods.kinect.camera_motion import displacement, estimated_motion, view_after
from depthcli.methods.kinect.disparity import Measurement
from depthcli.methods.kinect.layers import Layer
from depthcli.methods.kinect.pipeline.sequence import carried_labels, still_pixels
from depthcli.simulate.depth_sensor import KinectSample
from depthcli.simulate.kinect_scenes import make_kinect_sequence
from tests.contracts.inputs import preset
from tests.methods.kinect._made import blocks, labels_of, noisy, off, random_planes, same_points
from tests.naive import kinect as naive


def sequence(*settings):
    return preset("refine-kinect", "sequence", *settings).pipeline


@functools.cache
def frames(kind: str) -> list[KinectSample]:
    return make_kinect_sequence(kind, 8, 1, 240, 180, 32)


def run(pipeline, samples):
    results, state = [], None
    for sample in samples:
        result, state = pipeline.step(sample.frame(), state)
        results.append(result)
    return results, state


def mean_error(results, samples):
    """After the first frame."""
    return np.mean([off(result, sample).mean() for result, sample in zip(results, samples, strict=True)][1:])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["static", "moving"])
def test_as_good_as_frame_by_frame(kind):
    errors, pipeline = np.zeros(2), sequence()
    for seed in (0, 1):
        samples = make_kinect_sequence(kind, 8, seed, 320, 240, 40)
        along, state = run(pipeline, samples)
        assert state.age == 7  # segments were computed once
        errors += [mean_error(way, samples) for way in (along, [pipeline(sample.frame()) for sample in samples])]
    assert errors[0] <= 1.05 * errors[1]


def test_the_estimated_motion_is_that_of_the_poses():
    first, _, third = frames("camera")[:3]
    assert first.intrinsics is not None and first.pose is not None and third.pose is not None
    found = estimated_motion(first.color, third.color, first.disparity, first.intrinsics, RgbdFrame.fb)
    true = np.linalg.inv(third.pose) @ first.pose
    assert found is not None and np.linalg.norm(true[:3, 3]) > 0.06  # meters
    np.testing.assert_allclose(found[:3, 3], true[:3, 3], atol=0.005)
    np.testing.assert_allclose(found[:3, :3], true[:3, :3], atol=0.002)


@pytest.mark.slow
@pytest.mark.parametrize(("known", "motion"), [(True, "pose"), (False, "estimated")])
def test_a_moving_camera_is_followed_with_less_error_and_less_noise_than_frame_by_frame(known, motion):
    errors, noise, pipeline = np.zeros(2), np.zeros(2), sequence()
    for seed in (0, 1):
        samples = make_kinect_sequence("camera", 6, seed, 320, 240, 40)
        given = [replace(sample, pose=sample.pose if known else None) for sample in samples]
        along, state = run(pipeline, given)
        assert [result.words["motion"] for result in along] == ["new"] + [motion] * 5
        assert not state.layers[0].own.all()
        ways = along, [pipeline(sample.frame()) for sample in given]
        errors += [mean_error(way, samples) for way in ways]
        places = [same_points(samples[0], sample) for sample in samples]
        seen = np.all([there for _, there in places], axis=0)
        for k, way in enumerate(ways):
            maps = [
                (RgbdFrame.fb / result.depth.values - sample.truth).ravel()[at]
                for result, sample, (at, _) in zip(way, samples, places, strict=True)
            ]
            noise[k] += np.std(maps, axis=0)[seen].mean()
    assert errors[0] < 0.95 * errors[1] and noise[0] < 0.8 * noise[1]


@pytest.mark.parametrize("kind", ["static", "moving"])
def test_a_still_camera_has_the_same_bytes_with_and_without_poses(kind):
    samples = frames(kind)[:4]
    posed = [replace(sample, pose=np.eye(4)) for sample in samples]
    ways = [run(sequence(), given)[0] for given in (samples, posed)]
    for way in ways:
        assert [result.words["motion"] for result in way] == ["new", "still", "still", "still"]
    for one, other in zip(*ways, strict=True):
        np.testing.assert_array_equal(one.depth.values, other.depth.values)


@pytest.mark.parametrize("turn", [0.0, 0.05])
def test_the_view_after_a_motion_shows_a_slanted_plane_where_it_is(turn):
    rows, columns = np.mgrid[:60, :80].astype(np.float32)
    camera, fb = Intrinsics(100.0, 100.0, 39.5, 29.5), 40.0
    disparity = 20 + 0.05 * columns - 0.03 * rows
    color = np.stack([columns * 3, rows * 4, rows + columns], axis=2).astype(np.uint8)
    rotation, shift = cv2.Rodrigues(np.array([0, 0, turn]))[0], np.array([[0.02], [0.01], [-0.05]])
    motion = np.block([[rotation, shift], [np.zeros(3), 1]])
    view = view_after(motion, color, disparity, camera, fb, 0.5)
    assert view.reached[12:-12, 12:-12].all()
    y, x = np.nonzero(view.reached)
    old_y, old_x = np.divmod(view.source[y, x], 80)
    z = fb / disparity[old_y, old_x]
    points = rotation @ np.stack([(old_x - 39.5) / 100 * z, (old_y - 29.5) / 100 * z, z]) + shift
    assert np.abs(100 * points[0] / points[2] + 39.5 - x).max() <= 1.51
    assert np.abs(fb / points[2] - view.disparity[y, x]).max() < 0.2
    inside = (old_x > 1) & (old_x < 78) & (old_y > 1) & (old_y < 58)
    assert np.abs(view.color[y, x].astype(int) - color[old_y, old_x])[inside].max() <= 6  # two pixels of the ramps
    assert displacement(motion, disparity, camera, fb) > 1 > 1e-9 > displacement(np.eye(4), disparity, camera, fb)
    assert displacement(motion, disparity * np.float32(np.nan), camera, fb) == 0


def test_segments_are_new_after_max_age_and_much_change():
    samples, state, ages = frames("static"), None, []
    for sample in samples:
        _, state = sequence("max_age=3").step(sample.frame(), state)
        ages.append(state.age)
    assert ages == [0, 1, 2, 0, 1, 2, 0, 1]
    first, pipeline = samples[0].frame(), sequence()
    other = RgbdFrame(255 - first.color, first.depth)
    result, state = pipeline.step(other, pipeline.step(first, None)[1])
    assert state.age == 0
    np.testing.assert_array_equal(result.depth.values, pipeline(other).depth.values)


shapes = pytest.mark.parametrize("shape", [(1, 1), (1, 30), (30, 1), (14, 23)])


@shapes
def test_still_pixels(shape):
    rng = np.random.default_rng(0)
    color = blocks(*shape)
    before = np.clip(color + rng.integers(-6, 7, color.shape), 0, 255).astype(np.uint8)
    reliable, disparity = noisy(*shape), noisy(*shape, seed=1)
    found = still_pixels(color, reliable, before, disparity, 5, 2.0)
    same = np.abs(color.astype(int) - before).max(axis=2) <= 5
    np.testing.assert_array_equal(found, same & ~(np.abs(reliable - disparity) > 2))


@shapes
@pytest.mark.parametrize("share", [0.0, 0.3, 0.8, 1.0])
def test_carried_labels(shape, share):
    rng = np.random.default_rng(2)
    labels = labels_of(*shape)
    count = labels.max() + 1
    labels[rng.random(shape) < 0.1] = -1
    scale = rng.uniform(0.2, 0.6, count).astype(np.float32)
    surfaces, value_at = random_planes(rng.integers(18, 28, (count, 3)), scale)
    limit = np.where(rng.random(shape) < 0.3, rng.uniform(10, 40, shape), np.inf).astype(np.float32)
    reliable, still, own = noisy(*shape), rng.random(shape) < share, rng.random(shape) < 0.5
    color = blocks(*shape)
    frame = RgbdFrame(color, np.full(shape, 2, np.float32))
    measurement = replace(Measurement.of(frame, 5.0, 0.0, False, 0.3), reliable=reliable, limit=limit)
    found = carried_labels(Layer(labels, surfaces, own), still, color, measurement)
    expected = naive.carried_labels(labels, own, still, color, reliable, limit, value_at, scale, 1.5, 0.3)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)

"""The state that a sequence carries from frame to frame."""

from __future__ import annotations

import functools
import pickle
from dataclasses import astuple

import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.polynomials import Surfaces
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthStatus
from depthcli.data.generated.arrays.kinect_scenes import KinectSample, make_kinect_sequence
from depthcli.methods.kinect.layers import Layer, Measurement
from depthcli.methods.kinect.pipeline.sequence import carried_labels, still_pixels
from tests.algorithms.test_statistical_region_merging import blocks
from tests.methods.kinect.test_dsrm import preset
from tests.methods.kinect.test_surfaces import labels_of, noisy
from tests.naive import kinect as naive


@functools.cache
def frames(kind: str, seed: int = 1, count: int = 8) -> list[KinectSample]:
    return make_kinect_sequence(kind, count, seed, 240, 180, 32)


def run(pipeline, samples, state=None):
    results = []
    for sample in samples:
        result, state = pipeline.step(sample.frame(), state)
        results.append(result)
    return results, state


def off(result, sample):
    return np.abs(RgbdFrame.fb / result.depth.values - sample.truth)


@functools.cache
def both_ways(kind: str, seed: int):
    """The frames, refined along the sequence and each by itself."""
    samples = make_kinect_sequence(kind, 8, seed, 320, 240, 40)
    pipeline = preset("sequence")
    along, state = run(pipeline, samples)
    assert state.age == len(samples) - 1  # segments were computed once
    return samples, along, [pipeline(sample.frame()) for sample in samples]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["static", "moving"])
def test_as_good_as_frame_by_frame(kind):
    errors = np.zeros(2)
    for seed in (0, 1):
        samples, *ways = both_ways(kind, seed)
        errors += [np.mean([off(r, s).mean() for r, s in zip(way, samples, strict=True)][1:]) for way in ways]
    assert errors[0] <= 1.05 * errors[1]


@pytest.mark.slow
def test_no_trail_where_an_object_has_just_left():
    errors = np.zeros(2)
    for seed in (0, 1):
        samples, *ways = both_ways("moving", seed)
        for k in range(1, len(samples)):
            left = samples[k - 1].truth - samples[k].truth > 3
            assert left.sum() > 30
            errors += [off(way[k], samples[k])[left].mean() for way in ways]
    assert errors[0] <= 1.1 * errors[1]


def test_filled_values_are_carried_where_nothing_moves():
    samples = frames("static")
    results, _ = run(preset("sequence"), samples)
    assert not (results[0].depth.status & DepthStatus.CARRIED).any()
    unknown = np.isnan(samples[-1].disparity)
    assert (results[-1].depth.status[unknown] == DepthStatus.CARRIED).mean() > 0.8
    assert not (results[-1].depth.status[~unknown] & DepthStatus.CARRIED).any()


@pytest.mark.slow
@pytest.mark.parametrize("cut", [1, 4])
def test_a_state_saved_and_read_goes_on_with_the_same_bytes(cut):
    samples = frames("moving")
    pipeline = preset(
        "sequence", segmentation={"method": "statistical_region_merging", "complexity": 2000, "coarser": [300]}
    )
    whole, last = run(pipeline, samples)
    _, state = run(pipeline, samples[:cut])
    rest, end = run(pipeline, samples[cut:], pickle.loads(pickle.dumps(state)))
    for one, other in zip(whole[cut:], rest, strict=True):
        assert one.depth.values.tobytes() == other.depth.values.tobytes()
        assert one.depth.status.tobytes() == other.depth.status.tobytes()
        assert one.sigma.tobytes() == other.sigma.tobytes()
    np.testing.assert_equal(astuple(last), astuple(end))


def test_segments_are_new_after_max_age_and_much_change():
    samples = frames("static")
    ages = []
    state = None
    for sample in samples:
        _, state = preset("sequence", max_age=3).step(sample.frame(), state)
        ages.append(state.age)
    assert ages == [0, 1, 2, 0, 1, 2, 0, 1]
    _, state = preset("sequence").step(samples[0].frame(), None)
    first = samples[0].frame()
    result, state = preset("sequence").step(RgbdFrame(255 - first.color, first.depth), state)
    assert state.age == 0
    np.testing.assert_array_equal(
        result.depth.values, preset("sequence")(RgbdFrame(255 - first.color, first.depth)).depth.values
    )


def test_another_size_is_refused():
    pipeline = preset("sequence")
    _, state = pipeline.step(frames("static")[0].frame(), None)
    with pytest.raises(ValueError, match="size"):
        pipeline.step(RgbdFrame(np.zeros((20, 30, 3), np.uint8), np.ones((20, 30), np.float32)), state)


def test_the_state_of_the_frame_before_is_not_changed():
    samples = frames("moving")
    pipeline = preset("sequence")
    _, state = pipeline.step(samples[0].frame(), None)
    before = pickle.dumps(state)
    pipeline.step(samples[1].frame(), state)
    assert pickle.dumps(state) == before


@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (30, 1), (14, 23)])
def test_still_pixels(shape):
    rng = np.random.default_rng(0)
    color = blocks(*shape)
    before = np.clip(color + rng.integers(-6, 7, color.shape), 0, 255).astype(np.uint8)
    reliable, disparity = noisy(*shape), noisy(*shape, seed=1)
    found = still_pixels(color, before, reliable, disparity, 5, 2.0)
    same = np.abs(color.astype(int) - before).max(axis=2) <= 5
    np.testing.assert_array_equal(found, same & ~(np.abs(reliable - disparity) > 2))


@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (30, 1), (14, 23)])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.8, 1.0])
def test_carried_labels(shape, share):
    rng = np.random.default_rng(2)
    labels = labels_of(*shape)
    count = labels.max() + 1
    labels[rng.random(shape) < 0.1] = -1
    surfaces = Surfaces(
        np.zeros((count, 6)), np.zeros((count, 2)), np.full((count, 2), (0, 99), np.float32),
        rng.uniform(0.2, 0.6, count).astype(np.float32), 50.0,
    )  # fmt: skip
    surfaces.coefficients[:, :3] = rng.integers(18, 28, (count, 3))
    limit = np.where(rng.random(shape) < 0.3, rng.uniform(10, 40, shape), np.inf).astype(np.float32)
    reliable, still, own = noisy(*shape), rng.random(shape) < share, rng.random(shape) < 0.5
    color = blocks(*shape)
    measurement = Measurement(reliable, reliable, np.zeros(shape, bool), limit, 0.3)

    def value_at(s, y, x):
        b = surfaces.coefficients[s]
        return b[0] + b[1] * x / 50 + b[2] * y / 50

    found = carried_labels(Layer(labels, surfaces, own), still, color, measurement, 1.5)
    expected = naive.carried_labels(
        labels, own, still, color, reliable, limit, value_at, surfaces.scale, 1.5, 0.3
    )  # fmt: skip
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_array_equal(found[1], expected[1])

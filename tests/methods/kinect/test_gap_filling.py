"""Gaps filled along the cheapest paths."""

import cv2
import numpy as np
import pytest

from depthcli.core.frames import RgbdFrame
from depthcli.methods.kinect import gap_filling
from depthcli.methods.kinect.gap_filling import fill_gaps
from depthcli.simulate.kinect_scenes import make_kinect_scene
from tests.methods.kinect._made import off, pipeline, sample_of
from tests.naive import kinect as naive


def some(shape, seed, unknown=0.7):
    rng = np.random.default_rng(seed)
    values = np.rint(10 + 20 * rng.random(shape)).astype(np.float32)
    values[cv2.GaussianBlur(rng.random(shape), (0, 0), 2) > np.quantile(rng.random(shape), 0.5)] = np.nan
    values[rng.random(shape) < unknown] = np.nan
    lab = cv2.GaussianBlur(rng.integers(0, 256, (*shape, 3)).astype(np.uint8), (0, 0), 3)
    segments = (np.mgrid[: shape[0], : shape[1]][1] // 9)[None].astype(np.int32)
    limit = np.where(rng.random(shape) < 0.3, 20, np.inf).astype(np.float32)
    return values, lab, segments, limit, (5 * rng.random(shape)).astype(np.float32)


@pytest.mark.parametrize("shape", [(1, 30), (30, 1), (17, 23), (40, 50)])
@pytest.mark.parametrize("seed", range(3))
def test_values_are_those_at_the_start_of_the_cheapest_path_and_smoothed(shape, seed, monkeypatch):
    values, lab, segments, limit, cost = some(shape, seed)
    values[0, 0] = 5
    smoothed, _ = fill_gaps(values, lab, segments, limit, cost, None)
    monkeypatch.setattr(gap_filling, "_SMOOTHING_STRIDES", ())
    filled, _ = fill_gaps(values, lab, segments, limit, cost, None)
    _, expected = naive.cheapest_paths(lab, segments, limit, values, cost)
    assert (filled == expected).mean() > 0.95  # the sweeps miss paths that wind
    known = ~np.isnan(values)
    np.testing.assert_array_equal(filled[known], values[known])
    expected = naive.smoothed_gaps(filled, known, lab, limit, (12, 8, 6, 4, 3, 2, 1), 35)
    np.testing.assert_array_equal(smoothed, expected)
    assert (smoothed <= limit)[~known].sum() >= (filled <= limit)[~known].sum()


def test_planes_continue_and_fade():
    truth = 20 + np.float32(0.2) * np.mgrid[:40, :80][1].astype(np.float32)
    values = truth.copy()
    values[5:35, 30:60] = np.nan
    grey, nothing = np.full((40, 80, 3), 90, np.uint8), np.zeros_like(values)
    filled, inside = fill_gaps(values, grey, np.empty((0, 40, 80), np.int32), nothing + np.inf, nothing, 0.1)
    assert np.abs(filled - truth).max() < 1.2
    assert np.abs(filled - truth).mean() < 0.1 * np.nanstd(truth)
    np.testing.assert_allclose(filled[6, 40:50], truth[6, 40:50], atol=0.05)
    assert not inside.any()
    _, inside = fill_gaps(values, grey, np.zeros((1, 40, 80), np.int32), nothing + np.inf, nothing, 0.1)
    np.testing.assert_array_equal(inside, np.isnan(values))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "ratio"), [("plane_votes", 0.8), ("dsrm", 0.8), ("shadow_smoother", 1.2)])
@pytest.mark.parametrize("kind", ["planes", "foreground", "curved"])
def test_holes_in_a_frame_without_shadows_are_filled_better_than_by_the_nearest_value(name, ratio, kind):
    color, truth = make_kinect_scene(kind, 3, 320, 240, 40)
    rng = np.random.default_rng(0)
    measured = truth + 0.2 * rng.standard_normal(truth.shape, np.float32)
    holes = np.zeros(truth.shape, bool)
    for _ in range(20):
        y, x = rng.integers(0, 210), rng.integers(0, 285)
        holes[y : y + 30, x : x + 35] = True
    frame = RgbdFrame(color, (43.5 / np.where(holes, np.nan, measured)).astype(np.float32))
    error, nearest = (
        np.abs(43.5 / pipeline(each)(frame).depth.values - truth)[holes].mean() for each in (name, "nearest")
    )
    assert error < ratio * nearest


def test_where_shadows_lie_can_be_set():
    sample, errors = sample_of(size=(320, 240), shadows="right"), {}
    for where in (True, "right", "left", False):
        result = pipeline("dsrm", shadows=where)(sample.frame())
        errors[where] = off(result, sample)[sample.occluded].mean()
        assert set(result.figures) == {"shadows_left", "shadows_right", "shadow_width_left", "shadow_width_right"}
    assert errors["right"] == pytest.approx(errors[True], rel=0.2)
    assert errors[True] < 0.7 * errors["left"] and errors[True] < 0.7 * errors[False]

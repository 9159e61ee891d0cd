"""The measures against closed forms, slow twins and the data set's own figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from depthcli.evaluation.metrics import (
    ESTIMATED_ONLY,
    INTERPOLATED,
    Score,
    fit_size,
    interpolate_background,
    kitti,
    middlebury_v2,
    middlebury_v3,
    scale_warning,
    wrong_pixels,
)
from depthcli.io.disparity import read_disparity
from depthcli.io.scenes import find_scenes
from tests.naive import metrics as naive

DATA = Path(__file__).parents[2].parent / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the real scenes of ../shared/data are not here")


def random_maps(seed: int, shape: tuple[int, int] = (13, 17)):
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0, 80, shape).astype(np.float32)
    estimate = (truth + rng.normal(0, 3, shape)).astype(np.float32)
    truth[rng.random(shape) < 0.2] = np.nan
    estimate[rng.random(shape) < rng.choice([0.05, 0.5, 0.95])] = np.nan
    return estimate, truth, rng.random(shape) < 0.7


def pick(scores: list[Score], metric: str, threshold: float | None = None, convention: str | None = None) -> Score:
    found = [
        s
        for s in scores
        if s.metric == metric and threshold in (None, s.threshold) and convention in (None, s.convention)
    ]
    assert len(found) == 1
    return found[0]


@given(st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_v2_agrees_with_twin(seed):
    estimate, truth, mask = random_maps(seed)
    scores = middlebury_v2(estimate, truth, {"all": mask})
    for t in (0.5, 0.75, 1.0, 1.5, 2.0):
        score = pick(scores, "bad", t)
        wrong, pixels = naive.bad_v2(estimate, truth, mask, t)
        assert (score.wrong, score.pixels) == (wrong, pixels)
        assert score.value == pytest.approx(100 * wrong / pixels)


@given(st.integers(0, 10**6), st.sampled_from([1, 2, 4]), st.booleans())
@settings(max_examples=40, deadline=None)
def test_v3_agrees_with_twin(seed, factor, rounded):
    _, truth, mask = random_maps(seed, (12, 16))
    estimate, _, _ = random_maps(seed + 1, (12 // factor, 16 // factor))
    scores = middlebury_v3(estimate, truth, {"all": mask}, 60, rounded)
    for t in (0.5, 1.0, 2.0, 4.0):
        bad, invalid, total, average = naive.evaldisp(estimate, truth, mask, t, 60.0, rounded)
        assert pick(scores, "bad", t).value == pytest.approx(bad)
        assert pick(scores, "totbad", t).value == pytest.approx(total)
    assert pick(scores, "invalid").value == pytest.approx(invalid)
    assert pick(scores, "avgerr").value == pytest.approx(average, nan_ok=True, rel=1e-5)


@given(st.integers(0, 10**6))
@settings(max_examples=60, deadline=None)
def test_kitti_agrees_with_twin(seed):
    estimate, truth, mask = random_maps(seed)
    filled = interpolate_background(estimate)
    np.testing.assert_array_equal(filled, naive.interpolate_background(estimate))
    scores = kitti(estimate, truth, {"occ": mask})
    for convention, used in ((INTERPOLATED, filled), (ESTIMATED_ONLY, estimate)):
        score = pick(scores, "D1", 3.0, convention)
        assert (score.wrong, score.pixels) == naive.d1(used, truth, mask, convention == ESTIMATED_ONLY)


def test_interpolation_leaves_an_empty_row_between_full_ones():
    nan = np.nan
    disparity = np.array([[nan] * 3, [nan, 5, nan], [nan] * 3, [4, nan, 2], [nan] * 3], np.float32)
    expected = np.array([[5] * 3, [5] * 3, [nan] * 3, [4, 2, 2], [4, 2, 2]], np.float32)
    np.testing.assert_array_equal(interpolate_background(disparity), expected)
    assert np.isnan(interpolate_background(np.full((3, 4), nan, np.float32))).all()


def test_truth_scores_zero_and_shift_scores_all():
    truth = np.tile(np.arange(20, dtype=np.float32), (5, 1))
    everywhere = {"all": np.ones(truth.shape, bool)}
    assert pick(middlebury_v2(truth, truth, everywhere), "bad", 1.0).value == 0
    assert pick(middlebury_v2(truth + 2, truth, everywhere), "bad", 1.0).value == 100
    # The rule is "more than t": an error of exactly t is right.
    assert pick(middlebury_v2(truth + 1, truth, everywhere), "bad", 1.0).value == 0


def test_missing_values_count_by_the_convention():
    truth = np.full((1, 4), 10, np.float32)
    estimate = np.array([[10, np.nan, 15, 10]], np.float32)
    everywhere = {"all": np.ones(truth.shape, bool)}
    assert pick(middlebury_v2(estimate, truth, everywhere), "bad", 1.0).value == 50
    v3 = middlebury_v3(estimate, truth, everywhere)
    assert [pick(v3, "bad", 1.0).value, pick(v3, "invalid").value, pick(v3, "totbad", 1.0).value] == [25, 25, 50]
    assert pick(v3, "avgerr").value == pytest.approx(5 / 3)
    scores = kitti(estimate, truth, everywhere)
    assert pick(scores, "D1", 3.0, INTERPOLATED).value == 25
    assert pick(scores, "D1", 3.0, ESTIMATED_ONLY).value == pytest.approx(100 / 3)
    assert all(score.density == 75 for score in scores)


def test_d1_needs_both_conditions():
    truth = np.array([[100, 100, 20]], np.float32)
    estimate = np.array([[104, 106, 23.5]], np.float32)  # 4 %; 6 %; 3.5 px and 17.5 %
    everywhere = {"occ": np.ones((1, 3), bool)}
    assert pick(kitti(estimate, truth, everywhere), "D1", 3.0, ESTIMATED_ONLY).wrong == 2
    np.testing.assert_array_equal(wrong_pixels(estimate, truth, "kitti"), [[False, True, True]])


def test_quantiles_are_errors_that_occur():
    truth = np.zeros((1, 10), np.float32)
    estimate = np.arange(1, 11, dtype=np.float32)[None]
    scores = middlebury_v3(estimate, truth, {"all": np.ones((1, 10), bool)})
    assert [pick(scores, f"A{q}").value for q in (50, 90, 95, 99)] == [5, 9, 10, 10]


def test_no_pixel_gives_nan_not_an_error():
    truth = np.full((3, 3), np.nan, np.float32)
    for family in (middlebury_v2, middlebury_v3, kitti):
        scores = family(truth, truth, {"all": np.ones((3, 3), bool)})
        assert scores
        assert all(np.isnan(score.value) for score in scores)


def test_fit_size_scales_values_and_refuses_others():
    small = np.array([[1, 2], [3, np.nan]], np.float32)
    big = fit_size(small, (4, 4))
    np.testing.assert_array_equal(big[0], [2, 2, 4, 4])
    assert np.isnan(big[2:, 2:]).all()
    assert fit_size(small, (5, 5)).shape == (5, 5)  # an odd size halves to 2 or 3
    with pytest.raises(ValueError, match="2 x 2"):
        fit_size(small, (16, 16))


@pytest.mark.parametrize("factor", [16, 4, 256, 0.5, 1 / 16, -1])
def test_wrong_scale_is_noticed(factor):
    estimate, truth, _ = random_maps(3, (40, 50))
    estimate = np.where(np.isnan(estimate), np.nan, truth + np.float32(0.3)).astype(np.float32)
    assert scale_warning(estimate, truth) is None
    warning = scale_warning(estimate * np.float32(factor), truth)
    assert warning is not None
    assert "times the truth" in warning


def test_noise_is_not_taken_for_a_scale():
    rng = np.random.default_rng(0)
    truth = rng.uniform(1, 60, (50, 50)).astype(np.float32)
    assert scale_warning(rng.uniform(1, 240, (50, 50)).astype(np.float32), truth) is None


@needs_data
@pytest.mark.parametrize(("pair", "d1", "three", "end_point"), [
    ("pair_01", 4.19, 4.36, 0.797), ("pair_04", 3.54, 3.71, 1.045), ("pair_07", 8.30, 11.05, 1.438),
])  # fmt: skip
def test_figures_of_the_kitti_pairs(pair, d1, three, end_point):
    """The D1, > 3 px and end-point errors that DATA.md gives for a real network's maps."""
    (scene,) = find_scenes(DATA / "kitti_eval_pairs", pattern=pair)
    truth = scene.load_truth()
    assert truth.metric == "kitti"
    scores = kitti(read_disparity(DATA / "kitti_eval_pairs" / pair / "disp_est.png"), truth.disparity, truth.masks)
    assert pick(scores, "D1", 3.0, ESTIMATED_ONLY).value == pytest.approx(d1, abs=0.005)
    assert pick(scores, "out", 3.0, ESTIMATED_ONLY).value == pytest.approx(three, abs=0.005)
    assert pick(scores, "avgerr", None, ESTIMATED_ONLY).value == pytest.approx(end_point, abs=0.0005)

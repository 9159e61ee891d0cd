"""Sparsification, calibration, ranks, paired comparison, and what is said of runs: never more than the test shows."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import rankdata

from depthcli.evaluation import curves
from depthcli.evaluation.curves import PERCENTAGES, reliability, sparsification
from depthcli.evaluation.map_files import DisparityFiles
from depthcli.evaluation.protocols.registration import ExpectedErrorFiles
from depthcli.evaluation.statistics import Ranking, average_ranks, compare, compare_all, holm, smallest_p
from tests.files import laid
from tests.golden import refused
from tests.naive import metrics as naive

NINE = [float(k) for k in range(1, 10)]


@given(st.lists(st.tuples(st.integers(0, 2), st.booleans()), min_size=1, max_size=6))
@settings(max_examples=60, deadline=None)
def test_ties_are_averaged(pixels):
    confidence = np.array([c for c, _ in pixels], np.float32)
    wrong = np.array([w for _, w in pixels])
    expected = naive.expected_sparsification(confidence, wrong, PERCENTAGES)
    np.testing.assert_allclose(sparsification(confidence, wrong).errors, expected, atol=1e-12)


@pytest.mark.slow
@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 8)), min_size=1, max_size=5))
@settings(max_examples=20, deadline=None)
def test_areas_are_integrals(pixels):
    confidence = np.array([c for c, _ in pixels], np.float32)
    error = np.array([e / 4 for _, e in pixels])
    curve = sparsification(confidence, error)
    assert curve.auc == pytest.approx(naive.sparsification_area(confidence, error), abs=5e-3)
    assert curve.optimal == pytest.approx(naive.sparsification_area(-error, error), abs=5e-3)
    assert curve.mean == pytest.approx(error.mean())
    assert curve.ause == pytest.approx(curve.auc - curve.optimal)
    assert curve.aurg == pytest.approx(curve.mean - curve.auc)


@pytest.mark.parametrize("share", [0.01, 0.15, 0.9])
def test_a_perfect_ranking_has_ratio_one_and_a_useless_one_the_area_of_chance(share):
    wrong = np.arange(20000) >= 20000 * (1 - share)
    perfect, useless, reverse = (sparsification(c, wrong) for c in (~wrong, np.zeros(20000), wrong))
    assert (perfect.ratio, perfect.ause) == (pytest.approx(1), pytest.approx(0))
    assert perfect.auc == pytest.approx(share + (1 - share) * math.log(1 - share), rel=1e-9)
    assert (useless.auc, useless.aurg) == (pytest.approx(share), pytest.approx(0)) and reverse.auc > useless.auc
    # The figure of the other programs sees the curve at 20 shares only, in the optimum as well.
    assert perfect.auc_5_100 == perfect.optimal_5_100


def test_infinite_and_unknown_confidences():
    confidence = np.array([np.nan, -np.inf, -5.0, np.inf])
    for wrong, place in ((0, 3), (1, 2), (3, 0)):
        curve = sparsification(confidence, np.arange(4) == wrong)
        assert [curve.errors[PERCENTAGES.index(p)] > 0 for p in (25, 50, 75, 100)].index(True) == place
    refused(ValueError, sparsification, np.zeros(0), np.zeros(0, bool))


@given(st.integers(1, 5), st.integers(1, 6), st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_average_rank_agrees_with_scipy(rows, columns, seed):
    values = np.random.default_rng(seed).integers(0, 4, (rows, columns)).astype(float)
    np.testing.assert_allclose(average_ranks(values), rankdata(values, axis=0).mean(axis=1))
    assert np.isnan(average_ranks(values[:, :0])).all()


def test_paired_comparison():
    result = compare([1, 2, 3, 4, math.nan], [0.9, 1.8, 3.3, 4, 1])
    assert (result.scenes, result.wins, result.losses, result.ties) == (4, 2, 1, 1)
    assert result.mean_difference == pytest.approx(0)
    assert result.worst_ratio == pytest.approx(1.1)
    # |differences| 0.1, 0.2, 0.3 are ranks 1, 2, 3; a sum of wins of 3 or less, or of 3 or more, is all there is.
    assert (result.p_value, result.rank_difference) == (pytest.approx(1), pytest.approx(0))


@pytest.mark.parametrize("differences", [(1, 2, 3, 4), (1, 2, 3, -4, 5, 6), (2, 2, -2, 3, 3, 5, 8), (1,) * 9, (5,)])
def test_wilcoxon_counts_the_signs_that_are_at_least_so_uneven(differences: tuple[int, ...]):
    sizes = np.abs(differences)
    ranked = np.array([np.sum(sizes < s) + (np.sum(sizes == s) + 1) / 2 for s in sizes])
    sums = [abs(np.dot(signs, ranked)) for signs in itertools.product((-1, 1), repeat=len(ranked))]
    found = abs(np.dot(np.sign(differences), ranked))
    test = compare([0] * (len(differences) + 1), [*differences, 0])
    assert (test.scenes, test.ties) == (len(differences) + 1, 1)
    assert test.p_value == pytest.approx(np.mean(np.array(sums) >= found - 1e-9))
    assert test.rank_difference == pytest.approx(np.dot(np.sign(differences), ranked) / ranked.sum())


def test_holm_corrects_all_pairs_together():
    assert holm([0.01, 0.04, 0.03, math.nan]) == pytest.approx([0.03, 0.06, 0.06, math.nan], nan_ok=True)
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert (smallest_p(4, 1), smallest_p(4, 2), smallest_p(6, 1), smallest_p(1, 3)) == (0.125, 0.25, 0.03125, 1.0)
    pairs = compare_all({name: [v + k + k * v / 99 for v in NINE] for k, name in enumerate("abc")})
    assert [pair[:2] for pair in pairs] == [("a", "b"), ("a", "c"), ("b", "c")]
    assert [test.losses for _, _, test, _ in pairs] == [9, 9, 9]
    assert [p for *_, p in pairs] == holm([test.p_value for _, _, test, _ in pairs])


@pytest.mark.parametrize(("others", "said", "words"), [
    ({"b": [v + 1 + v / 99 for v in NINE]}, "a is significantly better than b.", ["best", "worse"]),
    ({"b": [v + (-1) ** k * k for k, v in enumerate(NINE, 1)]}, "No significant difference", ["best", "not sig"]),
    # One scene decides the mean; on all others b is better.
    ({"b": [0.9, *(v - 0.1 * v for v in NINE[1:8]), 99.0], "c": NINE}, "No significant", ["best", "not", "not"]),
    ({"b": [v - 0.1 * v for v in NINE]}, "In most scenes b is significantly better", ["best", "better in most"]),
    ({name: [v + 1 + k / 7 + v / 99 for v in NINE] for k, name in enumerate("bc")},
     "a is significantly better than every other run.", ["best", "worse", "worse"]),
    ({name: [v + 1 + k / 7 + v / 99 for v in NINE] for k, name in enumerate("bcde")}
     | {"f": [v + (-1) ** k * k for k, v in enumerate(NINE, 1)]},
     "a is significantly better than b, c, d and 1 more. No significant difference to f.",
     ["best", *["worse"] * 4, "not significant"]),
    ({name: [v + 1 + v / 99 for v in NINE] for name in "bde"}
     | {"c": [v + (-1) ** k * k for k, v in enumerate(NINE, 1)]},
     "a is significantly better than b, d and e. No significant difference to c.", ["best", *["worse"] * 3, "not"]),
    ({"b": [math.nan] * 9}, "No scene has a map of two runs", ["best", "no common scene"]),
    ({}, "", ["best"]),
])  # fmt: skip
def test_verdicts(others: dict[str, list[float]], said: str, words: list[str]):
    ranking = Ranking(["a", *others], {"a": NINE, **others})
    assert ranking.verdict().startswith(said)
    assert all(ranking.word(run).startswith(word) for run, word in zip(["a", *others], words, strict=True))
    for run in others:
        assert ranking.is_significant(run) == (ranking.word(run) in ("worse", "better in most"))


def test_the_verdict_follows_the_rank_beside_it():
    worse = {"a": NINE, "b": [v + 1 + v / 99 for v in NINE]}
    assert [Ranking("ab", worse, {"a": 1.2, "b": 1.8}).word(run) for run in "ab"] == ["best", "worse"]
    ranking = Ranking("ab", worse, {"a": 1.8, "b": 1.2})
    assert [ranking.word(run) for run in "ab"] == ["best figure", "better in most"]


@pytest.mark.parametrize(("scenes", "runs", "enough"), [(4, 1, 6), (1, 1, 6), (6, 2, 7), (6, 9, 9)])
def test_few_scenes_are_said_to_be_too_few(scenes: int, runs: int, enough: int):
    names = ["a", *(f"r{k}" for k in range(runs))]
    few, full = (
        Ranking(names, {name: [v + 9 * k + k * v / 99 for v in NINE[:count]] for k, name in enumerate(names)})
        for count in (scenes, enough)
    )
    assert "no difference can be significant" in few.verdict() and few.word("r0") == "too few scenes"
    assert few.verdict().endswith(f"it takes {enough} scenes.")
    assert full.is_significant("r0")


def test_confidence_beside_a_map(tmp_path: Path):
    """A measure called probability is not that of the map; of a registration, the confidence is a plane."""
    names = ("confidence", "probability", "confidence_probability", "confidence_pkr")
    laid(tmp_path, dict.fromkeys(("disp_left.pfm", *(f"{name}.pfm" for name in names)), b""))
    found = DisparityFiles().planes(tmp_path / "disp_left.pfm")
    assert found == {"pkr" if name == "confidence_pkr" else name: tmp_path / f"{name}.pfm" for name in names}
    laid(tmp_path, {"expected_error.nii.gz": b"", "confidence.nii.gz": b""})
    found = ExpectedErrorFiles(("expected_error",), (".nii.gz",)).planes(tmp_path / "expected_error.nii.gz")
    assert found == {"confidence": tmp_path / "confidence.nii.gz"}


def test_expected_calibration_error_by_hand():
    found = reliability(np.array([0.91, 0.93, 0.12, 1.0, 0.11]), np.array([True, False, False, True, False]))
    # Bins [.9, .95): mean .92, half right; [.1, .15): mean .115, none right; [.95, 1]: 1, all right.
    assert found.ece == pytest.approx((2 * 0.42 + 2 * 0.115 + 0) / 5)
    assert (found.pixels[18], found.right[18]) == (2, 0.5) and math.isnan(found.right[0])


def test_pooled_is_that_of_all_pixels_together():
    rng = np.random.default_rng(1)
    p, right = rng.random(1000), rng.random(1000) < 0.6
    pooled, whole = (
        curves.Reliability.pooled(reliability(p[k::3], right[k::3]) for k in range(3)),
        reliability(p, right),
    )
    assert pooled.pixels == whole.pixels
    assert pooled.ece == pytest.approx(whole.ece)


def test_hidden_pixels_by_hand():
    known = np.array([[1, 1, 1, 1, 1, 0]], bool)
    status = np.array([[1, 4, 1, 0, 0, 1]], np.uint8)  # occluded, or out of range
    found = curves.hidden_pixels(status, {"all": known, "nonocc": np.array([[0, 1, 1, 0, 1, 0]], bool)})
    assert found == curves.HiddenPixels(both=1, marked=3, true=2, pixels=5)
    shares = found.shares()
    expected = {"precision": 33.33, "recall": 50, "F1": 40, "said": 60, "true": 40}
    assert {name: round(shares[name], 2) for name in expected} == expected
    assert curves.HiddenPixels.pooled([found, found]).marked == 6
    assert math.isnan(curves.HiddenPixels(0, 0, 0, 4).shares()["precision"])

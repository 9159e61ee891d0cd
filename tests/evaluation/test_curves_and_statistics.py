"""Sparsification, ranks, paired comparison and error pictures."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import rankdata

from depthcli.evaluation.curves import PERCENTAGES, sparsification
from depthcli.evaluation.statistics import average_ranks, compare, holm, smallest_p
from tests.golden import refused
from tests.naive import metrics as naive


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


def test_holm():
    assert holm([0.01, 0.04, 0.03, math.nan]) == pytest.approx([0.03, 0.06, 0.06, math.nan], nan_ok=True)
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert (smallest_p(4, 1), smallest_p(4, 2), smallest_p(6, 1), smallest_p(1, 3)) == (0.125, 0.25, 0.03125, 1.0)

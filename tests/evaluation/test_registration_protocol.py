"""Figures of registration confidence against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.evaluation.protocols.registration import error_classes
from depthcli.evaluation.statistics import correlation, ranks, roc_area


def test_ranks_share_ties():
    assert ranks(np.array([3.0, 1.0, 3.0, 2.0])).tolist() == [3.5, 1.0, 3.5, 2.0]


def test_correlation():
    a = np.array([1.0, 2.0, 3.0, 4.0])
    assert correlation(a, 2 * a + 1) == pytest.approx(1)
    assert correlation(ranks(np.exp(a)), ranks(a)) == pytest.approx(1)
    assert correlation(a, -a) == pytest.approx(-1)
    assert np.isnan(correlation(a, np.ones(4)))


def test_area_counts_pairs_in_order():
    score, bad = np.array([1.0, 2.0, 2.0, 5.0]), np.array([False, True, False, True])
    in_order = [1.0, 0.5, 1.0, 1.0]  # (2 against 1), (2 against 2), (5 against 1), (5 against 2)
    assert roc_area(score, bad) == pytest.approx(sum(in_order) / 4)
    assert np.isnan(roc_area(score, np.ones(4, bool)))


def test_classes():
    assert error_classes(np.array([0.0, 2.99, 3.0, 5.99, 6.0, 40.0])).tolist() == [0, 0, 1, 1, 2, 2]

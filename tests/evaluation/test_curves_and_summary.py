"""Sparsification, ranks, paired comparison, tables, plots and pictures."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from depthcli.evaluation.curves import PERCENTAGES, optimal_auc, sparsification
from depthcli.evaluation.pictures import LEGEND, error_picture
from depthcli.evaluation.report import Line, Table, line_plot
from depthcli.evaluation.summary import average_ranks, compare, sign_test
from tests.naive import metrics as naive


@given(st.lists(st.tuples(st.integers(0, 2), st.booleans()), min_size=1, max_size=6))
@settings(max_examples=60, deadline=None)
def test_ties_are_averaged(pixels):
    confidence = np.array([c for c, _ in pixels], np.float32)
    wrong = np.array([w for _, w in pixels])
    expected = naive.expected_sparsification(confidence, wrong, PERCENTAGES)
    np.testing.assert_allclose(sparsification(confidence, wrong).rates, expected, atol=1e-12)


def test_order_of_pixels_does_not_matter():
    rng = np.random.default_rng(1)
    confidence, wrong = rng.integers(0, 5, 1000).astype(np.float32), rng.random(1000) < 0.2
    order = rng.permutation(1000)
    assert sparsification(confidence, wrong) == sparsification(confidence[order], wrong[order])


def test_perfect_useless_and_reversed_confidence():
    wrong = np.arange(20000) >= 17000
    rank = -np.arange(20000.0)
    perfect, useless, reverse = (sparsification(c, wrong) for c in (rank, np.zeros(20000), -rank))
    assert useless.auc == pytest.approx(0.15)
    assert useless.random == pytest.approx(0.15)
    assert perfect.rates[:16] == (0.0,) * 16
    assert perfect.rates[-1] == pytest.approx(0.15)
    assert perfect.optimal <= perfect.auc < perfect.optimal + 0.15 / 40 + 1e-4
    assert reverse.auc > useless.auc
    # The integral of max(0, 1 - (1 - e) / n) over n, by many small steps.
    n = (np.arange(200000) + 0.5) / 200000
    assert optimal_auc(0.15) == pytest.approx(np.mean(np.maximum(0, 1 - 0.85 / n)), abs=1e-6)
    assert optimal_auc(0) == 0
    assert optimal_auc(1) == 1


def test_nan_confidence_is_the_least_sure():
    curve = sparsification(np.array([np.nan, 1.0, 2.0, 3.0]), np.array([True, False, False, False]))
    assert curve.rates[PERCENTAGES.index(75)] == 0
    assert curve.rates[-1] == 0.25
    with pytest.raises(ValueError, match="N > 0"):
        sparsification(np.zeros(0), np.zeros(0, bool))


@given(st.integers(1, 5), st.integers(1, 6), st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_average_rank_agrees_with_twin(rows, columns, seed):
    values = np.random.default_rng(seed).integers(0, 4, (rows, columns)).astype(float)
    np.testing.assert_allclose(average_ranks(values), naive.mean_rank(values.tolist()))


def test_missing_result_ranks_last():
    np.testing.assert_allclose(average_ranks(np.array([[np.nan, 1.0], [9.0, 2.0]])), [1.5, 1.5])


def test_paired_comparison():
    result = compare([10, 20, 30, 40, float("nan")], [9, 18, 33, 40, 1])
    assert (result.scenes, result.wins, result.losses, result.ties) == (4, 2, 1, 1)
    assert result.mean_difference == pytest.approx(0)
    assert result.worst_ratio == pytest.approx(1.1)
    assert sign_test(17, 3) == pytest.approx(2 * (1 + 20 + 190 + 1140) / 2**20)
    assert sign_test(5, 5) == 1
    assert sign_test(0, 0) == 1


def test_table_as_text_and_markdown():
    table = Table("T", ("run", "bad"), (("a", "1.00"), ("long|name", "12.50")), "note")
    assert table.text() == "T\nrun          bad\na           1.00\nlong|name  12.50\nnote\n"
    assert "| long\\|name | 12.50 |" in table.markdown()


def test_plot_is_well_formed_and_escapes():
    svg = line_plot([Line("a<b & c", [5, 50, 100], [0, float("nan"), 0.2]), Line("flat", [5], [0])], "t<", "x", "y")
    root = ElementTree.fromstring(svg)
    lines = [e for e in root.iter() if e.tag.endswith("polyline")]
    assert [len(e.attrib["points"].split()) for e in lines] == [2, 1]
    assert any(e.text == "a<b & c" for e in root.iter())


def test_error_picture_colors():
    estimate = np.array([[1, 1, np.nan, 1, 1, 1]], np.float32)
    wrong = np.array([[0, 1, 0, 0, 1, 1]], bool)
    evaluate = np.array([[1, 1, 1, 1, 1, 0]], bool)
    visible = np.array([[1, 1, 1, 0, 0, 1]], bool)
    picture = error_picture(estimate, wrong, evaluate, visible)
    order = ["right", "wrong", "no value", "right, occluded", "wrong, occluded", "truth unknown or not evaluated"]
    assert [tuple(int(v) for v in p) for p in picture[0]] == [LEGEND[name] for name in order]

"""What is said of the runs: never more than the test over the scenes shows."""

import math

import pytest

from depthcli.evaluation.statistics import Ranking, compare_all, holm

NINE = [float(k) for k in range(1, 10)]


@pytest.mark.parametrize(("others", "said", "words"), [
    ({"b": [v + 1 + v / 99 for v in NINE]}, "a is significantly better than b.", ["best", "worse"]),
    ({"b": [v + (-1) ** k * k for k, v in enumerate(NINE, 1)]}, "No significant difference", ["best", "not sig"]),
    # One scene decides the mean; on all others b is better.
    ({"b": [0.9, *(v - 0.1 * v for v in NINE[1:8]), 99.0], "c": NINE}, "No significant", ["best", "not", "not"]),
    ({"b": [v - 0.1 * v for v in NINE]}, "In most scenes b is significantly better", ["best", "better in most"]),
    ({name: [v + 1 + k / 7 + v / 99 for v in NINE] for k, name in enumerate("bc")},
     "a is significantly better than every other run.", ["best", "worse", "worse"]),
    ({"b": [math.nan] * 9}, "No scene has a map of two runs", ["best", "no common scene"]),
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


def test_all_pairs_are_corrected_together():
    scores = {name: [v + k + k * v / 99 for v in NINE] for k, name in enumerate("abc")}
    pairs = compare_all(scores)
    assert [pair[:2] for pair in pairs] == [("a", "b"), ("a", "c"), ("b", "c")]
    assert [test.losses for _, _, test, _ in pairs] == [9, 9, 9]
    assert [p for *_, p in pairs] == holm([test.p_value for _, _, test, _ in pairs])


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

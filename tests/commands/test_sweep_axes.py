"""Combinations of a sweep and what their figures say."""

from __future__ import annotations

import itertools
import math

import pytest

from depthcli.commands._sweep_axes import combinations, effects, folder_names, parse_axes, value_text
from depthcli.core.errors import ConfigError


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("a.b=2,4,8", ("2", "4", "8")),
        ("a=20:40:5", ("20", "25", "30", "35", "40")),
        ("a=0.1:0.3:0.1", ("0.1", "0.2", "0.3")),
        ("a=3:1:-1", ("3", "2", "1")),
        ("a=0:1:0.4", ("0", "0.4", "0.8")),
        ("a=100:300:100", ("100", "200", "300")),
        ("a=[9,7],[11,9]", ("[9,7]", "[11,9]")),
        ("a={method: census, window: [9, 7]}, zncc", ("{method: census, window: [9, 7]}", "zncc")),
        ("a=true", ("true",)),
    ],
)
def test_axes(text: str, values: tuple[str, ...]):
    assert parse_axes([text]) == {text.partition("=")[0]: list(values)}


@pytest.mark.parametrize("text", ["a", "=1", "a=", "a=1,,2", "a=2,2", "a=1:5:0", "a=5:1:1", "a=0:1:1e-9", "b=1"])
def test_wrong_axes(text: str):
    with pytest.raises(ConfigError, match="--over"):
        parse_axes(["b=1", text])


AXES = {"x": ["1", "2", "3"], "y": ["a", "b"]}


def test_all_combinations_and_draws():
    every = combinations(AXES)
    assert every == list(itertools.product("123", "ab"))
    assert combinations(AXES, 6) == every
    few, more = combinations(AXES, 2, seed=5), combinations(AXES, 4, seed=5)
    assert len(set(few)) == 2
    assert set(few) < set(more) < set(every)
    assert combinations(AXES, 2, seed=5) == few
    assert len({tuple(combinations(AXES, 3, seed)) for seed in range(20)}) > 3
    huge = {name: list(map(str, range(100))) for name in "abcdef"}
    assert len(set(combinations(huge, 10))) == 10
    with pytest.raises(ConfigError, match="draw fewer"):
        combinations(huge)


def test_names_are_short_and_differ():
    axes = {"cost.p": ("1", "2"), "optimization.p": ("[9, 7]", "[9 7]"), "a.window": ("x/y",)}
    names = folder_names(axes, combinations(axes))
    assert len(set(names)) == 4
    assert names[0].startswith("cost.p=1,optimization.p=9-7,window=x-y-")
    assert all(name == name.strip("./") and "/" not in name for name in names)
    assert folder_names({"a.b": ["4"]}, [("4",)]) == ["b=4"]
    long = {"k": ("v" * 200, "w" * 200)}
    assert all(len(name) <= 120 for name in folder_names(long, combinations(long)))


def test_effects_against_numpy_free_arithmetic():
    # figure = 10 x + y exactly: the keys explain 1200/1204 and ... of the variance, together all of it
    figures = {(x, y): 10.0 * int(x) + (y == "b") for x, y in combinations(AXES)}
    first, second = effects(AXES, figures)
    assert (first["key"], first["spread"], second["key"], second["spread"]) == ("x", 20.0, "y", 1.0)
    means = {"1": (10.5, 10.0), "2": (20.5, 20.0), "3": (30.5, 30.0)}
    assert {row["value"]: (row["mean"], row["best"]) for row in first["values"]} == means
    assert [row["runs"] for row in second["values"]] == [3, 3]
    assert first["share_of_variance"] + second["share_of_variance"] == pytest.approx(1)
    assert second["share_of_variance"] == pytest.approx(1.5 / (400 + 1.5), rel=1e-6)
    assert [row["best"] for row in effects(AXES, figures, larger_is_better=True)[0]["values"]] == [11.0, 21.0, 31.0]


def test_effects_without_figures():
    holes = dict.fromkeys(combinations(AXES), math.nan)
    assert all(math.isnan(effect["spread"]) and not effect["values"] for effect in effects(AXES, holes))
    holes["1", "a"] = holes["2", "a"] = 3.0
    first = next(effect for effect in effects(AXES, holes) if effect["key"] == "x")
    assert ([row["mean"] for row in first["values"]], first["spread"]) == ([3.0, 3.0], 0.0)
    assert math.isnan(first["share_of_variance"])


def test_values_of_a_config_as_texts():
    config = {"a": {"b": [9, 7], "c": None}, "d": 0.5, "e": "mean", "f": [{"g": True}]}
    texts = {"a.b": "[9,7]", "a.b.1": "7", "a.c": "null", "d": "0.5", "e": "mean", "f.0.g": "true"}
    assert {key: value_text(config, key) for key in texts} == texts
    assert [value_text(config, key) for key in ("x", "a.b.2", "d.y", "a.b.c")] == [""] * 4

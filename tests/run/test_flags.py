"""Conditions on columns: their meaning, the rows that they flag, and the lines on wrong ones."""

from __future__ import annotations

import pytest

from depthcli.core.errors import ConfigError
from depthcli.run.console import Reporter
from depthcli.run.flags import conditions_of, flag_rows, plain_name

ROWS = [
    {"scene": "a", "measured": 0.4, "status": "done", "bad 1": 3.0, "bad 1 all": 9.0, "seconds": {"x": 1.0, "y": 2.0}},
    {"scene": "b", "measured": 0.6, "status": "failed", "bad 1": 5.0, "peak_memory": 7},
    {"scene": "c", "measured": float("nan"), "status": "done"},
]


def flagged(*texts):
    flags = flag_rows(conditions_of(texts, False), ROWS, Reporter())
    return [(each.scene, list(each.reasons)) for each in flags.flagged]


@pytest.mark.parametrize(
    ("text", "scenes"),
    [
        ("measured<0.6", ["a"]),
        (" measured <= .6", ["a", "b"]),
        ("measured>0.5", ["b"]),
        ("measured = 0.6", ["b"]),
        ("measured!=0.6", ["a"]),
        ("bad 1.0>3", ["b"]),
        ("bad  1 all>=9", ["a"]),
        ("memory>5", ["b"]),
        ("seconds>2.5", ["a"]),
        ("measured<-1e3", []),
    ],
)
def test_a_condition_flags_the_rows_that_it_holds_for(text, scenes):
    assert [scene for scene, _ in flagged(text)] == scenes


def test_rows_with_more_reasons_come_first_then_those_farthest_beyond_the_limit():
    assert flagged("measured<1", "bad 1>4") == [("b", ["measured 0.6 < 1", "bad 1 5 > 4"]), ("a", ["measured 0.4 < 1"])]
    assert [scene for scene, _ in flagged("measured<1")] == ["a", "b"]


def test_rows_without_a_value_are_not_flagged_but_counted(capsys):
    assert [scene for scene, _ in flagged("measured<1", "bad 2>0")] == ["a", "b"]
    err = capsys.readouterr().err
    assert "1 of 3 rows" in err and "no row has a value for 'bad 2'; did you mean 'bad 1'?" in err


@pytest.mark.parametrize("text", ["measured", "measured<", "", "measured<much", "measured=>0.5", "measured<nan"])
def test_wrong_conditions_are_refused_in_one_line(text):
    with pytest.raises(ConfigError, match="--flag") as raised:
        conditions_of([text], False)
    assert "\n" not in str(raised.value)


def test_table_and_json():
    rows = [{"scene": "a", "run": "x", "bad 1": 3.0}, {"scene": "b", "run": "long", "bad 1": 2.5}]
    flags = flag_rows(conditions_of(["bad 1>2"], False), rows, Reporter())
    assert flags.text().splitlines()[1:3] == ["flagged: 2 of 2", "scene  run   why"]
    assert [each["run"] for each in flags.to_dict()["flagged"]] == ["x", "long"]
    nothing = flag_rows([], rows, Reporter())
    assert nothing.to_dict() == {} and "none of 2" in nothing.text()
    assert plain_name(" bad  1.0  nonocc ") == "bad 1 nonocc"

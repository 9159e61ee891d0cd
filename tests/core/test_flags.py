"""Conditions on columns: what they mean, which rows they flag, and what is said of wrong ones."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.core.columns import ColumnHelp
from depthcli.core.conditions import MIN_SCORED, Condition, parse_conditions, plain_name, robust_scores
from depthcli.core.errors import ConfigError
from depthcli.core.flags import flag_rows

KNOWN = (
    ColumnHelp("measured", "share"),
    ColumnHelp("peak_memory", "bytes", also=("memory",)),
    ColumnHelp("seconds_STAGE", "time", also=("seconds",), pattern="seconds_.*"),
    ColumnHelp("bad T", "share", pattern=r"bad [\d.]+"),
    ColumnHelp("status", "done or failed"),
)
ROWS = [
    {"scene": "a", "measured": 0.4, "status": "done", "bad 1": 3.0, "bad 1 all": 9.0, "seconds": {"x": 1.0, "y": 2.0}},
    {"scene": "b", "measured": 0.6, "status": "failed", "bad 1": 5.0, "peak_memory": 7},
    {"scene": "c", "measured": float("nan"), "status": "done"},
]


def flagged(*texts, rows=ROWS):
    flags = flag_rows(parse_conditions(texts, KNOWN), rows)
    return [(each.scene, list(each.reasons)) for each in flags.flagged], [*flags.warnings, *flags.unanswered]


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
        ("status=failed", ["b"]),
        ("status!=failed", ["a", "c"]),
        ("memory>5", ["b"]),
        ("seconds>2.5", ["a"]),
        ("measured<-1e3", []),
    ],
)
def test_a_condition_flags_the_rows_that_it_holds_for(text, scenes):
    assert [scene for scene, _ in flagged(text)[0]] == scenes


def test_rows_with_more_reasons_come_first_and_say_them():
    found, _ = flagged("measured<1", "status=failed")
    assert found == [("b", ["measured 0.6 < 1", "status failed"]), ("a", ["measured 0.4 < 1"])]


def test_rows_without_a_value_are_not_flagged_but_counted():
    found, warnings = flagged("measured<1", "bad 2>0")
    assert [scene for scene, _ in found] == ["a", "b"]
    assert warnings == [
        "condition 'measured<1': 1 of 3 rows have no value there",
        "condition 'bad 2>0' flags nothing: no row has a value there; there is 'bad 1'",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("measured", "want COLUMN<NUMBER"),
        ("measured<", "want COLUMN<NUMBER"),
        ("", "want COLUMN<NUMBER"),
        ("measured<much", "want a number behind <"),
        ("measured=>0.5", "want COLUMN<NUMBER"),
        ("status==<2", "want COLUMN<NUMBER"),
        ("measured<>0.5", "want COLUMN<NUMBER"),
        ("z(measured)=word", "want a number"),
        ("measured<nan", "finite"),
        ("measurd<1", "did you mean 'measured'"),
        ("__import__(0)>1", "no column"),
    ],
)
def test_wrong_conditions_are_refused_in_one_line(text, message):
    with pytest.raises(ConfigError, match=message.replace("(", r"\(")) as raised:
        parse_conditions([text], KNOWN)
    assert "\n" not in str(raised.value)


def test_robust_scores_agree_with_numpy_and_find_the_outlier():
    values = [3.0, 3.1, 2.9, 3.2, 2.8, 9.0, None]
    known = np.array(values[:-1])
    expected = (known - np.median(known)) / (1.4826 * np.median(np.abs(known - np.median(known))))
    np.testing.assert_allclose(robust_scores(values)[:-1], expected)
    assert robust_scores(values)[-1] is None
    rows = [{"scene": str(k), "measured": value} for k, value in enumerate(values)]
    assert [scene for scene, _ in flagged("z(measured)>3.5", rows=rows)[0]] == ["5"]


def test_robust_scores_are_those_within_a_run():
    rows = [
        {"scene": str(k), "run": run, "measured": k + high} for run, high in (("a", 0), ("b", 90)) for k in range(6)
    ]
    assert flagged("z(measured)>2", rows=rows)[0] == []
    rows[3]["measured"] = 93  # as in the other run
    assert [scene for scene, _ in flagged("z(measured)>2", rows=rows)[0]] == ["3"]


def test_robust_scores_of_like_values():
    assert robust_scores([1.0] * 6) == [0.0] * 6
    scores = robust_scores([1.0] * 9 + [5.0])  # no median deviation: by the mean one
    assert scores[0] == 0 and scores[-1] == pytest.approx(4 / (1.2533 * 0.4))
    assert robust_scores([1.0] * (MIN_SCORED - 1)) == [None] * (MIN_SCORED - 1)
    rows = [{"scene": "a", "measured": 1.0}]
    assert flagged("z(measured)>1", rows=rows) == ([], ["condition 'z(measured)>1' flags nothing: fewer than 5 values"])


def test_plain_names():
    assert plain_name(" bad  1.0  nonocc ") == "bad 1 nonocc"
    assert Condition.of("z( bad 0.50 )<2").column == "bad 0.5"


def test_the_worst_rows_come_first():
    rows = [{"scene": name, "measured": share} for name, share in (("a", 0.8), ("b", 0.2), ("c", 0.5))]
    assert [scene for scene, _ in flagged("measured<0.9", rows=rows)[0]] == ["b", "c", "a"]
    found, _ = flagged("measured<0.9", "measured>0.7", rows=rows)
    assert [scene for scene, _ in found] == ["a", "b", "c"]  # two reasons before one


REGION_ROWS = [
    {"scene": "a", "region_95_liver": 2.0, "region_mean_liver": 1.0, "region_95_tumor": 6.0},
    {"scene": "b", "region_95_liver": 7.5, "region_error_tumor": "mask_tumor.nii.gz: cut off"},
    {"scene": "c", "status": "failed"},
]
REGIONS = (ColumnHelp("region_mean_NAME, region_95_NAME", "error", "mm", ("region_mean", "region_95"),
                      "region_(mean|95)_.+"), *KNOWN)  # fmt: skip


def test_conditions_on_regions_give_a_verdict_for_every_scene_and_region():
    flags = flag_rows(parse_conditions(["region_95>5", "status=failed"], REGIONS), REGION_ROWS)
    assert [(each.scene, each.region, each.reasons) for each in flags.flagged] == [
        ("b", "tumor", ("mask_tumor.nii.gz: cut off",)),
        ("b", "liver", ("region_95 7.5 > 5",)),
        ("a", "tumor", ("region_95 6 > 5",)),
        ("c", "", ("status failed",)),
    ]
    assert [(each.scene, each.region, each.verdict, each.value) for each in flags.verdicts] == [
        ("a", "liver", "passed", 2.0), ("a", "tumor", "flagged", 6.0), ("b", "liver", "flagged", 7.5),
        ("b", "tumor", "flagged", None), ("c", "liver", "unknown", None), ("c", "tumor", "unknown", None),
    ]  # fmt: skip
    assert flags.warnings == (
        "condition 'status=failed': 2 of 3 rows have no value there",
        "condition 'region_95>5': 3 of 6 regions have no value there",
    )
    assert flags.regions == ["liver", "tumor"]
    named = flag_rows(parse_conditions(["region_95_tumor>5"], REGIONS), [{"region_95_liver": 1.0, **REGION_ROWS[0]}])
    assert named.regions == ["tumor"]
    rows = [{"scene": "a", "region_volume_a": 1.0, "region_95_b": 2.0, "region_95_c": 9.0}]
    assert flag_rows(parse_conditions(["region_95>5"], REGIONS), rows).regions == ["c", "b", "a"]
    assert flags.to_dict()["flagged"][1] == {"scene": "b", "region": "liver", "reasons": ["region_95 7.5 > 5"]}


def test_a_verdict_has_the_value_and_the_reason_that_flag_it():
    rows = [{"scene": "a", "region_95_x": 2.0, "region_mean_x": 9.0}]
    (found,) = flag_rows(parse_conditions(["region_95>5", "region_mean>5"], REGIONS), rows).verdicts
    assert (found.verdict, found.value, found.reasons) == ("flagged", 9.0, ("region_mean 9 > 5",))


def test_a_condition_may_name_its_region():
    flags = flag_rows(parse_conditions(["region_95_liver>5", "region_mean_liver>=1"], REGIONS), REGION_ROWS)
    assert [(each.scene, each.region) for each in flags.flagged] == [("b", "tumor"), ("b", "liver"), ("a", "liver")]
    assert [each.scene for each in flags.verdicts if each.region == "tumor"] == ["b"]  # whose mask cannot be used
    none = flag_rows(parse_conditions(["region_95_lung>5"], REGIONS), REGION_ROWS)
    assert none.unanswered == ("condition 'region_95_lung>5' flags nothing: there is no such region",)


def test_a_mask_that_cannot_be_used_is_flagged_whatever_region_is_named():
    rows = [
        {"scene": "a", "region_95_liver": 2.0, "region_mean_liver": 1.0},
        {"scene": "b", "region_error_organs": "mask_organs.nii.gz: cut off"},
    ]
    flags = flag_rows(parse_conditions(["region_95_liver>5"], REGIONS), rows)
    (found,) = flags.flagged
    assert (found.scene, found.region, found.reasons) == ("b", "organs", ("mask_organs.nii.gz: cut off",))
    verdicts = {(each.scene, each.region): each.verdict for each in flags.verdicts}
    assert verdicts == {("a", "liver"): "passed", ("b", "liver"): "unknown", ("b", "organs"): "flagged"}
    assert flags.warnings == ("condition 'region_95_liver>5': 1 of 2 regions have no value there",)


@pytest.mark.parametrize("name", ["lobe 01", "01 lobe", "left  lung", "V1.0 part", "a(1)"])
def test_regions_of_any_name_can_be_named_in_conditions(name):
    rows = [{"scene": "a", f"region_95_{name}": 6.0, "region_95_other": 7.0}]
    (found,) = flag_rows(parse_conditions([f"region_95_{name}>5"], REGIONS), rows).flagged
    assert found.region == name


@pytest.mark.parametrize("text", ["region_95!=x", "region_95_liver=high"])
def test_figures_of_regions_are_not_compared_with_words(text):
    with pytest.raises(ConfigError, match="want a number"):
        parse_conditions([text], REGIONS)


def test_a_heading_like_one_without_values_is_named():
    rows = [{"scene": "a", "totbad 2": 3.0, "measured": 0.5}]
    _, (line,) = flagged("bad 2>1", rows=rows)
    assert line == "condition 'bad 2>1' flags nothing: no row has a value there; there is 'totbad 2'"


def test_robust_scores_of_regions_are_those_among_the_same_region():
    rows = [{"scene": str(k), "region_95_a": 1 + k / 10, "region_95_b": 20 + k / 10} for k in range(6)]
    assert not flag_rows(parse_conditions(["z(region_95)>2"], REGIONS), rows).flagged
    rows[2]["region_95_a"] = 20.0  # as usual in b
    (found,) = flag_rows(parse_conditions(["z(region_95)>2"], REGIONS), rows).flagged
    assert (found.scene, found.region) == ("2", "a")


@pytest.mark.parametrize(
    ("text", "meant"),
    [("bad2>1", "bad 2"), ("bda 2.0>1", "bad 2"), ("memry>1", "memory"), ("region_96>1", "region_95")],
)
def test_a_heading_that_may_be_meant_is_named(text, meant):
    with pytest.raises(ConfigError, match=f"did you mean '{meant}'"):
        parse_conditions([text], REGIONS)

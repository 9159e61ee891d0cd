"""``--flag`` and ``--fail-flagged``: what conditions mean, tables, JSON, the page, and exit codes."""

import json
import re
import shutil

import numpy as np
import pytest

from depthcli.core.errors import ConfigError
from depthcli.core.volumes import Grid
from depthcli.io.formats.disparity import read_pfm
from depthcli.io.formats.volumes import read_volume, write_array
from depthcli.run.console import Reporter
from depthcli.run.flags import conditions_of, flag_rows
from tests.command_line import run
from tests.files import laid
from tests.golden import refused, told


def test_runs_say_which_scenes_are_flagged(two_scenes, tmp_path, tool):
    scenes, report = shutil.copytree(two_scenes, tmp_path / "in"), tmp_path / "run" / "report.json"
    command = ("stereo", "fast", "-i", scenes, "-o", report.parent)
    out = tool.out(4, *command, "--flag", "measured<2", "--fail-flagged")
    assert "flagged: 2 of 2" in out and re.search(r"planes_0 +measured 0\.\d+ < 2", out)
    before = report.read_bytes()  # nothing is computed again
    document = json.loads(tool.out(0, *command, "--flag", "measured<2", "--flag", "density<0", "--json", "-q"))
    assert {each["scene"] for each in document["flagged"]} == {"foreground_0", "planes_0"}
    assert report.read_bytes() == before
    assert "flagged: none of 2" in tool.out(0, *command, "--flag", "measured<0", "--fail-flagged")
    for code, *words in ((0,), (4, "--fail-flagged")):  # a condition without any value does not pass
        tool.told(code, *command, "-q", "--flag", "measred<5", *words)
    (scenes / "planes_0" / "left.png").write_bytes(b"no image")  # failed scenes come first
    assert run(*command, "--flag", "measured<2", "--fail-flagged") == 3


def test_scores_flag_scenes_in_tables_json_and_page(two_scenes, tmp_path, tool):
    made, out = tmp_path / "run", tmp_path / "scores"
    assert run("stereo", "fast", "-i", two_scenes, "-o", made, "-q") == 0
    command = ("evaluate", f"mine={made}", "--truth", two_scenes)
    flags = ("--flag", "bad 1.0 all>=0", "--flag", "measured<0", "--fail-flagged")
    shown = tool.out(4, *command, *flags, "-o", out, "--html")
    assert re.search(r"planes_0 +mine +bad 1 all \S+ >= 0", shown)
    page, document = (out / "report.html").read_text("utf-8"), json.loads((out / "scores.json").read_text())
    assert page.index('id="flagged"') < page.index('id="section-0"') and "bad 1 all" in page
    assert "has the best mean" not in page  # of a single run
    assert '<a href="#scene-' in page[page.index('id="flagged"') : page.index('id="section-0"')]
    assert len(document["flagged"]) == 2
    bad = {r["scene"]: next(s["value"] for s in r["scores"] if s["threshold"] == 1) for r in document["results"]}
    middle = sum(bad.values()) / 2
    for scene in ("foreground_0", "planes_0"):  # the flagged one begins the page
        limit = f"{'<' if bad[scene] < middle else '>'}{middle}"
        assert run(*command, "-o", tmp_path / scene, "--html", "-q", "--flag", f"bad 1{limit}") == 0
        assert f'<a href="#scene-0">{scene}</a>' in (tmp_path / scene / "report.html").read_text("utf-8")
    assert "flagged" not in json.loads(tool.out(0, *command, "--json"))
    document = json.loads(tool.out(0, *command, "--scenes", "planes_0", "--json", "--flag", "measured<2"))
    assert [each["scene"] for each in document["flagged"]] == ["planes_0"]


def test_thresholds_of_smaller_images_are_named_by_those_of_the_full_size(two_scenes, tmp_path, tool):
    truth = {name: read_pfm(two_scenes / name / "disp_left.pfm") for name in ("planes_0", "foreground_0")}
    laid(tmp_path / "run", {f"{name}.pfm": values * (name == "planes_0") for name, values in truth.items()})
    flags = ("--fail-flagged", "--flag", "bad 2 all>10", "--flag", "totbad 2>10")
    words = ("--truth", two_scenes, "-o", tmp_path / "out", "--protocol", "middlebury-v3", "--resolution", "H")
    out = tool.out(4, "evaluate", tmp_path / "run", *words, *flags)
    assert re.search(r"foreground_0 +run +bad 2 all [\d.]+ > 10; totbad 2 [\d.]+ > 10", out) and "planes_0" not in out
    assert "bad 2 (1)" in (tmp_path / "out" / "report.md").read_text()


@pytest.fixture
def pairs(made_volumes, tmp_path):
    return shutil.copytree(made_volumes, tmp_path / "in")


def measure(pairs, *words):
    own = ("--set", "radius=3", "--set", "half_window=1", "--quiet", "--json")
    return "register-confidence", "mind", "-i", pairs, "-o", pairs.parent / "run", *own, *words


def write_masks(pair, **masks):
    grid = read_volume(pair / "fixed.nii.gz").grid
    for name, mask in masks.items():
        write_array(pair / f"mask_{name}.nii.gz", grid, mask)


@pytest.mark.slow
def test_regions_of_registrations_are_reported_and_flagged(pairs, tool):
    volume = read_volume(pairs / "pair_0" / "fixed.nii.gz")
    none, voxel = np.zeros(volume.values.shape, np.uint8), np.prod(volume.grid.spacing) / 1000
    low, tiny = none.copy(), none.copy()
    low[:, :, : low.shape[2] // 2] = 1
    tiny[20, 30, 30] = 1  # a quarter of a block
    write_masks(pairs / "pair_0", low=low, all=np.full_like(low, 255), none=none, tiny=tiny)
    flags = ("--flag", "region_95_low>=0", "--flag", "region_95_all<0", "--fail-flagged")
    blocks = ("--set", "max_voxels=20000")  # of 2 x 2 x 1 voxels
    document = json.loads(tool.out(4, *measure(pairs, *blocks, *flags)))
    row = document["scenes"][0]
    error = read_volume(pairs.parent / "run" / "pair_0" / "expected_error.nii.gz").values
    assert row["region_mean_all"] == pytest.approx(error.mean(), rel=0.02)
    assert row["region_mean_low"] == pytest.approx(error[low > 0].mean(), rel=0.05)
    assert row["region_95_low"] > row["region_mean_low"] and "region_mean_none" not in row
    assert row["region_volume_low"] == pytest.approx(low.sum() * voxel, rel=0.01)
    assert row["region_volume_tiny"] == pytest.approx(voxel, abs=1e-4) and row["region_mean_tiny"] > 0
    assert [each["scene"] for each in document["flagged"]] == ["pair_0"]


@pytest.mark.slow
def test_labels_of_a_map_are_regions_of_their_own(pairs, tool):
    labels, names = np.zeros((40, 56, 56), np.uint8), pairs / "pair_1" / "meta.json"
    labels[:20], labels[20:30], labels[30:] = 1, 2, 7
    write_masks(pairs / "pair_0", organs=labels)
    write_masks(pairs / "pair_1", organs=(labels > 1).astype(np.uint8))
    tool.told(0, *(word for word in measure(pairs) if word != "--quiet"))  # one label alone has no number
    write_masks(pairs / "pair_1", organs=labels)
    names.write_text('{"labels": {"organs": {"background": 0, "liver": 1, "spleen": 2}}}')
    first, second = json.loads(tool.out(0, *measure(pairs)))["scenes"]
    error = read_volume(pairs.parent / "run" / "pair_1" / "expected_error.nii.gz").values
    assert {key for key in first if key.startswith("region_95")} == {f"region_95_organs_{k}" for k in (1, 2, 7)}
    assert second["region_mean_spleen"] == pytest.approx(error[labels == 2].mean(), rel=0.1)
    assert {"region_95_liver", "region_95_organs_7"} < second.keys() and "region_95_organs_1" not in second
    names.write_text('{"labels": {"organs": {"spleen": 1, "liver": 2}}}')  # names are an input
    assert json.loads(tool.out(0, *measure(pairs)))["scenes"][1]["region_mean_liver"] == second["region_mean_spleen"]


@pytest.mark.slow
def test_a_mask_that_cannot_be_used_is_left_out_and_said(pairs, tool):
    volume = read_volume(pairs / "pair_0" / "fixed.nii.gz")
    good = np.ones(volume.values.shape, np.uint8)
    write_masks(pairs / "pair_0", good=good, liver=good, organs=2 * (volume.values > 0))
    (pairs / "pair_0" / "meta.json").write_text('{"labels": {"organs": {"liver": 2}}}')
    write_array(pairs / "pair_0" / "mask_small.nii.gz", Grid((4, 4, 4), volume.grid.spacing), good[:4, :4, :4])
    (pairs / "pair_1" / "mask_cut.nii.gz").write_bytes((pairs / "pair_0" / "mask_good.nii.gz").read_bytes()[:100])
    for _ in range(2):  # the second time, nothing is computed
        out, err = tool.both(3, *measure(pairs))
        document = json.loads(out)
        assert [line.partition(":")[0] for line in err.splitlines()] == ["pair_0", "pair_0", "pair_1"]
        assert "another grid" in err and "mask_cut.nii.gz" in err and "two regions are called liver" in err
        assert document["scenes"][0]["region_volume_liver"] == document["scenes"][0]["region_volume_good"] > 0
        assert {each["error"] for each in document["scenes"]} == {""}


ROWS = [
    {"scene": "a", "measured": 0.4, "status": "done", "bad 1": 3.0, "bad 1 all": 9.0, "seconds": {"x": 1.0, "y": 2.0}},
    {"scene": "b", "measured": 0.6, "status": "failed", "bad 1": 5.0, "peak_memory": 7},
    {"scene": "c", "measured": float("nan"), "status": "done"},
]


def flagged(*texts):
    flags = flag_rows(conditions_of(texts), ROWS, Reporter())
    return [(each.scene, list(each.reasons)) for each in flags.flagged]


def test_a_condition_flags_the_rows_that_it_holds_for():
    expected = {
        "measured<0.6": "a", " measured <= .6": "ab", "measured>0.5": "b", "measured = 0.6": "b", "measured!=0.6": "a",
        "bad 1.0>3": "b", "bad  1 all>=9": "a", "memory>5": "b", "seconds>2.5": "a", "measured<-1e3": "",
    }  # fmt: skip
    assert {text: "".join(scene for scene, _ in flagged(text)) for text in expected} == expected


def test_rows_with_more_reasons_come_first_and_those_without_a_value_are_counted(capsys):
    assert flagged("measured<1", "bad 1>4") == [("b", ["measured 0.6 < 1", "bad 1 5 > 4"]), ("a", ["measured 0.4 < 1"])]
    assert [scene for scene, _ in flagged("measured<1")] == ["a", "b"]  # then those farthest beyond the limit
    capsys.readouterr()
    assert [scene for scene, _ in flagged("measured<1", "bad 2>0")] == ["a", "b"]
    told(capsys.readouterr().err)


@pytest.mark.parametrize("text", ["measured", "measured<", "", "measured<much", "measured=>0.5", "measured<nan"])
def test_wrong_conditions_are_refused_in_one_line(text):
    refused(ConfigError, conditions_of, [text])

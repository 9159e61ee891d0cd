"""``--flag`` and ``--fail-flagged``: what conditions mean, tables, JSON, the page, and exit codes."""

import json
import re
import shutil

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.core.errors import ConfigError
from depthcli.core.volumes import Grid
from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.volumes import read_volume, write_array
from depthcli.run.console import Reporter
from depthcli.run.flags import conditions_of, flag_rows, plain_name
from tests.golden import refused, told


def test_runs_say_which_scenes_are_flagged(two_scenes, tmp_path, tool):
    command = ["stereo", "fast", "-i", str(two_scenes), "-o", str(tmp_path / "run"), "--flag", "measured<2"]
    out = tool.out(4, *command, "--fail-flagged")
    assert "flagged: 2 of 2" in out and re.search(r"planes_0 +measured 0\.\d+ < 2", out)
    before = (tmp_path / "run" / "report.json").read_bytes()
    document = json.loads(tool.out(0, *command, "--flag", "density<0", "--json", "-q"))  # nothing is computed again
    assert {each["scene"] for each in document["flagged"]} == {"foreground_0", "planes_0"}
    assert (tmp_path / "run" / "report.json").read_bytes() == before
    assert "flagged: none of 2" in tool.out(0, *command[:-1], "measured<0", "--fail-flagged")


def test_scores_flag_scenes_in_tables_json_and_page(two_scenes, tmp_path, capsys, tool):
    run = tmp_path / "run"
    assert main(["stereo", "fast", "-i", str(two_scenes), "-o", str(run), "-q"]) == 0
    flags = ["--flag", "bad 1.0 all>=0", "--flag", "measured<0"]
    command = ["evaluate", f"mine={run}", "--truth", str(two_scenes), *flags]
    assert main([*command, "-o", str(tmp_path / "scores"), "--html", "--fail-flagged"]) == 4
    assert re.search(r"planes_0 +mine +bad 1 all \S+ >= 0", capsys.readouterr().out)
    page = (tmp_path / "scores" / "report.html").read_text("utf-8")
    assert page.index('id="flagged"') < page.index('id="section-0"') and "bad 1 all" in page
    assert '<a href="#scene-' in page[page.index('id="flagged"') : page.index('id="section-0"')]
    assert len(json.loads((tmp_path / "scores" / "scores.json").read_text())["flagged"]) == 2
    scores = json.loads((tmp_path / "scores" / "scores.json").read_text())["results"]
    bad = {r["scene"]: next(s["value"] for s in r["scores"] if s["threshold"] == 1) for r in scores}
    middle = sum(bad.values()) / 2
    for scene in ("foreground_0", "planes_0"):  # the flagged one begins the page
        words = ["evaluate", str(run), "--truth", str(two_scenes), "-o", str(tmp_path / scene), "--html", "-q"]
        limit = f"{'<' if bad[scene] < middle else '>'}{middle}"
        assert main([*words, "--flag", f"bad 1{limit}"]) == 0
        page = (tmp_path / scene / "report.html").read_text("utf-8")
        assert f'<a href="#scene-0">{scene}</a>' in page
    assert "flagged" not in json.loads(tool.out(0, *command[:-4], "--json"))


def test_thresholds_of_smaller_images_are_named_by_those_of_the_full_size(two_scenes, tmp_path, tool):
    truth = tmp_path / "truth"
    camera = "[100 0 60; 0 100 45; 0 0 1]"
    calibration = f"cam0={camera}\ncam1={camera}\ndoffs=0\nbaseline=100\nwidth=96\nheight=64\nndisp=16\n"
    for scene, value in (("planes_0", 4), ("foreground_0", 9)):
        write_pfm(truth / scene / "disp0GT.pfm", np.full((64, 96), 4, np.float32))
        for name, file in (("im0.png", "left.png"), ("im1.png", "right.png")):
            shutil.copy(two_scenes / scene / file, truth / scene / name)
        (truth / scene / "calib.txt").write_text(calibration)
        write_pfm(tmp_path / "run" / f"{scene}.pfm", np.full((64, 96), value, np.float32))
    command = ["evaluate", str(tmp_path / "run"), "--truth", str(truth), "-o", str(tmp_path / "out"), "--fail-flagged"]
    out = tool.out(4, *command, "--flag", "bad 2 all>10", "--flag", "totbad 2>10", "--resolution", "H")
    assert re.search(r"foreground_0 +run +bad 2 all 100 > 10; totbad 2 100 > 10", out)
    assert "bad 2 (1)" in (tmp_path / "out" / "report.md").read_text()


@pytest.fixture
def pairs(made_volumes, tmp_path):
    return shutil.copytree(made_volumes, tmp_path / "in")


def measure(pairs, *words):
    own = ["--set", "radius=3", "--set", "half_window=1", "--quiet"]
    return "register-confidence", "mind", "-i", pairs, "-o", pairs.parent / "run", *own, *words


@pytest.mark.slow
def test_regions_of_registrations_are_reported_and_flagged(pairs, tool):
    volume = read_volume(pairs / "pair_0" / "fixed.nii.gz")
    half = np.zeros(volume.values.shape, np.uint8)
    half[:, :, : half.shape[2] // 2] = 1
    write_array(pairs / "pair_0" / "mask_low.nii.gz", volume.grid, half)
    write_array(pairs / "pair_0" / "mask_all.nii.gz", volume.grid, np.full_like(half, 255))
    tiny = np.zeros_like(half)
    write_array(pairs / "pair_0" / "mask_none.nii.gz", volume.grid, tiny)
    tiny[20, 30, 30] = 1  # a quarter of a block
    write_array(pairs / "pair_0" / "mask_tiny.nii.gz", volume.grid, tiny)
    flags = ("--flag", "region_95_low>=0", "--flag", "region_95_all<0", "--fail-flagged")
    blocks = ("--set", "max_voxels=20000")  # of 2 x 2 x 1 voxels
    document = json.loads(tool.out(4, *measure(pairs, "--json", *blocks, *flags)))
    row = document["scenes"][0]
    error = read_volume(pairs.parent / "run" / "pair_0" / "expected_error.nii.gz").values
    assert row["region_mean_all"] == pytest.approx(error.mean(), rel=0.02)
    assert row["region_mean_low"] == pytest.approx(error[half > 0].mean(), rel=0.05)
    assert row["region_95_low"] > row["region_mean_low"] and "region_mean_none" not in row
    voxel = np.prod(volume.grid.spacing) / 1000
    assert row["region_volume_low"] == pytest.approx(half.sum() * voxel, rel=0.01)
    assert row["region_volume_tiny"] == pytest.approx(voxel, abs=1e-4) and row["region_mean_tiny"] > 0
    assert [each["scene"] for each in document["flagged"]] == ["pair_0"]


@pytest.mark.slow
def test_labels_of_a_map_are_regions_of_their_own(pairs, tool):
    volume = read_volume(pairs / "pair_0" / "fixed.nii.gz")
    labels = np.zeros(volume.values.shape, np.uint8)
    labels[:20], labels[20:30], labels[30:] = 1, 2, 7
    for pair in ("pair_0", "pair_1"):
        write_array(pairs / pair / "mask_organs.nii.gz", volume.grid, labels)
    (pairs / "pair_1" / "meta.json").write_text('{"labels": {"organs": {"background": 0, "liver": 1, "spleen": 2}}}')
    document = json.loads(tool.out(0, *measure(pairs, "--json")))
    error = read_volume(pairs.parent / "run" / "pair_1" / "expected_error.nii.gz").values
    first, second = document["scenes"]
    assert {key for key in first if key.startswith("region_95")} == {f"region_95_organs_{k}" for k in (1, 2, 7)}
    assert second["region_mean_spleen"] == pytest.approx(error[labels == 2].mean(), rel=0.1)
    assert {"region_95_liver", "region_95_organs_7"} < second.keys() and "region_95_organs_1" not in second
    (pairs / "pair_1" / "meta.json").write_text('{"labels": {"organs": {"spleen": 1, "liver": 2}}}')
    again = json.loads(tool.out(0, *measure(pairs, "--json")))["scenes"][1]  # names are an input
    assert again["region_mean_liver"] == second["region_mean_spleen"]


@pytest.mark.slow
def test_a_mask_that_cannot_be_used_is_left_out_and_said(pairs, tool):
    volume = read_volume(pairs / "pair_0" / "fixed.nii.gz")
    good = np.ones(volume.values.shape, np.uint8)
    write_array(pairs / "pair_0" / "mask_good.nii.gz", volume.grid, good)
    write_array(pairs / "pair_0" / "mask_small.nii.gz", Grid((4, 4, 4), volume.grid.spacing), good[:4, :4, :4])
    (pairs / "pair_1" / "mask_cut.nii.gz").write_bytes((pairs / "pair_0" / "mask_good.nii.gz").read_bytes()[:100])
    for _ in range(2):  # the second time, nothing is computed
        out, err = tool.both(3, *measure(pairs, "--json"))
        document = json.loads(out)
        assert [line.partition(":")[0] for line in err.splitlines()] == ["pair_0", "pair_1"]
        assert "another grid" in err and "mask_cut.nii.gz" in err
        assert "region_95_good" in document["scenes"][0] and {each["error"] for each in document["scenes"]} == {""}


def test_a_condition_without_any_value_does_not_pass(two_scenes, tmp_path, tool):
    command = ["stereo", "fast", "-i", str(two_scenes), "-o", str(tmp_path / "run"), "-q", "--flag", "measred<5"]
    for words in ((0, *command), (4, *command, "--fail-flagged")):
        tool.told(*words)


def test_failed_scenes_come_before_flagged_ones_in_the_exit_code(two_scenes, tmp_path):
    shutil.copytree(two_scenes, tmp_path / "in")
    (tmp_path / "in" / "planes_0" / "left.png").write_bytes(b"no image")
    command = ["stereo", "fast", "-i", str(tmp_path / "in"), "-o", str(tmp_path / "run"), "--flag", "measured<2"]
    assert main([*command, "--fail-flagged"]) == 3


ROWS = [
    {"scene": "a", "measured": 0.4, "status": "done", "bad 1": 3.0, "bad 1 all": 9.0, "seconds": {"x": 1.0, "y": 2.0}},
    {"scene": "b", "measured": 0.6, "status": "failed", "bad 1": 5.0, "peak_memory": 7},
    {"scene": "c", "measured": float("nan"), "status": "done"},
]


def flagged(*texts):
    flags = flag_rows(conditions_of(texts), ROWS, Reporter())
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
    told(capsys.readouterr().err)


@pytest.mark.parametrize("text", ["measured", "measured<", "", "measured<much", "measured=>0.5", "measured<nan"])
def test_wrong_conditions_are_refused_in_one_line(text):
    refused(ConfigError, conditions_of, [text])


def test_table_and_json():
    rows = [{"scene": "a", "run": "x", "bad 1": 3.0}, {"scene": "b", "run": "long", "bad 1": 2.5}]
    flags = flag_rows(conditions_of(["bad 1>2"]), rows, Reporter())
    assert flags.text().splitlines()[1:3] == ["flagged: 2 of 2", "scene  run   why"]
    assert [each["run"] for each in flags.to_dict()["flagged"]] == ["x", "long"]
    assert "none of 2" in flag_rows(conditions_of(["bad 1>9"]), rows, Reporter()).text()
    assert plain_name(" bad  1.0  nonocc ") == "bad 1 nonocc"

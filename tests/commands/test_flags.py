"""``--flag`` and ``--fail-flagged``: tables, JSON, the page, and exit codes."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.core.volumes import Grid
from depthcli.data.formats.volumes import read_volume, write_array


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flags") / "scenes"
    size = ["--width", "120", "--height", "90", "--max-disparity", "16", "-q"]
    assert main(["sample", "-o", str(folder), "-n", "2", *size]) == 0
    return folder


def test_runs_say_which_scenes_are_flagged(scenes, tmp_path, capsys):
    command = ["stereo", "fast", "-i", str(scenes), "-o", str(tmp_path / "run"), "--flag", "measured<2"]
    assert main([*command, "--fail-flagged"]) == 4
    out = capsys.readouterr().out
    assert "flagged: 2 of 2" in out and re.search(r"planes_0 +measured 0\.\d+ < 2", out)
    before = (tmp_path / "run" / "report.json").read_bytes()
    assert main([*command, "--flag", "density<0", "--json", "-q"]) == 0  # nothing is computed again
    document = json.loads(capsys.readouterr().out)
    assert {each["scene"] for each in document["flagged"]} == {"foreground_0", "planes_0"}
    assert (tmp_path / "run" / "report.json").read_bytes() == before
    assert main([*command[:-1], "measured<0", "--fail-flagged"]) == 0
    assert "flagged: none of 2" in capsys.readouterr().out


def test_scores_flag_scenes_in_tables_json_and_page(scenes, tmp_path, capsys):
    run = tmp_path / "run"
    assert main(["stereo", "fast", "-i", str(scenes), "-o", str(run), "-q"]) == 0
    command = ["evaluate", f"mine={run}", "--truth", str(scenes), "--flag", "bad 1.0 all>=0", "--flag", "measured<0"]
    assert main([*command, "-o", str(tmp_path / "scores"), "--html", "--fail-flagged"]) == 4
    assert re.search(r"planes_0 +mine +bad 1 all \S+ >= 0", capsys.readouterr().out)
    page = (tmp_path / "scores" / "report.html").read_text("utf-8")
    assert page.index('id="flagged"') < page.index('id="section-0"') and "bad 1 all" in page
    assert '<a href="#scene-' in page[page.index('id="flagged"') : page.index('id="section-0"')]
    assert len(json.loads((tmp_path / "scores" / "scores.json").read_text())["flagged"]) == 2
    for scene in ("foreground_0", "planes_0"):  # the flagged one begins the page
        words = ["evaluate", str(run), "--truth", str(scenes), "-o", str(tmp_path / scene), "--html", "-q"]
        assert main([*words, "--flag", f"source={scenes / scene / 'left.png'}"]) == 0
        page = (tmp_path / scene / "report.html").read_text("utf-8")
        assert f'<a href="#scene-0">{scene}</a>' in page
    capsys.readouterr()
    assert main([*command[:-4], "--json"]) == 0
    assert "flagged" not in json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("text", ["bda 1>2", "measured", "measured<much"])
def test_a_wrong_condition_is_refused_before_anything_is_computed(scenes, tmp_path, capsys, text):
    command = ["stereo", "fast", "-i", str(scenes), "-o", str(tmp_path / "run"), "--flag", text]
    assert main(command) == 2
    assert capsys.readouterr().err.count("\n") == 1 and not (tmp_path / "run").exists()


def test_failed_scenes_come_before_flagged_ones_in_the_exit_code(scenes, tmp_path, capsys):
    broken = tmp_path / "in"
    for scene in scenes.iterdir():
        for file in scene.glob("*") if scene.is_dir() else ():
            (broken / scene.name).mkdir(parents=True, exist_ok=True)
            (broken / scene.name / file.name).write_bytes(file.read_bytes())
    (broken / "planes_0" / "left.png").write_bytes(b"no image")
    command = ["stereo", "fast", "-i", str(broken), "-o", str(tmp_path / "run"), "--flag", "status=failed"]
    assert main([*command, "--fail-flagged"]) == 3
    assert re.search(r"planes_0 +status failed", capsys.readouterr().out)


@pytest.mark.slow
def test_regions_of_registrations_are_reported_and_flagged(tmp_path, capsys):
    assert main(["sample", "--registration", "-o", str(tmp_path / "in"), "-n", "1", "-q"]) == 0
    pair = tmp_path / "in" / "pair_0"
    volume = read_volume(pair / "fixed.nii.gz")
    half = np.zeros(volume.values.shape, np.uint8)
    half[:, :, : half.shape[2] // 2] = 1
    write_array(pair / "mask_low.nii.gz", volume.grid, half)
    write_array(pair / "mask_all.nii.gz", volume.grid, np.ones_like(half))
    write_array(pair / "mask_none.nii.gz", volume.grid, np.zeros_like(half))
    command = ["register-confidence", "mind", "-i", str(tmp_path / "in"), "-o", str(tmp_path / "run"), "--json", "-q"]
    command += ["--set", "radius=3", "--set", "half_window=1"]
    assert main([*command, "--flag", "region_95_low>=0", "--flag", "region_95_all<0"]) == 0
    document = json.loads(capsys.readouterr().out)
    (row,) = document["scenes"]
    error = read_volume(tmp_path / "run" / "pair_0" / "expected_error.nii.gz").values
    assert row["region_mean_all"] == pytest.approx(error.mean(), rel=0.02)
    assert row["region_mean_low"] == pytest.approx(error[half > 0].mean(), rel=0.05)
    assert row["region_95_low"] > row["region_mean_low"] and "region_mean_none" not in row
    assert document["flagged"][0]["reasons"][0].startswith("region_95_low ")
    write_array(pair / "mask_low.nii.gz", Grid((4, 4, 4), volume.grid.spacing), np.ones((4, 4, 4), np.uint8))
    assert main(command) == 3  # the region is an input: computed again, and refused

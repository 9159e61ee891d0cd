"""Sweeps from end to end, and --dry-run."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from depthcli.cli import main
from depthcli.core.yaml_source import read_config
from depthcli.methods.stereo.config import StereoConfig
from depthcli.run.presets import find_config


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweep") / "set"
    size = ("--width", "64", "--height", "40", "--max-disparity", "8")
    assert main(["sample", "-o", str(folder), "-n", "2", *size, "-q"]) == 0
    return folder


def sweep(scenes: Path, output: Path, *more: str) -> int:
    return main(["sweep", "fast", "-i", str(scenes), "-o", str(output), *more])


@pytest.mark.slow
def test_a_sweep_is_resumed_and_says_what_matters(scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    over = ("--over", "optimization.p2=2,8", "--over", "cost.window=[5,5],[9,7]")
    assert sweep(scenes, tmp_path, *over, "--html") == 0
    out, err = capsys.readouterr()
    assert err.rstrip().endswith(f": {tmp_path / 'evaluation' / 'report.html'}")
    assert "Sensitivity, the strongest first" in out
    runs = sorted(path.name for path in (tmp_path / "runs").iterdir())
    assert runs == ["own-values", "p2=2,window=5-5", "p2=2,window=9-7", "p2=8,window=5-5", "p2=8,window=9-7"]
    runs.remove("own-values")
    assert "own-values *" in out
    assert "*: the config's own values" in out
    assert "window: [9, 7]" in (tmp_path / "runs" / runs[1] / "run.yaml").read_text()
    (result,) = json.loads((tmp_path / "sweep.json").read_text())["results"]
    scores = json.loads((tmp_path / "evaluation" / "scores.json").read_text())
    figures = {each["run"]: each["value"] for each in scores["headlines"]}
    rows = {row["run"]: row for row in result["runs"]}
    assert {run: row[result["headline"]] for run, row in rows.items()} == figures
    assert rows[runs[0]]["optimization.p2"] == "2"
    assert [run for run, row in rows.items() if row["own_values"]] == ["own-values"]
    own = StereoConfig.model_validate(read_config(find_config("stereo", "fast")).data).pipeline
    assert float(rows["own-values"]["optimization.p2"]) == own.optimization.p2
    assert json.loads(rows["own-values"]["cost.window"]) == list(own.cost.window)
    assert result["best"] == min(figures, key=lambda run: figures[run])
    by_key = {each["key"]: each for each in result["sensitivity"]}
    means = {each["value"]: each["mean"] for each in by_key["optimization.p2"]["values"]}
    assert means["2"] == pytest.approx((figures[runs[0]] + figures[runs[1]]) / 2)
    with (tmp_path / "sweep.csv").open(newline="") as file:
        assert [row["run"] for row in csv.DictReader(file)] == [row["run"] for row in result["runs"]]
    assert (tmp_path / "evaluation" / "report.html").is_file()
    maps = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("disp_left.pfm")}
    assert sweep(scenes, tmp_path, "--over", "optimization.p2=2,8,4", *over[2:], "--json") == 0
    captured = capsys.readouterr()
    assert not list(tmp_path.glob(".*"))
    assert len(json.loads(captured.out)["results"][0]["runs"]) == 7
    assert {path: path.stat().st_mtime_ns for path in maps} == maps


def test_wrong_keys_are_told_before_anything_is_computed(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert sweep(scenes, tmp_path / "a", "--over", "optimization.pp=2,8") == 2
    assert "depthcli: --over optimization.pp: no such key" in capsys.readouterr().err
    assert sweep(scenes, tmp_path / "a", "--over", "optimization.p2=2,-8") == 2
    assert "depthcli: --over optimization.p2: should be greater than 0 (got -8)" in capsys.readouterr().err
    assert sweep(scenes, tmp_path / "a", "--over", "optimization.p2=2", "--command", "evaluate") == 2
    assert "--command: must be one of stereo, fuse" in capsys.readouterr().err
    assert not (tmp_path / "a").exists()


def test_draws_and_dry_runs(scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    over = ("--over", "optimization.p2=1:9:1", "--over", "optimization.p1=0.1:0.9:0.1", "--random", "3", "--seed", "2")
    assert sweep(scenes, tmp_path / "a", *over, "--dry-run", "--json") == 0
    rows = json.loads(capsys.readouterr().out)["runs"]
    assert [(row["scenes"], row["done"]) for row in rows] == [(2, 0)] * 4
    assert sweep(scenes, tmp_path / "a", *over, "--dry-run") == 0
    assert rows[0]["run"] in capsys.readouterr().out
    assert not (tmp_path / "a").exists()


def test_a_dry_run_lists_config_scenes_memory_and_what_is_done(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    output = tmp_path / "run"
    command = ["stereo", "fast", "-i", str(scenes), "-o", str(output)]
    assert main([*command, "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "pipeline: local" in out
    assert "2 scenes: 2 to do" in out
    assert "MiB" in out
    assert not output.exists()
    name = next(path.name for path in sorted(scenes.iterdir()) if path.is_dir())
    assert main([*command, "--scenes", name, "-q"]) == 0
    assert main([*command, "--dry-run", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [row["status"] for row in document["scenes"]] == ["done, kept", "to do"]
    assert all(row["memory"] > 10_000 for row in document["scenes"])
    assert main([*command, "--set", "optimization.p2=3", "--dry-run"]) == 0
    assert "made with another config; needs --overwrite" in capsys.readouterr().out
    assert main([*command, "--list-scenes", "--shard", "2/2"]) == 0
    assert len(capsys.readouterr().out.split()) == 1


def test_dry_runs_of_commands_without_a_config(scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    output = tmp_path / "out"
    assert main(["sample", "-o", str(output), "--dry-run"]) == 0
    assert "6 to do" in capsys.readouterr().out
    run = tmp_path / "run"
    assert main(["stereo", "fast", "-i", str(scenes), "-o", str(run), "-q"]) == 0
    assert main(["depth", str(run), "-o", str(output), "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "2 scenes: 2 cannot be used" in out
    assert "no calibration beside the images" in out
    by_hand = ("--focal", "500", "--baseline", "0.1")
    assert main(["depth", str(run), "-o", str(output), *by_hand, "--dry-run", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["config"]["focal"] == 500
    assert [row["status"] for row in document["scenes"]] == ["to do"] * 2
    absent = str(tmp_path / "absent.yml")
    command = ["rectify", "-i", str(scenes), "-o", str(output), "--dry-run"]
    assert main([*command, "--calibration", absent]) == 0
    assert absent in capsys.readouterr().out
    assert main([*command, "--uncalibrated"]) == 0
    assert "2 scenes: 2 to do" in capsys.readouterr().out
    assert not output.exists()


def test_completion(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setenv("_DEPTHCLI_COMPLETE", "complete_bash")
    for words, place, wanted in (("depthcli ste", "1", "stereo"), ("depthcli evaluate --thr", "2", "--threshold")):
        monkeypatch.setenv("COMP_WORDS", words)
        monkeypatch.setenv("COMP_CWORD", place)
        with pytest.raises(SystemExit):
            main([])
        assert wanted in capsys.readouterr().out.split()


@pytest.mark.slow
def test_own_values_that_are_tried_anyway_are_marked(scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    command = ["sweep", "opencv-bm", "-i", str(scenes), "-o", str(tmp_path), "--set", "block=7"]
    assert main([*command, "--over", "block=5,7"]) == 0
    out = capsys.readouterr().out
    assert sorted(path.name for path in (tmp_path / "runs").iterdir()) == ["block=5", "block=7"]
    assert "block=7 *" in out
    assert "block=5 *" not in out
    with (tmp_path / "sweep.csv").open(newline="") as file:
        assert {row["run"]: row["own_values"] for row in csv.DictReader(file)} == {
            "block=5": "False",
            "block=7": "True",
        }

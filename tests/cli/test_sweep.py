"""Sweeps from end to end, their combinations and what their figures say, and --dry-run."""

import csv
import itertools
import json
import math
import shutil
import sys
from pathlib import Path

import pytest

import depthcli.commands.sweep
from depthcli.core.errors import ConfigError
from depthcli.evaluation.sweeps import combinations, effects, folder_names, parse_axes, value_text
from depthcli.run.folder import FolderLock
from tests.command_line import run
from tests.files import laid
from tests.golden import refused


@pytest.mark.slow
def test_a_sweep_is_resumed_and_says_what_matters(two_scenes: Path, tmp_path: Path, tool):
    command, window = ("sweep", "fast", "-i", two_scenes, "-o", tmp_path), ("--over", "cost.window=[5,5],[9,7]")
    out, err = tool.both(0, *command, "--over", "optimization.p2=2,8", *window, "--html")
    assert err.rstrip().endswith(f": {tmp_path / 'evaluation' / 'report.html'}")
    assert "Sensitivity, the strongest first" in out
    runs = {path.name for path in (tmp_path / "runs").iterdir()}
    assert runs == {"own-values", "p2=2,window=5-5", "p2=2,window=9-7", "p2=8,window=5-5", "p2=8,window=9-7"}
    assert "own-values *" in out and "*: the config's own values" in out
    assert "window: [9, 7]" in (tmp_path / "runs" / "p2=2,window=9-7" / "run.yaml").read_text()
    assert (tmp_path / "evaluation" / "report.html").is_file()
    maps = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("disp_left.pfm")}
    again = tool.out(0, *command, "--over", "optimization.p2=2,8,4", *window, "--json")
    assert not list(tmp_path.glob(".*"))
    assert len(json.loads(again)["results"][0]["runs"]) == 7
    assert {path: path.stat().st_mtime_ns for path in maps} == maps


def test_wrong_values_draws_and_dry_runs_compute_nothing(two_scenes: Path, tmp_path: Path, tool):
    command = ("sweep", "fast", "-i", two_scenes, "-o", tmp_path / "a", "--over")
    tool.told(2, *command, "optimization.p2=2,-8")
    draws = ("optimization.p2=1:9:1", "--over", "optimization.p1=0.1:0.9:0.1", "--random", "3", "--seed", "2")
    rows = json.loads(tool.out(0, *command, *draws, "--dry-run", "--json"))["runs"]
    assert [(row["scenes"], row["done"]) for row in rows] == [(2, 0)] * 4
    assert rows[0]["run"] in tool.out(0, *command, *draws, "--dry-run")
    assert not (tmp_path / "a").exists()


def test_the_thesis_s_symbols_are_names_of_keys(two_scenes: Path, tmp_path: Path, tool):
    command = ("sweep", "thesis/ch2-kp-dedc", "-i", two_scenes, "-o", tmp_path / "a", "--dry-run", "--json")
    over = ("--over", "alpha=0.1,0.2", "--over", "sigma=150", "--set", "w=30")
    rows = json.loads(tool.out(0, *command, *over))["runs"]
    assert [row["run"] for row in rows][1:] == ["margin=0.1,color_scale=150", "margin=0.2,color_scale=150"]
    tool.told(2, *command, *over, "--over", "ranges.margin=0.3")
    for name, keys, said in (
        ("ch2-kp-dedc", "lambda w sigma hs hr", "ranges.margin"), ("ch3-ad-census-cross", "tau L", "aggregation."),
        ("ch3-ad-aw", "gamma_c gamma_s", "aggregation."),
    ):  # fmt: skip
        command = ("stereo", f"thesis/{name}", "-i", two_scenes, "--dry-run")
        tool.both(0, *command, *(f"--set={key}=3" for key in keys.split()))
        wrong = [*keys.split(), *(["alpha"] if "ch2" in name else [])]
        assert said in tool.err(2, *command, *(f"--set={key}=x" for key in wrong))


def test_a_dry_run_lists_config_scenes_memory_and_what_is_done(two_scenes: Path, tmp_path: Path, tool):
    output, alone = tmp_path / "run", ("stereo", "fast", "-i", two_scenes)
    command = (*alone, "-o", output)
    out, plan = tool.both(0, *command, "--dry-run")
    assert out == "foreground_0\nplanes_0\n"
    assert "pipeline: local" in plan and "2 scenes: 2 to do" in plan and "MiB" in plan
    assert not output.exists()
    assert tool.both(0, *alone, "--dry-run") == (out, plan)
    assert json.loads(tool.out(0, *alone, "--dry-run", "--json"))["output"] is None
    tool.told(2, *alone)
    assert run(*command, "--scenes", "foreground_0", "-q") == 0
    document = json.loads(tool.out(0, *command, "--dry-run", "--json"))
    assert [row["status"] for row in document["scenes"]] == ["done, kept", "to do"]
    assert all(180 << 20 < row["memory"] < 300 << 20 for row in document["scenes"])  # of the whole process
    tool.told(3, *alone, "-o", tmp_path / "small", "--max-memory", "100MiB")
    err = tool.err(2, *command, "--set", "optimization.p2=3", "--dry-run")
    assert "another config; needs --overwrite" in err and "has a run of another config (it has" in err
    tool.both(0, *command, "--set", "optimization.p2=3", "--dry-run", "--overwrite")
    assert len(tool.out(0, *command, "--list-scenes", "--shard", "2/2").split()) == 1


def test_dry_runs_of_commands_without_a_config(two_scenes: Path, tmp_path: Path, tool):
    output, made = ("-o", tmp_path / "out", "--dry-run"), tmp_path / "run"
    tool.told(0, "sample", *output)
    assert run("stereo", "fast", "-i", two_scenes, "-o", made, "-q") == 0
    plan = tool.err(0, "depth", made, *output)
    assert "2 scenes: 2 cannot be used" in plan and "no calibration with the images" in plan
    document = json.loads(tool.out(0, "depth", made, *output, "--focal", "500", "--baseline", "0.1", "--json"))
    assert document["config"]["focal"] == 500
    assert [row["status"] for row in document["scenes"]] == ["to do"] * 2
    for how in (("--calibration", tmp_path / "absent.yml"), ("--uncalibrated",)):
        tool.told(0, "rectify", "-i", two_scenes, *output, *how)
    assert not (tmp_path / "out").exists()


def test_sweeps_without_truth_without_own_values_and_beside_other_files(two_scenes: Path, tmp_path: Path, tool):
    scenes = shutil.copytree(two_scenes, tmp_path / "in", ignore=shutil.ignore_patterns("disp*"))
    command = ("sweep", "opencv-bm", "-i", scenes, "-o", tmp_path / "a", "--over", "block=5,7")
    tool.told(0, *command)
    assert not (tmp_path / "a" / "sweep.csv").exists() and (tmp_path / "a" / "runs" / "block=7").is_dir()
    laid(tmp_path / "b", {"sweep.csv": "mine"})
    tool.told(2, *command[:4], "-o", tmp_path / "b", *command[6:])
    config = laid(tmp_path, {"c.yaml": "pipeline: command\n"}) / "c.yaml"  # which of the programs is not said
    program = f'program=["{sys.executable}","-c","1","{{left}}","{{right}}","{{output}}"]'
    words = ("sweep", config, "-i", scenes, "-o", tmp_path / "c", "--dry-run", "--json", "--over")
    rows = json.loads(tool.out(0, *words, program, "--over", "max_disparity=9,12"))["runs"]
    assert [row["run"].rpartition(",")[2] for row in rows] == ["max_disparity=9", "max_disparity=12"]


@pytest.mark.slow
def test_the_sweep_that_ends_last_compares_and_marks_own_values(two_scenes: Path, tmp_path: Path, tool, monkeypatch):
    command = ("sweep", "opencv-bm", "-i", two_scenes, "-o", tmp_path, "--set", "block=7", "--over", "block=5,7")
    with FolderLock(tmp_path, print) as other:  # as of another process, which has not ended
        other.share()
        assert tool.out(0, *command) == ""
        assert [path.name for path in tmp_path.glob("[!.]*")] == ["runs"]
        with monkeypatch.context() as patch:
            patch.setattr(depthcli.commands.sweep, "_compute", lambda *_: (True, True))  # one failed, others go on
            tool.told(3, *command)
    out = tool.out(0, *command)
    assert "block=7 *" in out and "block=5 *" not in out
    with (tmp_path / "sweep.csv").open(newline="") as file:
        own = {row["run"]: row["own_values"] for row in csv.DictReader(file)}
    assert own == {"block=5": "False", "block=7": "True"}


def test_axes():
    for text, values in {
        "a.b=2,4,8": ["2", "4", "8"],
        "a=20:40:5": ["20", "25", "30", "35", "40"],
        "a=0.1:0.3:0.1": ["0.1", "0.2", "0.3"],
        "a=3:1:-1": ["3", "2", "1"],
        "a=0:1:0.4": ["0", "0.4", "0.8"],
        "a=100:300:100": ["100", "200", "300"],
        "a=[9,7],[11,9]": ["[9,7]", "[11,9]"],
        "a={method: census, window: [9, 7]}, zncc": ["{method: census, window: [9, 7]}", "zncc"],
        "a=true": ["true"],
    }.items():
        assert parse_axes([text]) == {text.partition("=")[0]: values}


@pytest.mark.parametrize("text", ["a", "=1", "a=", "a=1,,2", "a=2,2", "a=1:5:0", "a=5:1:1", "a=0:1:1e-9", "b=1"])
def test_wrong_axes(text: str):
    refused(ConfigError, parse_axes, ["b=1", text])


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
    refused(ConfigError, combinations, huge)


def test_names_are_short_and_differ():
    axes = {"cost.p": ("1", "2"), "optimization.p": ("[9, 7]", "[9 7]"), "a.window": ("x/y",)}
    names = folder_names(axes, combinations(axes))
    assert len(set(names)) == 4
    assert names[0].startswith("cost.p=1,optimization.p=9-7,window=x-y-")
    assert all(name == name.strip("./") and "/" not in name for name in names)
    assert folder_names({"a.b": ["4"]}, [("4",)]) == ["b=4"]
    long = {"k": ("v" * 200, "w" * 200)}
    assert all(len(name) <= 120 for name in folder_names(long, combinations(long)))


def test_effects_by_hand():
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
    # Without figures.
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

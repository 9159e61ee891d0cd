"""``depthcli warmup``: what it compiled is not compiled again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from depthcli.cli import main
from tests.kernels.test_cache import ROOT


def run(cache: Path, *arguments: str) -> str:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "depthcli", *arguments]
    return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout


def test_the_list_has_the_longest_first(capsys):
    assert main(["warmup", "stereo/fast", "--list", "--json"]) == 0
    calls = json.loads(capsys.readouterr().out)
    assert calls
    assert [call["seconds"] for call in calls] == sorted((call["seconds"] for call in calls), reverse=True)
    assert main(["warmup", "stereo/fast", "--list"]) == 0
    assert f"{len(calls)} kernels" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["nothing/there"], [], ["stereo/fast", "nope"]])
def test_wrong_presets_are_one_line(words, capsys):
    assert main(["warmup", *words]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_a_preset_without_kernels_is_ready(capsys):
    assert main(["warmup", "refine-kinect/nearest", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"kernels": 0, "compiled": 0, "failed": []}


@pytest.mark.system
def test_a_run_behind_it_compiles_nothing(tmp_path: Path, made_scenes: Path):
    cache = tmp_path / "cache"
    first = json.loads(run(cache, "warmup", "stereo/fast", "--json"))
    assert first["compiled"] == first["kernels"] > 0
    assert first["failed"] == []
    kept = {path: path.stat().st_mtime_ns for path in cache.rglob("*.nbc")}
    assert json.loads(run(cache, "warmup", "transparent/nearest", "--json", "--jobs", "1"))["compiled"] > 0
    assert json.loads(run(cache, "warmup", "stereo/fast", "--json"))["compiled"] == 0
    before = set(cache.rglob("*.nbc"))
    run(cache, "stereo", "fast", "-i", str(made_scenes), "--scenes", "planes_0", "-o", str(tmp_path / "out"))
    assert set(cache.rglob("*.nbc")) == before
    assert kept.items() <= {path: path.stat().st_mtime_ns for path in before}.items()

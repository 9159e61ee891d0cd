"""The examples of Snakemake and DVC, run by these programs where they are installed."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from depthcli.cli import main

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "docs" / "examples"

Runner = Callable[..., subprocess.CompletedProcess[str]]


def needs(program: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(shutil.which(program) is None, reason=f"{program} is not installed")


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Two scenes where the examples expect them."""
    folder = tmp_path / "data" / "middlebury_v2"
    size = ["--width", "120", "--height", "90", "--max-disparity", "16"]
    assert main(["sample", "--output", str(folder), "--count", "2", *size, "--quiet"]) == 0
    return folder


@pytest.fixture
def workflow(tmp_path: Path) -> Runner:
    """Run a program in the folder of the test, with these sources as ``depthcli``."""
    start = tmp_path / "bin" / "depthcli"
    start.parent.mkdir()
    start.write_text(f'#!/bin/sh\nPYTHONPATH="{ROOT}" exec "{sys.executable}" -m depthcli "$@"\n')
    start.chmod(0o755)
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    env = inherited | {"PATH": f"{start.parent}:{os.environ['PATH']}", "HOME": str(tmp_path), "DVC_NO_ANALYTICS": "1"}
    env["NUMBA_CACHE_DIR"] = os.environ.get("NUMBA_CACHE_DIR", str(Path.home() / ".cache" / "depthcli" / "kernels"))

    def run(*command: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=300, check=False)

    return run


@pytest.mark.system
@needs("snakemake")
def test_runs_by_snakemake_follow_their_configs(data: Path, tmp_path: Path, workflow: Runner):
    shutil.copy(EXAMPLES / "snakemake" / "Snakefile", tmp_path)
    (tmp_path / "experiments").mkdir()
    for name, preset in (("fast", "fast"), ("bm", "opencv-bm")):
        (tmp_path / "experiments" / f"{name}.yaml").write_text(f"base: {preset}\n")
    done = workflow("snakemake", "--cores", "2")
    assert done.returncode == 0, done.stderr
    log, kept = tmp_path / "experiments.jsonl", (tmp_path / "runs" / "bm" / "report.json").stat().st_mtime_ns
    assert [json.loads(line)["run"] for line in log.read_text().splitlines()] == ["bm", "fast"]
    (tmp_path / "experiments" / "fast.yaml").write_text("base: fast\noptimization:\n  p2: 60\n")
    done = workflow("snakemake", "--cores", "2")
    assert done.returncode == 0, done.stderr
    changes = [json.loads(line)["changes"] for line in log.read_text().splitlines()]
    assert changes == [{}, {}, {"optimization.p2": 60.0}]
    assert (tmp_path / "runs" / "bm" / "report.json").stat().st_mtime_ns == kept
    assert "Nothing to be done" in workflow("snakemake", "--cores", "2").stderr


@pytest.mark.system
@needs("dvc")
def test_stages_by_dvc_follow_their_parameters(data: Path, tmp_path: Path, workflow: Runner):
    for file in (EXAMPLES / "dvc").iterdir():
        shutil.copy(file, tmp_path)
    assert workflow("dvc", "init", "--no-scm").returncode == 0
    found = []
    for p2 in (120, 60):
        parameters = tmp_path / "params.yaml"
        parameters.write_text(re.sub(r"p2: \d+", f"p2: {p2}", parameters.read_text()))
        done = workflow("dvc", "repro")
        assert done.returncode == 0, done.stderr
        shown = json.loads(workflow("dvc", "metrics", "show", "--json").stdout)
        (document,) = (values for root in shown.values() for values in root["data"].values())
        document = document["data"]
        assert document["config"]["optimization"]["p2"] == p2
        found.append(document["metrics"]["middlebury_v2/overall/bad 1"])
    assert found[0] != found[1]
    assert "Data and pipelines are up to date" in workflow("dvc", "repro").stdout


def test_commands_of_the_example_for_dvc(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    stages = yaml.safe_load((EXAMPLES / "dvc" / "dvc.yaml").read_text())["stages"]
    parameters = yaml.safe_load((EXAMPLES / "dvc" / "params.yaml").read_text())

    def value(name: re.Match[str]) -> str:
        found = parameters
        for part in name[1].split("."):
            found = found[part]
        return str(found)

    monkeypatch.chdir(tmp_path)
    for stage in stages.values():
        command, _, otherwise = re.sub(r"\$\{([\w.]+)\}", value, stage["cmd"]).partition("||")
        assert otherwise.strip() == "[ $? -eq 3 ]"
        program, *arguments = shlex.split(command)
        assert program == "depthcli"
        assert main(arguments) == 0
        for each in (*stage["outs"], *stage.get("metrics", ())):
            assert Path(each if isinstance(each, str) else next(iter(each))).exists()
    assert json.loads((tmp_path / "metrics.json").read_text())["preset"] == "fast"

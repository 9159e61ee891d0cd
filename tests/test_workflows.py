"""The example of Snakemake, run by this program where it is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from depthcli.cli import main

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.system
@pytest.mark.skipif(shutil.which("snakemake") is None, reason="snakemake is not installed")
def test_runs_by_snakemake_follow_their_configs(tmp_path: Path):
    size = ["--width", "120", "--height", "90", "--max-disparity", "16"]
    data = str(tmp_path / "data" / "middlebury_v2")
    assert main(["sample", "--output", data, "--count", "2", *size, "--quiet"]) == 0
    shutil.copy(ROOT / "docs" / "examples" / "snakemake" / "Snakefile", tmp_path)
    program = tmp_path / "bin" / "depthcli"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nPYTHONPATH="{ROOT}" exec "{sys.executable}" -m depthcli "$@"\n')
    program.chmod(0o755)
    environment = os.environ | {"PATH": f"{program.parent}:{os.environ['PATH']}"}
    environment.pop("PYTHONPATH", None)

    def snakemake() -> str:
        command = ["snakemake", "--cores", "2"]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stderr

    (tmp_path / "experiments").mkdir()
    for name, preset in (("fast", "fast"), ("bm", "opencv-bm")):
        (tmp_path / "experiments" / f"{name}.yaml").write_text(f"base: {preset}\n")
    snakemake()
    kept = (tmp_path / "runs" / "bm" / "report.json").stat().st_mtime_ns
    (tmp_path / "experiments" / "fast.yaml").write_text("base: fast\noptimization:\n  p2: 60\n")
    snakemake()
    assert yaml.safe_load((tmp_path / "runs" / "fast" / "run.yaml").read_text())["optimization"]["p2"] == 60
    assert (tmp_path / "runs" / "bm" / "report.json").stat().st_mtime_ns == kept
    assert "Nothing to be done" in snakemake()

"""The wheel, as a user gets it: installed elsewhere, with its presets."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.system
def test_the_wheel_matches_a_scene_in_an_environment_of_its_own(tmp_path: Path, made_scenes: Path):
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(tmp_path), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "env")], check=True)
    (packages,) = (tmp_path / "env" / "lib").glob("python*/site-packages")
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(packages)]
    subprocess.run([*install, str(wheel)], check=True)
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    python, out = str(tmp_path / "env" / "bin" / "python"), str(tmp_path / "run")
    run = [python, "-m", "depthcli", "stereo", "fast", "-i", str(made_scenes), "-o", out, "--scenes", "planes_0"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run(run, env=environment, cwd=tmp_path, check=True)
    assert (tmp_path / "run" / "planes_0" / "disp_left.pfm").is_file()

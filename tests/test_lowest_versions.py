"""The lowest versions that ``pyproject.toml`` declares, in an environment of their own: the commands run."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.command_line import ended

ROOT = Path(__file__).resolve().parent.parent

pytestmark = [pytest.mark.first, pytest.mark.system]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lowest")
    subprocess.run([sys.executable, "-m", "venv", folder / "tool"], check=True)
    if subprocess.run([folder / "tool/bin/pip", "install", "-q", "uv"], check=False).returncode:
        pytest.skip("no uv to be had: it installs the lowest versions")
    uv = folder / "tool/bin/uv"
    subprocess.run([uv, "venv", "-q", "--python", sys.executable, folder / "env"], check=True)
    lowest = ["--resolution", "lowest-direct", "--python", folder / "env/bin/python", f"{ROOT}[medical]"]
    subprocess.run([uv, "pip", "install", "-q", *lowest], check=True)
    return folder


def test_commands_run(place: Path):
    def run(*words: str) -> str:
        names = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "NUMBA_CACHE_DIR")}
        return ended(0, place / "env/bin/python", "-m", "depthcli", *words, cwd=place, env=names).stdout

    assert "refine-kinect" in run("--help")
    run("sample", "-o", "pairs", "--count", "1", "--kind", "planes", "-q")
    run("sample", "--kinect", "-o", "frames", "-q")
    run("stereo", "fast", "-i", "pairs", "-o", "runs/fast", "-j", "1", "--bound")
    run("stereo", "segments", "-i", "pairs", "-o", "runs/segments", "-j", "1")
    assert "segments" in run("evaluate", "runs/fast", "runs/segments", "--truth", "pairs", "-o", "out", "--html")
    run("refine-kinect", "fast", "-i", "frames", "--scenes", "planes", "-o", "runs/kinect", "-j", "1")
    run("sample", "--registration", "-o", "volumes", "-q")
    run("register-confidence", "axes", "-i", "volumes", "-o", "runs/volumes", "-j", "1")

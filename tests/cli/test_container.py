"""Without privileges, a home, or anything that can be written but the output."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "container_test"


@pytest.mark.system
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits as Linux has them")
def test_it_runs_as_in_a_container():
    command = [sys.executable, str(SCRIPT), "--presets", "stereo/opencv-bm", "--width", "160"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=SCRIPT.parents[1])
    if done.returncode == 2:
        pytest.skip(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr

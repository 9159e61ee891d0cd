from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "kill_test"


@pytest.mark.system
@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_killed_runs_end_with_the_same_bytes():
    small = ("--preset", "opencv-sgbm", "--width", "160", "--scenes", "5")
    command = [sys.executable, str(SCRIPT), "--kills", "30", *small]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=SCRIPT.parents[1])
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("every re-run gave the bytes") == 11  # commands

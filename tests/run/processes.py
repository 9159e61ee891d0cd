"""Runs in processes of their own, and what stands in their folders."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from depthcli.run.folder import REPORT_FILES
from depthcli.run.records import RECORD_FILE


def start(*arguments: str | Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "depthcli", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file without measured times, hidden ones included."""
    others = (*REPORT_FILES, RECORD_FILE)
    paths = (path for path in folder.rglob("*") if path.is_file() and path.name not in others)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def wait_for(folder: Path, scenes: int, process: subprocess.Popen[Any]) -> None:
    """Until so many scenes are done; the run must not be over by then."""
    end = time.monotonic() + 120
    while len(list(folder.glob(f"*/{RECORD_FILE}"))) < scenes:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.002)

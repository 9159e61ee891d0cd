"""The tool, called in the process of the tests or in its own, and what it left and said."""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.io.formats.files import RECORD_FILE
from depthcli.run.records import REPORT_FILES
from tests.golden import told


def run(*arguments: str | Path) -> int:
    return main([str(a) for a in arguments])


class Tool:
    """Calls of the tool that end with a given exit code, and what each of them printed."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self.capsys = capsys

    def both(self, code: int, *words: str | Path) -> tuple[str, str]:
        self.capsys.readouterr()  # what was printed before
        assert run(*words) == code
        return self.capsys.readouterr()

    def out(self, code: int, *words: str | Path) -> str:
        return self.both(code, *words)[0]

    def err(self, code: int, *words: str | Path) -> str:
        return self.both(code, *words)[1]

    def told(self, code: int, *words: str | Path) -> str:
        """Return what is on stderr, and note it for the comparison with ``tests/messages.txt``."""
        return told(self.err(code, *words))


def in_threads(works: Sequence[Callable[[], None]]) -> None:
    """Call the functions side by side, and wait for all of them."""
    threads = [threading.Thread(target=work) for work in works]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not any(thread.is_alive() for thread in threads)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file without measured times, hidden ones included."""
    others = (*REPORT_FILES, RECORD_FILE)
    paths = (path for path in folder.rglob("*") if path.is_file() and path.name not in others)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def rows(output: Path) -> dict[str, dict[str, Any]]:
    """Return the rows of a run's report by the names of their scenes."""
    return {row["scene"]: row for row in json.loads((output / "report.json").read_text())["scenes"]}


def statuses(output: Path) -> dict[str, str]:
    """Return what became of each scene of a run, by its name."""
    return {name: row["status"] for name, row in rows(output).items()}


def ended(code: int | None, *words: str | Path, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a program, which must end with this exit code; None: any."""
    done = subprocess.run([*map(str, words)], capture_output=True, text=True, check=False, **options)
    assert code in (done.returncode, None), done.stdout[-3000:] + done.stderr[-3000:]
    return done


def vertices(cloud: Path) -> np.ndarray:
    """Return the points of a PLY file, ``["xyz"]`` and ``["rgb"]``, as its header describes them."""
    head, _, data = cloud.read_bytes().partition(b"end_header\n")
    assert b"format binary_little_endian" in head
    table = np.frombuffer(data, [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    assert f"element vertex {len(table)}\n".encode() in head
    return table


def start(*arguments: str | Path, **options: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "depthcli", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def wait_for(folder: Path, scenes: int, process: subprocess.Popen[Any]) -> None:
    """Until so many scenes are done; the run must not be over by then."""
    end = time.monotonic() + 120
    while len(list(folder.glob(f"*/{RECORD_FILE}"))) < scenes:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.002)

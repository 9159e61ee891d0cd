"""What people see while scenes are computed, on a terminal and in a log."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import struct
import threading
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from depthcli.run.activities import Announcer, Board, Running
from depthcli.run.progress_bar import Progress
from pydantic import BaseModel

from depthcli.cli import main
from depthcli.core.progress import Activity, announce_stage, counted
from depthcli.core.result import Clock
from depthcli.io.scenes import Scene
from depthcli.run.batch import Outcome, RunOptions
from depthcli.run.console import Reporter
from depthcli.run.runner import run_scenes

TILE = Activity("first_estimate", "tile", 3, 12)


class Now:
    """A clock that stands still until it is put forward; the thread that shows progress sleeps."""

    def __init__(self) -> None:
        self.time = 100.0

    def monotonic(self) -> float:
        return self.time


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> Now:
    clock = Now()
    monkeypatch.setattr("depthcli.run.progress_bar.time", clock)
    monkeypatch.setattr("depthcli.run.progress_bar._TICK", 1e6)
    return clock


def test_lines_of_a_log_say_what_is_done_every_30_seconds(now: Now):
    running: list[Running] = []
    lines: list[str] = []
    progress = Progress("stereo", 7, 1, "scene", lambda: running, lines.append, bar=False)
    running[:] = [Running("Teddy", TILE)]
    progress.show()
    now.time += 29
    progress.show()
    assert lines == []
    now.time += 1
    progress.show()
    now.time += 10
    progress.step(failed=True, computed=True)
    running[:] = [Running("Cones", Activity("cost"))] + 4 * [Running("x", Activity())]
    now.time += 20
    progress.show()
    progress.close()
    assert lines == [
        "stereo: 1 of 7 scenes; Teddy: first estimate, tile 3 of 12",
        "stereo: 2 of 7 scenes, 1 failed; Cones: cost; x: begins; x: begins; 2 more; about 3 min left",
    ]


def test_estimates_of_the_end_leave_out_compilation_and_what_comes_before_the_first_scene(now: Now):
    running: list[Running] = []
    lines: list[str] = []
    progress = Progress("stereo", 6, 1, "scene", lambda: running, lines.append, bar=False)
    now.time += 1000  # workers start
    progress.show()
    running[:] = [Running("a", Activity("cost"))]
    progress.show()
    for compiling, seconds in ((False, 2), (True, 150), (False, 3)):
        running[:] = [Running("a", Activity("cost"), compiling, 4, 16)]
        progress.show()
        now.time += seconds
        progress.show()
    running[:] = []
    progress.step(failed=False, computed=True)  # in 5 seconds
    progress.step(failed=False, computed=False)  # by another process
    now.time += 1
    running[:] = [Running("b", Activity("cost"), True, 5, 16)]
    progress.show()
    now.time += 30
    progress.show()
    progress.close()
    assert lines[-1] == "stereo: 3 of 6 scenes; b: compiling kernel 5 of about 16, cost; about 15 s left"


def test_without_knowing_what_is_done_scenes_are_counted(now: Now):
    lines: list[str] = []
    progress = Progress("evaluate", 4, 0, "map", None, lines.append, bar=False)
    now.time += 40
    progress.step(failed=False, computed=True)
    progress.show()
    progress.close()
    assert lines == ["evaluate: 1 of 4 maps; about 2 min left"]


def test_what_a_process_does_is_read_by_another_one():
    board = Board(bytearray(Board.size(2)))
    announcer = Announcer(board.memory, "stereo/fast")
    first, second = board.add("Teddy"), board.add("Cones")
    assert board.running() == []  # neither has begun
    with announcer.scene(second):
        assert board.running() == [Running("Cones", Activity())]
        for _ in counted("ab", "tile"):
            announce_stage("cost")
        announce_stage("a name of a stage that is by far too long for its place")
        assert board.running()[0].activity.stage.startswith("a name of a stage that is")
        announcer.compiling(SimpleNamespace(busy=True, calls=1))
        assert board.running()[0][2:] == (True, 1, 0)
        announcer.compiling(SimpleNamespace(busy=False, calls=5))
        assert board.running()[0][2:] == (False, 5, 0)
    assert board.running() == []
    with announcer.scene(first):
        board.remove(first)  # the process died, as far as anybody knows
        assert board.running() == []
    assert board.add("again") == first


class Config(BaseModel):
    """Nothing to set."""


@dataclass(frozen=True, kw_only=True)
class Named(Scene):
    @property
    def input_files(self) -> dict[str, Path]:
        return {}

    def load(self) -> None:
        return None


@dataclass(frozen=True)
class Stages:
    """Announces stages and tiles, and lets the display catch up; a worker dies in a scene named so."""

    name: str = "stages"
    results: tuple[str, ...] = ()

    def compute(self, config: Config, scene: Named, folder: Path, memory: int) -> Outcome:
        clock = Clock()
        for stage in ("cost", "aggregation"):
            clock.start(stage)
            for _ in counted("ab", "tile"):
                threading.Event().wait(0.25)
        if scene.name == "dies":
            os.kill(os.getpid(), signal.SIGKILL)
        return Outcome({}, clock.seconds)

    def files(self, config: Config, scene: Named) -> dict[str, Path]:
        return {}

    def settings(self, config: Config, scene: Named) -> dict[str, str]:
        return {}


class Terminal:
    """A pseudo terminal, 100 columns wide, in place of stderr; afterwards ``text`` is all that was written to it."""

    def __init__(self) -> None:
        pty, fcntl, termios = (pytest.importorskip(name) for name in ("pty", "fcntl", "termios"))
        self._leader, follower = pty.openpty()
        fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 100, 0, 0))
        self.stream = os.fdopen(follower, "w", encoding="utf-8")
        self.text, self._data = "", b""
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def __enter__(self) -> Terminal:
        self._redirection = contextlib.redirect_stderr(self.stream)
        self._redirection.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._redirection.__exit__(None, None, None)
        self.stream.close()
        self._thread.join(10)
        self.text = self._data.decode()

    def _read(self) -> None:
        while True:
            try:
                data = os.read(self._leader, 65536)
            except OSError:
                return
            if not data:
                return
            self._data += data


def screen(text: str) -> list[str]:
    """Return the lines that a terminal shows in the end."""
    lines, row, column = [""], 0, 0
    for part in re.findall(r"\x1b\[A|[\r\n]|[^\r\n\x1b]+", text):
        if part == "\r":
            column = 0
        elif part == "\n":
            row, column = row + 1, 0
            lines += [""] * (row + 1 - len(lines))
        elif part == "\x1b[A":
            row = max(row - 1, 0)
        else:
            line = lines[row].ljust(column)
            lines[row] = line[:column] + part + line[column + len(part) :]
            column += len(part)
    return [line.rstrip() for line in lines]


def compute(tmp_path: Path, names: list[str], level: int = 0, **options: Any) -> list[str]:
    scenes = [Named(name=name, folder=tmp_path) for name in names]
    rows = run_scenes(Stages(), Config(), scenes, tmp_path / "run", RunOptions(**options), Reporter(level))
    return [row["status"] for row in rows]


def test_a_terminal_shows_stages_and_tiles_and_is_clean_in_the_end(tmp_path: Path):
    with Terminal() as terminal:
        assert compute(tmp_path, ["Teddy", "Cones"]) == ["done", "done"]
    assert re.search(r"scene 1/2 Teddy · aggregation · tile [12]/2", terminal.text)
    assert re.search(r"about \d s left · scene 2/2 Cones · (cost|aggregation) · tile [12]/2", terminal.text)
    assert screen(terminal.text) == [""]
    assert all(len(line) <= 100 for line in re.split(r"[\r\n]", terminal.text))


@pytest.mark.slow
def test_stages_of_workers_are_shown_and_one_that_dies_leaves_a_clean_terminal(tmp_path: Path):
    with Terminal() as terminal:
        assert compute(tmp_path, ["Teddy", "Cones", "dies"], jobs=2) == ["done", "done", "failed"]
    assert re.search(r"scenes · \w+: (cost|aggregation), tile [12]/2 · \w+: (cost|aggr)", terminal.text)
    died = "dies: the worker process died 3 times (killed, probably out of memory; see --max-memory)"
    assert screen(terminal.text) == [died, ""]


def test_quiet_runs_and_logs_have_no_bar(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch):
    compute(tmp_path / "quiet", ["Teddy"], level=-1)
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr("depthcli.run.progress_bar._HEARTBEAT", 0.3)
    compute(tmp_path / "log", ["Teddy", "Cones"])
    out, err = capsys.readouterr()
    assert out == ""
    assert re.search(r"stages: 0 of 2 scenes; Teddy: (cost|aggregation), tile [12] of 2\n", err)
    assert re.search(r"stages: 1 of 2 scenes; Cones: (cost|aggregation), tile [12] of 2; about \d s left\n", err)
    assert "\r" not in err


def test_quiet_runs_show_nothing_on_a_terminal(tmp_path: Path):
    with Terminal() as terminal:
        compute(tmp_path, ["Teddy"], level=-1)
    assert terminal.text == ""


def test_json_and_files_are_the_same_with_a_bar(made_scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    common = ("stereo", "opencv-bm", "-i", str(made_scenes), "--scenes", "planes_0*", "--json")
    assert main([*common, "-o", str(tmp_path / "plain")]) == 0
    plain = json.loads(capsys.readouterr().out)
    with Terminal() as terminal:
        assert main([*common, "-o", str(tmp_path / "bar")]) == 0
    assert "stereo " in terminal.text
    assert [row["scene"] for row in json.loads(capsys.readouterr().out)["scenes"]] == [
        row["scene"] for row in plain["scenes"]
    ]
    for path in (tmp_path / "plain").rglob("*"):
        if path.is_file() and not path.name.startswith("report"):
            assert path.read_bytes() == (tmp_path / "bar" / path.relative_to(tmp_path / "plain")).read_bytes()

"""Closed pipes, full disks, signals, odd names: the computation goes on, the exit code says what happened."""

import os
import shutil
import signal
import sys
import threading
import time
from pathlib import Path

import pytest

from depthcli.run.console import Reporter
from tests.command_line import ended, run, start, statuses, wait_for

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/full, signals and file names of bytes"),
]


def shell(code: int, line: str, *arguments: str | Path, **environment: str) -> str:
    """Run ``line`` in bash with ``arguments`` as the command's, "$@" in the line; return what is on stderr."""
    command = (sys.executable, "-m", "depthcli", "stereo", "opencv-bm", *arguments)
    words = ("bash", "-o", "pipefail", "-c", line, "bash", *command)
    return ended(code, *words, env=os.environ | environment, errors="replace").stderr


@pytest.mark.parametrize(("line", "code"), [
    ('"$@" | true', 0),
    ('"$@" >&-', 0),
    ('"$@" 2>&-', 0),
    ('"$@" 2>/dev/full', 0),
    ('"$@" --json >/dev/full', 3),
    ('"$@" --json | head -c 1', 0),
])  # fmt: skip
def test_no_stream_stops_the_work(made_scenes: Path, tmp_path: Path, line: str, code: int):
    err = shell(code, line, "-i", made_scenes, "-o", tmp_path / "r")
    assert "Traceback" not in err and "Exception ignored" not in err
    assert set(statuses(tmp_path / "r").values()) == {"done"}
    assert code == 0 or "stdout: cannot be written (No space left on device)" in err


def test_a_failed_scene_is_told_through_a_closed_pipe(made_scenes: Path, tmp_path: Path):
    for name in ("a", "b"):
        shutil.copytree(made_scenes / "planes_0", tmp_path / "in" / name)
    (tmp_path / "in" / "a" / "left.png").write_bytes(b"")
    shell(3, '"$@" | true; exit ${PIPESTATUS[0]}', "-i", tmp_path / "in", "-o", tmp_path / "r")
    assert statuses(tmp_path / "r") == {"a": "failed", "b": "done"}


def test_names_that_no_terminal_shows(made_scenes: Path, tmp_path: Path):
    for name in (b"caf\xc3\xa9", b"latin\xe9", b"new\nline"):
        shutil.copytree(os.fsencode(made_scenes / "planes_0"), os.path.join(os.fsencode(tmp_path), b"in", name))
    for options in ([], ["--json"]):
        words = ("-i", tmp_path / "in", "-o", tmp_path / "r", *options)
        assert "Traceback" not in shell(0, '"$@"', *words, LC_ALL="C", PYTHONUTF8="0")
    assert len(statuses(tmp_path / "r")) == 3


@pytest.mark.parametrize(("sent", "jobs"), [
    (signal.SIGTERM, "1"),
    *(pytest.param(signal.SIGINT, jobs, marks=pytest.mark.system) for jobs in ("1", "2", "auto")),
])  # fmt: skip
def test_a_signal_leaves_a_run_to_go_on_with(made_scenes: Path, tmp_path: Path, sent: signal.Signals, jobs: str):
    for number in range(4):  # enough scenes that the signal falls into the run
        for scene in filter(Path.is_dir, made_scenes.iterdir()):
            shutil.copytree(scene, tmp_path / "in" / f"{scene.name}_{number}", copy_function=os.symlink)
    command, made = ("stereo", "opencv-sgbm", "-i", tmp_path / "in", "--jobs", jobs, "-o"), tmp_path / "run"
    # Tests that run in the background of a shell inherit an ignored SIGINT.
    heard = {"start_new_session": True, "preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    process = start(*command, made, **heard)
    wait_for(made, 1, process)
    os.killpg(process.pid, sent)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 128 + sent, err
    assert "ed; run the same command again" in err and "Traceback" not in err
    assert set(statuses(made).values()) == {"done"} and not list(made.glob(".partial-*"))
    assert run(*command, made) == 0
    assert len(list(made.glob("*/record.json"))) == 48


def test_a_terminal_shows_a_bar_with_failures(monkeypatch: pytest.MonkeyPatch, capsys):
    """Without a thread of the bar's own, beside which no worker could be forked."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    reporter, threads = Reporter(), {*threading.enumerate()}
    with reporter.counting(2, 0, "stereo"):
        for failed in (True, False):
            time.sleep(0.21)  # a bar is drawn five times a second at most
            reporter.step(failed)
        assert {*threading.enumerate()} <= threads  # threads of other tests may end meanwhile
    assert any("2/2" in bar and "1 failed" in bar for bar in capsys.readouterr().err.split("\r"))


@pytest.mark.parametrize("options", ["--version", "stereo --help"])
def test_texts_that_cannot_be_written(options: str):
    said = "depthcli: stdout: cannot be written (No space left on device)\n"
    for target, code, err in ((">/dev/full", 3, said), ("| true", 0, ""), (">&-", 0, "")):
        line = f"{sys.executable} -m depthcli {options} {target}"
        assert ended(code, "bash", "-o", "pipefail", "-c", line).stderr == err


def test_warnings_of_libraries_are_not_shown():
    code = "import warnings; from depthcli.cli import main; main(['presets', '-q']); warnings.warn('odd', UserWarning)"
    for option, shown in (((), False), (("-W", "default"), True)):
        assert ("UserWarning" in ended(0, sys.executable, *option, "-c", code).stderr) == shown

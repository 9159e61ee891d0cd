"""Several processes in one run folder: who does what, who waits for whom, and what is left when one is killed."""

import json
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from depthcli.core.errors import ConfigError, OutputError
from depthcli.run import workers
from depthcli.run.console import Reporter
from depthcli.run.folder import _REPORT, LOCKS_FILE, FolderLock, staging_folder
from depthcli.run.job import shard_of
from tests.command_line import contents, ended, run, start, statuses
from tests.files import laid
from tests.golden import refused

FAST = "opencv-bm"


@pytest.fixture(scope="module")
def whole(made_scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What one process makes of the twelve scenes."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    assert run("stereo", FAST, "-i", made_scenes, "-o", folder, "-q") == 0
    return folder


def assert_same(output: Path, whole: Path) -> None:
    assert contents(output) == contents(whole)
    assert statuses(output) == statuses(whole)


_OTHER = """
import pathlib, shutil, sys
from depthcli.run.folder import FolderLock
out, made, *names = sys.argv[1:]
with FolderLock(pathlib.Path(out), print) as lock:
    lock.share()
    print(*map(lock.claim, names), flush=True)
    sys.stdin.readline()
    if pathlib.Path(made).is_dir():
        shutil.copytree(made, pathlib.Path(out, names[0]))
    lock.release(names[0])
    print("released", flush=True)
    sys.stdin.readline()
"""


def another(out: Path, made: Path, *names: str) -> tuple[subprocess.Popen[str], list[str]]:
    """Start a process that claims scenes; return it, and which it got.

    After a line it puts ``made``, if there, in the place of the first one and releases it; after another it ends.
    """
    command = [sys.executable, "-c", _OTHER, out, made, *names]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, process.stdout.readline().split()


@pytest.mark.slow
def test_the_same_run_twice_is_done_once(made_scenes: Path, whole: Path, tmp_path: Path):
    common = ("stereo", FAST, "-i", made_scenes, "-o", tmp_path / "run", "-v")
    running = [start(*common), start(*common, "--jobs", "2")]
    said = [process.communicate(timeout=60)[1] for process in running]
    assert [process.returncode for process in running] == [0, 0], said
    made = Counter(line.partition(":")[0] for text in said for line in text.splitlines() if line.endswith(" s"))
    assert all(count == 1 for scene, count in made.items() if "_" in scene), made
    assert_same(tmp_path / "run", whole)


@pytest.mark.slow
def test_who_may_come_in(made_scenes: Path, tmp_path: Path, tool, monkeypatch):
    out = tmp_path / "run"
    common = ("stereo", FAST, "-i", made_scenes, "-o", out, "--scenes", "planes_0", "-q")
    monkeypatch.setattr("depthcli.run.folder._SETUP_TIMEOUT", 0.1)
    assert run(*common) == 0
    with FolderLock(out, print) as lock:
        assert lock.alone
        tool.told(2, *common)  # still being set up
        lock.share()
        tool.told(2, *common, "--set", "block=7", "--overwrite")
        assert run(*common) == 0
        assert lock.last()
        assert not (out / LOCKS_FILE).exists()
    assert run(*common, "--set", "block=7") == 2
    assert run(*common, "--set", "block=7", "--overwrite") == 0
    assert run(*common) == 2
    assert run(*common, "--overwrite") == 0
    left = ["planes_0", "report.csv", "report.json", "run.yaml", "status.txt"]
    assert sorted(path.name for path in out.iterdir()) == left


def test_a_scene_is_claimed_by_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Two processes, since these locks are a process's."""
    with FolderLock(tmp_path / "run", print) as lock:
        lock.share()
        assert lock.claim("b")
        other, claimed = another(tmp_path / "run", tmp_path / "nothing", "a", "b", "c")
        assert claimed == ["True", "False", "True"]
        assert not lock.claim("a") and not lock.last()
        with lock.reporting():
            reporter, claimed = another(tmp_path / "run", tmp_path / "nothing", _REPORT)
            assert claimed == ["False"]
        reporter.kill()
        reporter.communicate()
        other.stdin.write("\n")
        other.stdin.flush()
        other.stdout.readline()
        assert lock.claim("a") and not lock.claim("c")
        other.kill()
        other.communicate()
        assert lock.claim("c")
        with monkeypatch.context() as patched:  # of a file system that locks folders alone
            patched.setattr("fcntl.lockf", Mock(side_effect=OSError(37, "No locks available")))
            assert lock.claim("d")
        assert lock.last()


@pytest.mark.slow
def test_the_process_that_ends_last_evaluates_all_scenes(made_scenes: Path, whole: Path, tmp_path: Path, monkeypatch):
    """Another process computes ``planes_0`` when this one comes to it; it ends after, before, or without a result."""
    out, compute = tmp_path / "run", workers.compute_scene
    out.mkdir()
    shutil.copy(whole / "run.yaml", out)
    common = ("stereo", FAST, "-i", made_scenes, "-o", out, "--scenes", "planes_[01]", "--evaluate", "-q")

    def runs_beside_another(made: Path, ends_before: bool) -> int:
        shutil.rmtree(out / "planes_1", ignore_errors=True)
        other, claimed = another(out, made, "planes_0")
        assert claimed == ["True"]

        def computed(*task: Any) -> Any:
            if ends_before:
                other.communicate("\n", timeout=60)
            return compute(*task)

        monkeypatch.setattr(workers, "compute_scene", computed)
        code = run(*common)
        if not ends_before:
            other.communicate("\n", timeout=60)
        assert other.returncode == 0
        return code

    assert runs_beside_another(tmp_path / "nothing", ends_before=False) == 0
    assert statuses(out) == {"planes_1": "done"}
    assert not (out / "evaluation").exists()
    assert runs_beside_another(tmp_path / "nothing", ends_before=True) == 3
    assert runs_beside_another(whole / "planes_1", ends_before=True) == 3  # a result of another input
    shutil.rmtree(out / "planes_0")
    assert runs_beside_another(whole / "planes_0", ends_before=True) == 0
    assert statuses(out) == {"planes_0": "done", "planes_1": "done"}
    scores = json.loads((out / "evaluation" / "scores.json").read_text())
    assert not scores["failed"]
    assert all(result["seconds"] > 0 for result in scores["results"]), scores["results"]


@pytest.mark.slow
def test_a_file_system_without_locks(made_scenes: Path, whole: Path, tmp_path: Path, monkeypatch, capsys):
    def refused(*arguments: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr("fcntl.flock", refused)
    monkeypatch.setattr("fcntl.lockf", refused)
    common = ("stereo", FAST, "-i", made_scenes, "-o", tmp_path / "run")
    for index in (1, 2):
        assert run(*common, "--shard", f"{index}/2") == 0
        assert capsys.readouterr().err.count("no locks on this file system") == 1
    assert_same(tmp_path / "run", whole)
    assert run(*common, "--set", "block=7") == 2


def test_what_a_shard_is():
    for text, slurm, shard in (
        (None, "", None), ("3/8", "", (3, 8)), (None, "ID=5 MIN=1 COUNT=4 STEP=2", (3, 4)),
        (None, "ID=0 MIN=0 COUNT=4 STEP=1", (1, 4)), ("1/2", "ID=5 MIN=1 COUNT=4 STEP=2", (1, 2)),
    ):  # fmt: skip
        environment = {f"SLURM_ARRAY_TASK_{pair.partition('=')[0]}": pair.partition("=")[2] for pair in slurm.split()}
        assert shard_of(text, environment) == shard
    for text in ("0/2", "3/2", "1", "a/b"):
        refused(ConfigError, shard_of, text, {})


@pytest.mark.slow
def test_a_shard_of_slurm_misses_no_value_that_others_have(made_scenes: Path, tmp_path: Path, monkeypatch):
    common = ("stereo", FAST, "-i", made_scenes, "--flag", "absent<1", "--fail-flagged", "-q", "-o")
    assert run(*common, tmp_path / "whole") == 4
    assert run(*common, tmp_path / "run", "--shard", "1/6") == 0
    for name, value in {"ID": "2", "MIN": "1", "STEP": "1", "COUNT": "6"}.items():
        monkeypatch.setenv(f"SLURM_ARRAY_TASK_{name}", value)
    assert run(*common, tmp_path / "run") == 0


@pytest.mark.slow
def test_a_system_without_locks_and_folders_that_open(made_scenes: Path, whole: Path, tmp_path: Path):
    """Windows: no fcntl, no resource, and a folder cannot be opened."""
    code = """if True:
        import os, shutil, sys
        sys.modules |= {"fcntl": None, "resource": None}
        shutil._use_fd_functions, opened = False, os.open
        def no_folders(path, *rest, **more):
            if os.path.isdir(path):
                raise PermissionError(13, "Permission denied", path)
            return opened(path, *rest, **more)
        os.open = no_folders
        from depthcli.cli import main
        sys.exit(main(sys.argv[1:]))
    """
    common = ("-i", made_scenes, "-o", tmp_path / "run", "--scenes", "planes_0", "-q")
    ended(0, sys.executable, "-c", code, "stereo", FAST, *common)
    assert contents(tmp_path / "run" / "planes_0") == contents(whole / "planes_0")


def test_a_process_that_the_run_ends_costs_no_try():
    def worker(tries: int, recv: Any) -> Any:
        process = SimpleNamespace(kill=lambda: None, join=lambda: None, exitcode=-9)
        pipe = SimpleNamespace(recv=recv)
        return workers._Worker(process, pipe, computing=("task", tries))  # type: ignore[arg-type]

    def ended() -> None:
        raise EOFError

    compiling, other = worker(1, lambda: "compiling"), worker(workers._MAX_TRIES, ended)
    pool = workers._Pool(iter(()), None, Reporter(), 2, [compiling, other])  # type: ignore[arg-type]
    assert list(pool.received(compiling)) == []
    assert list(pool.received(other)) == [] and pool.retried == [("task", workers._MAX_TRIES - 1)]


@pytest.mark.slow
def test_leaving_files_out(made_scenes: Path, whole: Path, tmp_path: Path):
    out = tmp_path / "run"
    common = ("stereo", FAST, "-i", made_scenes, "-o", out, "--scenes", "planes_0", "-q")
    stamps = set()
    for _ in range(2):
        assert run(*common, "--keep", "disp_left.pfm, record.json") == 0
        assert sorted(path.name for path in (out / "planes_0").iterdir()) == ["disp_left.pfm", "record.json"]
        stamps.add((out / "planes_0/disp_left.pfm").stat().st_mtime_ns)
    assert len(stamps) == 1
    assert run(*common) == 0
    assert contents(out / "planes_0") == contents(whole / "planes_0")


def test_results_that_are_no_scenes_are_replaced_together_or_not_at_all(tmp_path: Path, monkeypatch):
    def write(text: str) -> None:
        with staging_folder(tmp_path / "out", "evaluate", ["*.txt"], print) as made:
            laid(made, {"a.txt": text, "b.txt": text})

    write("first")
    monkeypatch.setattr("depthcli.run.folder.install", Mock(side_effect=OSError(5, "Input/output error")))
    refused(OutputError, write, "second")
    assert {path.read_text() for path in (tmp_path / "out").glob("*.txt")} == {"first"}
    assert not list((tmp_path / "out").glob(".partial*"))

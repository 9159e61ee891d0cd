"""A real scheduler and two workers on this machine: the same bytes, whoever is killed."""

import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from depthcli.cli import main
from depthcli.core.errors import ConfigError, IncompleteError
from depthcli.run import cluster as cluster_module
from depthcli.run import records
from depthcli.run.console import Reporter
from depthcli.run.job import Execution
from depthcli.run.records import read_record
from depthcli.run.scene import Work
from tests.command_line import contents, ended, rows, start, wait_for
from tests.conftest import sampled
from tests.files import laid
from tests.golden import refused, told
from tests.run.test_runner import Config, Repeat, task_in

PRESET = "opencv-sgbm"
SCENES = 48


class Cluster:
    """Processes of dask.distributed, which find each other by a file."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.file = folder, folder / "scheduler.json"
        self.scheduler = self._start("dask_scheduler", "--host", "127.0.0.1", "--port", "0")
        while not (self.file.exists() and self.file.stat().st_size):
            assert self.scheduler.poll() is None, (folder / "log").read_text()
            time.sleep(0.05)
        self.address: str = json.loads(self.file.read_text())["address"]
        self.workers = [self._start("dask_worker", "--no-nanny", "--nthreads", "1") for _ in range(2)]

    def _start(self, program: str, *options: str, environment: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{program}", "--no-dashboard", "--scheduler-file", self.file]
        with (self.folder / "log").open("a") as log:
            return subprocess.Popen([*command, *options], stdout=log, stderr=log, cwd=self.folder, env=environment)

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Cluster]:
    pytest.importorskip("distributed", reason="no dask.distributed (the extra 'cluster')")
    # The workers run elsewhere than this process and must find the package that is tested.
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(records.__file__).parents[2]), *sys.path]))
    (tmp_path / "dask").mkdir()
    made = Cluster(tmp_path / "dask")
    yield made
    made.close()


@pytest.mark.system
def test_a_killed_worker_and_a_lost_scheduler(cluster: Cluster, tmp_path_factory, tmp_path: Path, capfd):
    size = ("--width", "96", "--height", "72", "--max-disparity", "12")
    scenes = sampled(tmp_path_factory, "-n", str(SCENES), *size)
    whole, output = tmp_path / "whole", tmp_path / "run"
    assert main(["stereo", PRESET, "-i", str(scenes), "-o", str(whole), "-q"]) == 0
    command = ("stereo", PRESET, "-i", scenes, "-o", output, "--scheduler", cluster.address)

    run = start(*command)
    wait_for(output, 5, run)
    os.kill(cluster.workers[0].pid, signal.SIGKILL)
    _, said = run.communicate(timeout=120)
    assert run.returncode == 0, said
    assert "workers at tcp://" in said
    assert f"{SCENES} of {SCENES} scenes done" in said
    assert contents(output) == contents(whole)
    assert list(rows(output)) == list(rows(whole))
    assert sum(bool(row["seconds"]) for row in rows(output).values()) >= SCENES - 10

    # Some scenes are to do again, the scheduler goes: what is done is reported, the rest can be resumed, by anyone.
    again = sorted(path.parent.name for path in output.glob(f"*/{records.RECORD_FILE}"))[:40]
    for name in again:
        (output / name / records.RECORD_FILE).unlink()
    run = start(*command)
    wait_for(output, SCENES - 36, run)
    os.kill(cluster.scheduler.pid, signal.SIGKILL)
    _, said = run.communicate(timeout=120)
    assert run.returncode == 3, said
    assert "the scheduler was lost" in said
    assert "Traceback" not in said, said
    done = set(rows(output))
    assert SCENES - 40 < len(done) < SCENES
    capfd.readouterr()
    assert main(["stereo", PRESET, "-i", str(scenes), "-o", str(output)]) == 0
    assert "scenes are done already" in capfd.readouterr().err
    assert contents(output) == contents(whole)


def edited_copy(folder: Path) -> dict[str, str]:
    """An environment whose depthcli has the same version and one other line."""
    package = Path(records.__file__).parents[1]
    shutil.copytree(package, folder / "depthcli", ignore=shutil.ignore_patterns("__pycache__"))
    with (folder / "depthcli/core/result.py").open("a") as file:
        file.write("\n# edited\n")
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *sys.path])}


@pytest.mark.system
def test_workers_without_a_plug_in_and_a_late_one_of_other_code_are_refused(
    cluster: Cluster, made_scenes: Path, tmp_path: Path
):
    output = tmp_path / "run"
    command = ("stereo", PRESET, "-i", made_scenes, "-o", output, "--scheduler", cluster.address)
    source = "from depthcli.methods.stereo.cost.census import Census\nclass Far(Census):\n    '''Far.'''\n"
    metadata = "Metadata-Version: 2.1\nName: far-cost\nVersion: 1.2\n"
    packages = laid(tmp_path / "far", {"far_cost.py": source, "far_cost-1.2.dist-info/METADATA": metadata})
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(packages), os.environ["PYTHONPATH"]])}
    plugged = ("stereo", "fast", *command[2:], "--set", "cost=far", "--plugin", "far_cost")
    done = ended(2, sys.executable, "-m", "depthcli", *plugged, env=environment)
    assert "not its plug-ins" in done.stderr

    for worker in cluster.workers:  # nobody is there when the run begins
        worker.kill()
        worker.wait()
    run = start(*command)
    end = time.monotonic() + 60
    while not list(output.glob(".partial-*")) and time.monotonic() < end:
        time.sleep(0.05)
    time.sleep(1)
    late = cluster._start("dask_worker", "--no-nanny", "--nthreads", "1", environment=edited_copy(tmp_path / "copy"))
    cluster.workers.append(late)
    for running in (run, None):
        running = running or start(*command)  # which finds it at the start
        _, said = running.communicate(timeout=120)
        assert running.returncode == 2, said
        assert "has another depthcli" in said
        assert "Traceback" not in said, said
        assert not list(output.glob("*/record.json"))


def test_no_scheduler_there_is_told_in_a_line(tmp_path: Path, tool, made_scenes: Path):
    pytest.importorskip("distributed", reason="no dask.distributed (the extra 'cluster')")
    command = ["stereo", PRESET, "-i", str(made_scenes), "-o", str(tmp_path / "run"), "-q"]
    assert "no scheduler answers there" in tool.err(2, *command, "--scheduler", "nonsense://x")
    for address in ("nope", "tcp://nope", "tcp://no.such.host.invalid:8786"):
        assert tool.err(2, *command, "--scheduler", address).count("\n") == 1
    tool.told(2, *command, "--scheduler", "tcp://127.0.0.1:1", "--jobs", "2")


WORK = Work(Repeat(Config()), Execution(scheduler="tcp://there"), frozenset())


class KilledWorker(Exception):  # noqa: N818  (its name in dask.distributed)
    pass


@pytest.mark.parametrize(("error", "ends"), [
    (KilledWorker("three times"), None), (RuntimeError("boom\nmore"), None),
    (ConfigError("another depthcli"), ConfigError), (ModuleNotFoundError("no depthcli"), ConfigError),
    (None, IncompleteError),
])  # fmt: skip
def test_what_comes_of_a_worker_s_error(error: Exception | None, ends: type[Exception] | None, tmp_path, monkeypatch):
    client, task = Mock(status="running"), task_in(tmp_path, "run/.partial")
    client.scheduler_info.return_value = {"workers": {}}
    client.submit.return_value = Mock(status="error", exception=lambda: error)
    if error is None:
        client.submit.side_effect = OSError("the connection is lost")
    monkeypatch.setattr(cluster_module, "_connected", lambda address: (client, Mock()))

    def compute() -> list[Any]:
        return list(cluster_module.compute_on_cluster([task], WORK, Reporter(-1), tmp_path / "run/.partial"))

    if ends is None:
        (row,) = compute()
        told(f"{row['status']}: {row['error']}")
        assert read_record(task.target).row == row
    else:
        refused(ends, compute)
        assert not task.target.exists()


def test_a_worker_refuses_other_versions_and_another_file_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    distributed = pytest.importorskip("distributed", reason="no dask.distributed (the extra 'cluster')")
    monkeypatch.setattr(distributed, "get_worker", lambda: Mock(address="tcp://worker"))
    task, there = task_in(tmp_path, "run/.partial"), cluster_module._compute_there
    for identity in ("another", cluster_module._identity_here(WORK)):
        refused(ConfigError, there, [], pickle.dumps((task, WORK, identity, str(tmp_path))))
    monkeypatch.setitem(sys.modules, "distributed", None)
    refused(ConfigError, cluster_module._connected, "tcp://there:1")

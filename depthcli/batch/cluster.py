"""Scenes on the workers of a dask.distributed cluster: the same rows and files as by worker processes here.

The workers see the same file system at the same places. Small scenes go out in chunks of some seconds. An scene whose
worker dies is done by another one; where the scheduler is lost, the run ends with its report and can be resumed.
"""

from __future__ import annotations

import contextlib
import logging
import os
import platform
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from depthcli import __version__
from depthcli.batch import record, resources
from depthcli.batch.making import BUG, AnyWork, RunOptions, Task, discard, failed_row, run_one
from depthcli.batch.report import row_of
from depthcli.batch.reporter import Reporter
from depthcli.batch.workers import compile_watch, say_compiled, use_threads
from depthcli.core.errors import ConfigError, IncompleteError

_CHUNK = 5.0  # seconds that a chunk of small scenes shall take
_LARGEST = 500  # scenes of a chunk
_AHEAD = 2  # chunks that every worker has or waits for
_PAUSE = 0.05
_GOES_ON = "goes-on"  # a file beside the scenes that are made; where it has gone, the run has ended, and workers stop
_PATIENCE = "20s"  # for the scheduler to answer

_one_at_a_time = threading.Lock()  # threads of one worker share kernels and buffers


def compute(
    tasks: list[Task],
    work: AnyWork,
    config: Any,
    options: RunOptions,
    reporter: Reporter,
    claim: Callable[[Task], bool],
) -> Iterator[dict[str, Any]]:
    """Rows of the tasks, in the order in which they are finished.

    Raises
    ------
    ConfigError
        No distributed, no scheduler at that address, or workers that have another depthcli or another file system.
    IncompleteError
        The scheduler was lost.
    """
    making, output = tasks[0].work, tasks[0].output
    making.mkdir(parents=True, exist_ok=True)
    (making / _GOES_ON).touch()
    client = _connected(options.scheduler or "")
    cluster = _Cluster(client, work, config, options)
    waiting, ready = list(reversed(tasks)), list[Task]()
    compiled = say_compiled(reporter)
    try:
        cluster.check(output, reporter)
        while waiting or ready or cluster.running:
            while (waiting or ready) and cluster.has_room():
                size = cluster.chunk(len(waiting) + len(ready))
                while waiting and len(ready) < size:
                    if claim(task := waiting.pop()):
                        ready.append(task)
                if ready:
                    cluster.submit(ready[:size])
                    del ready[:size]
            for found, left in cluster.finished(reporter):
                rows, kernels, seconds = found
                compiled(kernels, seconds)
                yield from rows
                ready += left
            if client.status != "running":
                lacking = len(waiting) + len(ready) + sum(len(chunk) for chunk in cluster.running.values())
                raise IncompleteError(
                    f"{options.scheduler}: the scheduler was lost, {lacking} scenes are not done; "
                    "the same command goes on where it stopped"
                )
            time.sleep(_PAUSE)
    finally:
        discard(making)
        with contextlib.suppress(Exception):  # of a scheduler that has gone
            if client.status == "running":
                client.cancel(list(cluster.running))
            client.close(timeout=2)


class _Cluster:
    """Chunks that are out, and how large the next ones should be."""

    def __init__(self, client: Any, work: AnyWork, config: Any, options: RunOptions) -> None:
        self.client, self.work, self.config, self.options = client, work, config, options
        self.running: dict[Any, list[Task]] = {}
        self.alone: set[str] = set()  # scenes whose chunk was lost with its worker again and again
        self.each: float | None = None  # seconds of an scene
        self.workers, self.counted = 1, 0.0

    def check(self, output: Path, reporter: Reporter) -> None:
        """The workers that are there now have this depthcli and see this run folder."""
        here = _about(str(output.absolute()))
        try:
            found = self.client.run(_about, str(output.absolute()))
        except Exception as error:
            raise ConfigError(f"{self.options.scheduler}: its workers have no such depthcli ({error})") from error
        for address, about in sorted(found.items()):
            if about != here:
                raise ConfigError(
                    f"{self.options.scheduler}: worker {address} has depthcli {about[0]}, the run folder is "
                    f"{'there' if about[1] == here[1] else 'not the one here'}; want {here[0]} and a shared file system"
                )
        reporter.info(f"{len(found)} workers at {self.options.scheduler}" + ("" if found else "; waiting for some"))

    def has_room(self) -> bool:
        """Some worker has fewer chunks than it should."""
        if self.client.status != "running":
            return False
        if time.monotonic() - self.counted > 1:
            with contextlib.suppress(OSError, TimeoutError):  # it is lost in this moment
                self.workers = max(1, len(self.client.scheduler_info(n_workers=-1)["workers"]))
            self.counted = time.monotonic()
        return len(self.running) < _AHEAD * self.workers

    def chunk(self, left: int) -> int:
        """Scenes of the next chunk: some seconds, and no more than leaves work for the others."""
        size = 1 if self.each is None else int(_CHUNK / max(self.each, 1e-3))
        return max(1, min(size, _LARGEST, left // (_AHEAD * self.workers)))

    def submit(self, chunk: list[Task]) -> None:
        """Send a chunk out."""
        how = (self.work, self.config, self.options.threads, self.options.max_memory, os.getcwd())
        future = self.client.submit(_do, chunk, *how, pure=False)
        self.running[future] = chunk

    def finished(self, reporter: Reporter) -> Iterator[tuple[tuple[list[dict[str, Any]], int, float], list[Task]]]:
        """(rows, kernels compiled, seconds of that) of every chunk that came back, and its scenes to do again."""
        for future in [future for future in self.running if future.done()]:
            chunk = self.running.pop(future)
            if future.status == "finished":
                rows, kernels, seconds = found = future.result()
                spent = [sum(row["seconds"].values()) for row in rows if row["seconds"]]
                if spent:
                    mean = sum(spent) / len(spent)
                    self.each = mean if self.each is None else 0.5 * (self.each + mean)
                if not rows:
                    why = f"{chunk[0].work}: a worker does not see it; is the file system shared?"
                    found = ([failed_row(task, why) for task in chunk], kernels, seconds)
                names = {row["scene"] for row in found[0]}
                yield found, [task for task in chunk if task.scene.name not in names]
                continue
            if future.status != "error":  # cancelled, or lost with the scheduler
                self.running[future] = chunk
                return
            error = future.exception()
            if type(error).__name__ == "KilledWorker" and len(chunk) > 1:
                reporter.info(f"workers died several times with {len(chunk)} scenes; trying these one by one")
                for task in chunk:
                    self.submit([task])
                yield ([], 0, 0.0), []
            elif type(error).__name__ == "KilledWorker":
                why = "its worker died several times, probably out of memory; see --max-memory"
                yield ([failed_row(task, why) for task in chunk], 0, 0.0), []
            else:
                why = f"{BUG}{type(error).__name__}: {error}".splitlines()[0][:300]
                yield ([failed_row(task, why) for task in chunk], 0, 0.0), []


def _connected(address: str) -> Any:
    try:
        import dask
        import distributed
    except ImportError as error:
        raise ConfigError(f"--scheduler wants dask.distributed: pip install 'depthcli[cluster]' ({error})") from error
    for name in [*logging.root.manager.loggerDict, "asyncio"]:  # what went wrong is said here, in a line
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    # A scheduler that has gone is noticed soon.
    dask.config.set({"distributed.comm.timeouts.connect": "10s"})
    try:
        return distributed.Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ConfigError(f"--scheduler {address}: no scheduler answers there ({reason})") from error


def _about(output: str) -> tuple[str, str]:
    """Version, and what the run folder is, of the process that is asked."""
    return __version__, record.digest(record.saved_config(Path(output)).encode())


def _do(
    chunk: list[Task], work: AnyWork, config: Any, threads: int | None, limit: int | None, place: str
) -> tuple[list[dict[str, Any]], int, float]:
    """On a worker: the rows of a chunk's scenes, kernels compiled, and how long that took."""
    from distributed import get_worker

    mine = f"{platform.node()}-{os.getpid()}"
    rows: list[dict[str, Any]] = []
    with _one_at_a_time, compile_watch(lambda: None) as watch:
        os.chdir(place)  # files may be named relative to where the run was started
        use_threads(threads or get_worker().state.nthreads)
        for task in chunk:
            if not (task.work / _GOES_ON).exists():
                break
            known = record.read_record(task.target)
            if known is not None and record.is_done(task.target, task.run, task.inputs, known):
                rows.append(row_of(known, {"source": task.source}))  # by a worker that died with the rest of its chunk
                continue
            # A worker that was given up may still be at it.
            own = replace(task, work=task.work / mine)
            shutil.rmtree(own.hidden, ignore_errors=True)
            rows.append(run_one(own, work, config, limit or resources.available_memory()))
    return rows, watch.kernels, watch.seconds

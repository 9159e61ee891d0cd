"""Scenes computed by the workers of a dask.distributed cluster, with the same rows and files as on one machine.

The workers must have the same file system at the same paths. Small scenes are sent in chunks of some seconds. A scene
whose worker dies is computed by another one; if the scheduler is lost, the run ends with its report and can be resumed.
"""

from __future__ import annotations

import contextlib
import logging
import operator
import os
import pickle
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from depthcli.core.errors import ConfigError, IncompleteError
from depthcli.core.registry import versions_here
from depthcli.run.cluster_worker import RUNNING_FILE, chunk_function, folder_digest, source_digest_function
from depthcli.run.console import Reporter
from depthcli.run.install import discard
from depthcli.run.json_csv import Row
from depthcli.run.processes import report_compilation
from depthcli.run.task import BUG, Run, Task

_CHUNK_SECONDS = 5.0  # computing time of a chunk of small scenes
_MAX_CHUNK = 500  # scenes of a chunk
_CHUNKS_PER_WORKER = 2  # one that is computed, one that waits
_POLL_SECONDS = 0.05
_COUNT_SECONDS = 1.0  # between two counts of the workers
_CONNECT_TIMEOUT = "20s"


class _Chunk(NamedTuple):
    """What came back of a chunk: rows, the kernels that were compiled, in how long, and scenes to compute again."""

    rows: list[Row]
    kernels: int = 0
    seconds: float = 0.0
    left: tuple[Task, ...] = ()


def compute(tasks: list[Task], run: Run, reporter: Reporter, claim: Callable[[Task], bool]) -> Iterator[Row]:
    """Yield the rows of the tasks in the order in which they are finished.

    Raises
    ------
    ConfigError
        No dask.distributed, no scheduler at that address, or workers with another depthcli or another file system.
    IncompleteError
        The connection to the scheduler was lost.
    """
    workspace, output, scheduler = tasks[0].workspace, tasks[0].output, run.options.scheduler
    if files := sorted({plugin.package for plugin in run.plugins if plugin.is_file}):
        raise ConfigError(f"--scheduler: {', '.join(files)}: workers have no plug-in files; install it as a package")
    workspace.mkdir(parents=True, exist_ok=True)
    (workspace / RUNNING_FILE).touch()
    client = _connected(scheduler or "")
    cluster = _Cluster(client, run)
    waiting, ready = list(reversed(tasks)), list[Task]()
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
            for chunk in cluster.finished(reporter):
                report_compilation(reporter, chunk.kernels, chunk.seconds)
                yield from chunk.rows
                ready += chunk.left
            if client.status != "running":
                lacking = len(waiting) + len(ready) + sum(map(len, cluster.running.values()))
                raise IncompleteError(
                    f"{scheduler}: the scheduler was lost, {lacking} scenes are not done; "
                    "the same command goes on where it stopped"
                )
            time.sleep(_POLL_SECONDS)
    finally:
        discard(workspace)
        with contextlib.suppress(Exception):  # the scheduler may be gone
            if client.status == "running":
                client.cancel(list(cluster.running))
            client.close(timeout=2)


class _Cluster:
    """The chunks that are being computed, and the size of the next ones."""

    def __init__(self, client: Any, run: Run) -> None:
        self.client, self.run = client, run
        self.sources, self.function = source_digest_function()()[1], chunk_function()
        self.running: dict[Any, list[Task]] = {}
        self.each: float | None = None  # seconds of one scene
        self.workers, self.counted = 1, 0.0

    def check(self, output: Path, reporter: Reporter) -> None:
        """Raise ConfigError unless all present workers have this depthcli and see this run folder.

        Those that join later are checked with every chunk.
        """
        scheduler = self.run.options.scheduler
        try:
            found = self.client.run(source_digest_function())
            for address, (version, sources) in sorted(found.items()):
                if sources != self.sources:
                    raise ConfigError(f"{scheduler}: {_other_code(f'{address} (version {version})')}")
            for address, versions in sorted(self.client.run(versions_here, self.run.plugins).items()):
                for package, version in versions_here(self.run.plugins).items():
                    if versions[package] != version:
                        has = f"has the plug-in {package} {versions[package]}, this machine {version}"
                        raise ConfigError(f"{scheduler}: worker {address} {has}; install the same there")
            identities = self.client.run(operator.attrgetter("identity"), self.run)
            folders = self.client.run(folder_digest, str(output.absolute()))
        except ConfigError:
            raise
        except Exception as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise ConfigError(f"{scheduler}: its workers have no such depthcli ({reason})") from error
        for address, identity in sorted(identities.items()):
            if identity != self.run.identity:
                raise ConfigError(f"{scheduler}: {_other_code(address)}")
        for address, folder in sorted(folders.items()):
            if folder != folder_digest(str(output.absolute())):
                raise ConfigError(
                    f"{scheduler}: worker {address} does not see the run folder {output.absolute()}; "
                    "want a file system that all share"
                )
        reporter.info(f"{len(found)} workers at {scheduler}" + ("" if found else "; waiting for some"))

    def has_room(self) -> bool:
        """Return True where some worker has fewer chunks than it should."""
        if self.client.status != "running":
            return False
        if time.monotonic() - self.counted > _COUNT_SECONDS:
            with contextlib.suppress(OSError, TimeoutError):  # the scheduler was just lost
                self.workers = max(1, len(self.client.scheduler_info(n_workers=-1)["workers"]))
            self.counted = time.monotonic()
        return len(self.running) < _CHUNKS_PER_WORKER * self.workers

    def chunk(self, left: int) -> int:
        """Return the number of scenes of the next chunk: some seconds of work, and a fair share of what is left."""
        size = 1 if self.each is None else int(_CHUNK_SECONDS / max(self.each, 1e-3))
        return max(1, min(size, _MAX_CHUNK, left // (_CHUNKS_PER_WORKER * self.workers)))

    def submit(self, chunk: list[Task]) -> None:
        """Send a chunk to the scheduler."""
        data = pickle.dumps((chunk, self.run, os.getcwd()))
        self.running[self.client.submit(self.function, self.sources, data, pure=False)] = chunk

    def finished(self, reporter: Reporter) -> Iterator[_Chunk]:
        """Yield every chunk that came back; the scenes of one whose workers died are sent again one by one."""
        for future in [future for future in self.running if future.done()]:
            tasks = self.running.pop(future)
            if future.status == "finished":
                if isinstance(result := future.result(), str):
                    raise ConfigError(f"{self.run.options.scheduler}: {_other_code(result)}")
                yield self._returned(tasks, _Chunk(*result))
                continue
            if future.status != "error":  # cancelled, or lost with the scheduler
                self.running[future] = tasks
                return
            error = future.exception()
            died = type(error).__name__ == "KilledWorker"
            if died and len(tasks) > 1:
                reporter.info(f"workers died several times with {len(tasks)} scenes; trying these one by one")
                for task in tasks:
                    self.submit([task])
                continue
            why = "its worker died several times, probably out of memory; see --max-memory"
            if not died:
                why = f"{BUG}{type(error).__name__}: {error}".splitlines()[0][:300]
            yield _Chunk([task.failed(why) for task in tasks])

    def _returned(self, tasks: list[Task], chunk: _Chunk) -> _Chunk:
        spent = [sum(row["seconds"].values()) for row in chunk.rows if row["seconds"]]
        if spent:
            mean = sum(spent) / len(spent)
            self.each = mean if self.each is None else 0.5 * (self.each + mean)
        if not chunk.rows:
            why = f"{tasks[0].workspace}: a worker does not see it; is the file system shared?"
            return chunk._replace(rows=[task.failed(why) for task in tasks])
        names = {row["scene"] for row in chunk.rows}
        return chunk._replace(left=tuple(task for task in tasks if task.scene.name not in names))


def _connected(address: str) -> Any:
    try:
        import dask
        import distributed
        from distributed.comm.addressing import resolve_address
    except ImportError as error:
        raise ConfigError(f"--scheduler wants dask.distributed: pip install 'depthcli[cluster]' ({error})") from error
    for name in [*logging.root.manager.loggerDict, "asyncio"]:  # problems are reported below, in one line
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    dask.config.set({"distributed.comm.timeouts.connect": "10s"})
    client = distributed.Client.__new__(distributed.Client)
    try:
        resolve_address(address)  # an address without port or host would be tried for long
        distributed.Client.__init__(client, address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
        return client
    except (OSError, ValueError, TimeoutError) as error:
        client.status = "closed"  # its destructor would wait for what never began
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ConfigError(f"--scheduler {address}: no scheduler answers there ({reason})") from error


def _other_code(worker: str) -> str:
    return (
        f"worker {worker} has another depthcli, or other versions of Python and its libraries, than this machine; "
        "end it or install the same there; the same command goes on where it stopped"
    )

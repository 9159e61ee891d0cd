"""Compute scenes on the workers of a dask.distributed cluster."""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import threading
import time
from collections.abc import Generator, Iterable
from concurrent.futures import CancelledError
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from depthcli.core.context import Latest
from depthcli.core.errors import RESUME, ConfigError, IncompleteError
from depthcli.core.plugins import load_plugin, loaded
from depthcli.kernels.jit import CompileWatch
from depthcli.run.console import Reporter
from depthcli.run.job import available_memory
from depthcli.run.records import digest, file_digest
from depthcli.run.scene import BUG, Task, Work, compute_scene
from depthcli.run.workers import counted, report_compilation, use_threads
from depthcli.show.table import Row

_CONNECT_TIMEOUT = "20s"
_RUNNING_FILE = "goes-on"  # in a run's hidden folder; workers stop when it is removed
_lock = threading.Lock()  # the threads of a worker share kernels and buffers


def compute_on_cluster(
    tasks: Iterable[Task], work: Work, reporter: Reporter, workspace: Path
) -> Generator[Row, None, None]:
    """Yield the rows of the tasks as the workers of a dask.distributed cluster finish them.

    The workers must have the same file system at the same paths. If a worker dies, another one computes its scene.

    Raises
    ------
    ConfigError
        If dask.distributed or a scheduler at the address is missing, or workers have another depthcli or file system.
    IncompleteError
        If the connection to the scheduler is lost.
    """
    address = work.how.scheduler or ""
    lost = f"{address}: the scheduler was lost; {RESUME}"
    if files := sorted(plugin.package for plugin in work.plugins if plugin.is_file):
        raise ConfigError(f"--scheduler: {', '.join(files)}: workers have no plug-in files; install it as a package")
    modules = [plugin.module for plugin in loaded.values() if not plugin.is_file]
    workspace.mkdir(parents=True, exist_ok=True)
    (workspace / _RUNNING_FILE).touch()
    client, wait = _connected(address)
    waiting, running, n_workers = iter(tasks), dict[Any, Task](), -1
    identity, folder = _identity_here(work), os.getcwd()
    try:
        while True:
            with contextlib.suppress(OSError, TimeoutError):  # the scheduler may just have been lost
                found = len(client.scheduler_info(n_workers=-1)["workers"])
                if n_workers < 0:
                    reporter.info(f"{found} workers at {address}" + ("" if found else "; waiting for some"))
                n_workers = found
            while client.status == "running" and len(running) < 2 * max(n_workers, 1):
                if (task := next(waiting, None)) is None:
                    break
                data = pickle.dumps((task, work, identity, folder))
                running[client.submit(_compute_there, modules, data, pure=False)] = task
            if not running:
                return
            with contextlib.suppress(Exception):  # nothing is finished yet, or the scheduler is lost
                wait(list(running), timeout=1, return_when="FIRST_COMPLETED")
            for future in [future for future in running if future.status in ("finished", "error")]:
                task = running.pop(future)
                error = future.exception() if future.status == "error" else None
                if error is None:
                    row, kernels, seconds = future.result()
                    report_compilation(reporter, kernels, seconds)
                elif type(error).__name__ == "KilledWorker":
                    row = task.died("its worker died several times, probably out of memory; see --max-memory", work)
                else:
                    reason = (str(error).splitlines() or [""])[0][:300]
                    if isinstance(error, ConfigError):
                        raise ConfigError(f"{address}: {reason}") from error
                    if isinstance(error, ImportError | AttributeError | pickle.UnpicklingError):
                        problem = f"its workers have no such depthcli, or not its plug-ins ({reason})"
                        raise ConfigError(f"{address}: {problem}") from error
                    row = task.died(f"{BUG}{type(error).__name__}: {reason}", work)
                yield row
            if client.status != "running":
                raise IncompleteError(lost)
    except (OSError, CancelledError) as error:  # any call of the client; a future without scheduler
        raise IncompleteError(lost) from error
    finally:
        (workspace / _RUNNING_FILE).unlink(missing_ok=True)
        with contextlib.suppress(Exception):  # the scheduler may be gone
            if client.status == "running":
                client.cancel(list(running))
            client.close(timeout=2)


def _connected(address: str) -> tuple[Any, Any]:
    """Return a client of the scheduler, and the function that waits for its futures."""
    try:
        import dask
        import distributed
        from distributed.comm.addressing import resolve_address
    except ImportError as error:
        raise ConfigError(f"--scheduler needs dask.distributed: pip install 'depthcli[cluster]' ({error})") from error
    for name in [*logging.root.manager.loggerDict, "asyncio"]:  # depthcli reports problems in one line
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    dask.config.set({"distributed.comm.timeouts.connect": "10s"})
    client = distributed.Client.__new__(distributed.Client)
    try:
        resolve_address(address)  # fails at once without port or host; a client would retry for long
        distributed.Client.__init__(client, address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        client.status = "closed"  # otherwise its destructor would wait
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ConfigError(f"--scheduler {address}: no scheduler answers there ({reason})") from error
    return client, distributed.wait


def _compute_there(modules: Iterable[str], data: bytes) -> tuple[Row, int, float]:
    """Compute a scene on a cluster's worker; return its row, the number of compiled kernels, and their seconds."""
    from distributed import get_worker

    worker = get_worker()
    try:
        with _lock:
            for module in modules:
                load_plugin(module)
    except ConfigError as error:
        raise ConfigError(f"worker {worker.address} has not its plug-ins: {error}") from error
    task, work, identity, folder = pickle.loads(data)
    if identity != _identity_here(work):
        raise ConfigError(
            f"worker {worker.address} has another depthcli, or other versions of Python, its libraries or plug-ins, "
            f"than this machine; end it or install the same there; {RESUME}"
        )
    with _lock, CompileWatch(lambda _: None) as watch:
        running = Path(folder, task.hidden.parent, _RUNNING_FILE)
        if not running.exists():  # it is also missing if the run has ended
            raise ConfigError(f"worker {worker.address} does not see {running}; all need a common file system")
        os.chdir(folder)  # paths may be relative to where the run was started
        use_threads(work.how.threads or worker.state.nthreads)
        # A worker that seemed dead may still compute the scene in its own folder.
        own = replace(task, hidden=task.hidden.with_name(f"{task.hidden.name}-{os.getpid()}-{time.time_ns():x}"))
        limit = work.how.max_memory or available_memory()
        latest = worker.__dict__.setdefault("depthcli_latest", Latest())  # kept as long as the worker lives
        finish, kernels, seconds = counted(partial(compute_scene, own, work, limit, latest), watch)
        return finish(), kernels, seconds


def _identity_here(work: Work) -> str:
    """Return the run's identity with this process's versions, and a digest of depthcli's sources."""
    return digest(work.text.encode()) + _sources()


@cache
def _sources() -> str:  # cached, since loaded code stays when its file changes
    folder = Path(__file__).parent.parent
    files = sorted(path for path in folder.rglob("*") if path.suffix in (".py", ".cl", ".json"))
    return digest("".join(f"{path.relative_to(folder)} {file_digest(path)}" for path in files).encode())

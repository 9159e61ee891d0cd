"""What a worker of a cluster does: compute a chunk of scenes, in rows and files as on the machine of the run."""

from __future__ import annotations

import os
import platform
import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from depthcli.run import records, resources, run_folder
from depthcli.run.json_csv import Row
from depthcli.run.processes import compile_watch, use_threads
from depthcli.run.reports import finished_row
from depthcli.run.task import Run, Task, run_task

RUNNING_FILE = "goes-on"
"""A file in the workspace; workers stop when it is gone, since the run has ended then."""

_compute_lock = threading.Lock()  # threads of one worker share kernels and buffers


def source_digest_function() -> Callable[[], tuple[str, str]]:
    """Return a function that returns version and digest of the sources of depthcli where it is called.

    It is a local one so that dask sends its code: a worker with another depthcli would know another by its name.
    """

    def source_digest() -> tuple[str, str]:
        import hashlib
        from pathlib import Path

        import depthcli

        known: dict[str, tuple[str, str]] = vars(depthcli)
        if "_source_digest" not in known:  # once a process: code that was loaded stays when its file changes
            folder, sha = Path(depthcli.__file__).parent, hashlib.sha256()
            for path in sorted(folder.rglob("*")):
                if path.suffix in (".py", ".cl", ".json", ".yaml"):
                    sha.update(f"{path.relative_to(folder).as_posix()} {path.stat().st_size} ".encode())
                    sha.update(path.read_bytes())
            known["_source_digest"] = depthcli.__version__, sha.hexdigest()
        return known["_source_digest"]

    return source_digest


def chunk_function() -> Callable[[str, bytes], tuple[list[Row], int, float] | str]:
    """Return the function that computes a chunk on a worker, or returns which process it is where its code differs."""
    source_digest = source_digest_function()

    def compute_chunk(sources: str, data: bytes) -> tuple[list[Row], int, float] | str:
        import os
        import pickle
        import platform

        if source_digest()[1] != sources:
            return f"{platform.node()}, process {os.getpid()},"
        from depthcli.run import cluster_worker

        try:
            chunk, run, folder = pickle.loads(data)
        except ImportError:  # a plug-in that this worker does not have
            return f"{platform.node()}, process {os.getpid()},"
        return cluster_worker.compute_chunk(chunk, run, folder)

    return compute_chunk


def folder_digest(output: str) -> str:
    """Return the digest of the run folder's config as this process sees it."""
    return records.digest(run_folder.saved_config(Path(output)).encode())


def compute_chunk(chunk: list[Task], run: Run, folder: str) -> tuple[list[Row], int, float] | str:
    """Return, on a worker, the rows of the chunk's scenes, the number of compiled kernels, and the time for these.

    Return which process it is where versions of its libraries differ.
    """
    from distributed import get_worker

    if chunk[0].run != run.identity:
        return f"{platform.node()}, process {os.getpid()},"
    own = f"{platform.node()}-{os.getpid()}"
    rows: list[Row] = []
    with _compute_lock, compile_watch(lambda watch: None) as watch:
        os.chdir(folder)  # paths may be relative to where the run was started
        use_threads(run.options.threads or get_worker().state.nthreads)
        for task in chunk:
            if not (task.workspace / RUNNING_FILE).exists():
                break
            known = records.read_record(task.target)
            if known is not None and known.is_done(task.target, task.run, task.inputs):
                rows.append(finished_row(known, {"source": task.source}))  # by a worker that died with its chunk
                continue
            # A worker that was believed to be dead may still compute the scene in its own workspace.
            mine = replace(task, workspace=task.workspace / own)
            shutil.rmtree(mine.hidden, ignore_errors=True)
            rows.append(run_task(mine, run, run.options.max_memory or resources.available_memory()))
    return rows, watch.calls, watch.seconds

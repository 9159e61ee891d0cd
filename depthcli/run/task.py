"""One scene as a task: computed in a hidden folder, then moved into its own folder."""

from __future__ import annotations

import contextlib
import errno
import fnmatch
import os
import shutil
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from depthcli.core import memory
from depthcli.core.errors import DepthcliError, OutputError
from depthcli.core.method import used_plugins
from depthcli.core.registry import Plugin
from depthcli.core.scene import computing
from depthcli.core.text import show_bytes
from depthcli.io.formats.files import collected_warnings
from depthcli.io.formats.map_format import format_plugins
from depthcli.io.layouts import layout_plugins
from depthcli.io.scenes import Scene
from depthcli.run import resources
from depthcli.run.batch import Outcome
from depthcli.run.command import SceneCommand
from depthcli.run.install import install, remove_results
from depthcli.run.json_csv import Row
from depthcli.run.records import Record, digest, digests_below, read_record
from depthcli.run.run_folder import run_text
from depthcli.run.sharing import Shard

BUG = "a bug in depthcli: "
"""Prefix of the error of a scene that failed by a fault of the program."""

_MAX_TRACE_NAME = 200  # bytes of a scene's name in that of its traceback; a file's name has 255


@dataclass(frozen=True)
class RunOptions:
    """How a run is carried out; none of it changes the results.

    Attributes
    ----------
    jobs : worker processes; 1 computes in this process
    threads : threads of each; None divides the cores among them
    max_memory : bytes that all of them together may use; None: what is available
    overwrite : replace what an earlier run with another config or from other inputs left
    shard : the part of the scenes that this process computes, while others fill the same folder; None: all
    fail_fast : stop at the first scene that fails
    keep : shell patterns of the files that are kept of a scene; none: all
    scheduler : address of the dask.distributed cluster that computes; None: this machine
    preset : ``command/name`` of the config, or the command, whose kernels progress counts while they are compiled
    """

    jobs: int = 1
    threads: int | None = None
    max_memory: int | None = None
    overwrite: bool = False
    shard: Shard | None = None
    fail_fast: bool = False
    keep: tuple[str, ...] = ()
    scheduler: str | None = None
    preset: str = ""

    def threads_each(self) -> int:
        """Return the number of threads of one worker."""
        return self.threads or max(1, resources.cores() // self.jobs)

    def memory_each(self) -> int:
        """Return the bytes that one worker may use."""
        return (self.max_memory or resources.available_memory()) // self.jobs


@dataclass(frozen=True)
class Run:
    """A command with its config, whose types only the command itself needs to know, and plug-ins used; picklable."""

    command: SceneCommand[Any, Any]
    config: Any
    options: RunOptions
    plugins: frozenset[Plugin] = frozenset()

    @classmethod
    def of(cls, command: SceneCommand[Any, Any], config: Any, scenes: Sequence[Scene], options: RunOptions) -> Run:
        """Return the run of these scenes, with the plug-ins that it uses."""
        used = used_plugins(config) | used_plugins(command) | layout_plugins(scenes)
        used |= format_plugins(file for scene in scenes for file in scene.input_files.values())
        return cls(command, config, options, frozenset(used))

    @property
    def text(self) -> str:
        """The text of ``run.yaml``: config and versions of this process."""
        return run_text(self.command.name, self.config, self.plugins)

    @property
    def identity(self) -> str:
        """The identity of this run: the digest of its ``run.yaml``."""
        return digest(self.text.encode())


@dataclass(frozen=True, slots=True)
class Task:
    """One scene to compute.

    Attributes
    ----------
    scene : the scene
    output, workspace : the run folder, and the folder in it where scenes are computed
    number : number of the scene in this call, and the name of its folder in ``workspace``
    run : identity of the run
    inputs : role -> digest of what the result depends on
    source : path of the input, for the report
    """

    scene: Scene
    output: Path
    workspace: Path
    number: int
    run: str
    inputs: dict[str, str]
    source: str

    @property
    def target(self) -> Path:
        """The scene's folder in the run folder."""
        return self.output / self.scene.name

    @property
    def hidden(self) -> Path:
        """The folder in which the scene is computed."""
        return self.workspace / str(self.number)

    @property
    def trace(self) -> Path:
        """The file for the traceback of a bug."""
        name = self.scene.name.replace("/", "_")
        if len(os.fsencode(name)) > _MAX_TRACE_NAME:
            name = f"{name[:40]}-{digest(os.fsencode(name))[:16]}"
        return self.output / f"traceback-{name}.txt"

    def failed(self, error: str) -> Row:
        """Return the row of the report for a scene that failed."""
        return {"scene": self.scene.name, "status": "failed", "error": error, "seconds": {}, "peak_memory": None,
                "source": self.source}  # fmt: skip


def run_task(task: Task, run: Run, limit: int) -> Row:
    """Compute a scene with at most ``limit`` bytes and return its row; any failure becomes the row's ``error``.

    Where a disk was full, the row has the key ``disk_full`` with the place, the reason and the bytes that are free.
    """
    with collected_warnings() as lines:
        row = _run_task(task, run, limit)
    if place := row.get("disk_full"):
        row["disk_full"] = row["error"]
        with contextlib.suppress(OSError):  # the files of this scene have been deleted by now
            row["disk_full"] += f" ({show_bytes(shutil.disk_usage(place).free)} free on that disk)"
    row["warnings"] = list(dict.fromkeys([*row.get("warnings", ()), *lines]))
    return row


def _run_task(task: Task, run: Run, limit: int) -> Row:
    resources.reset_peak()
    opened, lost = None, False
    try:
        task.scene.check()
        task.hidden.mkdir(parents=True)
        opened = os.open(task.hidden, os.O_RDONLY)  # while it is open, no other folder gets its inode number
        with computing(task.scene.name, limit) as programs:
            outcome = run.command.compute(run.config, task.scene, task.hidden, limit)
        _delete_unwanted(task.hidden, run.options.keep)
        _install(task, outcome, opened, run.options.overwrite)
        seconds = {name: round(value, 6) for name, value in outcome.seconds.items()}
        row: Row = {"scene": task.scene.name, "status": "done", "error": "", **outcome.facts, "seconds": seconds}
        row |= {"peak_memory": resources.peak_memory(), **programs.used, "source": task.source}
        row["warnings"] = outcome.warnings
    except Exception as error:
        row = _failed_row(task, error)
    finally:
        memory.release()
        if opened is not None:
            # Another process may have taken the scene over where this run was ended while it was computed.
            lost = not _is_open(task.hidden, opened)
            os.close(opened)
        shutil.rmtree(task.hidden, ignore_errors=True)
    known = read_record(task.target) if row["status"] == "failed" and not lost else None
    if known is not None and (known.run == task.run or run.options.overwrite):
        with contextlib.suppress(OSError):  # the result of an earlier run from other inputs must not stay
            remove_results(task.target)
    return row


def _failed_row(task: Task, error: Exception) -> Row:
    """Return the row of a scene whose computation raised ``error``, which is being handled."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT):
            place = _folder_of(cause.filename, task.output)
            return task.failed(f"{place}: {cause.strerror or 'the disk is full'}") | {"disk_full": str(place)}
        cause = cause.__cause__ or cause.__context__
    if isinstance(error, MemoryError):
        return task.failed("out of memory; see --max-memory")
    if isinstance(error, DepthcliError):
        return task.failed(str(error))
    if isinstance(error, OSError):
        return task.failed(f"{error.filename or task.target}: {error.strerror or error}")
    what = f"{type(error).__name__}: {error}".splitlines()[0][:300]
    with contextlib.suppress(OSError):
        task.trace.write_text(traceback.format_exc(), "utf-8", "backslashreplace")
    return task.failed(f"{BUG}{what}; the traceback is in {task.trace.name}, please report it")


def _folder_of(file: object, output: Path) -> Path:
    """Return the folder in which a file could not be written: the run folder, unless it lies elsewhere."""
    if not isinstance(file, str | Path) or Path(file).absolute().is_relative_to(output.absolute()):
        return output
    return Path(file).parent


def _delete_unwanted(folder: Path, keep: tuple[str, ...]) -> None:
    for path in [path for path in folder.rglob("*") if path.is_file()] if keep else []:
        name = path.relative_to(folder).as_posix()
        if not any(fnmatch.fnmatchcase(name, each) or fnmatch.fnmatchcase(path.name, each) for each in keep):
            path.unlink()


def _is_open(folder: Path, opened: int) -> bool:
    try:
        return os.path.samestat(os.stat(folder), os.fstat(opened))
    except OSError:
        return False


def _install(task: Task, outcome: Outcome, opened: int, overwrite: bool) -> None:
    """Move a computed scene into the run folder; ``opened`` is the open folder that it was computed in."""
    try:
        files = digests_below(task.hidden)
        if not _is_open(task.hidden, opened):
            raise OutputError(f"{task.hidden}: was removed while it was written: the run has ended")
        record = Record(task.scene.name, task.run, task.inputs, files, outcome.facts)
        install(task.hidden, task.target, record, overwrite)
    except OSError as error:
        raise OutputError(f"{task.target}: cannot be written ({error.strerror or error})") from error
    task.trace.unlink(missing_ok=True)

"""The way of one scene: its task, its computation in a hidden folder, and its move into the folder of its name.

Files and record are moved together, the record last. Every failure becomes a row with its reason.
"""

from __future__ import annotations

import contextlib
import errno
import fnmatch
import os
import platform
import shutil
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from depthcli import __version__
from depthcli.core import memory
from depthcli.core.config_file import dump_config
from depthcli.core.context import Context, Latest
from depthcli.core.errors import DepthcliError, InputError, OutputError, Terminated, shortage
from depthcli.core.plugins import Plugin, plugin_behind, versions_here
from depthcli.core.text import show_bytes, without_secrets
from depthcli.core.yaml_source import to_yaml
from depthcli.io.formats.files import collected_warnings, file_states, shown
from depthcli.io.scenes import Scene
from depthcli.run.folder import TITLE
from depthcli.run.job import Execution, Job, Outcome, peak_memory, reset_peak
from depthcli.run.records import Record, digest, digests_below, file_digest, install, record_failure
from depthcli.show.table import Row

BUG = "a bug in depthcli: "
"""Prefix of the error of a scene that failed because of a bug."""

# Packages whose versions may change results; the versions are part of the run's identity.
_LIBRARIES = ("numpy", "numba", "opencv-contrib-python-headless", "scikit-image", "PyMaxflow")
_MAX_TRACE_NAME = 200  # bytes of a scene's name in the name of its traceback; a file's name has 255
_MAX_NAMED = 20  # files in a message
_NOT_OPEN = -1  # in place of a folder's descriptor: Windows cannot open folders
_KEPT_SHARE = 16  # of the memory that a process may use, for arrays of its next scene: fresh pages take long


@dataclass(frozen=True)
class Work:
    """The work for workers: the job, options for its execution, and its plug-ins."""

    job: Job[Any]
    how: Execution
    plugins: frozenset[Plugin]

    @property
    def text(self) -> str:
        """The text of ``run.yaml``: the resolved config, which can be used as CONFIG again, and all versions."""
        versions = {"depthcli": __version__, "python": platform.python_version()}
        for name in _LIBRARIES:
            with contextlib.suppress(metadata.PackageNotFoundError):
                versions[name] = metadata.version(name)
        command, config = self.job.command, self.job.config
        run = to_yaml({"run": {"command": command, "versions": versions | versions_here(self.plugins)}})
        if isinstance(config, BaseModel):
            return f"{TITLE} Repeat it with: depthcli {command} run.yaml ...\n{dump_config(config)}{run}"
        return f"{TITLE}\n{to_yaml(dict(config))}{run}"


@dataclass(frozen=True)
class Task:
    """A scene to compute in the folder ``hidden``; ``inputs`` are role -> digest of the result's inputs."""

    scene: Scene
    output: Path
    hidden: Path
    run: str
    inputs: dict[str, str]
    source: str
    watched: dict[Path, tuple[str, object]]  # file -> its digest and its state before reading

    @property
    def target(self) -> Path:
        """The scene's folder in the run folder."""
        return self.output / self.scene.name

    @property
    def trace(self) -> Path:
        """The path for a bug's traceback."""
        name = self.scene.name.replace("/", "_")
        if len(os.fsencode(name)) > _MAX_TRACE_NAME:
            name = f"{name[:40]}-{digest(os.fsencode(name))[:16]}"
        return self.output / f"traceback-{name}.txt"

    def done(self, outcome: Outcome, used: Mapping[str, float], warnings: Sequence[str]) -> Row:
        """Return the row of a computed scene; ``used`` has the time and memory of external programs."""
        row: Row = {"scene": self.scene.name, "status": "done", "error": "", **outcome.facts}
        row["seconds"] = {name: round(value, 6) for name, value in outcome.seconds.items()}
        row |= {"peak_memory": peak_memory(), **used, "source": self.source}
        return row | {"warnings": list(dict.fromkeys([*outcome.warnings, *warnings]))}

    def failed(self, error: str) -> Row:
        """Return the row of a failed scene."""
        error = without_secrets(error)
        row: Row = {"scene": self.scene.name, "status": "failed", "error": error, "seconds": {}, "peak_memory": None}
        return row | {"source": self.source, "warnings": []}

    def is_done(self, known: Record | None) -> bool:
        """Return whether a record has this run and these inputs, and its files are unchanged."""
        if known is None or known.row.get("status") != "done" or (known.run, known.inputs) != (self.run, self.inputs):
            return False
        return all(file_digest(self.target / name) == content for name, content in known.files.items())

    def record(self, row: Row, files: dict[str, str]) -> Record:
        """Return the record of the scene."""
        return Record(self.scene.name, self.run, self.inputs, files, row)

    def died(self, reason: str, work: Work) -> Row:
        """Record the scene as failed, since its worker was killed in each try, and return its row."""
        row = self.failed(reason)
        record_failure(self.target, self.record(row, {}), work.how.overwrite)
        return row


def compute_scene(task: Task, work: Work, limit: int, latest: Latest | None = None) -> Callable[[], Row]:
    """Compute a scene in its hidden folder with at most ``limit`` bytes; return the function that finishes it.

    The function moves the files into place, writes the record and returns the row. It waits for the disk, and may run
    in another thread while the next scene is computed. If a disk was full, the row has the key ``disk_full`` with the
    place, the reason and the free bytes, and nothing is recorded.

    ``latest`` has results that the scenes of this process share.
    """
    reset_peak()
    opened, done = None, False
    with collected_warnings() as lines:
        try:
            task.scene.check()
            lines += task.scene.warnings
            task.hidden.mkdir(parents=True)
            opened = _NOT_OPEN
            with contextlib.suppress(PermissionError):  # no other folder can get its inode number while it is open
                opened = os.open(task.hidden, os.O_RDONLY)
            context = Context(limit, task.scene.name, limit, latest or Latest())
            outcome = work.job.compute(task.scene, task.hidden, context)
            row, done = task.done(outcome, context.used, lines), True
        except (KeyboardInterrupt, Terminated):
            _leave(task, opened)
            raise
        except BaseException as error:  # plug-ins may exit, or panic in Rust; only their scene fails
            row = _failed_row(task, error) | {"warnings": lines}
    return partial(_finished, task, work, limit, row, done, opened)


def _finished(task: Task, work: Work, limit: int, row: Row, done: bool, opened: int | None) -> Row:
    """Move the files of a ``done`` scene into place, or record its failure, and return the row.

    ``opened`` is the descriptor of the hidden folder, or None if the folder was not made; it is closed here.
    """
    try:
        try:
            if done and opened is not None:
                _install(task, work, row, opened)
        except (KeyboardInterrupt, Terminated):
            raise
        except BaseException as error:
            row, done = _failed_row(task, error) | {"warnings": row["warnings"]}, False
        # If this run was ended meanwhile, another process may compute the scene now.
        if not done and "disk_full" not in row and (opened is None or _is_open(task.hidden, opened)):
            record_failure(task.target, task.record(row, {}), work.how.overwrite)
    finally:
        memory.release(limit // _KEPT_SHARE)
        _leave(task, opened)
    if place := row.get("disk_full"):
        row["disk_full"] = row["error"]
        with contextlib.suppress(OSError):  # this scene's files are already deleted
            row["disk_full"] += f" ({show_bytes(shutil.disk_usage(place).free)} free on that disk)"
    return row


def _install(task: Task, work: Work, row: Row, opened: int) -> None:
    """Move the hidden folder into place. Raise InputError if an input has changed, OutputError on failure."""
    for file, (content, state) in task.watched.items():
        if file_states(file) != state and file_digest(file) != content:
            raise InputError(f"{shown(file)}: changed since the run began; the same command reads it again")
    try:
        if work.how.keep:
            _keep_only(work.how.keep, task.hidden)
        files = digests_below(task.hidden)
        if not _is_open(task.hidden, opened):
            raise OutputError(f"{task.hidden}: was removed while it was written: the run has ended")
        install(task.hidden, task.target, task.record(row, files), work.how.overwrite)
    except OSError as error:
        raise OutputError(f"{task.target}: cannot be written ({error.strerror or error})") from error
    task.trace.unlink(missing_ok=True)


def _leave(task: Task, opened: int | None) -> None:
    """Close and delete the hidden folder."""
    if opened is not None and opened != _NOT_OPEN:
        os.close(opened)
    shutil.rmtree(task.hidden, ignore_errors=True)


def _keep_only(patterns: Sequence[str], folder: Path) -> None:
    """Delete the files whose name or path matches none of the patterns. Raise InputError if none would stay."""
    paths = [path for path in folder.rglob("*") if path.is_file()]
    others = []
    for path in paths:
        names = path.relative_to(folder).as_posix(), path.name
        if not any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns for name in names):
            others.append(path)
    if paths and len(others) == len(paths):
        there = ", ".join(sorted({path.name for path in paths})[:_MAX_NAMED])
        raise InputError(f"--keep {','.join(patterns)} matches no file of the scene; there are {there}")
    for path in others:
        path.unlink()


def _failed_row(task: Task, error: BaseException) -> Row:
    """Return the row of a scene whose computation raised ``error``; call it while the error is handled."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT):
            place = task.output
            if cause.filename and not Path(cause.filename).absolute().is_relative_to(place.absolute()):
                place = Path(cause.filename).parent
            return task.failed(f"{place}: {cause.strerror or 'the disk is full'}") | {"disk_full": str(place)}
        cause = cause.__cause__ or cause.__context__
    if isinstance(error, MemoryError):
        return task.failed("out of memory; see --max-memory")
    if isinstance(error, DepthcliError):
        return task.failed(str(error))
    if text := shortage(error):
        return task.failed(text)
    if isinstance(error, OSError):
        return task.failed(f"{error.filename or task.target}: {error.strerror or error}")
    what = f"{type(error).__name__}: {error}".splitlines()[0][:300]
    with contextlib.suppress(OSError):
        task.trace.write_text(traceback.format_exc(), "utf-8", "backslashreplace")
    if plugin := plugin_behind(error):
        return task.failed(f"plug-in {plugin}: {what}; the traceback is in {task.trace.name}")
    return task.failed(f"{BUG}{what}; the traceback is in {task.trace.name}, please report it")


def _is_open(folder: Path, opened: int) -> bool:
    """Return whether the path still leads to the folder that was opened."""
    if opened == _NOT_OPEN:
        return folder.is_dir()
    try:
        return os.path.samestat(os.stat(folder), os.fstat(opened))
    except OSError:
        return False

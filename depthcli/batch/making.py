"""One scene, from its files to its folder: computed in a hidden place, moved into its own with its record last."""

from __future__ import annotations

import contextlib
import fnmatch
import os
import shutil
import time
import traceback
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypeVar

from depthcli.batch import record, resources
from depthcli.batch.sharing import Shard
from depthcli.core import memory
from depthcli.core.errors import DepthcliError, OutputError
from depthcli.data.scenes import Scene

BUG = "a bug in depthcli: "
"""How the reason of an scene begins that failed by our fault."""


@dataclass
class Outcome:
    """What one scene gave, beside its files.

    Attributes
    ----------
    facts : columns of the report that are the same in every run (size, density, figures)
    seconds : time by stage, in order
    warnings : what a person should know about the result
    """

    facts: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class RunOptions:
    """How a run is done; never what it computes.

    Attributes
    ----------
    jobs : worker processes; 1 computes in this process
    threads : threads of each; None shares the cores out
    max_memory : bytes all of them together may use; None = what is available
    overwrite : replace what an earlier run with another config or from other inputs left
    shard : the part of the scenes that this process does, beside others in the same folder; None: all, alone
    fail_fast : stop at the first scene that fails
    keep : shell patterns of the files that stay of an scene; none: all
    scheduler : of a dask.distributed cluster whose workers compute; None: this machine does
    """

    jobs: int = 1
    threads: int | None = None
    max_memory: int | None = None
    overwrite: bool = False
    shard: Shard | None = None
    fail_fast: bool = False
    keep: tuple[str, ...] = ()
    scheduler: str | None = None

    def threads_each(self) -> int:
        """Threads of one worker."""
        return self.threads or max(1, resources.cores() // self.jobs)

    def memory_each(self) -> int:
        """Bytes one worker may use."""
        return (self.max_memory or resources.available_memory()) // self.jobs


_Config = TypeVar("_Config", contravariant=True)
_Scene = TypeVar("_Scene", contravariant=True)


class Work(Protocol[_Config, _Scene]):
    """What a command does with its scenes; picklable, for worker processes."""

    @property
    def name(self) -> str: ...

    def compute(self, config: _Config, scene: _Scene, folder: Path, memory: int, /) -> Outcome:
        """Compute ``scene`` with at most ``memory`` bytes and write its files into the empty ``folder``."""

    def files(self, config: _Config, scene: _Scene, /) -> dict[str, Path]:
        """Role -> file whose content the result depends on."""

    def settings(self, config: _Config, scene: _Scene, /) -> dict[str, str]:
        """What else the result depends on, beside the config."""

    def effort(self, config: _Config, scene: _Scene, /) -> int | None:
        """About how much work it is, in any unit; None: it follows the size of its files."""


AnyWork: TypeAlias = Work[Any, Any]
"""The work of any command, where its config and its scenes are only passed on."""


@dataclass(frozen=True, slots=True)
class Task:
    """One scene to compute.

    Attributes
    ----------
    scene : what
    output, work : the run folder, and where in it scenes are made
    number : of the scene in this call
    run : identity of the run
    inputs : role -> digest of what the result depends on
    source : where the inputs are, for the report
    keep : patterns of the files that stay
    """

    scene: Scene
    output: Path
    work: Path
    number: int
    run: str
    inputs: dict[str, str]
    source: str
    keep: tuple[str, ...] = ()

    @property
    def target(self) -> Path:
        """The item's folder."""
        return self.output / self.scene.name

    @property
    def hidden(self) -> Path:
        """Where it is made."""
        return self.work / str(self.number)

    @property
    def trace(self) -> Path:
        """Where the traceback of a bug goes."""
        return self.output / f"traceback-{self.scene.name.replace('/', '_')}.txt"


def run_one(task: Task, work: AnyWork, config: Any, limit: int) -> dict[str, Any]:
    """One scene from its files to its folder; whatever goes wrong is the row's reason."""
    resources.reset_peak()
    row: dict[str, Any]
    mine, lost = None, False
    try:
        task.scene.check()
        task.hidden.mkdir(parents=True)
        mine = os.open(task.hidden, os.O_RDONLY)  # open, so that no other folder gets its number
        outcome = work.compute(config, task.scene, task.hidden, limit)
        _leave(task)
        _install(task, outcome, mine)
        seconds = {name: round(value, 6) for name, value in outcome.seconds.items()}
        row = {"scene": task.scene.name, "status": "done", "error": "", **outcome.facts, "seconds": seconds}
        row |= {"peak_memory": resources.peak_memory(), "source": task.source, "warnings": outcome.warnings}
    except MemoryError:
        row = failed_row(task, "out of memory; see --max-memory")
    except DepthcliError as error:
        row = failed_row(task, str(error))
    except OSError as error:
        row = failed_row(task, f"{error.filename or task.target}: {error.strerror or error}")
    except Exception as error:
        what = f"{type(error).__name__}: {error}".splitlines()[0][:300]
        with contextlib.suppress(OSError):
            task.trace.write_text(traceback.format_exc(), "utf-8", "backslashreplace")
        row = failed_row(task, f"{BUG}{what}; the traceback is in {task.trace.name}, please report it")
    finally:
        memory.release()
        # Of a run that has ended while its scene was made: another one may have the scene by now.
        lost = mine is not None and not _is_open(task.hidden, mine)
        if mine is not None:
            os.close(mine)
        shutil.rmtree(task.hidden, ignore_errors=True)
    if row["status"] == "failed" and not lost:
        # What an earlier run left for other inputs must not pass for this item's result.
        known = record.read_record(task.target)
        if known is not None:
            with contextlib.suppress(OSError):
                remove(task.target, known)
    return row


def _leave(task: Task) -> None:
    """Delete the files that are not to be kept."""
    for path in [path for path in task.hidden.rglob("*") if path.is_file()] if task.keep else []:
        name = path.relative_to(task.hidden).as_posix()
        if not any(fnmatch.fnmatchcase(name, each) or fnmatch.fnmatchcase(path.name, each) for each in task.keep):
            path.unlink()


def discard(folder: Path) -> None:
    """Delete a folder in which scenes are made; who still writes there finds it gone as a whole, not file by file."""
    away = folder.with_name(f"{folder.name}-{time.time_ns()}")
    try:
        folder.rename(away)
    except OSError:
        away = folder
    shutil.rmtree(away, ignore_errors=True)


def _is_open(folder: Path, opened: int) -> bool:
    try:
        return os.path.samestat(os.stat(folder), os.fstat(opened))
    except OSError:
        return False


def _install(task: Task, outcome: Outcome, mine: int) -> None:
    """Move a finished scene into place, its record last; ``mine`` is the open folder that it was made in."""
    try:
        made = sorted(path for path in task.hidden.rglob("*") if path.is_file())
        files = {path.relative_to(task.hidden).as_posix(): record.file_digest(path) for path in made}
        if not _is_open(task.hidden, mine):
            raise OutputError(f"{task.hidden}: was removed while it was written: the run has ended")
        known = {"scene": task.scene.name, "run": task.run, "inputs": task.inputs, "files": files}
        record.write_record(task.hidden, {**known, "facts": outcome.facts})
        before = record.read_record(task.target)
        if before is not None:
            remove(task.target, before)
        task.target.parent.mkdir(parents=True, exist_ok=True)
        try:
            task.hidden.rename(task.target)
        except OSError:  # the folder is there and holds something that is not ours
            task.target.mkdir(exist_ok=True)
            for name in (*files, record.RECORD_FILE):
                (task.target / name).parent.mkdir(exist_ok=True)
                os.replace(task.hidden / name, task.target / name)
    except OSError as error:
        raise OutputError(f"{task.target}: cannot be written ({error.strerror or error})") from error
    task.trace.unlink(missing_ok=True)


def remove(target: Path, known: dict[str, Any]) -> None:
    """Delete the files that a record lists, the record first; what else lies there is not ours."""
    (target / record.RECORD_FILE).unlink(missing_ok=True)
    folders = {target}
    for name in known["files"]:
        (target / name).unlink(missing_ok=True)
        folders.add((target / name).parent)
    for folder in sorted(folders, key=lambda path: -len(path.parts)):
        with contextlib.suppress(OSError):  # it holds something that is not ours
            folder.rmdir()


def failed_row(task: Task, error: str) -> dict[str, Any]:
    """The row of an scene that gave nothing."""
    return {
        "scene": task.scene.name, "status": "failed", "error": error, "seconds": {}, "peak_memory": None,
        "source": task.source,
    }  # fmt: skip

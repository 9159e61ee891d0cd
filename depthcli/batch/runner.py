"""The loop of every batch command: resume, isolate failures, show progress, spread over processes.

An item is computed into a hidden folder beside the others and then moved into place with its record
written last, so that a run can be killed at any moment and started again: what has a record that
matches the config and the inputs is kept, anything else is made anew.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from depthcli.batch import record, resources
from depthcli.batch.reporter import Reporter
from depthcli.core import memory
from depthcli.core.errors import ConfigError, DepthcliError, IncompleteError, OutputError
from depthcli.io.items import Item

BUG = "a bug in depthcli: "
"""How the reason of an item begins that failed by our fault."""

_HIDDEN = ".partial-"


@dataclass
class Outcome:
    """What one item gave, beside its files.

    Attributes
    ----------
    facts : columns of the report that are the same in every run (size, density, figures)
    seconds : time by stage, in order
    warnings : what a person should know about the result
    """

    facts: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


class Work(Protocol):
    """What a command does with its items; picklable, for worker processes."""

    @property
    def name(self) -> str: ...

    def compute(self, config: Any, item: Any, folder: Path, memory: int, /) -> Outcome:
        """Compute ``item`` with at most ``memory`` bytes and write its files into the empty ``folder``."""

    def files(self, config: Any, item: Any, /) -> dict[str, Path]:
        """Role -> file whose content the result depends on."""

    def settings(self, config: Any, item: Any, /) -> dict[str, str]:
        """What else the result depends on, beside the config."""


@dataclass(frozen=True)
class Options:
    """How a run is done; never what it computes.

    Attributes
    ----------
    jobs : worker processes; 1 computes in this process
    threads : threads of each; None shares the cores out
    max_memory : bytes all of them together may use; None = what is available
    overwrite : replace what an earlier run with another config or from other inputs left
    """

    jobs: int = 1
    threads: int | None = None
    max_memory: int | None = None
    overwrite: bool = False

    def threads_each(self) -> int:
        """Threads of one worker."""
        return self.threads or max(1, resources.cores() // self.jobs)

    def memory_each(self) -> int:
        """Bytes one worker may use."""
        return (self.max_memory or resources.available_memory()) // self.jobs


@dataclass(frozen=True)
class Task:
    """One item to compute.

    Attributes
    ----------
    item : what
    target, hidden : its folder, and where it is made
    run : identity of the run
    inputs : role -> digest of what the result depends on
    source : where the inputs are, for the report
    """

    item: Item
    target: Path
    hidden: Path
    run: str
    inputs: dict[str, str]
    source: str

    @property
    def trace(self) -> Path:
        """Where the traceback of a bug goes."""
        return self.hidden.parent.parent / f"traceback-{self.item.name.replace('/', '_')}.txt"


def run_items(
    work: Work, config: Any, items: Sequence[Item], output: Path, options: Options, reporter: Reporter
) -> list[dict[str, Any]]:
    """Run ``work`` on every item that is not done yet; write the run folder.

    Parameters
    ----------
    work : what to do with each
    config : together with the command's name and the versions it is the identity of the run folder
    items : what to run on, names unique
    output : the run folder

    Returns
    -------
    One row an item of this call, in order: ``scene``, ``status`` (done or failed), ``error``, facts,
    ``seconds`` by stage, ``peak_memory`` in bytes, ``source``.

    Raises
    ------
    ConfigError
        The folder holds another run or the result of another input of the same name, is in use, or lies
        where the inputs are.
    OutputError
        The folder cannot be used.
    IncompleteError
        Everything was computed, but the report cannot be written.
    """
    _check_names(work, config, items, output)
    text = record.run_text(work.name, config)
    with record.locked(output, reporter.info):
        earlier = record.read_report(output)
        run = record.open_run(output, text, options.overwrite)
        _clean(output)
        if options.overwrite:
            _drop_others(output, run, earlier, {item.name for item in items})
        rows: dict[str, dict[str, Any]] = {}
        tasks = []
        for number, item in enumerate(items):
            files, inputs = inputs_of(work, config, item)
            source = str(next(iter(files.values()), item.folder).absolute())
            task = Task(item, output / item.name, output / f"{_HIDDEN}{os.getpid()}" / str(number), run, inputs, source)
            known, before = record.read_record(task.target), earlier.get(item.name, {})
            if record.is_done(task.target, run, inputs, known):
                assert known is not None
                rows[item.name] = _row(known, {**before, "source": source})
                continue
            origin = before.get("source")
            if known is not None and known.get("run") == run and origin and origin != source and not options.overwrite:
                raise ConfigError(
                    f"{output}: holds the result of another {item.name!r}, made from {origin}; this one is "
                    f"{source}; choose another --output or --name, or --overwrite it"
                )
            tasks.append(task)
        if rows:
            reporter.info(f"{len(rows)} of {len(items)} scenes are done already")
        writer = _ReportWriter(output, work.name, _other_rows(output, run, earlier, items), rows, items)
        try:
            with reporter:
                reporter.start(len(items), len(rows), work.name)
                for row in _compute(tasks, work, config, options, reporter):
                    rows[row["scene"]] = row
                    if row["status"] == "failed":
                        reporter.error(f"{row['scene']}: {row['error']}")
                    else:
                        reporter.detail(f"{row['scene']}: {sum(row['seconds'].values()):.2f} s")
                    for line in row.pop("warnings", ()):
                        reporter.info(f"{row['scene']}: warning: {line}")
                    writer.update()
                    reporter.step(row["status"] == "failed")
        finally:
            for task in tasks:
                if task.item.name in rows:
                    rows[task.item.name] = _still_there(task, rows[task.item.name])
            writer.update(final=True)
            _clean(output)
    if writer.problem:
        raise IncompleteError(writer.problem)
    return [rows[item.name] for item in items]


def inputs_of(work: Work, config: Any, item: Item) -> tuple[dict[str, Path], dict[str, str]]:
    """Files that an item's result depends on; and their digests, with the settings that it depends on."""
    if item.problem:
        return {}, {}
    files = work.files(config, item)
    return files, {role: record.file_digest(file) for role, file in files.items()} | work.settings(config, item)


def _still_there(task: Task, row: dict[str, Any]) -> dict[str, Any]:
    """The row, unless what it speaks of was deleted since."""
    if row["status"] == "done" and not (task.target / record.RECORD_FILE).is_file():
        return failed_row(task, f"{task.target}: was computed, but its files have gone since")
    return row


def _check_names(work: Work, config: Any, items: Sequence[Item], output: Path) -> None:
    for item in items:
        if any(not part or part.startswith(".") or "\0" in part for part in item.name.split("/")):
            raise ConfigError(f"{item.name!r} is no name for a folder of results; give one with --name")
        target = os.path.realpath(output / item.name)  # unlike resolve() it lives with loops of links
        files = () if item.problem else work.files(config, item).values()
        if any(target == os.path.dirname(os.path.realpath(file)) for file in files):
            raise ConfigError(f"{output}: {item.name} would be written over its own input; choose another --output")


class _ReportWriter:
    """Keeps the report on disk current without writing it after each of a thousand items."""

    def __init__(
        self,
        output: Path,
        command: str,
        others: list[dict[str, Any]],
        rows: dict[str, dict[str, Any]],
        items: Sequence[Item],
    ) -> None:
        self.output, self.command, self.others, self.rows = output, command, others, rows
        self.order = [item.name for item in items]
        self.written = 0.0
        self.pause = 1.0
        self.problem = ""

    def update(self, final: bool = False) -> None:
        start = time.monotonic()
        if final or start - self.written > self.pause:
            rows = [self.rows[name] for name in self.order if name in self.rows]
            rows = sorted(self.others + rows, key=lambda row: str(row["scene"]))
            try:
                record.write_report(self.output, self.command, rows)
                self.problem = ""
            except OutputError as error:  # the items go on, and say themselves what they cannot write
                self.problem = str(error)
            self.written = time.monotonic()
            self.pause = max(1.0, 20 * (self.written - start))  # a long report is not most of the work


def _row(known: dict[str, Any], measured: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "scene": known.get("scene"),
        "status": "done",
        "error": "",
        **known["facts"],
        "seconds": measured.get("seconds") or {},
        "peak_memory": measured.get("peak_memory"),
        "source": measured.get("source") or "",
    }


def _other_rows(
    output: Path, run: str, earlier: dict[str, dict[str, Any]], items: Sequence[Item]
) -> list[dict[str, Any]]:
    """Rows of items that this call does not concern but that belong to the same run."""
    chosen = {item.name for item in items}
    rows = []
    for name, row in earlier.items():
        known = record.read_record(output / name) if name not in chosen and record.is_inside(name) else None
        if known is not None and known.get("run") == run:
            rows.append(_row(known, row))
    return rows


def _clean(output: Path) -> None:
    """Remove what killed runs left."""
    for leftover in (*output.glob(f"{_HIDDEN}*"), *output.glob(".*.partial~")):
        if leftover.is_dir() and not leftover.is_symlink():
            shutil.rmtree(leftover, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):
                leftover.unlink(missing_ok=True)


def _drop_others(output: Path, run: str, earlier: dict[str, dict[str, Any]], chosen: set[str]) -> None:
    """Remove the items of the run that is replaced, which are those its report lists; other runs' stay."""
    for name in earlier:
        known = record.read_record(output / name) if name not in chosen and record.is_inside(name) else None
        if known is not None and known.get("run") != run:
            _remove(output / name, known)


def _remove(target: Path, known: dict[str, Any]) -> None:
    """Delete the files that a record lists, the record first; what else lies there is not ours."""
    (target / record.RECORD_FILE).unlink(missing_ok=True)
    folders = {target}
    for name in known["files"]:
        (target / name).unlink(missing_ok=True)
        folders.add((target / name).parent)
    for folder in sorted(folders, key=lambda path: -len(path.parts)):
        with contextlib.suppress(OSError):  # it holds something that is not ours
            folder.rmdir()


def _install(task: Task, outcome: Outcome) -> None:
    """Move a finished item into place, its record last."""
    try:
        made = sorted(path for path in task.hidden.rglob("*") if path.is_file())
        files = {path.relative_to(task.hidden).as_posix(): record.file_digest(path) for path in made}
        known = {"scene": task.item.name, "run": task.run, "inputs": task.inputs, "files": files}
        record.write_record(task.hidden, {**known, "facts": outcome.facts})
        before = record.read_record(task.target)
        if before is not None:
            _remove(task.target, before)
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


def failed_row(task: Task, error: str) -> dict[str, Any]:
    """The row of an item that gave nothing."""
    return {
        "scene": task.item.name, "status": "failed", "error": error, "seconds": {}, "peak_memory": None,
        "source": task.source,
    }  # fmt: skip


def run_one(task: Task, work: Work, config: Any, limit: int) -> dict[str, Any]:
    """One item from its files to its folder; whatever goes wrong is the row's reason."""
    resources.reset_peak()
    row: dict[str, Any]
    try:
        task.item.check()
        task.hidden.mkdir(parents=True)
        outcome = work.compute(config, task.item, task.hidden, limit)
        _install(task, outcome)
        seconds = {name: round(value, 6) for name, value in outcome.seconds.items()}
        row = {"scene": task.item.name, "status": "done", "error": "", **outcome.facts, "seconds": seconds}
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
        shutil.rmtree(task.hidden, ignore_errors=True)
    if row["status"] == "failed":
        # What an earlier run left for other inputs must not pass for this item's result.
        known = record.read_record(task.target)
        if known is not None:
            with contextlib.suppress(OSError):
                _remove(task.target, known)
    return row


def _compute(
    tasks: list[Task], work: Work, config: Any, options: Options, reporter: Reporter
) -> Iterator[dict[str, Any]]:
    from depthcli.batch import workers

    if not tasks:
        return
    jobs = min(options.jobs, len(tasks))
    if jobs > 1:
        yield from workers.compute(tasks, work, config, options, reporter, jobs)
        return
    workers.use_threads(options.threads_each())
    compiled: Callable[[int, float], None] = workers.say_compiled(reporter)
    with workers.compile_watch(lambda: workers.say_compiling(reporter)) as watch:
        for task in tasks:
            kernels, seconds = watch.kernels, watch.seconds
            yield run_one(task, work, config, options.memory_each())
            compiled(watch.kernels - kernels, watch.seconds - seconds)

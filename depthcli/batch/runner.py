"""The scene loop of every command: resume, isolate failures, show progress, spread over processes.

A scene is computed into a hidden folder beside the others and then moved into place with its record
written last, so that a run can be killed at any moment and started again: what has a record that
matches the config and the inputs is kept, anything else is made anew.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import shutil
import signal
import threading
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Protocol

from pydantic import BaseModel

from depthcli.batch import record, resources
from depthcli.batch.reporter import Reporter
from depthcli.core import memory
from depthcli.core.errors import ConfigError, DepthcliError, OutputError
from depthcli.io.atomic import write_text

_HIDDEN = ".partial-"
_HEAD_START = 1.0  # seconds the first worker may show that kernels have to be compiled


class Scene(Protocol):
    """What the loop needs to know of a scene."""

    @property
    def name(self) -> str: ...
    @property
    def input_files(self) -> tuple[Path, ...]: ...


@dataclass
class Outcome:
    """What one scene gave, beside its files.

    Attributes
    ----------
    facts : columns of the report that are the same in every run (size, density, figures)
    seconds : time by stage, in order
    """

    facts: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)


class Work(Protocol):
    """What a command does with one scene; picklable, for worker processes."""

    def __call__(self, scene: Any, folder: Path, memory: int, /) -> Outcome:
        """Compute ``scene`` with at most ``memory`` bytes and write its files into the empty ``folder``."""

    def settings(self, scene: Any, /) -> dict[str, str]:
        """What the result depends on beside the config and the content of the input files."""


@dataclass(frozen=True)
class Options:
    """How a run is done; never what it computes.

    Attributes
    ----------
    jobs : worker processes; 1 computes in this process
    threads : threads of each; None shares the cores out
    max_memory : bytes all of them together may use; None = what is available
    overwrite : replace a run made with another config, and compute every scene anew
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
class _Task:
    scene: Any
    target: Path
    hidden: Path
    run: str
    inputs: dict[str, str]


def run_scenes(
    command: str,
    config: BaseModel,
    scenes: Sequence[Scene],
    work: Work,
    output: Path,
    options: Options,
    reporter: Reporter,
) -> list[dict[str, Any]]:
    """Run ``work`` on every scene that is not done yet; write the run folder.

    Parameters
    ----------
    command, config : what is run; together with the versions they are the identity of the run folder
    scenes : what to run on, names unique
    work : what to do with each
    output : the run folder

    Returns
    -------
    One row a scene of this call, in order: ``scene``, ``status`` (done or failed), ``error``, facts,
    ``seconds`` by stage, ``peak_memory`` in bytes.

    Raises
    ------
    ConfigError
        The folder holds another run, is in use, or lies where the inputs are.
    OutputError
        The folder cannot be written.
    """
    for scene in scenes:
        target = (output / scene.name).resolve()
        if any(target == file.resolve().parent for file in scene.input_files):
            raise ConfigError(f"{output}: {scene.name} would be written over its own input; choose another --output")
    text = record.run_text(command, config)
    with _locked(output):
        run = record.open_run(output, text, options.overwrite)
        _clean(output, run if options.overwrite else None)
        earlier = record.read_report(output)
        rows: dict[str, dict[str, Any]] = {}
        tasks = []
        for number, scene in enumerate(scenes):
            target = output / scene.name
            inputs = {**record.file_digests(scene.input_files), **work.settings(scene)}
            known = record.read_record(target)
            if not options.overwrite and known is not None and record.is_done(target, run, inputs, known):
                rows[scene.name] = _row(known, earlier.get(scene.name, {}))
            else:
                tasks.append(_Task(scene, target, output / f"{_HIDDEN}{os.getpid()}" / str(number), run, inputs))
        if rows:
            reporter.info(f"{len(rows)} of {len(scenes)} scenes are done already")
        others = _other_rows(output, run, earlier, {scene.name for scene in scenes})
        writer = _ReportWriter(output, command, others, rows, [scene.name for scene in scenes])
        failed_writing: BaseException | None = None
        try:
            with reporter:
                reporter.start(len(scenes), len(rows), command)
                for row in _compute(tasks, work, options, reporter):
                    rows[row["scene"]] = row
                    if row["status"] == "failed":
                        reporter.error(f"{row['scene']}: {row['error']}")
                    else:
                        reporter.detail(f"{row['scene']}: {sum(row['seconds'].values()):.2f} s")
                    writer.update()
                    reporter.step()
        except BaseException as error:
            failed_writing = error
            raise
        finally:
            with contextlib.suppress(OutputError) if failed_writing else contextlib.nullcontext():
                writer.update(final=True)
            _clean(output, None)
    return [rows[scene.name] for scene in scenes]


class _ReportWriter:
    """Keeps the report on disk current without writing it after each of a thousand scenes."""

    def __init__(
        self,
        output: Path,
        command: str,
        others: list[dict[str, Any]],
        rows: dict[str, dict[str, Any]],
        order: list[str],
    ) -> None:
        self.output, self.command, self.others, self.rows, self.order = output, command, others, rows, order
        self.written = 0.0

    def update(self, final: bool = False) -> None:
        if final or time.monotonic() - self.written > 1:
            rows = [self.rows[name] for name in self.order if name in self.rows]
            record.write_report(self.output, self.command, sorted(self.others + rows, key=lambda r: str(r["scene"])))
            self.written = time.monotonic()


def _row(known: dict[str, Any], measured: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "scene": known.get("scene"),
        "status": "done",
        "error": "",
        **(known.get("facts") or {}),
        "seconds": measured.get("seconds") or {},
        "peak_memory": measured.get("peak_memory"),
    }


def _other_rows(output: Path, run: str, earlier: dict[str, dict[str, Any]], chosen: set[str]) -> list[dict[str, Any]]:
    """Rows of scenes that this call does not concern but that belong to the same run."""
    rows = []
    for name, row in earlier.items():
        known = record.read_record(output / name) if name not in chosen else None
        if known is not None and known.get("run") == run:
            rows.append(_row(known, row))
    return rows


@contextlib.contextmanager
def _locked(output: Path) -> Iterator[None]:
    """Keep a second run out of the folder; the system drops the lock when this process ends, however it ends."""
    try:
        output.mkdir(parents=True, exist_ok=True)
        handle = os.open(output, os.O_RDONLY)
    except OSError as error:
        raise OutputError(f"{output}: cannot be used as a run folder ({error.strerror})") from error
    try:
        try:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(f"{output}: another depthcli is writing there now") from None
        except (ImportError, OSError):
            pass  # no such locks on this system or file system
        yield
    finally:
        os.close(handle)


def _clean(output: Path, keep_only: str | None) -> None:
    """Remove what killed runs left, and with ``keep_only`` the scenes of any other run."""
    for leftover in output.glob(f"{_HIDDEN}*"):
        shutil.rmtree(leftover, ignore_errors=True)
    for leftover in output.glob(".*.partial~"):
        leftover.unlink(missing_ok=True)
    if keep_only is not None:
        for file in sorted(output.rglob(record.RECORD_FILE)):
            known = record.read_record(file.parent)
            if known is not None and known.get("run") != keep_only:
                _remove(file.parent, known)


def _remove(target: Path, known: dict[str, Any]) -> None:
    """Delete the files that a record lists, the record first; what else lies there is not ours."""
    (target / record.RECORD_FILE).unlink(missing_ok=True)
    for name in known["files"]:
        if Path(name).name == name:
            (target / name).unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        target.rmdir()


def _install(task: _Task, outcome: Outcome) -> None:
    """Move a finished scene into place, its record last."""
    files = {path.name: path.stat().st_size for path in sorted(task.hidden.iterdir())}
    known = {"scene": task.scene.name, "run": task.run, "inputs": task.inputs, "files": files, "facts": outcome.facts}
    write_text(task.hidden / record.RECORD_FILE, record.to_json(known))
    try:
        before = record.read_record(task.target)
        if before is not None:
            _remove(task.target, before)
        task.target.parent.mkdir(parents=True, exist_ok=True)
        try:
            task.hidden.rename(task.target)
        except OSError:  # the folder is there and holds something that is not ours
            task.target.mkdir(exist_ok=True)
            for name in (*files, record.RECORD_FILE):
                os.replace(task.hidden / name, task.target / name)
    except OSError as error:
        raise OutputError(f"{task.target}: cannot be written ({error.strerror or error})") from error


def _run_one(task: _Task, work: Work, limit: int, verbose: bool) -> dict[str, Any]:
    """One scene from its files to its folder; whatever goes wrong is the row's reason."""
    row: dict[str, Any] = {"scene": task.scene.name, "status": "failed", "error": ""}
    measured: dict[str, Any] = {"seconds": {}, "peak_memory": None}
    resources.reset_peak()
    facts: dict[str, Any] = {}
    try:
        task.hidden.mkdir(parents=True)
        outcome = work(task.scene, task.hidden, limit)
        _install(task, outcome)
        measured["seconds"] = {name: round(value, 6) for name, value in outcome.seconds.items()}
        row["status"], facts = "done", outcome.facts
    except MemoryError:
        row["error"] = "out of memory; see --max-memory"
    except DepthcliError as error:
        row["error"] = str(error)
    except Exception as error:
        row["error"] = f"a bug in depthcli: {type(error).__name__}: {error}".splitlines()[0][:300]
        if verbose:
            traceback.print_exc()
    finally:
        memory.release()
        shutil.rmtree(task.hidden, ignore_errors=True)
    if row["status"] == "failed":
        # What an earlier run left for other inputs must not pass for this scene's result.
        known = record.read_record(task.target)
        if known is not None:
            _remove(task.target, known)
    measured["peak_memory"] = resources.peak_memory()
    return {**row, **facts, **measured}


def _compute(tasks: list[_Task], work: Work, options: Options, reporter: Reporter) -> Iterator[dict[str, Any]]:
    if not tasks:
        return
    jobs = min(options.jobs, len(tasks))
    if jobs > 1:
        yield from _compute_in_workers(tasks, work, options, reporter, jobs)
        return
    from depthcli.kernels.jit import CompileWatch

    _use_threads(options.threads_each())
    with CompileWatch(lambda: _say_compiling(reporter)) as watch:
        for task in tasks:
            kernels, seconds = watch.kernels, watch.seconds
            yield _run_one(task, work, options.memory_each(), reporter.level > 0)
            if watch.kernels > kernels:
                _say_compiled(reporter, watch.kernels - kernels, watch.seconds - seconds)


def _say_compiling(reporter: Reporter) -> None:
    reporter.info("first use of these settings here: compiling kernels for this machine (once; they are kept) ...")


def _say_compiled(reporter: Reporter, kernels: int, seconds: float) -> None:
    from depthcli.kernels.jit import cache_folder

    kept = f", kept in {cache_folder()}" if cache_folder() else ""
    reporter.info(f"compiled {kernels} kernels in {seconds:.1f} s{kept}")


def _use_threads(count: int) -> None:
    import cv2

    from depthcli.kernels.jit import set_threads

    set_threads(count)
    cv2.setNumThreads(count)


class _Worker:
    """A process that computes scenes one at a time; it may die without taking the run along."""

    def __init__(self, work: Work, options: Options, verbose: bool) -> None:
        context = multiprocessing.get_context("spawn")  # threads of OpenMP do not survive a fork
        self.connection, theirs = context.Pipe()
        arguments = (theirs, work, options.threads_each(), options.memory_each(), verbose)
        self.process = context.Process(target=_worker_main, args=arguments, daemon=True)
        before = os.environ.get("NUMBA_NUM_THREADS")
        os.environ["NUMBA_NUM_THREADS"] = str(options.threads_each())
        try:
            self.process.start()
        finally:
            if before is None:
                del os.environ["NUMBA_NUM_THREADS"]
            else:
                os.environ["NUMBA_NUM_THREADS"] = before
        theirs.close()
        self.task: _Task | None = None
        self.ready = False

    def give(self, task: _Task) -> None:
        self.task = task
        with contextlib.suppress(OSError):  # it has died: the loop will see that
            self.connection.send(task)

    def stop(self) -> None:
        self.connection.close()
        self.process.terminate()
        self.process.join()


def _worker_main(connection: Connection, work: Work, threads: int, limit: int, verbose: bool) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides
    parent = multiprocessing.parent_process()
    if parent is not None:
        # A parent that was killed must not leave workers that go on writing.
        threading.Thread(target=_die_after, args=(parent,), daemon=True).start()
    from depthcli.kernels.jit import CompileWatch

    _use_threads(threads)
    connection.send(("ready", None))
    with contextlib.suppress(EOFError, OSError), CompileWatch(lambda: connection.send(("compiling", None))) as watch:
        while True:
            task = connection.recv()
            kernels, seconds = watch.kernels, watch.seconds
            row = _run_one(task, work, limit, verbose)
            connection.send(("row", (row, watch.kernels - kernels, watch.seconds - seconds)))


def _die_after(parent: Any) -> None:
    parent.join()
    os._exit(1)


def _compute_in_workers(
    tasks: list[_Task], work: Work, options: Options, reporter: Reporter, jobs: int
) -> Iterator[dict[str, Any]]:
    """Hand out scenes to worker processes.

    The first scene has a head start: where it shows that kernels must be compiled, the other workers
    wait for it, so that they find them compiled instead of doing the same work at the same time.
    """
    queue = list(reversed(tasks))
    verbose = reporter.level > 0
    workers = [_Worker(work, options, verbose) for _ in range(jobs)]
    first, since, compiling, open_for_all = workers[0], float("inf"), False, False
    try:
        while queue or any(w.task for w in workers):
            for worker in workers:
                if queue and worker.task is None and worker.ready and (worker is first or open_for_all):
                    worker.give(queue.pop())
                    if worker is first:
                        since = min(since, time.monotonic())
            waiting = not open_for_all and not compiling and since < float("inf")
            timeout = max(0.0, since + _HEAD_START - time.monotonic()) if waiting else None
            events = wait([w.connection for w in workers] + [w.process.sentinel for w in workers], timeout)
            if waiting and time.monotonic() >= since + _HEAD_START:
                open_for_all = True
            for worker in list(workers):
                if worker.connection not in events and worker.process.sentinel not in events:
                    continue
                kind: str
                value: Any
                try:
                    kind, value = worker.connection.recv() if worker.connection.poll() else ("dead", None)
                except (EOFError, OSError):
                    kind, value = "dead", None
                if kind == "ready":
                    worker.ready = True
                elif kind == "compiling":
                    if not compiling:
                        _say_compiling(reporter)
                    compiling = True
                elif kind == "row":
                    row, kernels, seconds = value
                    worker.task = None
                    open_for_all = True
                    if kernels:
                        _say_compiled(reporter, kernels, seconds)
                    yield row
                else:
                    worker.process.join()
                    task, code = worker.task, worker.process.exitcode
                    worker.stop()
                    replacement = _Worker(work, options, verbose)
                    workers[workers.index(worker)] = replacement
                    if worker is first:
                        first = replacement
                    if task is None and not worker.ready:
                        raise DepthcliError(f"worker processes cannot be started (exit code {code})")
                    if task is not None:
                        open_for_all = True
                        shutil.rmtree(task.hidden, ignore_errors=True)
                        why = "killed, probably out of memory; see --max-memory" if code == -9 else f"exit code {code}"
                        yield {
                            "scene": task.scene.name,
                            "status": "failed",
                            "error": f"the worker process died ({why})",
                            "seconds": {},
                            "peak_memory": None,
                        }
    finally:
        for worker in workers:
            worker.stop()

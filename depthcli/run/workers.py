"""Scenes computed in this process, or in worker processes of this machine (on a cluster: ``cluster``).

:func:`compute_scene` computes a scene in a hidden folder and moves the files into its own folder, the record last.
Whatever fails becomes a row with its reason; a worker process that is killed costs one scene at most. A worker waits
for the disk in a thread of its own, while it computes the next scene.
"""

from __future__ import annotations

import contextlib
import errno
import fnmatch
import math
import multiprocessing
import os
import pickle
import platform
import shutil
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib import metadata
from multiprocessing import connection, resource_tracker
from pathlib import Path
from typing import Any, TypeVar

import cv2
from pydantic import BaseModel

from depthcli import __version__
from depthcli.core import memory
from depthcli.core.config_file import dump_config
from depthcli.core.context import Context, Latest
from depthcli.core.errors import DepthcliError, InputError, OutputError, Terminated, shortage
from depthcli.core.memory import BASE_BYTES
from depthcli.core.plugins import Plugin, load_plugin, loaded, plugin_behind, versions_here
from depthcli.core.text import show_bytes, without_secrets
from depthcli.core.yaml_source import to_yaml
from depthcli.io.formats.files import collected_warnings, file_states, shown
from depthcli.io.scenes import Scene
from depthcli.kernels.jit import CompileWatch, cache_folder, set_threads
from depthcli.run import resources
from depthcli.run.console import Reporter, silence_warnings
from depthcli.run.folder import TITLE
from depthcli.run.job import Execution, Job, Outcome
from depthcli.run.json_csv import Row
from depthcli.run.records import Record, digest, digests_below, file_digest, install, record_failure

_T = TypeVar("_T")

BUG = "a bug in depthcli: "
"""Prefix of the error of a scene that failed by a fault of the program."""
GOES_ON = "the same command goes on where it stopped"

# Packages whose versions change results; part of the run's identity.
_LIBRARIES = ("numpy", "numba", "opencv-contrib-python-headless", "scikit-image", "PyMaxflow")
_MAX_TRACE_NAME = 200  # bytes of a scene's name in the name of its traceback; a file's name has 255
_KEPT_SHARE = 16  # of the memory that a process may use, for arrays of its next scene: fresh pages take long
_START_SECONDS = 1.5  # until processes work that load all modules: two take 1.2 s on two cores
_MIN_SCENES = 8  # that a process for each core computes sooner than threads do, if they start as copies of this one
_MAX_NAMED = 20  # files in a message
_PROCESS_BYTES = 2 * BASE_BYTES  # of a process beside its scene: its own, and arrays that it keeps for the next one
_MAX_TRIES = 3  # of a scene whose worker dies: another program may have used up the memory


@dataclass(frozen=True)
class Work:
    """What workers get: the job, how it is carried out, and the plug-ins that take part."""

    job: Job[Any]
    how: Execution
    plugins: frozenset[Plugin]

    @property
    def text(self) -> str:
        """The text of ``run.yaml``: the resolved config, which can be used as CONFIG again, and all versions here."""
        versions = {"depthcli": __version__, "python": platform.python_version()}
        for name in _LIBRARIES:
            with contextlib.suppress(metadata.PackageNotFoundError):
                versions[name] = metadata.version(name)
        command, config = self.job.command, self.job.config
        run = to_yaml({"run": {"command": command, "versions": versions | versions_here(self.plugins)}})
        if isinstance(config, BaseModel):
            return f"{TITLE} Repeat it with: depthcli {command} run.yaml ...\n{dump_config(config)}{run}"
        return f"{TITLE}\n{to_yaml(dict(config))}{run}"

    @property
    def identity(self) -> str:
        """The identity of the run: the digest of its ``run.yaml``."""
        return digest(self.text.encode())


@dataclass(frozen=True)
class Task:
    """One scene to compute in the folder ``hidden``; ``inputs`` are role -> digest of inputs of the result."""

    scene: Scene
    output: Path
    hidden: Path
    run: str
    inputs: dict[str, str]
    source: str
    watched: dict[Path, tuple[str, object]]  # file -> its digest among ``inputs``, and its state before

    @property
    def target(self) -> Path:
        """The scene's folder in the run folder."""
        return self.output / self.scene.name

    @property
    def trace(self) -> Path:
        """The file with the traceback of a bug."""
        name = self.scene.name.replace("/", "_")
        if len(os.fsencode(name)) > _MAX_TRACE_NAME:
            name = f"{name[:40]}-{digest(os.fsencode(name))[:16]}"
        return self.output / f"traceback-{name}.txt"

    def done(self, outcome: Outcome, used: Mapping[str, float], warnings: Sequence[str]) -> Row:
        """Return the row of the report for a scene that was computed, by programs that ``used`` time and memory."""
        row: Row = {"scene": self.scene.name, "status": "done", "error": "", **outcome.facts}
        row["seconds"] = {name: round(value, 6) for name, value in outcome.seconds.items()}
        row |= {"peak_memory": resources.peak_memory(), **used, "source": self.source}
        return row | {"warnings": list(dict.fromkeys([*outcome.warnings, *warnings]))}

    def failed(self, error: str) -> Row:
        """Return the row of the report for a scene that failed."""
        error = without_secrets(error)
        row: Row = {"scene": self.scene.name, "status": "failed", "error": error, "seconds": {}, "peak_memory": None}
        return row | {"source": self.source, "warnings": []}

    def is_done(self, known: Record) -> bool:
        """Return True where a record of the scene is of this run and of these inputs, and its files are unchanged."""
        return known.is_done(self.target, self.run, self.inputs)

    def record(self, row: Row, files: dict[str, str]) -> Record:
        """Return the record of the scene with this row."""
        return Record(self.scene.name, self.run, self.inputs, files, row)

    def died(self, reason: str, work: Work) -> Row:
        """Return the row of the scene, recorded as failed, whose worker was killed each time."""
        row = self.failed(reason)
        record_failure(self.target, self.record(row, {}), work.how.overwrite)
        return row


def compute_scene(task: Task, work: Work, limit: int, latest: Latest | None = None) -> Row:
    """Compute a scene with at most ``limit`` bytes, write its record and return its row.

    ``latest`` holds results that the scenes of this process share.

    Where a disk was full, the row has the key ``disk_full`` with the place, the reason and the bytes that are free, and
    nothing is recorded.
    """
    return computed_scene(task, work, limit, latest)()


def computed_scene(task: Task, work: Work, limit: int, latest: Latest | None = None) -> Callable[[], Row]:
    """Compute a scene into its hidden folder; return the function that finishes as :func:`compute_scene` does.

    That waits for the disk, which it may do in another thread while the next scene is computed.
    """
    resources.reset_peak()
    opened, done = None, False
    with collected_warnings() as lines:
        try:
            task.scene.check()
            lines += task.scene.warnings
            task.hidden.mkdir(parents=True)
            opened = os.open(task.hidden, os.O_RDONLY)  # while it is open, no other folder gets its inode number
            context = Context(limit, task.scene.name, limit, latest or Latest())
            outcome = work.job.compute(task.scene, task.hidden, context)
            row, done = task.done(outcome, context.used, lines), True
        except (KeyboardInterrupt, Terminated):
            _leave(task, opened)
            raise
        except BaseException as error:  # a plug-in may exit, or panic as those in Rust: that ends its scene alone
            row = _failed_row(task, error) | {"warnings": lines}
    return partial(_finished, task, work, limit, row, done, opened)


def _finished(task: Task, work: Work, limit: int, row: Row, done: bool, opened: int | None) -> Row:
    try:
        try:
            if done and opened is not None:
                _install(task, work, row, opened)
        except (KeyboardInterrupt, Terminated):
            raise
        except BaseException as error:
            row, done = _failed_row(task, error) | {"warnings": row["warnings"]}, False
        # Another process may have taken the scene over where this run was ended while it was computed.
        if not done and "disk_full" not in row and (opened is None or _is_open(task.hidden, opened)):
            record_failure(task.target, task.record(row, {}), work.how.overwrite)
    finally:
        memory.release(limit // _KEPT_SHARE)
        _leave(task, opened)
    if place := row.get("disk_full"):
        row["disk_full"] = row["error"]
        with contextlib.suppress(OSError):  # the files of this scene have been deleted by now
            row["disk_full"] += f" ({show_bytes(shutil.disk_usage(place).free)} free on that disk)"
    return row


def _install(task: Task, work: Work, row: Row, opened: int) -> None:
    if changed := [file for file, known in task.watched.items() if _has_changed(file, *known)]:
        raise InputError(f"{shown(changed[0])}: changed since the run began; the same command reads it again")
    try:
        _keep_only(work.how.keep, task.hidden)
        files = digests_below(task.hidden)
        if not _is_open(task.hidden, opened):
            raise OutputError(f"{task.hidden}: was removed while it was written: the run has ended")
        install(task.hidden, task.target, task.record(row, files), work.how.overwrite)
    except OSError as error:
        raise OutputError(f"{task.target}: cannot be written ({error.strerror or error})") from error
    task.trace.unlink(missing_ok=True)


def _leave(task: Task, opened: int | None) -> None:
    if opened is not None:
        os.close(opened)
    shutil.rmtree(task.hidden, ignore_errors=True)


def _has_changed(file: Path, content: str, state: object) -> bool:
    return file_states(file) != state and file_digest(file) != content


def _keep_only(patterns: Sequence[str], folder: Path) -> None:
    """Delete the files whose name or path matches none of the patterns; without patterns all stay.

    InputError if none would stay.
    """
    paths = [path for path in folder.rglob("*") if path.is_file()] if patterns else []
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
    """Return the row of a scene whose computation raised ``error``, which is being handled."""
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
    try:
        return os.path.samestat(os.stat(folder), os.fstat(opened))
    except OSError:
        return False


def _n_threads() -> int:
    with contextlib.suppress(OSError):
        return len(os.listdir("/proc/self/task"))
    return 1


_N_AT_IMPORT = _n_threads()  # those of OpenBLAS, which it ends before a fork
_has_threads = threading.Event()  # of kernels, even if it is a single one


def _may_fork() -> bool:
    """Return whether processes can be copies of this one: on Linux, before it has threads, which no copy would have."""
    return sys.platform == "linux" and not _has_threads.is_set() and _n_threads() <= _N_AT_IMPORT


def use_threads(count: int) -> None:
    """Set the number of threads of the kernels and of OpenCV in this process."""
    _has_threads.set()
    set_threads(count)
    cv2.setNumThreads(count)


def counted(compute: Callable[[], _T], watch: CompileWatch) -> tuple[_T, int, float]:
    """Compute a scene; return its row, the number of kernels that were compiled for it, and their seconds."""
    kernels, seconds = watch.calls, watch.seconds
    row = compute()
    return row, watch.calls - kernels, watch.seconds - seconds


def _announce_compilation(reporter: Reporter, watch: CompileWatch | None = None) -> None:
    reporter.once("first use of these settings here: compiling kernels for this machine (once; they are kept) ...")
    if watch is not None:
        reporter.progress(f"compiling kernels: {watch.kernels} so far", watch.seconds)


def report_compilation(reporter: Reporter, kernels: int, seconds: float) -> None:
    """Say how many kernels were compiled, if any."""
    if kernels:
        kept = f", kept in {cache_folder()}" if cache_folder() else ""
        reporter.info(f"compiled {kernels} kernels in {seconds:.1f} s{kept}")


def compute_on_this_machine(
    tasks: Iterable[Task], work: Work, reporter: Reporter, scenes: Sequence[Scene]
) -> Generator[Row, None, None]:
    """Yield the rows of the tasks of ``scenes``, computed in this process or in as many as ``--jobs`` says.

    Without a number, many scenes are computed in as many processes as the cores and the memory take, if these can be
    copies of this one. Otherwise they are computed here until their time tells that processes finish the others sooner.
    Each process may take as much memory as this one, so that their number changes no map.
    """
    tasks, how = iter(tasks), work.how
    need = cache(lambda: _largest_need(work.job, scenes))  # which takes a look into every file

    def in_processes(jobs: int, left: int) -> Generator[Row, None, None]:
        reporter.detail(f"{jobs} processes compute {left} scenes")
        divided = replace(how, jobs=jobs, max_memory=how.max_memory if how.jobs else jobs * how.memory_each())
        return compute_in_processes(tasks, replace(work, how=divided), reporter, jobs)

    jobs, n_scenes = min(how.jobs or 1, len(scenes)), len(scenes)
    is_free = how.jobs is None and cache_folder() is not None  # where kernels are not kept, each would compile its own
    if is_free and n_scenes >= _MIN_SCENES and _may_fork():
        jobs = n_processes(how, n_scenes, 1.0, 1.0, need, start=0.0)
    if jobs > 1:
        yield from in_processes(jobs, n_scenes)
        return
    use_threads(how.threads_each())
    last, latest = (math.inf, math.inf), Latest()
    with CompileWatch(partial(_announce_compilation, reporter)) as watch:
        for number, task in enumerate(tasks, 1):
            begun, begun_busy = time.perf_counter(), time.process_time()
            row, kernels, seconds = counted(partial(compute_scene, task, work, how.memory_each(), latest), watch)
            took = time.perf_counter() - begun, time.process_time() - begun_busy
            report_compilation(reporter, kernels, seconds)
            yield row
            # The first scene loads or compiles kernels; any may have waited for the disk.
            if is_free and number > 1:
                jobs = n_processes(how, n_scenes - number, *min(took, last), need)
                if jobs > 1:
                    break
            last = took
        else:
            return
    memory.release()
    yield from in_processes(jobs, n_scenes - number)


def n_processes(
    how: Execution, left: int, took: float, busy: float, need: Callable[[], int | None], start: float = _START_SECONDS
) -> int:
    """Return how many processes compute the ``left`` scenes soonest; 1: this one, as starting others takes longer.

    Parameters
    ----------
    took, busy : seconds of a scene here, and of all cores together, of which several processes save nothing
    need : returns the largest bytes of a scene, None where they are not known
    start : seconds until processes work
    """

    def seconds(jobs: int) -> float:
        return start * (jobs > 1) + math.ceil(left / jobs) * max(took, busy * jobs / resources.cores())

    def soonest(most: int) -> int:
        return min(range(1, most + 1), key=seconds, default=1)

    jobs = soonest(min(left, resources.cores() // (how.threads or 1)))
    if jobs == 1 or (bound := need()) is None:
        return 1
    return soonest(min(jobs, how.memory_each() // (bound + _PROCESS_BYTES)))


def _largest_need(job: Job[Any], scenes: Sequence[Scene]) -> int | None:
    needs: list[int | None] = [0]
    for scene in scenes:
        with contextlib.suppress(InputError):  # it will fail
            needs.append(0 if scene.problem else job.memory_bound(scene))
    return None if None in needs else max(need or 0 for need in needs)


@dataclass(eq=False)
class _Worker:
    """A worker process as its parent sees it: the tasks that it computes and finishes, each with how often it tried."""

    process: multiprocessing.process.BaseProcess
    pipe: connection.Connection
    computing: tuple[Task, int] | None = None
    finishing: tuple[Task, int] | None = None  # the one before, which waits for the disk


def compute_in_processes(
    tasks: Iterable[Task], work: Work, reporter: Reporter, jobs: int
) -> Generator[Row, None, None]:
    """Yield the rows of the tasks, computed by ``jobs`` processes, in the order in which they are finished.

    If kernels have to be compiled for the first scenes, the process that begins with it computes alone until its scene
    is done: the others are ended, instead of compiling the same ones.
    """
    waiting, retried = iter(tasks), list[tuple[Task, int]]()
    workers: list[_Worker] = []
    alone, compiled = False, False
    try:
        with _ctrl_c_later():  # so that those that have started are ended
            for _ in range(jobs):  # side by side
                workers.append(_start(work))
        while True:
            while sum(worker.computing is not None for worker in workers) < (1 if alone else jobs):
                task, tries = retried.pop() if retried else (next(waiting, None), 0)
                if task is None:
                    break
                worker = next((worker for worker in workers if worker.computing is None), None)
                if worker is None:  # one has died
                    with _ctrl_c_later():
                        workers.append(worker := _start(work))
                worker.computing = task, tries + 1
                with contextlib.suppress(OSError):  # it has died meanwhile, which is seen below
                    worker.pipe.send(task)
            busy = {worker.pipe: worker for worker in workers if worker.computing or worker.finishing}
            if not busy:
                return
            for pipe in connection.wait(list(busy)):
                worker = busy[pipe]  # type: ignore[index]
                try:
                    message = worker.pipe.recv()
                except (EOFError, OSError):  # the process is no more
                    worker.process.join()
                    workers.remove(worker)
                    killed = worker.process.exitcode == -signal.SIGKILL
                    code = f"exit code {worker.process.exitcode}"
                    why = "killed, probably out of memory; see --max-memory" if killed else code
                    for task, tries in filter(None, (worker.finishing, worker.computing)):
                        if tries < _MAX_TRIES:
                            retried.append((task, tries))
                        else:
                            yield task.died(f"the worker process died {_MAX_TRIES} times ({why})", work)
                    continue
                if message == "compiling":
                    _announce_compilation(reporter)
                    if not (alone or compiled):
                        alone = True
                        for other in workers:
                            if other is not worker:
                                other.process.kill()
                elif message == "computed":
                    worker.computing, worker.finishing, alone, compiled = None, worker.computing, False, True
                else:
                    row, kernels, seconds = message
                    worker.finishing = None
                    report_compilation(reporter, kernels, seconds)
                    yield row
    finally:
        for worker in workers:
            worker.process.kill()
        for worker in workers:
            worker.process.join()
            worker.pipe.close()


def _start(work: Work) -> _Worker:
    context: Any = multiprocessing.get_context("fork" if _may_fork() else "spawn")
    ours, theirs = context.Pipe()
    # A process that is no copy of this one unpickles its arguments before it runs anything.
    arguments = theirs, tuple(plugin.source for plugin in loaded.values()), pickle.dumps(work)
    process = context.Process(target=_serve, args=arguments, daemon=True)
    if context.get_start_method() == "spawn":
        resource_tracker.ensure_running()  # started with the first process, it would lift the block for that one
    process.start()
    theirs.close()
    return _Worker(process, ours)


@contextlib.contextmanager
def _ctrl_c_later() -> Iterator[None]:
    """Keep Ctrl-C back, which reaches all processes: one that is starting would answer with a traceback.

    The process inherits the block. Here, any thread may get the signal, so the handler is replaced, too.
    """
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "pthread_sigmask"):
        yield
        return
    came: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        signal.signal(signal.SIGINT, handler)
    for number in came:
        signal.raise_signal(number)


def _serve(pipe: connection.Connection, plugins: Iterable[str], pickled: bytes) -> None:
    """Compute the tasks that come through the pipe, of the pickled work, until the parent closes it."""

    def end_with(parent: Any) -> None:  # which may be killed: no worker may continue to write
        parent.join()
        os._exit(1)

    silence_warnings()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what Ctrl-C does
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=end_with, args=(multiprocessing.parent_process(),), daemon=True).start()
    for plugin in plugins:
        load_plugin(plugin)
    work: Work = pickle.loads(pickled)
    use_threads(work.how.threads_each())
    limit, latest, turn = work.how.memory_each(), Latest(), threading.Lock()

    def say(message: object) -> None:
        with turn:
            pipe.send(message)

    def finish(scene: Callable[[], Row], kernels: int, seconds: float) -> None:
        say((scene(), kernels, seconds))

    with (
        contextlib.suppress(EOFError, ConnectionError),
        ThreadPoolExecutor(1, "finish") as disk,
        CompileWatch(lambda _: say("compiling")) as watch,
    ):
        finished: Future[None] | None = None
        while True:
            task = pipe.recv()
            shutil.rmtree(task.hidden, ignore_errors=True)  # left by a worker that died
            computed = counted(partial(computed_scene, task, work, limit, latest), watch)
            if finished is not None:
                finished.result()
            say("computed")
            finished = disk.submit(finish, *computed)

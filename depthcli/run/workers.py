"""Compute scenes in this process or in worker processes of this machine; ``cluster`` uses other machines.

A worker process that is killed costs one scene at most. A worker waits for the disk in a thread of its own, while it
computes the next scene.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, partial
from multiprocessing import connection, resource_tracker
from typing import Any, TypeVar

import cv2

from depthcli.core import memory
from depthcli.core.context import Latest
from depthcli.core.errors import InputError
from depthcli.core.memory import BASE_BYTES
from depthcli.core.plugins import load_plugin, loaded
from depthcli.io.scenes import Scene
from depthcli.kernels.jit import CompileWatch, cache_folder, set_threads
from depthcli.run.console import Reporter, silence_warnings
from depthcli.run.job import Execution, Job, cores
from depthcli.run.scene import Task, Work, compute_scene
from depthcli.show.table import Row

_T = TypeVar("_T")

_START_SECONDS = 1.5  # until processes work that load all modules: two take 1.2 s on two cores
_MIN_SCENES = 8  # that a process for each core computes sooner than threads do, if they start as copies of this one
_PROCESS_BYTES = 2 * BASE_BYTES  # of a process in addition to its scene: its own, and arrays kept for the next scene
_MAX_TRIES = 3  # of a scene whose worker dies: another program may have used up the memory


def _n_threads() -> int:
    with contextlib.suppress(OSError):
        return len(os.listdir("/proc/self/task"))
    return 1


_N_AT_IMPORT = _n_threads()  # threads of OpenBLAS, which ends them before a fork
_has_threads = threading.Event()  # set once kernels have threads, even a single one


def _may_fork() -> bool:
    """Return whether this process can be forked: on Linux, before it has threads, which would be missing in forks."""
    return sys.platform == "linux" and not _has_threads.is_set() and _n_threads() <= _N_AT_IMPORT


def use_threads(count: int) -> None:
    """Set the number of threads of the kernels and of OpenCV in this process."""
    _has_threads.set()
    set_threads(count)
    cv2.setNumThreads(count)


def counted(compute: Callable[[], _T], watch: CompileWatch) -> tuple[_T, int, float]:
    """Compute a scene; return its result, and number and seconds of the kernels compiled for it."""
    kernels, seconds = watch.calls, watch.seconds
    row = compute()
    return row, watch.calls - kernels, watch.seconds - seconds


def _announce_compilation(reporter: Reporter, watch: CompileWatch | None = None) -> None:
    reporter.once("first use of these settings here: compiling kernels for this machine (once; they are kept) ...")
    if watch is not None:
        reporter.progress(f"compiling kernels: {watch.kernels} so far", watch.seconds)


def report_compilation(reporter: Reporter, kernels: int, seconds: float) -> None:
    """Print the number of compiled kernels, if any."""
    if kernels:
        kept = f", kept in {cache_folder()}" if cache_folder() else ""
        reporter.info(f"compiled {kernels} kernels in {seconds:.1f} s{kept}")


def compute_on_this_machine(
    tasks: Iterable[Task], work: Work, reporter: Reporter, scenes: Sequence[Scene]
) -> Generator[Row, None, None]:
    """Yield the rows of the tasks of ``scenes``, computed in this process or in ``--jobs`` processes.

    Without a number, many scenes are computed in as many processes as cores and memory allow, if processes can be
    forked. Otherwise scenes are computed here until their time shows that processes would finish the rest sooner. Each
    process may use as much memory as this one, so that their number does not change maps.
    """
    tasks, how = iter(tasks), work.how
    need = cache(lambda: _largest_need(work.job, scenes))  # cached, since it opens every file

    def in_processes(jobs: int, left: int) -> Generator[Row, None, None]:
        reporter.detail(f"{jobs} processes compute {left} scenes")
        divided = replace(how, jobs=jobs, max_memory=how.max_memory if how.jobs else jobs * how.memory_each())
        return compute_in_processes(tasks, replace(work, how=divided), reporter, jobs)

    jobs, n_scenes = min(how.jobs or 1, len(scenes)), len(scenes)
    is_free = how.jobs is None and cache_folder() is not None  # otherwise each process would compile kernels
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
            finish, kernels, seconds = counted(partial(compute_scene, task, work, how.memory_each(), latest), watch)
            row = finish()
            took = time.perf_counter() - begun, time.process_time() - begun_busy
            report_compilation(reporter, kernels, seconds)
            yield row
            # The first scene loads or compiles kernels. Any scene may have waited for the disk.
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
    """Return the number of processes that finish the ``left`` scenes soonest; 1 means this process.

    Parameters
    ----------
    took, busy : wall time per scene, and CPU time per scene, which parallel processes cannot reduce; seconds
    need : returns the largest memory of a scene in bytes, or None if it is unknown
    start : seconds to start processes
    """

    def seconds(jobs: int) -> float:
        return start * (jobs > 1) + math.ceil(left / jobs) * max(took, busy * jobs / cores())

    def soonest(most: int) -> int:
        return min(range(1, most + 1), key=seconds, default=1)

    jobs = soonest(min(left, cores() // (how.threads or 1)))
    if jobs == 1 or (bound := need()) is None:
        return 1
    return soonest(min(jobs, how.memory_each() // (bound + _PROCESS_BYTES)))


def _largest_need(job: Job[Any], scenes: Sequence[Scene]) -> int | None:
    """Return the largest memory of a scene in bytes, or None if that of any is unknown."""
    needs: list[int | None] = [0]
    for scene in scenes:
        with contextlib.suppress(InputError):  # the scene will fail
            needs.append(0 if scene.problem else job.memory_bound(scene))
    return None if None in needs else max(need or 0 for need in needs)


@dataclass(eq=False)
class _Worker:
    """A worker process in its parent, with the tasks that it computes and finishes and their numbers of tries."""

    process: multiprocessing.process.BaseProcess
    pipe: connection.Connection
    computing: tuple[Task, int] | None = None
    finishing: tuple[Task, int] | None = None  # the previous task, which waits for the disk
    ended: bool = False  # by us, so that its tasks lose no try


def compute_in_processes(
    tasks: Iterable[Task], work: Work, reporter: Reporter, jobs: int
) -> Generator[Row, None, None]:
    """Yield the rows of the tasks as ``jobs`` processes finish them.

    If the first scenes need new kernels, the process that compiles first computes alone until its scene is computed;
    the others are ended, so that they do not compile the same kernels.
    """
    pool = _Pool(iter(tasks), work, reporter, jobs)
    try:
        with _ctrl_c_later():  # so that all started processes are ended
            for _ in range(jobs):  # they start in parallel
                pool.workers.append(_start(work))
        while True:
            pool.hand_out()
            busy = {worker.pipe: worker for worker in pool.workers if worker.computing or worker.finishing}
            if not busy:
                return
            for pipe in connection.wait(list(busy)):
                yield from pool.received(busy[pipe])  # type: ignore[index]
    finally:
        for worker in pool.workers:
            worker.process.kill()
        for worker in pool.workers:
            worker.process.join()
            worker.pipe.close()


@dataclass(eq=False)
class _Pool:
    """The worker processes, and the tasks that they have not got yet."""

    waiting: Iterator[Task]
    work: Work
    reporter: Reporter
    jobs: int
    workers: list[_Worker] = field(default_factory=list)
    retried: list[tuple[Task, int]] = field(default_factory=list)  # of workers that died, with the number of tries
    alone: bool = False  # one process compiles kernels, and the others are ended
    compiled: bool = False  # the kernels are there

    def hand_out(self) -> None:
        """Give every idle process a task, as long as there are any; replace processes that have died."""
        while sum(worker.computing is not None for worker in self.workers) < (1 if self.alone else self.jobs):
            task, tries = self.retried.pop() if self.retried else (next(self.waiting, None), 0)
            if task is None:
                return
            worker = next((worker for worker in self.workers if worker.computing is None), None)
            if worker is None:  # one has died
                with _ctrl_c_later():
                    self.workers.append(worker := _start(self.work))
            worker.computing = task, tries + 1
            with contextlib.suppress(OSError):  # it has died meanwhile, which ``received`` reports
                worker.pipe.send(task)

    def received(self, worker: _Worker) -> Iterator[Row]:
        """Take a message of a process, or its end; yield the row of a finished scene."""
        try:
            message = worker.pipe.recv()
        except (EOFError, OSError):  # the process has ended
            yield from self._lost(worker)
            return
        if message == "compiling":
            _announce_compilation(self.reporter)
            if not (self.alone or self.compiled):
                self.alone = True
                for other in self.workers:
                    if other is not worker:
                        other.process.kill()
                        other.ended = True
        elif message == "computed":
            worker.computing, worker.finishing = None, worker.computing
            self.alone, self.compiled = False, True
        else:
            row, kernels, seconds = message
            worker.finishing = None
            report_compilation(self.reporter, kernels, seconds)
            yield row

    def _lost(self, worker: _Worker) -> Iterator[Row]:
        """Have the tasks of a process that has ended computed again; yield failed rows after too many tries."""
        worker.process.join()
        self.workers.remove(worker)
        killed = worker.process.exitcode == -9  # SIGKILL, which Windows has not
        code = f"exit code {worker.process.exitcode}"
        why = "killed, probably out of memory; see --max-memory" if killed else code
        for task, tries in filter(None, (worker.finishing, worker.computing)):
            if (lost := tries - worker.ended) < _MAX_TRIES:
                self.retried.append((task, lost))
            else:
                yield task.died(f"the worker process died {_MAX_TRIES} times ({why})", self.work)


def _start(work: Work) -> _Worker:
    """Start a worker process, as a copy of this one if that is possible."""
    context: Any = multiprocessing.get_context("fork" if _may_fork() else "spawn")
    ours, theirs = context.Pipe()
    # A spawned process unpickles its arguments before it loads plug-ins, so that the work is pickled separately.
    arguments = theirs, tuple(plugin.source for plugin in loaded.values()), pickle.dumps(work)
    process = context.Process(target=_serve, args=arguments, daemon=True)
    if context.get_start_method() == "spawn":
        resource_tracker.ensure_running()  # starting it with the first process would unblock Ctrl-C there
    process.start()
    theirs.close()
    return _Worker(process, ours)


@contextlib.contextmanager
def _ctrl_c_later() -> Iterator[None]:
    """Delay Ctrl-C, which reaches all processes: a starting process would print a traceback.

    New processes inherit the block. The handler is replaced, too, since any thread of this process may get the signal.
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
    """Compute the tasks from the pipe, for the pickled work, until the parent closes the pipe."""

    def end_with(parent: Any) -> None:  # if the parent is killed, workers must not continue to write
        parent.join()
        os._exit(1)

    silence_warnings()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=end_with, args=(multiprocessing.parent_process(),), daemon=True).start()
    for plugin in plugins:
        load_plugin(plugin)
    work: Work = pickle.loads(pickled)
    use_threads(work.how.threads_each())
    limit, latest, turn = work.how.memory_each(), Latest(), threading.Lock()

    def send(message: object) -> None:
        with turn:
            pipe.send(message)

    def finish(scene: Callable[[], Row], kernels: int, seconds: float) -> None:
        send((scene(), kernels, seconds))

    with (
        contextlib.suppress(EOFError, ConnectionError),
        ThreadPoolExecutor(1, "finish") as disk,
        CompileWatch(lambda _: send("compiling")) as watch,
    ):
        finished: Future[None] | None = None
        while True:
            task = pipe.recv()
            shutil.rmtree(task.hidden, ignore_errors=True)  # a worker that died may have left it
            computed = counted(partial(compute_scene, task, work, limit, latest), watch)
            if finished is not None:
                finished.result()
            send("computed")
            finished = disk.submit(finish, *computed)

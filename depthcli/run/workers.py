"""Scenes computed in this process, or in worker processes of this machine (on a cluster: ``cluster``).

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
from dataclasses import dataclass, replace
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
from depthcli.run import resources
from depthcli.run.console import Reporter, silence_warnings
from depthcli.run.job import Execution, Job
from depthcli.run.scene import Task, Work, compute_scene, computed_scene
from depthcli.show.table import Row

_T = TypeVar("_T")

_START_SECONDS = 1.5  # until processes work that load all modules: two take 1.2 s on two cores
_MIN_SCENES = 8  # that a process for each core computes sooner than threads do, if they start as copies of this one
_PROCESS_BYTES = 2 * BASE_BYTES  # of a process beside its scene: its own, and arrays that it keeps for the next one
_MAX_TRIES = 3  # of a scene whose worker dies: another program may have used up the memory


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

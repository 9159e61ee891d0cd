"""Scenes computed by worker processes of this machine, in a pool by pebble that survives the death of a worker."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from multiprocessing import resource_tracker
from typing import Any

import cv2

from depthcli.core.result import Clock
from depthcli.kernels.jit import CompileWatch, cache_folder, compile_seconds, set_threads
from depthcli.run.activities import Announcer, Board
from depthcli.run.console import Reporter, silence_warnings
from depthcli.run.json_csv import Row
from depthcli.run.task import Run, Task, run_task

_HEAD_START = 1.0  # seconds in which the first worker can show that kernels have to be compiled
_MAX_TRIES = 3  # of a scene whose worker dies: another program may have used up the memory


def use_threads(count: int) -> None:
    """Set the number of threads of the kernels and of OpenCV in this process."""
    set_threads(count)
    cv2.setNumThreads(count)


@contextlib.contextmanager
def compile_watch(changed: Callable[[CompileWatch], None]) -> Iterator[CompileWatch]:
    """Count compiled kernels and keep their compilation out of all measured times; each calls ``changed`` twice."""
    Clock.untimed = staticmethod(compile_seconds)
    with CompileWatch(changed) as watch:
        yield watch


def announce_compilation(reporter: Reporter) -> None:
    """Print, once, why a run takes longer than the next one will."""
    reporter.once("first use of these settings here: compiling kernels for this machine (once; they are kept) ...")


def report_compilation(reporter: Reporter, kernels: int, seconds: float) -> None:
    """Print how many kernels were compiled, and how long that took."""
    if kernels:
        kept = f", kept in {cache_folder()}" if cache_folder() else ""
        reporter.info(f"compiled {kernels} kernels in {seconds:.1f} s{kept}")


def shared_board(jobs: int) -> Board:
    """Return a board for :func:`compute` with so many ``jobs``."""
    return Board(multiprocessing.get_context("spawn").RawArray("B", Board.size(jobs + 1)))


def compute(
    tasks: list[Task], run: Run, reporter: Reporter, claim: Callable[[Task], bool], jobs: int, board: Board
) -> Iterator[Row]:
    """Yield the rows of the tasks, computed by ``jobs`` processes, in the order in which they are finished.

    The first scene is computed alone for a moment. If kernels have to be compiled for it, the other processes wait
    for them instead of compiling the same ones.
    """
    import pebble  # with asyncio: 30 ms that a run in one process does without

    context = multiprocessing.get_context("spawn")  # threads of OpenMP do not survive a fork
    waiting, tries = list(reversed(tasks)), dict[str, int]()
    running: dict[Future[tuple[Row, int, float]], tuple[Task, int]] = {}
    alone, since = True, float("inf")
    options = run.options
    with _environment("NUMBA_NUM_THREADS", str(options.threads_each())):
        pool = pebble.ProcessPool(
            max_workers=jobs,
            context=context,
            initializer=_start_worker,
            initargs=(run, options.memory_each(), board.memory),
        )
        try:
            with _interrupts_blocked():
                assert pool.active  # starts the pool, whose threads and later processes inherit the signal mask
            while waiting or running:
                while waiting and len(running) < (1 if alone else jobs + 1):
                    if claim(task := waiting.pop()):
                        slot = board.add(task.scene.name)
                        running[pool.schedule(_run, args=[task, slot])] = task, slot
                if not running:
                    continue
                done, _ = wait(running, timeout=0.02 if alone else None, return_when=FIRST_COMPLETED)
                begun = board.running() if alone else []
                if any(scene.kernels for scene in begun):
                    announce_compilation(reporter)
                elif begun:
                    since = min(since, time.monotonic())
                    alone = time.monotonic() < since + _HEAD_START
                for future in done:
                    (task, slot), alone = running.pop(future), False
                    board.remove(slot)
                    try:
                        row, kernels, seconds = future.result()
                    except pebble.ProcessExpired as error:
                        tries[task.scene.name] = tries.get(task.scene.name, 0) + 1
                        if tries[task.scene.name] < _MAX_TRIES:
                            waiting.append(task)
                            continue
                        row, kernels, seconds = _worker_died(task, error.exitcode), 0, 0.0
                    report_compilation(reporter, kernels, seconds)
                    yield row
        finally:
            pool.stop()
            pool.join()


def _worker_died(task: Task, code: int) -> Row:
    killed = code == -signal.SIGKILL
    why = "killed, probably out of memory; see --max-memory" if killed else f"exit code {code}"
    return task.failed(f"the worker process died {_MAX_TRIES} times ({why})")


@contextlib.contextmanager
def _environment(name: str, value: str) -> Iterator[None]:
    """Set an environment variable, which the worker processes inherit."""
    earlier = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if earlier is None:
            del os.environ[name]
        else:
            os.environ[name] = earlier


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT: Ctrl-C reaches all processes, and one that is starting would answer with a traceback."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # started with the first process, it would lift the block for that one
    earlier = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, earlier)


class _Worker:
    """What a worker process keeps between scenes."""

    run: Run
    memory: int
    announcer: Announcer
    watch: CompileWatch
    open = contextlib.ExitStack()  # never closed: the watch lasts as long as the process


def _start_worker(run: Run, memory: int, board_memory: Any) -> None:
    silence_warnings()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what Ctrl-C does
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:
        # Workers of a parent that was killed must not go on writing.
        threading.Thread(target=_exit_after, args=(parent,), daemon=True).start()
    use_threads(run.options.threads_each())
    _Worker.run, _Worker.memory = run, memory
    _Worker.announcer = Announcer(board_memory, run.options.preset)
    _Worker.watch = _Worker.open.enter_context(compile_watch(_Worker.announcer.compiling))


def _run(task: Task, slot: int) -> tuple[Row, int, float]:
    watch = _Worker.watch
    kernels, seconds = watch.calls, watch.seconds
    with _Worker.announcer.scene(slot):
        shutil.rmtree(task.hidden, ignore_errors=True)  # left by a worker that died
        row = run_task(task, _Worker.run, _Worker.memory)
    return row, watch.calls - kernels, watch.seconds - seconds


def _exit_after(parent: Any) -> None:
    parent.join()
    os._exit(1)

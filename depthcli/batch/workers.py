"""Worker processes (a pool by pebble, which survives the death of a worker), threads, and kernels that they compile."""

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
from typing import Any

import cv2
import pebble

from depthcli.batch.making import AnyWork, RunOptions, Task, failed_row, run_one
from depthcli.batch.reporter import Reporter
from depthcli.core.result import Clock
from depthcli.kernels.jit import CompileWatch, cache_folder, compile_seconds, set_threads

_HEAD_START = 1.0  # seconds the first worker may show that kernels have to be compiled
_TRIES = 3  # an scene whose worker dies is tried again: more often than not something else killed it


def use_threads(count: int) -> None:
    """Threads of the kernels and of OpenCV in this process."""
    set_threads(count)
    cv2.setNumThreads(count)


@contextlib.contextmanager
def compile_watch(started: Callable[[], None]) -> Iterator[CompileWatch]:
    """Watch compilation, and keep it out of every measured time; ``started`` is called at the first kernel."""
    Clock.untimed = staticmethod(compile_seconds)
    with CompileWatch(started) as watch:
        yield watch


def say_compiling(reporter: Reporter) -> None:
    """Why it takes longer this time."""
    reporter.once("first use of these settings here: compiling kernels for this machine (once; they are kept) ...")


def say_compiled(reporter: Reporter) -> Callable[[int, float], None]:
    """What tells how many kernels were compiled, and how long that took."""

    def say(kernels: int, seconds: float) -> None:
        if kernels:
            kept = f", kept in {cache_folder()}" if cache_folder() else ""
            reporter.info(f"compiled {kernels} kernels in {seconds:.1f} s{kept}")

    return say


def compute(
    tasks: list[Task],
    work: AnyWork,
    config: Any,
    options: RunOptions,
    reporter: Reporter,
    jobs: int,
    claim: Callable[[Task], bool],
) -> Iterator[dict[str, Any]]:
    """Rows of the tasks, in the order in which they are finished.

    The first scene has a head start: where it shows that kernels must be compiled, the other workers
    wait for it, so that they find them compiled instead of doing the same work at the same time.
    """
    context = multiprocessing.get_context("spawn")  # threads of OpenMP do not survive a fork
    begun, compiling = context.Event(), context.Event()
    compiled = say_compiled(reporter)
    waiting = list(reversed(tasks))
    tries: dict[str, int] = {}
    running: dict[Future[Any], Task] = {}
    alone, since = True, float("inf")
    before = os.environ.get("NUMBA_NUM_THREADS")
    os.environ["NUMBA_NUM_THREADS"] = str(options.threads_each())
    pool = pebble.ProcessPool(
        max_workers=jobs,
        context=context,
        initializer=_start_worker,
        initargs=(work, config, options.threads_each(), options.memory_each(), begun, compiling),
    )
    try:
        with _interrupts_blocked():
            assert pool.active  # starts the pool: its threads, and all processes they ever make, inherit the mask
        while waiting or running:
            while waiting and len(running) < (1 if alone else jobs + 1):
                task = waiting.pop()
                if not claim(task):
                    continue
                running[pool.schedule(_run, args=[task])] = task
            if not running:
                continue
            done, _ = wait(running, timeout=0.02 if alone else None, return_when=FIRST_COMPLETED)
            if alone and compiling.is_set():
                say_compiling(reporter)
            elif alone and begun.is_set():
                since = min(since, time.monotonic())
                alone = time.monotonic() < since + _HEAD_START
            for future in done:
                task = running.pop(future)
                alone = False
                try:
                    row, kernels, seconds = future.result()
                except pebble.ProcessExpired as error:
                    tries[task.scene.name] = tries.get(task.scene.name, 0) + 1
                    if tries[task.scene.name] < _TRIES:
                        waiting.append(task)
                        continue
                    killed = error.exitcode == -signal.SIGKILL
                    why = (
                        "killed, probably out of memory; see --max-memory" if killed else f"exit code {error.exitcode}"
                    )
                    row, kernels, seconds = failed_row(task, f"the worker process died {_TRIES} times ({why})"), 0, 0.0
                compiled(kernels, seconds)
                yield row
    finally:
        pool.stop()
        pool.join()
        if before is None:
            del os.environ["NUMBA_NUM_THREADS"]
        else:
            os.environ["NUMBA_NUM_THREADS"] = before


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Ctrl-C reaches the whole process group: a worker that is still starting must not answer with a traceback."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Here:
    """What a worker process keeps between scenes."""

    work: AnyWork
    config: Any
    limit: int
    begun: Any
    watch: CompileWatch
    open = contextlib.ExitStack()  # never closed: the watch lasts as long as the process


def _start_worker(work: AnyWork, config: Any, threads: int, limit: int, begun: Any, compiling: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:
        # A parent that was killed must not leave workers that go on writing.
        threading.Thread(target=_die_after, args=(parent,), daemon=True).start()
    use_threads(threads)
    _Here.work, _Here.config, _Here.limit, _Here.begun = work, config, limit, begun
    _Here.watch = _Here.open.enter_context(compile_watch(compiling.set))


def _run(task: Task) -> tuple[dict[str, Any], int, float]:
    _Here.begun.set()
    kernels, seconds = _Here.watch.kernels, _Here.watch.seconds
    shutil.rmtree(task.hidden, ignore_errors=True)  # of a worker that died with it
    row = run_one(task, _Here.work, _Here.config, _Here.limit)
    return row, _Here.watch.kernels - kernels, _Here.watch.seconds - seconds


def _die_after(parent: Any) -> None:
    parent.join()
    os._exit(1)

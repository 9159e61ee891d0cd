"""Compiler options of all kernels. Kernels import numba's names from this module, never from numba itself.

numba reads its settings once, at its import; :mod:`depthcli.kernels.cache` sets them before that.
"""

from __future__ import annotations

import importlib
import os
import sys
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from queue import SimpleQueue
from typing import Any, TypeVar, cast

from depthcli.kernels.cache import KernelCache, cache_folder  # before numba: it sets numba's options

import numba  # isort: skip
import numba.core.event
import numba.extending
from numba import float32, int32, types
from numba.core import cgutils
from numba.core.codegen import JITCPUCodegen
from numba.core.compiler import CompileResult
from numba.extending import models, overload, register_model

__all__ = [
    "CompileWatch", "cache_folder", "cgutils", "compile_seconds", "float32", "int32", "intrinsic", "jit", "models",
    "n_threads", "overload", "register_model", "run_bands", "set_threads", "types",
]  # fmt: skip


def _load_without_scipy() -> None:
    """Load numba's array functions without scipy.linalg, whose import takes longer than numba's.

    numba needs it for matrix products only, so kernels cannot call ``np.dot`` or ``np.linalg``.
    """
    name = "scipy.linalg"
    if name in sys.modules or "numba.np.arraymath" in sys.modules:
        return
    sys.modules[name] = None  # type: ignore[assignment]
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        del sys.modules[name]


_load_without_scipy()
_F = TypeVar("_F", bound=Callable[..., Any])

# Without nnan/ninf: NaN means "no value" in our maps and must survive.
_FASTMATH = {"reassoc", "contract", "arcp", "nsz"}
_OPTIONS: dict[str, Any] = {"no_cfunc_wrapper": True, "nogil": True, "error_model": "numpy", "fastmath": _FASTMATH}


def jit(function: _F) -> _F:
    """Return ``function`` as a kernel, which is compiled and cached for each combination of argument types."""
    kernel: Any = numba.njit(**_OPTIONS)(function)
    kernel._compiler = compiler = _Compiler(kernel._compiler)
    if cache_folder() is not None:
        kernel._cache = KernelCache(function, compiler)
    return cast(_F, kernel)


class _Compiler:
    """Compiles a kernel and loads the result in the same way as from disk.

    A kernel has its own copies of the functions that it calls, optimized with it. numba would link them to the first
    copy in the compiling process, optimized with other code, and sums of floats would differ in their last digits.
    """

    def __init__(self, compiler: Any) -> None:
        self._compiler = compiler
        self.compiled: Any = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._compiler, name)

    def compile(self, arguments: Any, return_type: Any) -> Any:
        """Return the result of ``numba.core.dispatcher._FunctionCompiler.compile``."""
        self.compiled = self._compiler.compile(arguments, return_type)
        target = self.compiled.target_context
        own = target.subtarget(_internal_codegen=JITCPUCodegen("depthcli"))
        loaded = CompileResult._rebuild(own, *self.compiled._reduce())
        target.insert_user_function(loaded.entry_point, loaded.fndesc, [loaded.library])
        return loaded


def intrinsic(function: Callable[..., Any]) -> Any:
    """Return an operation for kernels; ``function`` emits its LLVM code (see numba's manual)."""
    return numba.extending.intrinsic(function)


def n_threads() -> int:
    """Return the number of threads that kernels run on."""
    return _threads.used


def set_threads(count: int) -> None:
    """Let kernels use at most ``count`` threads, limited by ``NUMBA_NUM_THREADS`` (default: the number of cores)."""
    _threads.used = max(1, min(count, _threads.most))


class _Threads:
    """The threads of this process that run bands in addition to the calling thread."""

    def __init__(self) -> None:
        self.most = self.used = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
        self.forget()
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self.forget)

    def forget(self) -> None:
        """Reset: a forked process has none of its parent's threads."""
        self._lock = threading.Lock()
        self._started = 0
        self._tasks: SimpleQueue[Callable[[], None]] = SimpleQueue()

    def offer(self, task: Callable[[], None], times: int) -> None:
        """Let up to ``times`` threads call ``task`` as soon as they are idle."""
        if self._started < times:
            with self._lock:
                for _ in range(self._started, times):
                    threading.Thread(
                        target=self._work, args=(self._tasks,), name="depthcli-kernels", daemon=True
                    ).start()
                self._started = max(self._started, times)
        for _ in range(times):
            self._tasks.put(task)

    @staticmethod
    def _work(tasks: SimpleQueue[Callable[[], None]]) -> None:
        while True:
            tasks.get()()


_threads = _Threads()


def run_bands(kernel: Callable[..., None], count: int, *arguments: Any) -> None:
    """Call ``kernel(begin, end, *arguments)`` on all threads, each for a band of the numbers 0 .. ``count`` - 1.

    The output of a kernel for one number, e.g. a row, must not depend on the band. Any thread may call this function at
    any time: the caller itself runs the bands that no other thread has begun, so it never waits in a queue.
    """
    n_bands = min(_threads.used, count)
    if n_bands <= 1:
        if count > 0:
            kernel(0, count, *arguments)
        return
    bands = list(pairwise([count * k // n_bands for k in range(n_bands + 1)]))
    finished: SimpleQueue[BaseException | None] = SimpleQueue()

    def run_one() -> None:
        try:
            band = bands.pop()
        except IndexError:  # all bands have begun
            return
        try:
            kernel(*band, *arguments)
        except BaseException as error:
            finished.put(error)
        else:
            finished.put(None)

    _threads.offer(run_one, n_bands - 1)
    for _ in range(n_bands):
        run_one()
    errors = [error for error in [finished.get() for _ in range(n_bands)] if error]
    if errors:
        raise errors[0]


class CompileWatch(numba.core.event.Listener):
    """Counts compiled kernels, without kernels read from the cache, and the time of their compilation.

    ``changed`` is called at the beginning and the end of the compilation of a kernel that Python calls.
    """

    def __init__(self, changed: Callable[[CompileWatch], None] = lambda watch: None) -> None:
        self.kernels = 0  # all kernels, including those called by other kernels
        self.calls = 0  # kernels that Python calls
        self.seconds = 0.0  # time of the finished compilations
        self._changed = changed
        self._depth = 0
        self._begin = 0.0

    def on_start(self, event: Any) -> None:
        self.kernels += 1
        self._depth += 1
        if self._depth == 1:  # compiling a kernel includes compiling the kernels that it calls
            self.calls += 1
            self._begin = time.perf_counter()
            self._changed(self)

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._begin
            self._changed(self)

    def __enter__(self) -> CompileWatch:
        numba.core.event.register("numba:compile", self)
        return self

    def __exit__(self, *error: object) -> None:
        numba.core.event.unregister("numba:compile", self)


_all_compiled = CompileWatch().__enter__()


def compile_seconds() -> float:
    """Return the time that this process has spent compiling kernels, seconds."""
    return _all_compiled.seconds

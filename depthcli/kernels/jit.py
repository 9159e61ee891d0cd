"""Compiler options of every kernel. Kernels take what they need of numba from here, none imports it by itself.

numba reads its settings once, when it is imported: :mod:`depthcli.kernels.cache` makes them before.
"""

from __future__ import annotations

import copy
import importlib
import sys
import time
from collections.abc import Callable
from typing import Any, TypeVar, cast

from depthcli.kernels.cache import KernelCache, cache_folder  # before numba: it sets where kernels are kept

import numba  # isort: skip
import numba.core.event
import numba.extending
from numba import float32, int32, prange, types
from numba.core import cgutils
from numba.core.codegen import JITCPUCodegen
from numba.core.compiler import CompileResult
from numba.extending import models, overload, register_model

__all__ = [
    "CompileWatch", "cache_folder", "cgutils", "compile_seconds", "float32", "int32", "intrinsic", "jit", "models",
    "overload", "parallel_jit", "prange", "register_model", "set_threads", "threads", "types",
]  # fmt: skip


def _load_without_scipy() -> None:
    """Load numba's array functions without scipy.linalg, which takes longer to import than numba itself.

    numba wants it for matrix products only; so a kernel cannot call ``np.dot`` or ``np.linalg``.
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
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": _FASTMATH}


def jit(function: _F) -> _F:
    """Compile one serial kernel (callable from other kernels)."""
    return cast(_F, _cached(numba.njit(**_OPTIONS)(function)))


def parallel_jit(function: _F) -> _F:
    """Compile one kernel whose ``prange`` loops run on all threads."""
    return cast(_F, _cached(numba.njit(**_OPTIONS, parallel=True)(function)))


def _cached(kernel: Any) -> Any:
    """The kernel, kept on disk once it is compiled (what ``cache=True`` does, with our cache)."""
    kernel._compiler = _Compiler(kernel._compiler)
    if cache_folder() is not None:
        kernel._cache = KernelCache(kernel)
    return kernel


class _Compiler:
    """Compiles, then loads what it compiled as from disk.

    numba runs a loop of ``prange`` from the first of two copies that were optimized once and twice, but keeps the
    second on disk: sums of floats differ in their last digits. Loaded into an engine of its own, code is the same.
    """

    def __init__(self, compiler: Any) -> None:
        self._compiler = compiler
        self.compiled: Any = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._compiler, name)

    def compile(self, arguments: Any, return_type: Any) -> Any:
        """What ``numba.core.dispatcher._FunctionCompiler.compile`` gives."""
        self.compiled = self._compiler.compile(arguments, return_type)
        target = self.compiled.target_context
        own = copy.copy(target)
        own._internal_codegen = JITCPUCodegen("depthcli")
        loaded = CompileResult._rebuild(own, *self.compiled._reduce())
        target.insert_user_function(loaded.entry_point, loaded.fndesc, [loaded.library])
        return loaded


def intrinsic(function: Callable[..., Any]) -> Any:
    """Define an operation that kernels call, by the code it becomes (callers leave out the typing context)."""
    return numba.extending.intrinsic(function)


def threads() -> int:
    """How many threads a parallel kernel runs on: for those that hold scratch memory a thread."""
    count: int = numba.get_num_threads()
    return count


def set_threads(count: int) -> None:
    """Let kernels use at most ``count`` threads (never more than numba was started with)."""
    n_started: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    numba.set_num_threads(max(1, min(count, n_started)))


class CompileWatch(numba.core.event.Listener):
    """Counts kernels that are compiled, as opposed to read from the cache, and the seconds it takes.

    Parameters
    ----------
    started : called once, when the first kernel is about to be compiled
    """

    def __init__(self, started: Callable[[], None] = lambda: None) -> None:
        self.kernels = 0
        self.seconds = 0.0
        self._started = started
        self._depth = 0
        self._begin = 0.0

    def on_start(self, event: Any) -> None:
        if self.kernels == 0:
            self._started()
        self.kernels += 1
        if self._depth == 0:  # a kernel that calls another one compiles it inside its own compilation
            self._begin = time.perf_counter()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._begin

    def __enter__(self) -> CompileWatch:
        numba.core.event.register("numba:compile", self)
        return self

    def __exit__(self, *error: object) -> None:
        numba.core.event.unregister("numba:compile", self)


_all_compiled = CompileWatch().__enter__()


def compile_seconds() -> float:
    """Seconds this process has spent compiling kernels so far."""
    return _all_compiled.seconds

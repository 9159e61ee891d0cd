"""Compiler options of every kernel. Kernels import what they need of numba from here, never from numba itself.

numba reads its settings once, when it is imported: :mod:`depthcli.kernels.cache` sets them before that.
"""

from __future__ import annotations

import contextlib
import copy
import importlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
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
    "n_threads", "one_at_a_time", "overload", "parallel_jit", "prange", "register_model", "set_threads", "types",
]  # fmt: skip


def _load_without_scipy() -> None:
    """Load numba's array functions without scipy.linalg, which takes longer to import than numba itself.

    numba needs it for matrix products only; therefore a kernel cannot call ``np.dot`` or ``np.linalg``.
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
    """Return ``function`` as a kernel that runs on one thread; other kernels can call it."""
    return cast(_F, _cached(numba.njit(**_OPTIONS)(function)))


def parallel_jit(function: _F) -> _F:
    """Return ``function`` as a kernel whose ``prange`` loops run on all threads."""
    return cast(_F, _cached(numba.njit(**_OPTIONS, parallel=True)(function)))


def _cached(kernel: Any) -> Any:
    """The kernel, kept on disk once it is compiled (what ``cache=True`` does, with our cache)."""
    kernel._compiler = _Compiler(kernel._compiler)
    if cache_folder() is not None:
        kernel._cache = KernelCache(kernel)
    return kernel


class _Compiler:
    """Compiles a kernel and loads the result in the way that it is loaded from disk.

    For a ``prange`` loop, numba runs the machine code of its first optimization pass but saves that of a second one:
    sums of floats would differ in their last digits between the first run and later ones. Therefore the code that is
    saved is loaded and run at once.
    """

    def __init__(self, compiler: Any) -> None:
        self._compiler = compiler
        self.compiled: Any = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._compiler, name)

    def compile(self, arguments: Any, return_type: Any) -> Any:
        """Return what ``numba.core.dispatcher._FunctionCompiler.compile`` returns."""
        self.compiled = self._compiler.compile(arguments, return_type)
        target = self.compiled.target_context
        own = copy.copy(target)
        own._internal_codegen = JITCPUCodegen("depthcli")
        loaded = CompileResult._rebuild(own, *self.compiled._reduce())
        target.insert_user_function(loaded.entry_point, loaded.fndesc, [loaded.library])
        return loaded


def intrinsic(function: Callable[..., Any]) -> Any:
    """Return an operation for kernels that ``function`` defines by the LLVM code that it emits (see numba's manual)."""
    return numba.extending.intrinsic(function)


def n_threads() -> int:
    """Return the number of threads of a parallel kernel, for kernels that allocate scratch memory per thread."""
    count: int = numba.get_num_threads()
    return count


def set_threads(count: int) -> None:
    """Let kernels use at most ``count`` threads, and no more than numba was started with."""
    n_started: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    numba.set_num_threads(max(1, min(count, n_started)))


@contextlib.contextmanager
def one_at_a_time() -> Iterator[None]:
    """Let one Python thread at a time pass where numba's pool of threads takes kernels of one only.

    That is its own pool, which it has where neither OpenMP nor TBB is installed. Which pool it is is known when the
    first parallel kernel has run: until then threads pass one at a time, too.
    """
    try:
        takes_several = numba.threading_layer() in ("omp", "tbb")  # type: ignore[attr-defined]
    except ValueError:
        takes_several = False
    with contextlib.nullcontext() if takes_several else _turn:
        yield


_turn = threading.RLock()


class CompileWatch(numba.core.event.Listener):
    """Counts the kernels that are compiled, not those read from the cache, and the seconds that this takes.

    ``changed`` is called when the compilation of a kernel that Python calls begins, and when it has ended.
    """

    def __init__(self, changed: Callable[[CompileWatch], None] = lambda watch: None) -> None:
        self.kernels = 0  # those that other kernels call included
        self.calls = 0  # kernels that Python calls, with all that they call themselves
        self.seconds = 0.0  # of the finished compilations
        self._changed = changed
        self._depth = 0
        self._begin = 0.0

    @property
    def busy(self) -> bool:
        """Return whether a kernel is being compiled."""
        return self._depth > 0

    def on_start(self, event: Any) -> None:
        self.kernels += 1
        self._depth += 1
        if self._depth == 1:  # a kernel that calls another one compiles it inside its own compilation
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
    """Return the seconds that this process has spent on compiling kernels so far."""
    return _all_compiled.seconds

"""Compiler options of all kernels. Kernels import numba's names from this module, never from numba itself.

numba reads its settings once, at its import; :mod:`depthcli.kernels.cache` sets them before that.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import os
import pickle
import sys
import threading
import time
import zlib
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar, cast

from depthcli.kernels.cache import cache_folder, kernel_files, warn_once  # before numba: it sets numba's options

import numba  # isort: skip
import numba.core.event
import numba.extending
from numba import float32, int32, types
from numba.core import cgutils
from numba.core.codegen import JITCPUCodegen
from numba.core.compiler import CompileResult
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps
from numba.extending import lower_builtin, models, register_model, type_callable

__all__ = [
    "CompileWatch", "cache_folder", "cgutils", "compile_seconds", "empty", "float32", "helper", "int32", "intrinsic",
    "jit", "lower_builtin", "models", "n_threads", "register_model", "run_bands", "set_threads", "type_callable",
    "types", "zeros",
]  # fmt: skip


if "scipy.linalg" not in sys.modules:
    # Its import takes longer than numba's. numba's array functions need it for matrix products only, which kernels
    # therefore cannot call.
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]
    try:
        import numba.np.arraymath
    finally:
        del sys.modules["scipy.linalg"]

from numba.np.arrayobj import _empty_nd_impl

_F = TypeVar("_F", bound=Callable[..., Any])

# Without nnan/ninf: NaN means "no value" in our maps and must survive.
_FASTMATH = {"reassoc", "contract", "arcp", "nsz"}
_OPTIONS: dict[str, Any] = {"no_cfunc_wrapper": True, "nogil": True, "error_model": "numpy", "fastmath": _FASTMATH}


def jit(function: _F) -> _F:
    """Return ``function`` as a kernel, which is compiled and kept on disk for each combination of argument types."""
    return _compiled(function)


def helper(function: _F) -> _F:
    """Return ``function`` as a part of kernels: compiled sooner, since Python cannot call it."""
    made: Any = _compiled(function, no_cpython_wrapper=True)
    made.__class__ = _Helper  # a call would crash
    return cast(_F, made)


def _compiled(function: _F, **options: Any) -> _F:
    kernel: Any = numba.njit(**_OPTIONS, **options)(function)
    _Compiled(kernel, kernel_files(function))
    return cast(_F, kernel)


class _Helper(type(numba.njit(lambda: None))):  # type: ignore[misc]
    def __call__(self, *arguments: Any) -> Any:
        raise TypeError(f"{self.__name__} is a part of kernels, which Python cannot call")


class _Compiled:
    """The compiled versions of a kernel, in memory and on disk.

    A kernel just compiled is loaded in the same way as from disk: with its own copies of the functions that it calls,
    optimized with it. numba would link them to the first copy in the compiling process, optimized with other code, and
    sums of floats would differ in their last digits. numba's own cache does not do that, takes 0.2 s to set up, and
    fails at a full disk or at damaged files, which here never make a computation fail.
    """

    def __init__(self, kernel: Any, files: tuple[Path, str] | None) -> None:
        self._files = files
        # numba calls the second for a new combination of types, unless the first returns a compiled version.
        compiler = kernel._compiler
        kernel._cache.load_overload, compiler.compile = self.load, partial(self.compile, compiler.compile)
        compiler.fold_argument_types = partial(self.general_types, compiler.fold_argument_types)

    def _file(self, arguments: Any) -> Path:
        folder, name = self._files or (Path(), "")
        return folder / f"{name}-{hashlib.sha256(repr(tuple(arguments)).encode()).hexdigest()[:20]}.kernel"

    @staticmethod
    def general_types(fold: Callable[..., Any], arguments: Any, named: Any) -> Any:
        """Return the types of arguments, that of a constant as of any number: one version serves all constants."""
        signature, arguments = fold(arguments, named)
        return signature, tuple(map(types.unliteral, arguments))

    def load(self, signature: Any, target: Any) -> Any:
        """Return the version for these types of arguments; None if there is none on disk."""
        if self._files is None:
            return None
        try:
            content = self._file(getattr(signature, "args", signature)).read_bytes()
        except OSError:
            return None
        try:
            if zlib.crc32(content[4:]) != int.from_bytes(content[:4], "little"):  # damaged code must not run
                raise ValueError("wrong checksum")
            rtsys.initialize(target)  # arrays need it; numba does it before it compiles
            return CompileResult._rebuild(target, *pickle.loads(content[4:]))
        except Exception:  # damage can show anywhere in unpickling and linking
            warn_once(f"{cache_folder()}: compiled kernels there are damaged; they are compiled again")
            return None

    def compile(self, compile_types: Callable[..., Any], arguments: Any, return_type: Any) -> Any:
        """Compile a version for these types of arguments, write it, and return it."""
        collects = gc.isenabled()
        gc.disable()  # there is little to collect, and looking for it takes 3 % of the time of compiling
        try:
            compiled = compile_types(arguments, return_type)
        finally:
            if collects:
                gc.enable()
        parts, target = compiled._reduce(), compiled.target_context
        if self._files is not None and not compiled.library.has_dynamic_globals:  # addresses in this process
            self._write(self._file(arguments), dumps(parts))
        loaded = CompileResult._rebuild(target.subtarget(_internal_codegen=JITCPUCodegen("depthcli")), *parts)
        # kernels compiled later link to the loaded copy
        target.insert_user_function(loaded.entry_point, loaded.fndesc, [loaded.library])
        return loaded

    @staticmethod
    def _write(file: Path, content: bytes) -> None:
        new = file.with_suffix(f".{os.getpid()}")
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            new.write_bytes(zlib.crc32(content).to_bytes(4, "little") + content)
            new.replace(file)
        except OSError as error:
            folder, reason = cache_folder(), error.strerror or error
            warn_once(f"{folder}: compiled kernels cannot be kept there ({reason}); each process compiles its own")
            with contextlib.suppress(OSError):
                new.unlink()


intrinsic: Any = numba.extending.intrinsic
"""Decorator of operations for kernels, functions that emit LLVM code (see numba's manual)."""


def _allocation(are_zeros: bool) -> Any:
    # numba's np.empty and np.zeros would be compiled for each combination of types: a tenth of all compiling.
    def define(typingctx, shape, dtype):
        is_tuple = isinstance(shape, types.BaseTuple)
        sizes = list(shape) if is_tuple else [shape]
        kind = types.Array(dtype.dtype, len(sizes), "C")

        def codegen(context, builder, signature, args):
            values = cgutils.unpack_tuple(builder, args[0]) if is_tuple else [args[0]]
            extents = [context.cast(builder, *each, types.intp) for each in zip(values, sizes, strict=True)]
            made = _empty_nd_impl(context, builder, kind, extents)
            if are_zeros:
                cgutils.memset(builder, made.data, builder.mul(made.itemsize, made.nitems), 0)
            return made._getvalue()

        return kind(shape, dtype), codegen

    return intrinsic(define)


empty = _allocation(False)
"""``np.empty(shape, dtype)`` in kernels."""
zeros = _allocation(True)
"""``np.zeros(shape, dtype)`` in kernels."""


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

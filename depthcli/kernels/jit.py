"""The one place that imports numba: the compiler options of every kernel, and where compiled kernels are kept.

numba reads its settings once, when it is imported. So every kernel takes what it needs of numba from here.
"""

from __future__ import annotations

import contextlib
import copy
import importlib
import logging
import os
import pickle
import sys
import tempfile
import time
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

# Waiting threads sleep instead of spinning: where cores are shared, a spinning thread holds the core that
# the thread it waits for needs. Has to be set before the OpenMP library is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def _user_cache() -> Path:
    if os.environ.get("XDG_CACHE_HOME"):
        return Path(os.environ["XDG_CACHE_HOME"])
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path("~/AppData/Local").expanduser())
    return Path("~/Library/Caches" if sys.platform == "darwin" else "~/.cache").expanduser()


def _usable(folder: Path, private: bool = True) -> bool:
    """Make ``folder``; True where we may write into it and nobody else planted it (the cache holds code)."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if private and hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
            return False
        with tempfile.TemporaryFile(dir=folder):
            return True
    except (OSError, RuntimeError):
        return False


def _find_cache_folder() -> Path | None:
    if os.environ.get("NUMBA_CACHE_DIR"):
        chosen = Path(os.environ["NUMBA_CACHE_DIR"])
        return chosen if _usable(chosen, private=False) else None
    user = os.getuid() if hasattr(os, "getuid") else "user"
    with contextlib.suppress(RuntimeError):  # no home folder
        if _usable(_user_cache() / "depthcli" / "kernels"):
            return _user_cache() / "depthcli" / "kernels"
    with contextlib.suppress(OSError):  # no temporary folder either
        folder = Path(tempfile.gettempdir()) / f"depthcli-{user}" / "kernels"
        return folder if _usable(folder) else Path(tempfile.mkdtemp(prefix="depthcli-"))
    return None


_FOLDER = _find_cache_folder()


def cache_folder() -> Path | None:
    """Folder for compiled kernels: ``NUMBA_CACHE_DIR``, the user's cache, or else a temporary one.

    Never the package's own folder: it may be read-only, and is shared by users who are not. None where nothing
    can be written: then every process compiles for itself.
    """
    return _FOLDER


if _FOLDER is not None:
    # Workers started by this process find the same folder, also where it is a temporary one.
    os.environ["NUMBA_CACHE_DIR"] = str(_FOLDER)

import numba  # noqa: E402
import numba.core.event  # noqa: E402
import numba.extending  # noqa: E402
from numba import float32, int32, prange, types  # noqa: E402
from numba.core import cgutils  # noqa: E402
from numba.core.caching import FunctionCache, IndexDataCacheFile  # noqa: E402
from numba.core.codegen import JITCPUCodegen  # noqa: E402
from numba.core.compiler import CompileResult  # noqa: E402
from numba.extending import models, overload, register_model  # noqa: E402

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
if _FOLDER is not None:
    numba.config.CACHE_DIR = str(_FOLDER)  # type: ignore[attr-defined]  # where numba was imported before us

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
    if _FOLDER is not None:
        try:
            kernel._cache = _Cache(kernel)
        except (OSError, RuntimeError) as error:
            _say_once(f"compiled kernels cannot be kept ({error}): each process compiles its own")
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


@cache
def _say_once(message: str) -> None:
    logging.getLogger("depthcli").warning(message)


class _CheckedFile(IndexDataCacheFile):
    """numba's cache files, each followed by its checksum: a damaged one must not be run."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._version += " checked"  # files without checksums count as those of another version

    def _dump(self, obj: Any) -> bytes:
        data: bytes = super()._dump(obj)
        return data + zlib.crc32(data).to_bytes(4, "little")  # unpickling stops before it

    def _load_index(self) -> Any:
        with contextlib.suppress(FileNotFoundError):
            _check(self._index_path, pickle.dumps(self._version, protocol=-1))
        return super()._load_index()

    def _load_data(self, name: str) -> Any:
        _check(self._data_path(name))
        return super()._load_data(name)


def _check(path: str, head: bytes = b"") -> None:
    data = Path(path).read_bytes()
    if data.startswith(head) and zlib.crc32(data[len(head) : -4]).to_bytes(4, "little") != data[-4:]:
        raise ValueError("wrong checksum")


class _Cache(FunctionCache):
    """Compiled versions of one kernel on disk, where nothing that happens to the files may fail a computation."""

    def __init__(self, kernel: Any) -> None:
        super().__init__(kernel.py_func)
        self._compiler = kernel._compiler
        implementation = self._impl
        self._cache_file = _CheckedFile(
            self._cache_path, implementation.filename_base, implementation.locator.get_source_stamp()
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was compiled before, or None."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # damage can show anywhere in unpickling and linking
            _say_once(f"{_FOLDER}: compiled kernels there are damaged; they are compiled again")
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, where there is room."""
        try:
            super().save_overload(sig, self._compiler.compiled)
        except Exception as error:
            reason = getattr(error, "strerror", None) or error
            _say_once(f"{_FOLDER}: compiled kernels cannot be kept there ({reason}); each process compiles its own")


def intrinsic(function: Callable[..., Any]) -> Any:
    """Define an operation that kernels call, by the code it becomes (callers leave out the typing context)."""
    return numba.extending.intrinsic(function)


def threads() -> int:
    """How many threads a parallel kernel runs on: for those that hold scratch memory a thread."""
    count: int = numba.get_num_threads()
    return count


def set_threads(count: int) -> None:
    """Let kernels use at most ``count`` threads (never more than numba was started with)."""
    most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    numba.set_num_threads(max(1, min(count, most)))


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


if _FOLDER is None:
    _say_once("no folder for compiled kernels can be written (see NUMBA_CACHE_DIR): each process compiles its own")

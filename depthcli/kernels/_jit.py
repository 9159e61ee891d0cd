"""The one place that holds the compiler options of every kernel, and where compiled kernels are kept."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
import tempfile
import time
from collections.abc import Callable
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


def _private(folder: Path) -> bool:
    """Make ``folder``; True where we may write into it and nobody else planted it (the cache holds code)."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
            return False
        with tempfile.TemporaryFile(dir=folder):
            return True
    except (OSError, RuntimeError):
        return False


def cache_folder() -> Path:
    """Folder for compiled kernels: ``NUMBA_CACHE_DIR``, the user's cache, or else a temporary one.

    Never the package's own folder: it may be read-only, and is shared by users who are not.
    """
    if os.environ.get("NUMBA_CACHE_DIR"):
        return Path(os.environ["NUMBA_CACHE_DIR"])
    user = os.getuid() if hasattr(os, "getuid") else "user"
    candidates = [Path(tempfile.gettempdir()) / f"depthcli-{user}"]
    with contextlib.suppress(RuntimeError):  # no home folder
        candidates.insert(0, _user_cache() / "depthcli")
    for folder in candidates:
        if _private(folder / "kernels"):
            return folder / "kernels"
    return Path(tempfile.mkdtemp(prefix="depthcli-"))


# Workers started by this process find the same folder, also where it is a temporary one.
os.environ["NUMBA_CACHE_DIR"] = str(cache_folder())

import numba  # noqa: E402
import numba.core.event  # noqa: E402
import numba.extending  # noqa: E402


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
_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": _FASTMATH}


def jit(function: _F) -> _F:
    """Compile one serial kernel (callable from other kernels)."""
    return cast(_F, numba.njit(**_OPTIONS)(function))


def parallel_jit(function: _F) -> _F:
    """Compile one kernel whose ``prange`` loops run on all threads."""
    return cast(_F, numba.njit(**_OPTIONS, parallel=True)(function))


def intrinsic(function: Callable[..., Any]) -> Any:
    """Define an operation that kernels call, by the code it becomes (callers leave out the typing context)."""
    return numba.extending.intrinsic(function)


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

"""Compiled kernels on disk: where they are kept, by what they are identified, and what happens to damaged ones.

numba identifies a kernel by the digest of its own source file: after a change of a helper in another file, the kernel
would still run the old helper. Here a kernel is identified by the digest of everything that its machine code was made
from (:mod:`depthcli.kernels.fingerprint`), and its folder is named after its module instead of its path: a moved or
copied package finds its kernels.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import sys
import tempfile
import time
import zlib
from functools import cache
from pathlib import Path
from typing import Any

# Waiting threads sleep instead of spinning: where cores are shared, a spinning thread holds the core that
# the thread it waits for needs. Has to be set before the OpenMP library is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

# Intel's vector math library, where a machine happens to have it, would give other last digits than everywhere else.
os.environ.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")

_MAX_AGE_DAYS = 30  # a month of other work, or of another branch, costs no compilation
_DAY = 86400


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
    """Return the folder of compiled kernels: ``NUMBA_CACHE_DIR``, the user's cache, or else a temporary one.

    Never the package's own folder, which may be read-only or belong to another user. None where no folder can be
    written: then every process compiles for itself.
    """
    return _FOLDER


if _FOLDER is not None:
    # Workers started by this process find the same folder, also where it is a temporary one.
    os.environ["NUMBA_CACHE_DIR"] = str(_FOLDER)

# numba reads its settings once, when it is imported.
import numba  # noqa: E402
from numba.core.caching import (  # noqa: E402
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    _CacheLocator,
)
from numba.core.runtime.nrt import rtsys  # noqa: E402

from depthcli.kernels.fingerprint import fingerprint  # noqa: E402

if _FOLDER is not None:
    numba.config.CACHE_DIR = str(_FOLDER)  # type: ignore[attr-defined]  # where numba was imported before us


@cache
def warn_once(message: str) -> None:
    """Log a warning, the first time only."""
    logging.getLogger("depthcli").warning(message)


class _Locator(_CacheLocator):
    """Where the files of one kernel lie, and the stamp that says whether they are current."""

    def __init__(self, module: str, stamp: str) -> None:
        self._module = module
        self._stamp = stamp

    def get_cache_path(self) -> str:
        return str(Path(_FOLDER or ".") / self._module)

    def get_source_stamp(self) -> str:
        return self._stamp

    def get_disambiguator(self) -> str:
        return self._stamp[:16]

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> _Locator:
        return cls(py_func.__module__, fingerprint(py_func._kernel))


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012


class KernelCache(FunctionCache):
    """Compiled versions of one kernel on disk. Damaged or missing files never make a computation fail.

    Parameters
    ----------
    kernel : numba's dispatcher of the kernel. Its fingerprint is taken at its first call, when all that it refers to
        is defined.
    """

    _impl_class = _Implementation

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._compiler = kernel._compiler
        self._files: _CheckedFile | None = None

    def _prepare(self) -> _CheckedFile:
        if self._files is None:
            self._kernel.py_func._kernel = self._kernel
            super().__init__(self._kernel.py_func)
            names, stamp = self._impl.filename_base, self._impl.locator.get_source_stamp()
            self._cache_file = self._files = _CheckedFile(self._cache_path, names, stamp)
        return self._files

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel compiled for the types ``sig``; None if there is none."""
        files = self._prepare()
        try:
            # Not by numba's load_overload, which first sets up all that compiling needs: that takes 0.2 s. Compiled
            # code needs the runtime system alone.
            rtsys.initialize(target_context)
            with self._guard_against_spurious_io_errors():
                found = self._load_overload(sig, target_context)
        except Exception:  # damage can show anywhere in unpickling and linking
            warn_once(f"{_FOLDER}: compiled kernels there are damaged; they are compiled again")
            with contextlib.suppress(OSError):
                self.flush()
            return None
        if found is not None:
            files.mark_as_used()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the compiled kernel to the folder; where that fails, warn once."""
        try:
            super().save_overload(sig, self._compiler.compiled)
            _remove_unused(Path(self.cache_path).parent)
        except Exception as error:
            reason = getattr(error, "strerror", None) or error
            warn_once(f"{_FOLDER}: compiled kernels cannot be kept there ({reason}); each process compiles its own")


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

    def mark_as_used(self) -> None:
        """Set the time of the index to now, at most once per day."""
        with contextlib.suppress(OSError):
            if time.time() - os.stat(self._index_path).st_mtime > _DAY:
                os.utime(self._index_path)


def _check(path: str, head: bytes = b"") -> None:
    data = Path(path).read_bytes()
    if data.startswith(head) and zlib.crc32(data[len(head) : -4]).to_bytes(4, "little") != data[-4:]:
        raise ValueError("wrong checksum")


@cache  # once per process, and only where something was compiled
def _remove_unused(folder: Path) -> None:
    """Remove the kernels that nothing has used for a month: of older versions, or edited since."""
    for index in folder.glob("depthcli*/*.nbi"):
        with contextlib.suppress(OSError):
            if time.time() - index.stat().st_mtime > _MAX_AGE_DAYS * _DAY:
                for file in index.parent.glob(f"{index.stem}.*"):
                    file.unlink()


if _FOLDER is None:
    warn_once("no folder for compiled kernels can be written (see NUMBA_CACHE_DIR): each process compiles its own")

"""Compiled kernels on disk: where they are kept, what a kept one is found by, and what happens to damaged ones.

numba keeps a kernel under the digest of its own source file: a kernel whose helper changed in another file would go on
running the old helper. Here a kernel is kept under the digest of everything that its machine code was made from
(:func:`fingerprint`), and under its module's name instead of its path: a moved or copied package finds its kernels.
"""

from __future__ import annotations

import contextlib
import enum
import hashlib
import logging
import os
import pickle
import sys
import tempfile
import time
import zlib
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

# Waiting threads sleep instead of spinning: where cores are shared, a spinning thread holds the core that
# the thread it waits for needs. Has to be set before the OpenMP library is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

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

    Never the package's own folder: it may be read-only, and is shared by users who are not. None where nothing
    can be written: then every process compiles for itself.
    """
    return _FOLDER


if _FOLDER is not None:
    # Workers started by this process find the same folder, also where it is a temporary one.
    os.environ["NUMBA_CACHE_DIR"] = str(_FOLDER)

# numba reads its settings once, when it is imported.
import llvmlite  # noqa: E402
import numba  # noqa: E402
import numpy as np  # noqa: E402
from numba.core.caching import (  # noqa: E402
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    _CacheLocator,
)
from numba.core.dispatcher import Dispatcher  # noqa: E402

if _FOLDER is not None:
    numba.config.CACHE_DIR = str(_FOLDER)  # type: ignore[attr-defined]  # where numba was imported before us


@cache
def warn_once(message: str) -> None:
    """Log a warning, the first time only."""
    logging.getLogger("depthcli").warning(message)


def fingerprint(kernel: Any) -> str:
    """Return the digest of all that the machine code of ``kernel`` is made from, as hexadecimal digits.

    That is the byte code, constants and compiler options of the kernel and of every kernel that it calls, in any file;
    the values of all globals that they read; the source files of operations that are defined by the code they become
    (intrinsics); numba's settings and the version of LLVM. Comments, docstrings and line numbers are not in it.
    """
    config: Any = numba.config
    settings = (llvmlite.__version__, config.BOUNDSCHECK, config.OPT, config.DISABLE_INTEL_SVML)
    digest = hashlib.sha256(repr(settings).encode())
    reached: dict[int, Any] = {}
    waiting = [kernel]
    while waiting:
        own = waiting.pop()
        if id(own) not in reached:
            reached[id(own)] = own
            text, called = _own_facts(own)
            digest.update(text)
            waiting.extend(called)
    return digest.hexdigest()


_facts: dict[int, tuple[bytes, list[Any]]] = {}  # id of a kernel -> what _own_facts found; kernels live as long as we


def _own_facts(kernel: Any) -> tuple[bytes, list[Any]]:
    """Return the digest of one kernel by itself, and the kernels that it calls, in the order of their names."""
    if id(kernel) not in _facts:
        function: FunctionType = kernel.py_func
        options = sorted((name, _stable(value)) for name, value in kernel.targetoptions.items())
        facts: list[object] = [function.__module__, function.__qualname__, options]
        called: list[Any] = []
        names = _read_code(function.__code__, function.__doc__, facts)
        for name in sorted(names):
            if name in function.__globals__:
                facts.append(name)
                _read_value(function.__globals__[name], names, facts, called)
        for value in (*(cell.cell_contents for cell in function.__closure__ or ()), *(function.__defaults__ or ())):
            _read_value(value, names, facts, called)
        _facts[id(kernel)] = hashlib.sha256(repr(facts).encode()).digest(), called
    return _facts[id(kernel)]


def _read_code(code: CodeType, docstring: str | None, facts: list[object]) -> set[str]:
    """Append the byte code and its constants to ``facts``; return the names of globals and attributes that it reads."""
    names = set(code.co_names)
    facts += [code.co_code, code.co_names, code.co_varnames, code.co_freevars, code.co_flags]
    for constant in code.co_consts:
        if isinstance(constant, CodeType):  # a nested function, or a comprehension
            names |= _read_code(constant, None, facts)
        elif constant is None or constant != docstring:
            facts.append((type(constant).__name__, _stable(constant)))
    return names


def _stable(value: object) -> str:
    """Return a text of ``value`` that is the same in every process: sets are sorted."""
    return repr(sorted(value, key=repr) if isinstance(value, set | frozenset) else value)


def _read_value(value: Any, names: set[str], facts: list[object], called: list[Any]) -> None:
    """Append to ``facts`` what of a global ``value`` goes into machine code; kernels go to ``called`` instead."""
    if isinstance(value, Dispatcher):
        called.append(value)
    elif isinstance(value, enum.EnumMeta):
        facts.append(repr(dict(value.__members__)))
    elif isinstance(value, np.ndarray):
        facts.append((value.dtype.str, value.shape, hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()))
    elif isinstance(value, tuple | list):
        for each in value:
            _read_value(each, names, facts, called)
    elif isinstance(value, ModuleType):
        facts.append(value.__name__)
        if value.__name__.partition(".")[0] not in ("numpy", "numba", "math"):
            for name in sorted(names & set(vars(value))):
                _read_value(getattr(value, name), names, facts, called)
    elif isinstance(value, type) or callable(value):
        # Not a kernel: something that numba was taught, by an intrinsic or an overload, in the file that defines it.
        definition = getattr(value, "_defn", value)
        module = str(getattr(definition, "__module__", None))
        facts.append((module, str(getattr(definition, "__qualname__", definition))))
        if module.partition(".")[0] not in ("numpy", "numba", "builtins", "math", "operator"):
            facts.append(_file_digest(getattr(sys.modules.get(module), "__file__", None)))
    else:
        facts.append((type(value).__name__, _stable(value)))


@cache
def _file_digest(path: str | None) -> str:
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest() if path else ""
    except OSError:  # in a zip file, or gone
        return ""


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
    """Compiled versions of one kernel on disk, where nothing that happens to the files may fail a computation.

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
        """Return what was compiled before, or None."""
        files = self._prepare()
        try:
            found = super().load_overload(sig, target_context)
        except Exception:  # damage can show anywhere in unpickling and linking
            warn_once(f"{_FOLDER}: compiled kernels there are damaged; they are compiled again")
            with contextlib.suppress(OSError):
                self.flush()
            return None
        if found is not None:
            files.mark_as_used()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, where there is room."""
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
        """Set the time of the index to now, at most once a day."""
        with contextlib.suppress(OSError):
            if time.time() - os.stat(self._index_path).st_mtime > _DAY:
                os.utime(self._index_path)


def _check(path: str, head: bytes = b"") -> None:
    data = Path(path).read_bytes()
    if data.startswith(head) and zlib.crc32(data[len(head) : -4]).to_bytes(4, "little") != data[-4:]:
        raise ValueError("wrong checksum")


@cache  # once a process, and only where something was compiled
def _remove_unused(folder: Path) -> None:
    """Remove the kernels that nothing has used for a month: of older versions, or edited since."""
    for index in folder.glob("depthcli*/*.nbi"):
        with contextlib.suppress(OSError):
            if time.time() - index.stat().st_mtime > _MAX_AGE_DAYS * _DAY:
                for file in index.parent.glob(f"{index.stem}.*"):
                    file.unlink()


if _FOLDER is None:
    warn_once("no folder for compiled kernels can be written (see NUMBA_CACHE_DIR): each process compiles its own")

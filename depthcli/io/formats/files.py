"""Read regular files of bounded size, and write files atomically."""

from __future__ import annotations

import contextlib
import errno
import glob
import hashlib
import logging
import os
import stat
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from pathlib import Path
from typing import BinaryIO

from depthcli.core.errors import InputError, OutputError
from depthcli.core.text import one_line, without_secrets

MAX_BYTES = 1 << 31
"""Size of the largest file that is read as a whole."""

PARTIAL_SUFFIX = ".partial~"
"""Ending of temporary files; killed runs may leave such files, which can be deleted."""

RUN_FILE = "run.yaml"
"""Name of the file with a run's command and config; it marks the folder's files as results, not input."""

RECORD_FILE = "record.json"
"""Name of the file with a scene's record, next to the scene's results in a run."""

_MAX_NAME_BYTES = 255  # limit for one part of a path in nearly all file systems
_END_BYTES = 40  # kept from the end of a longer name
_MAX_START = 40  # characters kept at the start of a temporary name; the whole name may be too long
_MAX_SHOWN = 400  # characters of a path in a message; the longest path has 4096
_MAX_FLUSHES = 16  # threads that wait for the disk; a scene has about 6 files
_one_silence = threading.RLock()  # a second thread would keep what the first one has put in its place
_flushes = ThreadPoolExecutor(_MAX_FLUSHES, "flush")  # starts threads only when it gets work
# Opening a pipe must not block, and a terminal must not become the controlling one.
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)


def is_of_a_run(path: Path | str) -> bool:
    """Return True for a file in a scene's folder of a run: the scene's record is next to it."""
    return Path(path).with_name(RECORD_FILE).is_file()


def shown(path: Path | str) -> str:
    """Return ``path`` on one line for a message, without secrets; very long paths lose their middle."""
    text = without_secrets(one_line(str(path)))  # before shortening, which could separate a query from its URL
    return text if len(text) <= _MAX_SHOWN else f"{text[: _MAX_SHOWN // 2]}...{text[-_MAX_SHOWN // 2 :]}"


@contextlib.contextmanager
def naming(path: Path | str) -> Iterator[None]:
    """Prefix an InputError in the block with the file's name, if it is not there. Overflows become InputError, too."""
    try:
        yield
    except (OverflowError, RecursionError) as error:
        raise InputError(f"{shown(path)}: damaged ({str(error)[:100]})") from error
    except InputError as error:
        text, name = str(error), f"{shown(path)}: "
        raise InputError(text if text.startswith(name) else name + text) from error


_collected: ContextVar[list[str] | None] = ContextVar("collected", default=None)


def warn(text: str) -> None:
    """Warn about a readable but doubtful file; ``text`` begins with its name."""
    lines, text = _collected.get(), without_secrets(text)
    if lines is None:
        logging.getLogger("depthcli").warning("warning: %s", text)
    elif text not in lines:
        lines.append(text)


@contextlib.contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """Yield a list that collects the distinct warnings of :func:`warn` in the block."""
    lines: list[str] = []
    token = _collected.set(lines)
    try:
        yield lines
    finally:
        _collected.reset(token)


@contextlib.contextmanager
def warnings_naming(path: Path | str) -> Iterator[None]:
    """Prefix the block's warnings with the file's name, if it is not there."""
    name = f"{shown(path)}: "
    try:
        with collected_warnings() as lines:
            yield
    finally:
        for line in lines:
            warn(line if line.startswith(name) else name + line)


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Drop what libraries print in the block: on standard output from Python, on standard error also from C++."""
    with _one_silence, contextlib.ExitStack() as stack, open(os.devnull, "w", encoding="utf-8") as sink:
        stack.enter_context(contextlib.redirect_stdout(sink))
        with contextlib.suppress(OSError):  # there may be no standard error
            saved = os.dup(2)
            stack.callback(os.close, saved)
            stack.callback(os.dup2, saved, 2)
            os.dup2(sink.fileno(), 2)
        yield


@contextlib.contextmanager
def open_regular(path: Path | str) -> Iterator[BinaryIO]:
    """Open a regular file for reading; system errors, also inside the block, become InputError."""
    try:
        handle = os.open(path, _FLAGS)
        try:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise InputError(f"{shown(path)}: expected a regular file, no folder, pipe or device")
            with os.fdopen(handle, "rb", closefd=False) as file:
                yield file
        finally:
            os.close(handle)
    except FileNotFoundError as error:
        raise InputError(f"{shown(path)}: no such file") from error
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL, or no name at all in this encoding
        raise InputError(f"{shown(path)}: cannot be read ({getattr(error, 'strerror', None) or error})") from error


def read_bytes(path: Path | str, max_bytes: int = MAX_BYTES) -> bytes:
    """Return the bytes of a regular file. Raise InputError if there are more than ``max_bytes``."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > max_bytes:
            raise InputError(f"{shown(path)}: {size} bytes, expected at most {max_bytes}")
        try:
            data = file.read(size + 1)
        except MemoryError:
            raise InputError(f"{shown(path)}: no memory for its {size} bytes") from None
    if len(data) > size:
        raise InputError(f"{shown(path)}: grew while it was read")
    return data


def file_states(*files: Path) -> tuple[object, ...]:
    """Return modification time, size and inode of each file, to detect changes; zeros for missing files."""
    found = []
    for file in files:
        try:
            state = os.stat(file)
            found.append((state.st_mtime_ns, state.st_size, state.st_ino))
        except (OSError, ValueError):  # reading the file reports the cause
            found.append((0, 0, 0))
    return tuple(found)


def short_path(path: str) -> str:
    """Return a relative path in which a digest replaces the middle of parts too long for file systems."""
    parts = []
    for name in path.split("/"):
        if len(data := os.fsencode(name)) > _MAX_NAME_BYTES:
            end, digest = data[-_END_BYTES:].decode("utf-8", "ignore"), hashlib.sha256(data).hexdigest()[:16]
            name = f"{data[: _MAX_NAME_BYTES - _END_BYTES - 18].decode('utf-8', 'ignore')}~{digest}~{end}"
        parts.append(name)
    return "/".join(parts)


@contextlib.contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path next to ``path`` and rename it to ``path`` if the block succeeds; create the folder."""
    path = Path(path)
    temporary = path.with_name(f".{path.name[:_MAX_START]}.{os.getpid()}-{threading.get_ident()}{PARTIAL_SUFFIX}")
    try:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            os.replace(temporary, path)
        except (OSError, UnicodeError) as error:  # UnicodeError: no name in the file system's encoding
            reason = getattr(error, "strerror", None) or error
            raise OutputError(f"{shown(path)}: cannot be written ({reason})") from error
    except BaseException:
        with contextlib.suppress(OSError, UnicodeError):
            temporary.unlink(missing_ok=True)
        raise


def made(folder: Path | str) -> Path:
    """Return the folder; create it if needed. Raise OutputError on failure."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from error
    return Path(folder)


def flush_all(paths: Iterable[Path]) -> None:
    """Flush files in parallel, which takes about as long as one file. Raise OSError if one fails."""
    list(_flushes.map(flush, paths))


def flush(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk. Raise OSError on failure."""
    is_folder = path.is_dir()
    try:
        handle = os.open(path, os.O_RDWR if os.name == "nt" and not is_folder else os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError as error:
        if not is_folder or error.errno == errno.EIO:  # Windows and some file systems cannot flush folders
            raise


def remove_temporaries(folder: Path, name: str = "") -> None:
    """Delete temporary files that killed processes left in a folder, all or those for the file ``name``."""
    start = f"{glob.escape(name[:_MAX_START])}." if name else ""
    for leftover in folder.glob(f".{start}*{PARTIAL_SUFFIX}"):
        with contextlib.suppress(OSError):
            leftover.unlink()


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write ``data`` to ``path`` atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path | str, text: str) -> None:
    """Write ``text`` to ``path`` atomically as UTF-8 with LF line ends; undecodable bytes in names are escaped."""
    write_bytes(path, text.encode("utf-8", "backslashreplace"))

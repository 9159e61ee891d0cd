"""Files of any kind: read only where they are regular files of bounded size, written wholly or not at all."""

from __future__ import annotations

import contextlib
import glob
import hashlib
import logging
import os
import stat
import threading
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import BinaryIO

from depthcli.core.errors import InputError, OutputError
from depthcli.core.text import one_line, without_secrets

MAX_BYTES = 1 << 31
"""Size of the largest file that is read as a whole."""

PARTIAL_SUFFIX = ".partial~"
"""Ending of temporary names; a file left with it belongs to a killed run and may be deleted."""

_MAX_NAME_BYTES = 255  # of one part of a path, by nearly all file systems
_END_BYTES = 40  # of a longer name that stay
_MAX_START = 40  # characters of a name that its temporary one begins with; all may be too long for a file system
_MAX_SHOWN = 400  # characters of a path in a message; the longest path has 4096
_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
# A pipe would wait for its other end when it is opened; a terminal would become ours.
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)


def shown(path: Path | str) -> str:
    """``path`` on one line for a message, whatever bytes it holds; very long ones lose their middle."""
    text = without_secrets(one_line(str(path)))  # before it is cut, which would part a query from its URL
    return text if len(text) <= _MAX_SHOWN else f"{text[: _MAX_SHOWN // 2]}...{text[-_MAX_SHOWN // 2 :]}"


@contextlib.contextmanager
def naming(path: Path | str) -> Iterator[None]:
    """Put the file's name before the message of an :class:`InputError` that the block raises.

    A number that is too large for what it stands for, and what is nested too deeply, become one, too.
    """
    try:
        try:
            yield
        except (OverflowError, RecursionError) as error:
            raise InputError(f"damaged ({str(error)[:100]})") from error
    except InputError as error:
        raise InputError(f"{shown(path)}: {error}") from error


_collected: ContextVar[list[str] | None] = ContextVar("collected", default=None)


def warn(text: str) -> None:
    """Say of a file, whose name ``text`` begins with, that it is read though something looks wrong with it."""
    lines, text = _collected.get(), without_secrets(text)
    if lines is None:
        logging.getLogger("depthcli").warning("warning: %s", text)
    elif text not in lines:
        lines.append(text)


@contextlib.contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """Give a list that holds what the readers called in the block say by :func:`warn`, each text once."""
    lines: list[str] = []
    token = _collected.set(lines)
    try:
        yield lines
    finally:
        _collected.reset(token)


@contextlib.contextmanager
def open_regular(path: Path | str) -> Iterator[BinaryIO]:
    """Open a regular file for reading.

    Raises
    ------
    InputError
        There is no such file, it may not be read, or it is a folder, pipe, socket or device; one line that
        names it. An :class:`OSError` inside the block becomes one too.
    """
    try:
        _refuse_special(path, os.stat(path))
        handle = os.open(path, _FLAGS)
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL, or no name at all in this encoding
        raise _unreadable(path, error) from error
    try:
        _refuse_special(path, os.fstat(handle))  # what was opened may not be what was looked at
        with os.fdopen(handle, "rb", closefd=False) as file:
            yield file
    except OSError as error:
        raise _unreadable(path, error) from error
    finally:
        os.close(handle)


def _unreadable(path: Path | str, error: OSError | ValueError) -> InputError:
    if isinstance(error, FileNotFoundError):
        return InputError(f"{shown(path)}: no such file")
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return InputError(f"{shown(path)}: cannot be read ({reason})")


def _refuse_special(path: Path | str, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = next((name for test, name in _KINDS if test(status.st_mode)), "a special file")
        raise InputError(f"{shown(path)}: {kind}, want a regular file")


def read_bytes(path: Path | str, max_bytes: int = MAX_BYTES) -> bytes:
    """All bytes of a regular file of at most ``max_bytes`` bytes.

    Raises
    ------
    InputError
        As :func:`open_regular`; larger than ``max_bytes``; grew while it was read; no memory for it.
    """
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > max_bytes:
            raise InputError(f"{shown(path)}: {size} bytes, want at most {max_bytes}")
        try:
            data = file.read(size + 1)
        except MemoryError:
            raise InputError(f"{shown(path)}: no memory for its {size} bytes") from None
    if len(data) > size:
        raise InputError(f"{shown(path)}: grew while it was read")
    return data


def ends_of_file(path: Path | str, length: int = 1024) -> tuple[int, bytes, bytes] | None:
    """Return size, beginning and end of a file, which differ for nearly all files that do; None where unreadable."""
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            start = file.read(length)
            file.seek(max(0, size - length))
            return size, start, file.read(length)
    except InputError:
        return None


def short_path(path: str) -> str:
    """Return a relative path without parts longer than file systems take: in those a digest is in place of the middle.

    The last bytes of a part, its ending among them, stay.
    """
    return "/".join(map(_short_name, path.split("/")))


def _short_name(name: str) -> str:
    data = os.fsencode(name)
    if len(data) <= _MAX_NAME_BYTES:
        return name
    end, digest = data[-_END_BYTES:].decode("utf-8", "ignore"), hashlib.sha256(data).hexdigest()[:16]
    return f"{data[: _MAX_NAME_BYTES - _END_BYTES - len(digest) - 2].decode('utf-8', 'ignore')}~{digest}~{end}"


@contextlib.contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Give a temporary name beside ``path`` to write to; rename it to ``path`` on success.

    The folder is created where missing. When the block raises, the temporary file is removed and
    ``path`` keeps what it held before.

    Raises
    ------
    OutputError
        The folder cannot be made, or the file cannot be written or renamed.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name[:_MAX_START]}.{os.getpid()}-{threading.get_ident()}{PARTIAL_SUFFIX}")
    try:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            os.replace(temporary, path)
        except (OSError, UnicodeError) as error:  # UnicodeError: no name in the file system's encoding
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise OutputError(f"{shown(path)}: cannot be written ({reason})") from error
    except BaseException:
        with contextlib.suppress(OSError, UnicodeError):
            temporary.unlink(missing_ok=True)
        raise


def remove_temporaries(folder: Path, name: str = "") -> None:
    """Delete the temporary files in ``folder`` that killed processes left, of the file ``name`` alone where given.

    Nothing else may write there.
    """
    start = f"{glob.escape(name[:_MAX_START])}." if name else ""
    for leftover in folder.glob(f".{start}*{PARTIAL_SUFFIX}"):
        with contextlib.suppress(OSError):
            leftover.unlink()


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write ``data`` to ``path``, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path | str, text: str) -> None:
    """Write ``text`` to ``path`` as UTF-8 with LF line ends, atomically; bytes of odd file names are escaped."""
    write_bytes(path, text.encode("utf-8", "backslashreplace"))

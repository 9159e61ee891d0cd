"""Opening files that somebody else named: only regular ones, never more than asked for, never a hang."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from depthcli.core.errors import InputError, printable

MOST_BYTES = 1 << 31
"""Size of the largest file that is read as a whole."""

_SHOWN = 400  # characters of a path in a message; the longest path has 4096
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
    text = printable(str(path)).replace("\n", "\\n")
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN // 2]}...{text[-_SHOWN // 2 :]}"


@contextlib.contextmanager
def naming(path: Path | str) -> Iterator[None]:
    """Put the file's name before the message of an :class:`InputError` that the block raises."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{shown(path)}: {error}") from error


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


def read_bytes(path: Path | str, most: int = MOST_BYTES) -> bytes:
    """All bytes of a regular file of at most ``most`` bytes.

    Raises
    ------
    InputError
        As :func:`open_regular`; larger than ``most``; grew while it was read; no memory for it.
    """
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise InputError(f"{shown(path)}: {size} bytes, want at most {most}")
        try:
            data = file.read(size + 1)
        except MemoryError:
            raise InputError(f"{shown(path)}: no memory for its {size} bytes") from None
    if len(data) > size:
        raise InputError(f"{shown(path)}: grew while it was read")
    return data

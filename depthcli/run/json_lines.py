"""Files of JSON lines that several processes append to."""

from __future__ import annotations

import contextlib
import json
import os
import stat
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from depthcli.core.errors import ConfigError, OutputError
from depthcli.io.formats.files import atomic_path, read_bytes, remove_temporaries, shown

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_MAX_BYTES = 1 << 30


def check_lines(path: Path) -> None:
    """Raise ConfigError where a file is there that does not hold JSON lines, InputError where it cannot be read."""
    if not os.path.lexists(path):
        return
    if os.path.isdir(path):
        raise ConfigError(f"{shown(path)}: a folder; want the name of a file")
    first = next((line for line in read_bytes(path, _MAX_BYTES).splitlines() if line.strip()), b"{}")
    try:
        known = isinstance(json.loads(first), dict)
    except (ValueError, RecursionError):
        known = False
    if not known:
        if first.lstrip().startswith(b"{"):
            raise ConfigError(f"{shown(path)}: its first line is cut off or damaged: repair it, or name another file")
        raise ConfigError(f"{shown(path)}: holds something else than JSON lines; name another file")


def add_lines(path: Path, lines: Sequence[str], warn: Callable[[str], None]) -> int:
    """Append the lines that a file does not hold yet, and return how many they were.

    The file is replaced as a whole while it is locked: it never holds part of a line, and nothing that other processes
    add in this way is lost.

    Parameters
    ----------
    warn : takes a message where the file system has no locks

    Raises
    ------
    ConfigError, InputError
        As :func:`check_lines`.
    OutputError
        The file cannot be written.
    """
    path = Path(os.path.realpath(path))
    with _locked(path, warn) as mode:
        check_lines(path)
        old = read_bytes(path, _MAX_BYTES)
        known = set(old.splitlines())
        new = [data for line in dict.fromkeys(lines) if (data := line.encode("utf-8")) not in known]
        remove_temporaries(path.parent, path.name)
        if new:
            before = old if not old or old.endswith(b"\n") else old + b"\n"
            with atomic_path(path) as temporary:
                temporary.write_bytes(before + b"".join(data + b"\n" for data in new))
                os.chmod(temporary, mode)
    return len(new)


@contextlib.contextmanager
def _locked(path: Path, warn: Callable[[str], None]) -> Iterator[int]:
    """Hold the lock of a file, made where it is missing; gives its mode."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        while True:
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            try:
                _lock(handle, path, warn)
                held = os.fstat(handle)
                with contextlib.suppress(FileNotFoundError):
                    if os.path.samestat(held, os.stat(path)):  # else it was replaced while this process waited
                        break
            except BaseException:
                os.close(handle)
                raise
            os.close(handle)
    except OSError as error:
        raise OutputError(f"{shown(path)}: cannot be written ({error.strerror or error})") from error
    try:
        yield stat.S_IMODE(held.st_mode)
    finally:
        os.close(handle)


def _lock(handle: int, path: Path, warn: Callable[[str], None]) -> None:
    try:
        if fcntl is None:
            raise OSError("no locks on this system")
        fcntl.flock(handle, fcntl.LOCK_EX)
    except OSError:
        warn(f"{shown(path)}: no locks on this file system; make sure that nothing else writes there now")

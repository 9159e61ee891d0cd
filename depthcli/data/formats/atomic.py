"""Files that are either whole or not there."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path

from depthcli.core.errors import OutputError
from depthcli.data.formats.files import shown

PARTIAL_SUFFIX = ".partial~"
"""Ending of temporary names; a file left with it belongs to a killed run and may be deleted."""


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
    # The start of the name: all of it and the rest may be too long for a file system.
    temporary = path.with_name(f".{path.name[:40]}.{os.getpid()}-{threading.get_ident()}{PARTIAL_SUFFIX}")
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


def remove_leftovers(folder: Path) -> None:
    """Delete temporary files below ``folder`` whose process is gone: it was killed while it wrote them."""
    for leftover in folder.rglob(f".*{PARTIAL_SUFFIX}"):
        process = leftover.name.removesuffix(PARTIAL_SUFFIX).rpartition(".")[2].partition("-")[0]
        try:
            os.kill(int(process), 0)
        except ProcessLookupError:
            with contextlib.suppress(OSError):
                leftover.unlink()
        except (ValueError, OverflowError, OSError):  # no name of ours, or somebody else's process
            continue


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write ``data`` to ``path``, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path | str, text: str) -> None:
    """Write ``text`` to ``path`` as UTF-8 with LF line ends, atomically; bytes of odd file names are escaped."""
    write_bytes(path, text.encode("utf-8", "backslashreplace"))

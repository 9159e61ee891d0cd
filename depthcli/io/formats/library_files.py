"""Files in archives and behind URLs, for libraries that open files by their path."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.io import storage
from depthcli.io.formats.files import NEEDS_DISK, open_regular


@contextlib.contextmanager
def library_path(path: Path, beside: Sequence[Path] = ()) -> Iterator[Path]:
    """Give a path that a library can open: the file's own or, of one stored elsewhere, that of a copy in memory.

    The copy is there while the block runs, in no folder of a disk but for links to it, so that nothing large stays
    where a process is killed.

    Parameters
    ----------
    beside : files in or below the folder of ``path`` that the library looks for there

    Raises
    ------
    InputError
        The file cannot be read, or this system has no such files in memory.
    """
    if storage.is_plain(path):
        yield path
        return
    if not hasattr(os, "memfd_create") or not os.path.isdir("/proc/self/fd"):
        raise InputError(NEEDS_DISK)
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="depthcli-")))
        if away := [each for each in beside if not each.is_relative_to(path.parent) or ".." in each.parts]:
            raise InputError(f"names {away[0].name}, which does not lie beside it")
        for each in (path, *beside):
            copy = stack.enter_context(os.fdopen(os.memfd_create("depthcli"), "wb"))
            with open_regular(each) as stream:
                shutil.copyfileobj(stream, copy, 1 << 20)
            copy.flush()
            link = folder / each.relative_to(path.parent)
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(f"/proc/{os.getpid()}/fd/{copy.fileno()}")  # child processes open it, too
        yield folder / path.name

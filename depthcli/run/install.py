"""Results moved from the hidden folder where they were made into place: no file is replaced that no record claims."""

from __future__ import annotations

import contextlib
import os
import platform
import re
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from depthcli.core.errors import ConfigError, OutputError
from depthcli.io.formats.files import remove_temporaries
from depthcli.run.records import (
    CLAIM_FILE,
    RECORD_FILE,
    Record,
    claims,
    digests_below,
    file_digest,
    read_record,
    write_record,
)
from depthcli.run.sharing import FolderLock

OTHER_RUN = "holds a scene of another run; choose another --output, or --overwrite it"
PARTIAL_PREFIX = ".partial-"
"""Start of the names of hidden folders in which results are made; one without a process is left by a killed run."""

_MAX_NAMED = 3  # files that a message names


def hidden_folder(folder: Path) -> Path:
    """Return a new hidden folder below ``folder`` in which this process makes results.

    The time is part of its name: processes of restarted containers have the same machine and number again.
    """
    machine = re.sub("[^A-Za-z0-9-]", "_", platform.node())
    return folder / f"{PARTIAL_PREFIX}{machine}-{os.getpid()}-{time.time_ns():x}"


def install(made: Path, folder: Path, record: Record, overwrite: bool = False) -> None:
    """Move results from the hidden folder ``made`` to ``folder``, in the place of files that a record claims.

    Raises
    ------
    OutputError
        The folder holds results of another run and ``overwrite`` is not set, or files that no record claims have the
        names of results; nothing was moved then.
    """
    write_record(made, record)
    earlier = read_record(folder)
    if earlier is not None and earlier.run != record.run and not overwrite:
        raise OutputError(f"{folder}: {OTHER_RUN}")
    if foreign := _foreign_files(folder, record.files):
        raise OutputError(f"{folder}: {not_ours(foreign)}")
    remove_results(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        made.rename(folder)
    except OSError:  # the folder exists and holds files of others
        folder.mkdir(exist_ok=True)
        # Where this is interrupted, the next run knows by the claim that the files are its own.
        os.replace(made / RECORD_FILE, folder / CLAIM_FILE)
        for name in record.files:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(made / name, folder / name)
        os.replace(folder / CLAIM_FILE, folder / RECORD_FILE)


@contextlib.contextmanager
def staging_folder(folder: Path, command: str, patterns: Sequence[str], warn: Callable[[str], None]) -> Iterator[Path]:
    """Give a hidden folder to write into; what it holds at the end of the block replaces earlier results.

    For commands that make one set of files rather than scenes. Where the block raises, ``folder`` stays as it was.

    Parameters
    ----------
    command : its name, as identity in the record
    patterns : shell patterns of the paths of results below ``folder``
    warn : takes a message where the file system has no locks

    Raises
    ------
    ConfigError
        Before the block: the folder is a run that is being written, or holds results of another command, or files
        that no record claims.
    OutputError
        The results cannot be written.
    """
    made = hidden_folder(folder)
    with FolderLock(folder, True, warn) as lock:
        try:
            known = read_record(folder)
            if known is not None and known.run != command:
                raise ConfigError(f"{folder}: holds results of another command; choose another --output")
            if foreign := foreign_results(folder, patterns):
                raise ConfigError(f"{folder}: {not_ours(foreign)}")
            with _naming(folder):
                if lock.alone:
                    remove_leftovers(folder)
                made.mkdir()
            lock.settle()
            yield made
            with lock.reporting(), _naming(folder):
                install(made, folder, Record("", command, {}, digests_below(made), {}))
        finally:
            discard(made)
            lock.last()


@contextlib.contextmanager
def _naming(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from error


def remove_results(folder: Path) -> None:
    """Delete the files that the records of a folder claim, and folders that are empty then; other files stay.

    The record becomes a claim first: where this is interrupted the results are not done, but still known.
    """
    for _ in range(2):  # what a claim that was left behind lists, then what the record lists
        folders = {folder}
        for name in claims(folder, (CLAIM_FILE,)):
            (folder / name).unlink(missing_ok=True)
            folders.update(folder / parent for parent in Path(name).parents)
        (folder / CLAIM_FILE).unlink(missing_ok=True)
        for each in sorted(folders, key=lambda path: -len(path.parts)):
            with contextlib.suppress(OSError):  # it is not empty
                each.rmdir()
        if read_record(folder) is not None:
            with contextlib.suppress(FileNotFoundError):
                (folder / RECORD_FILE).replace(folder / CLAIM_FILE)


def discard(folder: Path) -> None:
    """Delete a hidden folder; it is renamed first, so that a process still writing into it loses all of it at once."""
    away = folder.with_name(f"{folder.name}-{time.time_ns()}")
    try:
        folder.rename(away)
    except OSError:
        away = folder
    shutil.rmtree(away, ignore_errors=True)


def remove_leftovers(folder: Path) -> None:
    """Remove what killed processes left in a folder where no other process writes."""
    for made in folder.glob(f"{PARTIAL_PREFIX}*"):
        if not made.is_symlink():
            discard(made)
    remove_temporaries(folder)


def _foreign_files(folder: Path, files: Mapping[str, str]) -> list[str]:
    """Return those of ``files``, name -> digest, that would replace a file that no record claims.

    A file with the same content counts as ours: nothing is lost. So do the results of a scene whose record was lost.
    """
    claimed = claims(folder)
    there = {name: file_digest(folder / name) for name in files if os.path.lexists(folder / name)}
    names = [name for name, content in there.items() if name not in claimed and content != files[name]]
    if not claimed and not any(content == files[name] for name, content in there.items()):
        names += [name for name in (RECORD_FILE, CLAIM_FILE) if os.path.lexists(folder / name)]  # not a damaged record
    return names


def foreign_results(folder: Path, patterns: Sequence[str]) -> list[str]:
    """Return, before anything is computed, the files under the names of results in a folder without a record.

    Where there is a record, :func:`install` compares what it claims.

    Parameters
    ----------
    patterns : shell patterns of the paths of results below ``folder``
    """
    if not os.path.isdir(folder) or any(os.path.lexists(folder / name) for name in (CLAIM_FILE, RECORD_FILE)):
        return []
    return sorted(
        {
            path.relative_to(folder).as_posix()
            for pattern in patterns
            for path in folder.glob(pattern)
            if not path.is_dir()
        }
    )


def not_ours(names: Sequence[str]) -> str:
    """Return why files that no run wrote are not replaced, and what to do."""
    more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
    return (
        f"{', '.join(names[:_MAX_NAMED])}{more} would be replaced, but no record says that depthcli wrote "
        f"{'it' if len(names) == 1 else 'them'}; move {'it' if len(names) == 1 else 'them'} away, or choose another "
        "folder of results (only results are ever replaced)"
    )

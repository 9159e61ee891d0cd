"""Where inputs lie: in folders, in archives, behind URLs; readers and layouts see paths alone.

``scenes.zip/planes/left.png`` names a member of an archive, where ``scenes.zip`` is a file; an archive itself is a
folder and no file. Paths stay plain, so that other processes can be given them; each process keeps the archives open
that it used last. Nothing is written: members are unpacked in memory, and their names lead to no other file.

=============  ==========================================================================================
``archive``    the members of an archive by name, and which of them are never read
``zips``       ``.zip``
``tars``       ``.tar``, ``.tar.gz`` and shards of WebDataset
``unpacking``  a gzip file, read from any place
``kept``       the bytes of files that were read last
``patterns``   archives by a pattern, and those in a folder
``remote``     URLs
=============  ==========================================================================================
"""

from __future__ import annotations

import atexit
import fnmatch
import io
import os
import re
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from depthcli.core.errors import InputError
from depthcli.core.text import without_secrets
from depthcli.io.storage import remote
from depthcli.io.storage.archive import LARGE_BYTES, Archive
from depthcli.io.storage.kept import KeptBytes
from depthcli.io.storage.sized import SizedFile

ARCHIVE_SUFFIXES = (".zip", ".tar", ".tar.gz", ".tgz")
"""File name endings of archives."""

# A URL may have a query behind it, such as the signature of a store.
_ENDING = re.compile(r"\.(?:zip|tar|tar\.gz|tgz)(?:\?[^/]*=[^/]*)?(?=/|$)", re.IGNORECASE)
AT_END = re.compile(r"\.(?:zip|tar|tar\.gz|tgz)(?:\?[^/]*=[^/]*)?$", re.IGNORECASE)

_OTHER_ENDING = re.compile(r"\.(?:tar\.(?:bz2|xz|zst|lz4|Z)|tbz2?|txz|7z|rar)$", re.IGNORECASE)
_MAX_OPEN = 8  # archives of a process
_SECONDS_SAME = 0.2  # an archive is taken to be the same file as before

_Key = tuple[object, ...]
_lock = threading.RLock()
_open: OrderedDict[_Key, Archive] = OrderedDict()
_kept = KeptBytes()
_looked_at: dict[str, tuple[float, _Key]] = {}


@dataclass(frozen=True)
class _Place:
    """Where a path leads that the system's calls do not know.

    Attributes
    ----------
    container : the archive; empty: none
    inside : path in the archive
    url : of the archive, or of the file or folder; empty for archives here
    """

    container: str
    inside: str
    url: str = ""


def is_file(path: Path | str) -> bool:
    """Return whether a path is a file, a member of an archive, or a file behind a URL; archives themselves are none."""
    if os.path.isfile(path):
        return AT_END.search(os.fspath(path)) is None
    place = _place(path)
    if place is None:
        return False
    try:
        if place.container:
            return place.inside in _archive(place).listing.files
        return remote.is_file(place.url)
    except (InputError, OSError):
        return False


def is_dir(path: Path | str) -> bool:
    """Return whether a path is a folder, an archive, a folder in one, or behind a URL.

    Raises
    ------
    InputError
        An archive cannot be opened, or a server fails; the message names it.
    """
    if os.path.isdir(path):
        return True
    place = _place(path)
    if place is None:
        return False
    try:
        if place.container:
            return not place.inside or place.inside in _archive(place).listing.folders
        return remote.is_folder(place.url)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def is_archive(path: Path | str) -> bool:
    """Return whether a path is that of an archive itself."""
    place = _place(path)
    return place is not None and bool(place.container) and not place.inside


def is_plain(path: Path | str) -> bool:
    """Return whether a path is in no archive and no URL, so that any library can open it."""
    return os.path.lexists(path) or _place(path) is None


def names(path: Path | str) -> list[str]:
    """Return the sorted names in a folder; OSError or InputError where it cannot be listed."""
    place = None if os.path.isdir(path) else _place(path)
    if place is None:
        return sorted(os.listdir(path))
    if not place.container:
        return remote.names(place.url)
    found = _archive(place).listing.folders.get(place.inside)
    if found is None:
        raise FileNotFoundError(f"no such folder in {place.container}")
    return found


def glob(folder: Path, pattern: str) -> list[Path]:
    """Return the paths in a folder whose name matches a shell pattern, sorted; none where it cannot be listed."""
    try:
        return [folder / name for name in names(folder) if fnmatch.fnmatchcase(name, pattern)]
    except (OSError, InputError):
        return []


def subfolders(path: Path) -> list[Path]:
    """Return the folders in a folder, sorted, hidden ones left out; archives in it are not among them."""
    place = None if os.path.isdir(path) else _place(path)
    if place is None:
        return sorted(each for each in path.iterdir() if not each.name.startswith(".") and os.path.isdir(each))
    if not place.container:
        inside = remote.subfolders(place.url)
        return [path / name for name in sorted(inside) if not name.startswith(".")]
    found, start = _archive(place).listing.folders, f"{place.inside}/" if place.inside else ""
    return [path / name for name in found.get(place.inside, ()) if name[:1] != "." and start + name in found]


def holding(path: Path, folders: list[Path], name: str) -> list[Path]:
    """Return those of the subfolders of a folder that hold a file of that name."""
    place = None if os.path.isdir(path) else _place(path)
    if place is None or not place.container:
        return [each for each in folders if is_file(each / name)]
    files, start = _archive(place).listing.files, f"{place.inside}/" if place.inside else ""
    return [each for each in folders if f"{start}{each.name}/{name}" in files]


def files_below(path: Path) -> Iterator[Path]:
    """Yield the files in a folder and in those below it, hidden ones left out; links to folders are not followed."""
    if os.path.isdir(path):
        yield from (each for each in path.rglob("[!.]*") if os.path.isfile(each))
        return
    folders = {folder.name for folder in subfolders(path)}
    for name in names(path):
        if name.startswith("."):
            continue
        if name in folders:
            yield from files_below(path / name)
        else:
            yield path / name


def findings(path: Path | str) -> tuple[list[str], str]:
    """Return lines about members of an archive that are not used, and why it is not complete, or empty.

    Raises
    ------
    InputError
        It cannot be opened.
    """
    place = _place(path)
    if place is None or not place.container:
        return [], ""
    try:
        listing = _archive(place).listing
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})") from error
    return listing.notes, listing.damage


def is_other_archive(path: Path | str) -> bool:
    """Return whether a path is a file that is an archive of a kind that is not read."""
    return _OTHER_ENDING.search(os.fspath(path)) is not None and is_file(path)


def location(path: Path) -> str:
    """Return the absolute path, or the URL without what may be a secret: its query, and a password."""
    place = None if os.path.lexists(path) else _place(path)
    if place is None or not place.url:
        return str(path.absolute())
    url = without_secrets(place.url)
    return f"{url}/{place.inside}" if place.inside else url


def open_stored(path: Path | str) -> BinaryIO | None:
    """Return a file in an archive or behind a URL; None where the path leads to neither.

    What has less than 64 MiB is read at once and its checksum compared; what is larger is read as it is asked for.

    Raises
    ------
    InputError, OSError
        There is none, or it cannot be read: a link, encrypted, damaged, the server fails.
    """
    place = _place(path)
    if place is None:
        return None
    with _lock:
        if place.container and not place.inside:
            raise InputError("an archive, want a file in it")
        if not place.container:
            return _open_remote(place.url)
        archive = _archive(place)
        member = archive.member(place.inside)
        key = (id(archive), place.inside)
        if (data := _kept.get(key)) is not None:
            return io.BytesIO(data)
        if member.size > LARGE_BYTES:
            return SizedFile(archive.open(member), member.size)
        data = archive.read(member)
        if len(data) != member.size:
            raise InputError(f"damaged in the archive: {len(data)} bytes, want {member.size}")
        _kept.add(key, data)
        return io.BytesIO(data)


def _open_remote(url: str) -> BinaryIO:
    if (data := _kept.get(("", url))) is not None:
        return io.BytesIO(data)
    file, size = remote.open_file(url, True)
    if not isinstance(file, io.BytesIO):
        return SizedFile(file, size)
    _kept.add(("", url), file.getvalue())
    return file


def _place(path: Path | str) -> _Place | None:
    text = os.fspath(path)
    url = remote.url_of(text) if ":/" in text else ""
    for ending in _ENDING.finditer(url or text):
        container, inside = (url or text)[: ending.end()], (url or text)[ending.end() + 1 :]
        if url or container in _looked_at or os.path.isfile(container):
            return _Place(container, inside.strip("/"), container if url else "")
    return _Place("", "", url) if url else None


def _state(container: str) -> _Key:
    """What tells whether an archive is still the same file; asked once in a while, not for each of its members."""
    now = time.monotonic()
    known = _looked_at.get(container)
    if known is None or now - known[0] > _SECONDS_SAME or known[1][0] != os.getpid():
        _looked_at.pop(container, None)
        status = os.stat(container)
        known = now, (os.getpid(), container, status.st_ino, status.st_size, status.st_mtime_ns)
        if len(_looked_at) >= _MAX_OPEN:
            _looked_at.clear()
        _looked_at[container] = known
    return known[1]


@atexit.register
def close_all() -> None:
    """Close all archives that this process has open."""
    with _lock:
        while _open:
            archive = _open.popitem()[1]
            _kept.remove(id(archive))
            archive.close()


def _archive(place: _Place) -> Archive:
    """The archive of a place, opened and listed by this process; a file that changed is opened again."""
    with _lock:
        key = (os.getpid(), place.container) if place.url else _state(place.container)
        if key in _open:
            _open.move_to_end(key)
            return _open[key]
        from depthcli.io.storage.tars import Tar
        from depthcli.io.storage.zips import Zip

        file = remote.open_file(place.url, False)[0] if place.url else open(place.container, "rb")  # noqa: SIM115
        found = AT_END.search(place.container)
        ending = found[0].partition("?")[0].lower() if found else ""
        try:
            archive = Zip(file) if ending == ".zip" else Tar(file, packed=ending.endswith("gz"))
        except BaseException:
            file.close()
            raise
        _open[key] = archive
        while len(_open) > _MAX_OPEN:
            old = _open.popitem(last=False)[1]
            _kept.remove(id(old))
            old.close()
        return archive

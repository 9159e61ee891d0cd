"""Files and folders behind URLs, by fsspec, an extra (``pip install depthcli[remote]``) that is imported here only.

A path holds a URL as ``pathlib`` leaves it, with one slash: ``https:/host/scenes/left.png``.
"""

from __future__ import annotations

import errno
import io
import re
from collections import OrderedDict
from typing import Any, BinaryIO

from depthcli.core.errors import InputError
from depthcli.io.storage.archive import LARGE_BYTES
from depthcli.io.storage.sized import RawFile

_URL = re.compile(r"(?:^|/)([a-z][a-z0-9+.-]+):/+(.+)", re.IGNORECASE)
_BLOCK_BYTES = 1 << 20  # that are fetched at a time
_CONNECT_SECONDS, _READ_SECONDS = 15, 60  # without an answer
_NEXT_SECONDS = 5  # of a server that did not answer before
_MAX_FOLDERS = 4096  # whose listings are kept
_MAX_WORDS = 160  # characters of what a server or library says

_silent: set[str] = set()
"""Servers that did not answer this process in time; each of a thousand scenes would wait as long for them."""

_listed: OrderedDict[str, dict[str, bool]] = OrderedDict()
"""URL of a folder -> name -> whether it is a folder, of the folders that this process listed last."""


def url_of(path: str) -> str:
    """Return the URL that a path stands for; empty where it stands for none."""
    found = _URL.search(path)
    if found is None:
        return ""
    return f"{found[1].lower()}://{'/' if found[1].lower() in ('file', 'local') else ''}{found[2]}"


def is_folder(url: str) -> bool:
    """Return whether a URL can be listed; InputError where the server fails, or fsspec is missing."""
    try:
        return bool(_entries(url))
    except FileNotFoundError:
        return False


def is_file(url: str) -> bool:
    """Return whether a file is there: by the listing of its folder, where there is one, else by asking for it."""
    parent, _, name = url.rstrip("/").rpartition("/")
    if parent in _listed:
        return _listed[parent].get(name) is False
    system, place = _system(url)
    try:
        return bool(system.isfile(place))
    except Exception as error:
        raise _failure(error, url) from error


def names(url: str) -> list[str]:
    """Return the names in a folder; FileNotFoundError where there is none, InputError where the server fails."""
    return sorted(_entries(url))


def subfolders(url: str) -> frozenset[str]:
    """Return the names of the folders in a folder."""
    return frozenset(name for name, folder in _entries(url).items() if folder)


def open_file(url: str, whole: bool) -> tuple[BinaryIO, int]:
    """Return a file that is read in blocks, or at once where ``whole`` and it is small, and its size.

    Raises
    ------
    FileNotFoundError, InputError
        There is none; the server fails, or gives no parts of files.
    """
    system, place = _system(url)
    try:
        if whole:
            with system.open(place, "rb", **({"block_size": 0} if url.startswith("http") else {})) as file:
                data = bytearray()
                while len(data) <= LARGE_BYTES and (block := file.read(_BLOCK_BYTES)):  # streams give less than asked
                    data += block
            if len(data) <= LARGE_BYTES:
                return io.BytesIO(bytes(data)), len(data)
        file = system.open(place, "rb", block_size=_BLOCK_BYTES, cache_type="readahead")
        size = getattr(file, "size", None)
        if size is None or not file.seekable():
            raise ValueError("no range requests")
        if url.startswith("http") and size > 1:  # whether the server gives parts is known when one was read
            file.seek(1)
            file.read(1)
            file.seek(0)
        return io.BufferedReader(_Blocks(file, url), _BLOCK_BYTES >> 3), int(size)
    except Exception as error:
        raise _failure(error, url) from error


def _entries(url: str) -> dict[str, bool]:
    url = url.rstrip("/")
    if url in _listed:
        _listed.move_to_end(url)
        return _listed[url]
    system, place = _system(url)
    try:
        found = system.ls(f"{place}/" if url.startswith("http") else place, detail=True)
    except NotADirectoryError:
        raise FileNotFoundError(errno.ENOENT, "no such folder") from None
    except Exception as error:
        raise _failure(error, url) from error
    own = system._strip_protocol(url).rstrip("/")
    entries = {}
    for each in found:
        inside = str(each["name"]).partition("?")[0].rstrip("/").removeprefix(own).lstrip("/")
        if inside and "/" not in inside and inside not in (".", ".."):
            link = each["type"] not in ("file", "directory")
            entries[inside] = system.isdir(each["name"]) if link else _is_folder(each)
    _listed[url] = entries
    if len(_listed) > _MAX_FOLDERS:
        _listed.popitem(last=False)
    return entries


def _is_folder(entry: dict[str, Any]) -> bool:
    return entry["type"] == "directory" or str(entry["name"]).endswith("/")


def _system(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the place in it."""
    try:
        import fsspec
    except ImportError:
        raise InputError("URLs need fsspec: pip install 'depthcli[remote]'") from None
    options: dict[str, Any] = {}
    try:
        if url.startswith("http"):
            import aiohttp

            waits = (_NEXT_SECONDS, _NEXT_SECONDS) if _server(url) in _silent else (_CONNECT_SECONDS, _READ_SECONDS)
            limits = aiohttp.ClientTimeout(total=None, sock_connect=waits[0], sock_read=waits[1])
            options = {"client_kwargs": {"timeout": limits}}
        system, place = fsspec.core.url_to_fs(url, **options)
    except ImportError as error:
        raise InputError(f"this kind of URL needs another package: {_words(error)}") from None
    except Exception as error:
        raise InputError(f"no URL that can be read ({_words(error)})") from error
    return system, place


class _Blocks(RawFile):
    """A file behind a URL; whatever goes wrong on the way is an OSError."""

    def __init__(self, file: Any, url: str) -> None:
        super().__init__(file)
        self._url = url

    def _next(self, size: int) -> bytes:
        try:
            return super()._next(size)
        except Exception as error:
            raise OSError(errno.EIO, str(_failure(error, self._url))) from error


def _failure(error: Exception, url: str) -> Exception:
    if isinstance(error, InputError):
        return error
    if isinstance(error, FileNotFoundError):  # the library says this of any failure to ask for a file
        reason = error.__cause__
        if reason is None or isinstance(reason, FileNotFoundError) or getattr(reason, "status", 0) in (404, 410):
            return FileNotFoundError(errno.ENOENT, "no such file")
        error = reason if isinstance(reason, Exception) else error
    words = _words(error)
    if isinstance(error, ValueError) and ("range" in words.lower() or "seek" in words.lower()):
        return InputError("the server gives no parts of files (HTTP ranges), which archives and large files need")
    if "timeout" in type(error).__name__.lower() or isinstance(error, TimeoutError):
        _silent.add(_server(url))
        return InputError("the server did not answer in time; try again")
    return InputError(f"the server failed ({words})")


def _server(url: str) -> str:
    return url.partition("://")[2].partition("/")[0]


def _words(error: Exception) -> str:
    return " ".join(str(error).split())[:_MAX_WORDS] or type(error).__name__

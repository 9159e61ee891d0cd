"""Archives and URLs as inputs: each is fetched and unpacked once, into the user's cache.

The folder ``depthcli/inputs`` of the cache (``XDG_CACHE_HOME``, usually ``~/.cache``) may be deleted at any time.
``scenes.zip/planes/left.png`` names a file in an archive.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import stat
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Self
from urllib.parse import unquote

from depthcli.core.errors import InputError
from depthcli.core.text import without_secrets
from depthcli.io.formats.files import collected_warnings, naming, warn

# A query may follow the ending of a URL, e.g. a signature.
_ARCHIVE = re.compile(
    r"\.(?:zip|tar|tar\.(?:gz|bz2|xz)|tgz|tbz2|txz)(?:\?[^/]*=(?:.*&[^/]*=)?[^/]*)?(?=/|$)", re.IGNORECASE
)
_URL = re.compile(r"(?:^|/)([a-z][a-z0-9+.-]+):/+(.+)", re.IGNORECASE)  # pathlib merges the two slashes

_MAX_MEMBERS = 1 << 20
_MAX_HEADER = 1 << 20  # bytes of a member in _HEADERS
# Image archives never expand by this factor; small mask archives can, so that the second limit applies to them.
_MAX_RATE, _ALWAYS_BYTES = 200, 1 << 30
_CONNECT_SECONDS, _READ_SECONDS = 15, 60  # timeouts
_LEFTOVER_SECONDS = 86400  # age at which leftovers of killed processes are deleted
_MAX_CACHE_BYTES, _MIN_AGE = 50 << 30, 7 * 86400  # size of the cache; seconds since last use before deletion
# Suffixes of files next to a cached folder: its source, and the warnings of its creation.
_ORIGIN, _WARNINGS = ".origin", ".warnings"
# Tar members that are read into memory as a whole, e.g. the long name of the next member.
_HEADERS = (b"L", b"K", b"x", b"g", b"X")


def local(place: Path | str) -> Path:
    """Return the local folder or file of a place; archives and URLs are fetched and unpacked.

    An archive stands for its content, or for its single top folder.
    """
    path, text, url = Path(place), str(place), ""
    if os.path.isdir(path) or (os.path.exists(path) and not is_archive(path)):
        return path
    if ":/" in text and not os.path.lexists(text) and (found := _URL.search(text)):
        kind = found[1].lower()
        text = url = f"{kind}://{'/' if kind in ('file', 'local') else ''}{found[2]}"
    for ending in _ARCHIVE.finditer(text):
        container, inside = text[: ending.end()], text[ending.end() + 1 :]
        if url or os.path.isfile(container):
            content = _fetched(container) if url else _unpacked(Path(container))
            return content / inside if inside else _entered(content)
    return _entered(_fetched(url)) if url else path


def is_archive(path: Path) -> bool:
    """Return whether a path is a file with the ending of an archive."""
    found = _ARCHIVE.search(path.name)
    return found is not None and os.path.isfile(path)


def origin(path: Path) -> str:
    """Return a path without secrets; a path in the cache becomes the path in its archive or URL."""
    root, real = Path(os.path.realpath(_root())), Path(os.path.realpath(path))
    if not path.is_absolute() or not real.is_relative_to(root):
        return without_secrets(str(path))
    digest, *rest = real.relative_to(root).parts
    try:
        source = (root / digest / f"{rest[0]}{_ORIGIN}").read_text("utf-8", "surrogateescape")
    except (IndexError, OSError):
        return str(path)
    return "/".join([source, *rest[1:]])


def _stem(name: str) -> str:
    return _ARCHIVE.sub("", name.partition("?")[0]) or "archive"


def _entered(folder: Path) -> Path:
    """Return the only folder in ``folder`` if it has nothing else, or ``folder`` (possibly a file) itself."""
    inside = [path for path in folder.iterdir() if path.name[0] != "."] if folder.is_dir() else []
    return inside[0] if len(inside) == 1 and inside[0].is_dir() else folder


def _root() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "depthcli" / "inputs"


def _cached(key: object, name: str, source: str, make: Callable[[Path], None]) -> Path:
    """Return the folder or file ``name`` of the key; ``make`` creates it if it is not in the cache.

    Every call repeats the warnings of its creation.
    """
    folder = _root() / hashlib.sha256(repr(key).encode("utf-8", "surrogateescape")).hexdigest()[:20]
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        _clean(folder.parent)
        with tempfile.TemporaryDirectory(prefix=".", dir=folder.parent, ignore_cleanup_errors=True) as made:
            with collected_warnings() as lines:
                make(Path(made, name))
            Path(made, name + _ORIGIN).write_text(source, "utf-8", "surrogateescape")
            if lines:
                Path(made, name + _WARNINGS).write_text("\n".join(lines), "utf-8", "surrogateescape")
            try:
                os.rename(made, folder)
            except OSError:
                if not folder.is_dir():  # if it exists, another process was faster
                    raise
    with contextlib.suppress(OSError):
        os.utime(folder)  # mark it as used
    with contextlib.suppress(OSError):
        for line in Path(folder, name + _WARNINGS).read_text("utf-8", "surrogateescape").splitlines():
            warn(line)
    return folder / name


def _clean(root: Path) -> None:
    """Delete leftovers of killed processes from the cache and, above its size limit, inputs unused for long."""
    now = time.time()
    for old in root.glob(".*"):
        with contextlib.suppress(OSError):
            if old.stat().st_mtime < now - _LEFTOVER_SECONDS:
                shutil.rmtree(old, ignore_errors=True)
    sizes: list[tuple[float, int, Path]] = []
    for folder in root.glob("[!.]*"):
        with contextlib.suppress(OSError):
            size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
            sizes.append((folder.stat().st_mtime, size, folder))
    total = sum(size for _, size, _ in sizes)
    for used, size, folder in sorted(sizes):
        if total <= _MAX_CACHE_BYTES or used > now - _MIN_AGE:
            break
        shutil.rmtree(folder, ignore_errors=True)
        total -= size


@contextlib.contextmanager
def _one_line(place: str) -> Iterator[None]:
    """Turn the many kinds of errors that libraries raise into an InputError of one line."""
    try:
        with naming(place):
            yield
    except InputError:
        raise
    except FileNotFoundError as error:  # raised for any failure of a server
        cause = error.__cause__
        is_missing = cause is None or isinstance(cause, FileNotFoundError) or getattr(cause, "status", 0) in (404, 410)
        words = "no such file" if is_missing else f"the server failed ({' '.join(str(cause).split())[:160]})"
        raise InputError(f"{place}: {words}") from error
    except Exception as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())[:160] or type(error).__name__
        raise InputError(f"{place}: cannot be read or unpacked ({reason})") from error


def _unpacked(archive: Path) -> Path:
    with _one_line(str(archive)):
        status, place = os.stat(archive), os.path.abspath(archive)
        key = (place, status.st_size, status.st_mtime_ns)
        return _cached(key, _stem(archive.name), place, lambda target: _unpack(archive, target))


def _unpack(archive: Path, target: Path) -> None:
    """Unpack the regular files of an archive below ``target``, except names that lead out of the archive."""
    target.mkdir()
    packed, total, left_out = archive.stat().st_size, 0, []
    limit = min(max(_ALWAYS_BYTES, _MAX_RATE * packed), shutil.disk_usage(target).free)
    members = _zip_members(archive) if zipfile.is_zipfile(archive) else _tar_members(archive)
    for number, (name, size, opened) in enumerate(members):
        if number >= _MAX_MEMBERS:
            raise InputError(f"more than {_MAX_MEMBERS} members; make several archives of it")
        path, total = _inside(name), total + size
        if total > limit:
            raise InputError(f"unpacks {packed} bytes to more than {limit}; not unpacked")
        if path is None or opened is None:
            left_out.append(name)
        elif not path.startswith("__MACOSX/"):
            file = target / path
            file.parent.mkdir(parents=True, exist_ok=True)
            with opened() as source, open(file, "xb") as sink:
                shutil.copyfileobj(source, sink)
    if left_out:
        some = ", ".join(ascii(name[:80]) for name in left_out[:3])
        warn(f"{archive}: {len(left_out)} members not used, links or names that lead out of the archive: {some}")


def _inside(name: str) -> str | None:
    """Return a member's path in the archive, or None if it could lead out of it."""
    parts = [part for part in name.replace("\\", "/").split("/") if part not in ("", ".")]
    unsafe = not parts or ".." in parts or name[:1] in "/\\" or parts[0][1:2] == ":" or "\0" in name
    return None if unsafe else "/".join(parts)


_Members = Iterator[tuple[str, int, Callable[[], Any] | None]]
"""Name, size and opening function of each member except folders; the function is None if it is no regular file."""


def _zip_members(archive: Path) -> _Members:
    with zipfile.ZipFile(archive) as file:
        for info in file.infolist():
            is_special = info.create_system == 3 and stat.S_IFMT(info.external_attr >> 16) not in (0, stat.S_IFREG)
            if not info.is_dir():
                yield info.filename, info.file_size, None if is_special else partial(file.open, info)


class _TarMember(tarfile.TarInfo):
    """A member that raises ReadError for unreasonable sizes, which the module would trust."""

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> Self:
        info = super().frombuf(buf, encoding, errors)
        if info.size < 0 or (info.size > _MAX_HEADER and info.type in _HEADERS):
            raise tarfile.ReadError("a header of unreasonable size")
        return info


def _tar_members(archive: Path) -> _Members:
    with tarfile.open(archive, tarinfo=_TarMember) as tar:
        while (info := tar.next()) is not None:
            if not info.isdir():
                yield info.name, info.size, partial(tar.extractfile, info) if info.isreg() else None
        packed: Any = tar.fileobj
        packed.seek(tar.offset)
        if (block := packed.read(tarfile.BLOCKSIZE)).strip(b"\0") or len(block) < tarfile.BLOCKSIZE:
            raise tarfile.ReadError("cut short or damaged")  # the module takes this for the end of the file
        while packed.read(1 << 20):  # read up to the checksum, which is verified there
            pass


def _fetched(url: str) -> Path:
    """Return the local file or folder of a URL; an archive is unpacked."""
    shown = without_secrets(url)
    with _one_line(shown):
        system, place = _system(url)
        is_folder = not _ARCHIVE.search(url) and system.isdir(f"{place.rstrip('/')}/")
        files = _files_below(system, place) if is_folder else {}
        facts = {} if is_folder else system.info(place)
        known = [str(facts.get(key)) for key in ("size", "ETag", "LastModified", "mtime", "updated", "created")]
        name = _stem(unquote(url.partition("?")[0].rstrip("/").rpartition("/")[2]))

        def fetch(target: Path) -> None:
            free, size = shutil.disk_usage(target.parent).free, facts.get("size")
            if isinstance(size, int) and size > min(free, _MAX_CACHE_BYTES):
                raise InputError(f"has {size} bytes, but {min(free, _MAX_CACHE_BYTES)} are free for it in {_root()}")
            if is_folder:
                for inside in files.values():
                    (target / inside).parent.mkdir(parents=True, exist_ok=True)
                system.get(list(files), [str(target / inside) for inside in files.values()])
                return
            file = target.with_name(f"{name}.fetched")
            system.get_file(place, str(file))
            if zipfile.is_zipfile(file) or _ARCHIVE.search(url):
                _unpack(file, target)
                file.unlink()
            else:
                file.rename(target)

        return _cached([url, known, sorted(files.items())], name, shown, fetch)


def _files_below(system: Any, place: str) -> dict[str, str]:
    """Return file -> relative path, for the files below ``place`` except names that lead out of it."""
    own = system._strip_protocol(place).rstrip("/")
    names = [name for name in system.find(f"{place.rstrip('/')}/") if name.startswith(own)]
    if len(names) > _MAX_MEMBERS:
        raise InputError(f"more than {_MAX_MEMBERS} files")
    paths = [_inside(unquote(name.partition("?")[0].removeprefix(own).lstrip("/"))) for name in names]
    return {name: path for name, path in zip(names, paths, strict=True) if path is not None}


def _system(url: str) -> tuple[Any, str]:
    """Return the file system of a URL, and the place in it."""
    try:
        import fsspec
    except ImportError:
        raise InputError("URLs need fsspec: pip install 'depthcli[remote]'") from None
    try:
        options: dict[str, Any] = {}
        if url.startswith("http"):
            import aiohttp

            limits = aiohttp.ClientTimeout(total=None, sock_connect=_CONNECT_SECONDS, sock_read=_READ_SECONDS)
            options = {"client_kwargs": {"timeout": limits}}
        system, place = fsspec.core.url_to_fs(url, **options)
    except ImportError as error:
        raise InputError(f"this kind of URL needs another package: {error}") from None
    except Exception as error:
        raise InputError(f"no URL that can be read ({error})") from error
    return system, place

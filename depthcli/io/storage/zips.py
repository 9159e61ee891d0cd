"""Members of ``.zip`` files, by the directory at their end."""

from __future__ import annotations

import contextlib
import errno
import io
import stat
import zipfile
import zlib
from collections.abc import Iterator
from typing import Any, BinaryIO

from depthcli.core.errors import InputError
from depthcli.io.storage.archive import Archive, Listing, Member, listing_of, problem_of_size
from depthcli.io.storage.sized import RawFile

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2)  # that of LZMA may ask for 4 GiB of memory
_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, OverflowError)


class Zip(Archive):
    """A zip file; its members are unpacked as they are read, and their checksums compared."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file)
        try:
            self._zip = zipfile.ZipFile(file)
        except _DAMAGE as error:
            if isinstance(error.__context__, OSError):  # the library calls whatever cannot be read no zip file
                raise error.__context__ from None
            raise InputError(f"not a zip file, or cut short ({str(error)[:100]})") from error
        self.listing: Listing[Any] = listing_of(self._members())

    def _members(self) -> Iterator[tuple[str, Member[zipfile.ZipInfo]]]:
        for info in self._zip.infolist():
            if not info.is_dir():
                yield info.filename, Member(info.file_size, info, _problem(info))

    def open(self, member: Member[Any]) -> BinaryIO:
        try:
            return io.BufferedReader(_Unpacked(self._zip.open(member.where)))
        except _DAMAGE as error:
            raise InputError(f"damaged in the archive ({str(error)[:100]})") from error

    def read(self, member: Member[Any]) -> bytes:
        with _damage_as_os_error():  # zipfile reads no more than the directory says
            return self._zip.read(member.where)

    def close(self) -> None:
        self._zip.close()
        super().close()


def _problem(info: zipfile.ZipInfo) -> str:
    kind = stat.S_IFMT(info.external_attr >> 16) if info.create_system == 3 else 0  # 3: made on Unix
    if kind not in (0, stat.S_IFREG):
        return f"{'a link' if kind == stat.S_IFLNK else 'a special file'} in the archive, which is never followed"
    if info.flag_bits & 0x1:
        return "encrypted; make the archive without a password"
    if info.compress_type not in _METHODS:
        name = zipfile.compressor_names.get(info.compress_type, "unknown")  # type: ignore[attr-defined]
        return f"packed by a method that is not read ({info.compress_type}, {name}); make the archive with deflate"
    return problem_of_size(info.file_size, info.compress_size)


class _Unpacked(RawFile):
    """A member whose damage is an OSError, as that of a file on a disk."""

    def seekable(self) -> bool:
        return bool(self._file.seekable())

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        with _damage_as_os_error():
            return super().seek(offset, whence)

    def _next(self, size: int) -> bytes:
        with _damage_as_os_error():
            return super()._next(size)


@contextlib.contextmanager
def _damage_as_os_error() -> Iterator[None]:
    try:
        yield
    except _DAMAGE as error:
        raise OSError(errno.EIO, f"damaged in the archive: {str(error)[:100]}") from error

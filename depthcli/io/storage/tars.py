"""Members of ``.tar`` files, plain or packed by gzip, WebDataset's shards among them: listed once, read in place."""

from __future__ import annotations

import errno
import io
import os
import tarfile
from collections.abc import Iterator
from typing import Any, BinaryIO

from depthcli.core.errors import InputError
from depthcli.io.storage.archive import Archive, Listing, Member, listing_of
from depthcli.io.storage.unpacking import UnpackedGzip

_BLOCK = 512  # a tar file consists of such blocks
_MAX_HEADER = 1 << 20  # bytes of long names and other fields of a member; what is larger would only fill the memory
_DAMAGE = (tarfile.TarError, OSError, EOFError, ValueError, OverflowError, RecursionError)


class Tar(Archive):
    """A tar file; ``packed``: inside a gzip file, which is read through once to list it."""

    def __init__(self, file: BinaryIO, packed: bool) -> None:
        super().__init__(file)
        self._raw = UnpackedGzip(file) if packed else file
        self._size = None if packed else file.seek(0, os.SEEK_END)
        self._damage = ""
        found = list(self._members())
        if self._damage and not found:
            raise InputError(f"not a tar file, or damaged ({self._damage})")
        damage = f"{self._damage}; what lies behind is missing" if self._damage else ""
        self.listing: Listing[Any] = listing_of(found, damage=damage, shards=True)

    def _members(self) -> Iterator[tuple[str, Member[int]]]:
        """Name and member, in their order; what stops the listing is left in ``_damage``."""
        held: tuple[str, Member[int]] | None = None
        try:
            self._raw.seek(0)
            with tarfile.open(fileobj=_Bounded(self._raw), mode="r:", errorlevel=1) as tar:  # type: ignore[call-overload]
                while (info := tar.next()) is not None:
                    tar.members.clear()  # they would all be kept
                    if held is not None:
                        yield held
                    held = None
                    if not info.isdir():
                        held = info.name, Member(info.size, info.offset_data, _problem(info))
                self._check_end(tar.offset)
        except _DAMAGE as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            self._damage = f"cut short or damaged: {reason[:100]}"
        if held is not None and self._damage:  # the next one could not be reached: is this one whole?
            held = held[0], self._if_whole(held[1])
        if held is not None:
            yield held

    def _check_end(self, place: int) -> None:
        self._raw.seek(place)
        block = self._raw.read(_BLOCK)
        if block.strip(b"\0"):  # the module takes damage for the end
            raise tarfile.ReadError(f"no header of a member at byte {place}")
        if len(block) < _BLOCK:
            raise tarfile.ReadError("the mark of its end is missing")
        while self._size is None and self._raw.read(1 << 20):  # to the checksum at the end
            pass

    def _if_whole(self, member: Member[int]) -> Member[int]:
        try:
            self._raw.seek(member.where + max(member.size - 1, 0))
            if not member.size or self._raw.read(1):
                return member
        except OSError:
            pass
        return Member(member.size, member.where, member.problem or "cut off: the archive ends in it")

    def open(self, member: Member[Any]) -> BinaryIO:
        return io.BufferedReader(_Part(self, self._raw, member.where, member.size))


def _problem(info: tarfile.TarInfo) -> str:
    if info.issym() or info.islnk():
        return "a link in the archive, which is never followed"
    if not info.isreg():
        return "a special file in the archive, which is never made"
    return "a sparse file in the archive, which is not read; pack it whole" if info.issparse() else ""


class _Bounded:
    """A file for the module tarfile, which would read a header of any size into memory."""

    def __init__(self, file: Any) -> None:
        self._file, self.seek, self.tell = file, file.seek, file.tell

    def read(self, size: int) -> bytes:
        """Return the next bytes."""
        if not 0 <= size <= _MAX_HEADER:
            raise tarfile.ReadError("a header of unreasonable size")
        made = b""
        while len(made) < size and (data := self._file.read(size - len(made))):
            made += data
        return made


class _Part(io.RawIOBase):
    """A member: ``size`` bytes from ``start`` on."""

    def __init__(self, archive: Archive, file: Any, start: int, size: int) -> None:
        self._archive, self._file, self._start, self._size, self._place = archive, file, start, size, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._place

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._place = max(0, offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._place, io.SEEK_END: self._size}[whence])
        return self._place

    def readinto(self, buffer: Any) -> int:
        wanted = max(0, min(len(buffer), self._size - self._place))
        if not wanted:
            return 0
        with self._archive.lock:
            if self._file.tell() != self._start + self._place:
                self._file.seek(self._start + self._place)
            data = self._file.read(wanted)
        if not data:
            raise OSError(errno.EIO, "cut off: the archive ends in it")
        buffer[: len(data)] = data
        self._place += len(data)
        return len(data)

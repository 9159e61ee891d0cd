"""A gzip file as an unpacked one that can be read from any place, in bounded memory and without a file of its own."""

from __future__ import annotations

import errno
import io
import zlib
from dataclasses import dataclass
from typing import Any, BinaryIO

_CHUNK = 1 << 14  # packed bytes that are read at a time
_PIECE = 1 << 18  # unpacked bytes that are made at a time
_FIRST_SPACING = 1 << 22  # unpacked bytes between two places where unpacking can begin; doubled when there are too many
_MAX_POINTS = 256  # of such places, about 45 kB each
# A file that unpacks to more than this, at a rate that images never have, is made to keep readers busy.
_BOMB_BYTES, _BOMB_RATE = 1 << 30, 200


@dataclass(frozen=True)
class _State:
    """Unpacking as it stands at one place.

    Attributes
    ----------
    place : in the unpacked file
    packed : place in the packed file of what is read next
    rest : bytes that were read and not unpacked
    decoder : zlib's state, which is copied before it is used
    """

    place: int
    packed: int
    rest: bytes
    decoder: Any


class UnpackedGzip(io.RawIOBase):
    """The content of a gzip file; damage is an OSError. Going back begins at the nearest of the places it remembers."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        start = _State(0, 0, b"", zlib.decompressobj(31))
        self._points, self._spacing = [start], _FIRST_SPACING
        self._resume(start)
        self._ahead = b""  # unpacked, and not given away

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._place - len(self._ahead)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        if whence == io.SEEK_END:
            raise io.UnsupportedOperation("the size of what is packed is not known")
        wanted = max(0, offset + (self.tell() if whence == io.SEEK_CUR else 0))
        nearest = max((point for point in self._points if point.place <= wanted), key=lambda point: point.place)
        if wanted < self.tell() or nearest.place > self._place:
            self._resume(nearest)
        while self.tell() < wanted:
            if not self._ahead:
                self._ahead = self._unpack()
                if not self._ahead:
                    break
            self._ahead = self._ahead[wanted - self.tell() :]
        return self.tell()

    def readinto(self, buffer: Any) -> int:
        if not self._ahead:
            self._ahead = self._unpack()
        data, self._ahead = self._ahead[: len(buffer)], self._ahead[len(buffer) :]
        buffer[: len(data)] = data
        return len(data)

    def _resume(self, state: _State) -> None:
        self._place, self._packed, self._rest = state.place, state.packed, state.rest
        self._decoder, self._ahead = state.decoder.copy(), b""

    def _unpack(self) -> bytes:
        """The next bytes; none at the end."""
        while True:
            if self._decoder.eof:  # gzip files may follow each other
                self._rest = self._decoder.unused_data or self._rest
                if not (self._rest or self._more()) or not self._rest.strip(b"\0"):
                    return b""
                self._decoder = zlib.decompressobj(31)
            if not self._rest and not self._more():
                raise OSError(errno.EIO, "damaged: the packed data end too early")
            try:
                made: bytes = self._decoder.decompress(self._rest, _PIECE)
            except zlib.error as error:
                raise OSError(errno.EIO, f"damaged: {error}") from error
            self._rest = b"" if self._decoder.eof else self._decoder.unconsumed_tail
            if made:
                break
        self._place += len(made)
        if self._place > _BOMB_BYTES and self._place > _BOMB_RATE * self._packed:
            raise OSError(errno.EFBIG, f"unpacks {self._packed} bytes to more than {self._place}; not read further")
        self._remember()
        return made

    def _more(self) -> bool:
        self._file.seek(self._packed)
        self._rest = self._file.read(_CHUNK)
        self._packed += len(self._rest)
        return bool(self._rest)

    def _remember(self) -> None:
        if self._decoder.eof or self._place < self._points[-1].place + self._spacing:
            return
        self._points.append(_State(self._place, self._packed, self._rest, self._decoder.copy()))
        if len(self._points) > _MAX_POINTS:
            self._points, self._spacing = self._points[::2], 2 * self._spacing

"""Files of known size that are read piece by piece and have no number of the system."""

from __future__ import annotations

import io
import os
from typing import Any, BinaryIO


def size_of(file: BinaryIO) -> int:
    """Return the size in bytes of a file; of a member of an archive, unpacked."""
    if isinstance(file, io.BytesIO):
        return file.getbuffer().nbytes
    size = getattr(file, "stored_size", None)
    return os.fstat(file.fileno()).st_size if size is None else int(size)


class RawFile(io.RawIOBase):
    """A file that another one is read by; subclasses say what becomes of its errors."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        return int(self._file.seek(offset, whence))

    def tell(self) -> int:
        return int(self._file.tell())

    def readinto(self, buffer: Any) -> int:
        data = self._next(len(buffer))
        buffer[: len(data)] = data
        return len(data)

    def close(self) -> None:
        if not self.closed:
            self._file.close()
        super().close()

    def _next(self, size: int) -> bytes:
        """Return the next bytes, at most ``size``; none at the end."""
        return bytes(self._file.read(size))


class SizedFile(io.BufferedReader):
    """A file of known size that is read piece by piece."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        super().__init__(RawFile(file))
        self.stored_size = size

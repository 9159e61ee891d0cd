"""Files of known size that are read piece by piece and have no number of the system."""

from __future__ import annotations

import io
import os
from typing import BinaryIO


def size_of(file: BinaryIO) -> int:
    """Return the size in bytes of a file; of a member of an archive, unpacked."""
    if isinstance(file, io.BytesIO):
        return file.getbuffer().nbytes
    size = getattr(file, "stored_size", None)
    return os.fstat(file.fileno()).st_size if size is None else int(size)


class SizedFile(io.BufferedReader):
    """A file of known size that is read piece by piece."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        super().__init__(_Forwarding(file))
        self.stored_size = size


class _Forwarding(io.RawIOBase):
    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.seek, self.tell = file.seek, file.tell  # type: ignore[method-assign]

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        data = self._file.read(len(buffer))
        buffer[: len(data)] = data
        return len(data)

    def close(self) -> None:
        if not self.closed:
            self._file.close()
        super().close()

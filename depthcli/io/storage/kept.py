"""The bytes of files that were read last: headers are read first, then digests, then all of them."""

from __future__ import annotations

from collections import OrderedDict

_MAX_BYTES = 1 << 26
_MAX_FILES = 256

Key = tuple[object, str]


class KeptBytes:
    """Bytes by the archive and the path in it (or by the URL), of bounded size together."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Key, bytes] = OrderedDict()
        self._size = 0

    def get(self, key: Key) -> bytes | None:
        """Return the bytes; None where they are not kept."""
        if key in self._kept:
            self._kept.move_to_end(key)
        return self._kept.get(key)

    def add(self, key: Key, data: bytes) -> None:
        """Keep bytes; those that were used longest ago go."""
        self._size += len(data) - len(self._kept.pop(key, b""))
        self._kept[key] = data
        while self._size > _MAX_BYTES or len(self._kept) > _MAX_FILES:
            self._size -= len(self._kept.popitem(last=False)[1])

    def remove(self, of: object) -> None:
        """Forget all files of an archive."""
        for key in [key for key in self._kept if key[0] == of]:
            self._size -= len(self._kept.pop(key))

"""Large work arrays that are recycled instead of returned to the operating system.

A cost volume is tens of megabytes. Page faults of fresh memory take longer than most kernels need to fill it.
"""

from __future__ import annotations

import ctypes
import math
import threading
import weakref
from collections.abc import Callable
from typing import Any, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

BASE_BYTES = 160 << 20
"""Memory of interpreter, libraries and kernels, which estimates of methods leave out (measured: 125 to 155 MiB)."""

_MIN_BYTES = 1 << 20  # of an array from the pool; malloc recycles smaller ones
_MAX_FREE_BYTES = 256 << 20  # of all free blocks together

_lock = threading.RLock()  # re-entrant: a finalizer may run inside ``empty``
_free: list[NDArray[np.uint8]] = []


def _keep_freed_memory() -> Callable[[int], int] | None:
    """Make glibc keep freed memory of small arrays; return its function that gives the memory back."""
    trim_threshold, mmap_threshold = -1, -3
    try:
        library = ctypes.CDLL(None)
        mallopt, trim = library.mallopt, library.malloc_trim
    except (AttributeError, OSError, TypeError):
        return None
    mallopt(trim_threshold, 256 << 20)
    mallopt(mmap_threshold, 32 << 20)
    return cast(Callable[[int], int], trim)


_trim = _keep_freed_memory()


def empty(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Return an array as :func:`numpy.empty` does; its memory goes back to a pool after the last view of it."""
    kind = np.dtype(dtype)
    size = math.prod(shape) * kind.itemsize
    if size < _MIN_BYTES:
        return np.empty(shape, kind)
    with _lock:
        fitting = [(block.size, k) for k, block in enumerate(_free) if size <= block.size <= 2 * size]
        block = _free.pop(min(fitting)[1]) if fitting else np.empty(size, np.uint8)
    # Views keep their base array, so the lease lives as long as the last view.
    lease = (ctypes.c_uint8 * block.size).from_buffer(block.data)
    weakref.finalize(lease, _give, block).atexit = False
    leased: NDArray[Any] = np.frombuffer(memoryview(lease), np.uint8, size).view(kind).reshape(shape)
    return leased


def _give(block: NDArray[np.uint8]) -> None:
    with _lock:
        _free.append(block)
        while kept() > _MAX_FREE_BYTES:
            _free.pop(0)


def kept() -> int:
    """Return the number of bytes of all free blocks in the pool."""
    with _lock:
        return sum(block.size for block in _free)


def release(above: int = -1) -> None:
    """Return all free blocks to the operating system if they have more than ``above`` bytes."""
    if kept() <= above:
        return
    with _lock:
        _free.clear()
    if _trim is not None:
        _trim(0)

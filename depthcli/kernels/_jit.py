"""The one place that holds the compiler options of every kernel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

_F = TypeVar("_F", bound=Callable[..., Any])

# Without nnan/ninf: NaN means "no value" in our maps and must survive.
_FASTMATH = {"reassoc", "contract", "arcp", "nsz"}


def jit(function: _F) -> _F:
    """Compile one serial kernel (callable from other kernels)."""
    compiled: _F = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FASTMATH)(function)
    return compiled


def parallel_jit(function: _F) -> _F:
    """Compile one kernel whose ``prange`` loops run on all threads."""
    compiled: _F = numba.njit(
        cache=True, nogil=True, error_model="numpy", fastmath=_FASTMATH, parallel=True
    )(function)
    return compiled

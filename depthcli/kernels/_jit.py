"""The one place that holds the compiler options of every kernel."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeVar

# Waiting threads sleep instead of spinning: where cores are shared, a spinning thread holds the core that
# the thread it waits for needs. Has to be set before the OpenMP library is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numba  # noqa: E402

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

"""What every computation for Python is wrapped in."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from depthcli.core.result import Clock
from depthcli.kernels.jit import compile_seconds, one_at_a_time


@contextlib.contextmanager
def computing() -> Iterator[None]:
    """Keep the compilation of kernels out of measured times, and threads apart where kernels want that."""
    Clock.untimed = staticmethod(compile_seconds)
    with one_at_a_time():
        yield

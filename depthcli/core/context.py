"""Context of one scene: everything besides its inputs that the stages need, passed as an argument."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar, cast

from depthcli.kernels.jit import compile_seconds

_T = TypeVar("_T")


@dataclass
class Latest:
    """The latest result of each of some computations, such as maps that rectify images of one size."""

    _results: dict[str, tuple[Hashable, Any]] = field(default_factory=dict)

    def get(self, what: str, key: Hashable, compute: Callable[[], _T]) -> _T:
        """Return the latest result for ``what`` if it has an equal key; otherwise the result of ``compute()``."""
        latest = self._results.get(what)
        if latest is None or latest[0] != key:
            self._results.pop(what, None)  # before the next one takes memory
            self._results[what] = latest = key, compute()
        return cast(_T, latest[1])


@dataclass
class Clock:
    """Adds up seconds by stage, without the time for compiling kernels, which happens once per machine."""

    _seconds: dict[str, float] = field(default_factory=dict)
    _stage: str | None = None
    _last: float = 0.0

    def start(self, stage: str) -> None:
        """End the current stage and begin another one; an earlier stage is continued."""
        self._book()
        self._stage = stage

    def include(self, stages: Mapping[str, float]) -> None:
        """Book ``stages``, which another clock timed during the current one, instead of that part of it."""
        self._book()
        if self._stage is not None:
            rest = max(self._seconds.pop(self._stage) - sum(stages.values()), 0.0)
            self._seconds |= {**stages, self._stage: rest}

    @property
    def seconds(self) -> dict[str, float]:
        """Stage -> seconds until now, in the order in which the stages ended; the same dict every time."""
        self._book()
        return self._seconds

    def _book(self) -> None:
        now = time.perf_counter() - compile_seconds()
        if self._stage is not None:
            self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + max(now - self._last, 0.0)
        self._last = now


@dataclass
class Context:
    """The computation of one scene in one process."""

    memory: int = sys.maxsize  # bytes that this process may take
    name: str = "scene"
    program_memory: int | None = None  # bytes that a program may take, with all processes that it starts; None: all
    latest: Latest = field(default_factory=Latest)  # of all scenes that this process computes
    clock: Clock = field(default_factory=Clock)
    # The matched pair and its image files, if the files contain it unchanged.
    originals: tuple[object, tuple[Path, ...]] | None = None
    # Columns of the report about programs: their processor time, seconds, and the largest memory of one, bytes.
    used: dict[str, float] = field(default_factory=dict)
    # (id of a pair, how it was adjusted) -> the pair, which keeps the id taken, and the adjusted one.
    adjusted: dict[tuple[int, Hashable], tuple[Any, Any]] = field(default_factory=dict)

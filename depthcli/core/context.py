"""Context of one scene: everything besides its inputs that the stages need, passed as an argument."""

from __future__ import annotations

import sys
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar, cast

from depthcli.core.result import Clock

_T = TypeVar("_T")


class Latest:
    """The latest result of each of some computations, such as maps that rectify images of one size."""

    def __init__(self) -> None:
        self._results: dict[str, tuple[Hashable, Any]] = {}

    def get(self, what: str, key: Hashable, compute: Callable[[], _T]) -> _T:
        """Return the result of ``compute()``, or the latest one of ``what`` if it was computed for an equal key."""
        latest = self._results.get(what)
        if latest is None or latest[0] != key:
            self._results.pop(what, None)  # before the next one takes memory
            self._results[what] = latest = key, compute()
        return cast(_T, latest[1])


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

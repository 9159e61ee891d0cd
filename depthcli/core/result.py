"""What every pipeline returns in addition to its main map, and the clock that times its stages."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import DepthMap
from depthcli.kernels.jit import compile_seconds


@dataclass(kw_only=True)
class Result:
    """Named results of a pipeline in addition to its main map, which subclasses add."""

    seconds: dict[str, float] = field(default_factory=dict)  # by stage, in order
    confidence: dict[str, NDArray[np.float32]] = field(default_factory=dict)  # (H, W), higher is surer
    tables: dict[str, list[dict[str, Any]]] = field(default_factory=dict)  # rows, written as CSV
    pictures: dict[str, NDArray[Any]] = field(default_factory=dict)  # uint8, or (H, W) uint16, written as PNG
    figures: dict[str, float] = field(default_factory=dict)  # added to the scene's row of the report
    words: dict[str, str] = field(default_factory=dict)  # added to it as well


@dataclass
class DepthResult(Result):
    """A refined depth map."""

    depth: DepthMap


class Clock:
    """Adds up seconds by stage, without those of compiling kernels, which happens once per machine."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}
        self._stage: str | None = None
        self._last = 0.0

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

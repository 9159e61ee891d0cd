"""What every pipeline gives back beside its main map, and the clock that times its stages."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import DepthMap


@dataclass(kw_only=True)
class Result:
    """What a pipeline gives back beside its main map; each problem adds its map to it.

    Attributes
    ----------
    seconds : time by stage, in order
    confidence : name -> (H, W) float32, higher is surer
    tables : name -> list of rows (dicts), written as CSV
    pictures : name -> (H, W), (H, W, 3) uint8 or (H, W) uint16, written as PNG
    figures : name -> number, added to the scene's row of the report
    """

    seconds: dict[str, float] = field(default_factory=dict)
    confidence: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    tables: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    pictures: dict[str, NDArray[Any]] = field(default_factory=dict)
    figures: dict[str, float] = field(default_factory=dict)


@dataclass
class RefinedDepth(Result):
    """A refined depth map and how far its values may be off.

    Attributes
    ----------
    depth : the map, with what was done to every pixel
    sigma : (H, W) float32, meters: standard deviation by the residuals of the model a value comes from, NaN = none
    """

    depth: DepthMap
    sigma: NDArray[np.float32]

    def __post_init__(self) -> None:
        if self.sigma.shape != self.depth.values.shape or self.sigma.dtype != np.float32:
            want, got = self.depth.values.shape, self.sigma.shape
            raise ValueError(f"want float32 sigma {want}, got {got} {self.sigma.dtype}")


class Clock:
    """Adds up seconds by stage.

    What ``untimed`` counts is left out: the seconds spent on compiling kernels, where a runner sets it so. That
    happens once on a machine and is not the method's time.
    """

    untimed: ClassVar[Callable[[], float]] = staticmethod(lambda: 0.0)

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = self._now()

    def stop(self, stage: str) -> None:
        """Book the time since the last call (or the start) under ``stage``."""
        now = self._now()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + max(now - self._last, 0.0)
        self._last = now

    def stop_stages(self, stages: Mapping[str, float]) -> None:
        """Book the time since the last call under ``stages``, which were timed within it, and the rest as ``other``."""
        self.stop("other")
        self.seconds |= {**stages, "other": max(self.seconds.pop("other") - sum(stages.values()), 0.0)}

    @staticmethod
    def _now() -> float:
        return time.perf_counter() - Clock.untimed()

"""What every pipeline returns in addition to its main map, and the clock that times its stages."""

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
    """What a pipeline returns in addition to its main map; subclasses add the map of their problem.

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
    """A refined depth map and the uncertainty of its values.

    Attributes
    ----------
    depth : the map, with a status for every pixel
    sigma : (H, W) float32, meters, NaN = none: standard deviation of the values, estimated from the residuals of the
        model that they come from
    """

    depth: DepthMap
    sigma: NDArray[np.float32]

    def __post_init__(self) -> None:
        if self.sigma.shape != self.depth.values.shape or self.sigma.dtype != np.float32:
            want, got = self.depth.values.shape, self.sigma.shape
            raise ValueError(f"want float32 sigma {want}, got {got} {self.sigma.dtype}")


class Clock:
    """Adds up seconds by stage.

    ``untimed`` returns seconds that are left out. A runner sets it to the time spent on compiling kernels, which
    happens once per machine and is not the method's time.
    """

    untimed: ClassVar[Callable[[], float]] = staticmethod(lambda: 0.0)

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = self._now()

    def stop(self, stage: str) -> None:
        """Add the time since the last call (or since the clock was made) to ``stage``."""
        now = self._now()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + max(now - self._last, 0.0)
        self._last = now

    def stop_stages(self, stages: Mapping[str, float]) -> None:
        """Divide the time since the last call among ``stages``, which were timed within it, and ``other``, the rest."""
        self.stop("other")
        self.seconds |= {**stages, "other": max(self.seconds.pop("other") - sum(stages.values()), 0.0)}

    @staticmethod
    def _now() -> float:
        return time.perf_counter() - Clock.untimed()

"""Results of every pipeline in addition to its main map."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import DepthMap


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

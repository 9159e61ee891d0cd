"""What the plane assignment works on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.regions import RegionGraph
from depthcli.methods.stereo.segments.first_estimate import FirstEstimate
from depthcli.methods.stereo.segments.planes import Members


@dataclass(frozen=True)
class Scene:
    """Segments with their first disparities.

    Attributes
    ----------
    labels : (H, W) int32 segments 0 .. n - 1
    trusted, untrusted, everything : the pixels of every segment, those that the cross-check passed or not
    """

    labels: NDArray[np.int32]
    first: FirstEstimate
    graph: RegionGraph
    trusted: Members
    untrusted: Members
    everything: Members
    max_disparity: int

    @classmethod
    def of(cls, labels: NDArray[np.int32], first: FirstEstimate, graph: RegionGraph, max_disparity: int) -> Scene:
        count = len(graph.sizes)
        return cls(
            labels,
            first,
            graph,
            Members.of(labels, first.trusted, count),
            Members.of(labels, ~first.trusted, count),
            Members.of(labels, None, count),
            max_disparity,
        )

    @property
    def width(self) -> int:
        """W, pixels."""
        return int(self.labels.shape[1])

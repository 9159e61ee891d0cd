"""What the plane assignment works on, and what it gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.labelling.regions import RegionGraph, joined_regions
from depthcli.stereo.segments.first_estimate import FirstEstimate
from depthcli.stereo.segments.planes import Members, PlaneFit, Planes

_LEAST = 30  # trusted pixels of a group that gets a plane of its own


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


@dataclass(frozen=True)
class Assignment:
    """Planes, the plane of every segment (n,), and the energy of the cheapest planes and of these."""

    planes: Planes
    labels: NDArray[np.int32]
    energy_before: float
    energy: float


def regrouped(scene: Scene, labels: NDArray[np.int32], fit: PlaneFit) -> tuple[Planes, NDArray[np.int64]]:
    """Planes fitted to groups of connected segments that share a label.

    Returns
    -------
    planes : Planes
    group : (n,) index of the plane of every segment's group; -1 where the group is too small for one
    """
    edges = scene.graph.edges
    same = labels[edges[:, 0]] == labels[edges[:, 1]]
    groups = joined_regions(len(labels), edges[same])
    members = Members.of(groups[scene.labels], scene.first.trusted, int(groups.max()) + 1)
    chosen = np.flatnonzero(members.sizes >= _LEAST)
    index = np.full(len(members.sizes), -1, np.int64)
    index[chosen] = np.arange(len(chosen))
    return fit(scene.first.values, members, chosen), index[groups]

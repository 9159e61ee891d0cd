"""Assignment of a plane to every segment: candidates, and the labels that minimize the energy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.graph_cut import alpha_expansion, potts_energy
from depthcli.algorithms.plane_fitting.segment_planes import SegmentPlaneFit, SegmentPlanes
from depthcli.algorithms.regions import RegionPixels, joined_regions
from depthcli.core.result import Clock
from depthcli.methods.stereo.segments.energy import Energy, smoothness
from depthcli.methods.stereo.segments.segmented_image import SegmentedImage
from depthcli.methods.stereo.volume import CostVolume

_MIN_GROUP_SIZE = 30  # trusted pixels of connected segments that a plane is fitted to again; choice of this program


class PlaneCandidates(SegmentPlaneFit):
    """Fit the planes that segments may lie on, and drop near-duplicates."""

    renamed: ClassVar[dict[str, str]] = {"most": "max_planes"}

    flat: bool = Field(False, description="also offer a plane of constant disparity for every segment")
    min_size: int = Field(
        100, ge=3, le=10**6, description="size of the smallest segment that contributes a plane, pixels"
    )
    min_trusted: float = Field(0.5, ge=0, le=1, description="share of trusted pixels that a segment with a plane needs")
    same_slope: float = Field(0.01, ge=0, le=16, description="largest difference in slope of duplicate planes")
    same_offset: float = Field(
        0.25, ge=0, le=16384, description="largest difference at the center of duplicate planes, pixels"
    )
    max_planes: int = Field(
        400, ge=1, le=5000, description="largest number of planes, the best supported ones are kept"
    )

    def of_segments(self, segments: SegmentedImage) -> SegmentPlanes | None:
        """Return the planes of segments that are large and trusted enough; None where no pixel is trusted."""
        sizes, trusted, values = segments.graph.sizes, segments.trusted.sizes, segments.first.values
        chosen = np.flatnonzero((sizes > self.min_size) & (trusted >= np.maximum(self.min_trusted * sizes, 3)))
        if len(chosen) == 0:
            # One flat plane for all trusted pixels.
            if not segments.first.trusted.any():
                return None
            everything = RegionPixels.of(np.zeros_like(segments.labels), segments.first.trusted, 1)
            return self.constant(values, everything, np.zeros(1, np.int64))
        own = self(values, segments.trusted, chosen)
        return SegmentPlanes.joined(own, self.constant(values, segments.trusted, chosen)) if self.flat else own

    def distinct(self, planes: SegmentPlanes) -> tuple[SegmentPlanes, NDArray[np.int32]]:
        """Return the planes without near-duplicates, and for every plane given the index of its representative."""
        return planes.distinct(self.same_slope, self.same_offset, self.max_planes)


@dataclass(frozen=True)
class Assignment:
    """The plane of every segment.

    Attributes
    ----------
    labels : (n,) int32 index in ``planes``
    energy_before : energy where every segment has its cheapest plane
    energy : energy of ``labels``
    """

    planes: SegmentPlanes
    labels: NDArray[np.int32]
    energy_before: float
    energy: float


def assign(
    segments: SegmentedImage,
    volume: CostVolume,
    candidates: PlaneCandidates,
    energy: Energy,
    rounds: int,
    sweeps: int,
    clock: Clock,
) -> Assignment | None:
    """Return the planes of all segments that minimize the energy (thesis, eq. 2.8); None where no pixel is trusted.

    Parameters
    ----------
    volume : costs for the matching-cost data term
    rounds : number of assignments; before each but the first, planes are fitted again to groups that share one
    sweeps : largest number of passes over all planes in the last assignment; half as many, at most two, in the others
    clock : receives the seconds of the stages
    """
    clock.start("planes")
    own_planes = candidates.of_segments(segments)
    if own_planes is None:
        return None
    weights = smoothness(segments.graph, energy.smoothness, energy.color_scale)
    planes, _ = candidates.distinct(own_planes)
    initial: NDArray[np.int32] | None = None
    for k in range(rounds):
        if initial is not None:
            clock.start("planes")
            group_planes, group = regrouped(segments, initial, candidates)
            planes, representative = candidates.distinct(SegmentPlanes.joined(group_planes, own_planes))
            initial = np.where(group >= 0, representative[group], -1).astype(np.int32)
        clock.start("data_term")
        unary = energy(segments, volume, planes)
        cheapest = np.argmin(unary, axis=1).astype(np.int32)
        initial = cheapest if initial is None else np.where(initial < 0, cheapest, initial)
        clock.start("expansion")
        last = k + 1 == rounds
        labels, lowest = alpha_expansion(
            unary, segments.graph.edges, weights, initial, max_sweeps=sweeps if last else min(max(sweeps // 2, 1), 2)
        )
        initial = labels
    energy_before = potts_energy(cheapest, unary, segments.graph.edges, weights)
    return Assignment(planes, labels, energy_before, lowest)


def regrouped(
    segments: SegmentedImage, labels: NDArray[np.int32], fit: SegmentPlaneFit
) -> tuple[SegmentPlanes, NDArray[np.int64]]:
    """Return planes fitted to groups of connected segments that share a label.

    Returns
    -------
    planes : SegmentPlanes
    group : (n,) index of the plane of every segment's group; -1 where the group is too small for one
    """
    edges = segments.graph.edges
    same = labels[edges[:, 0]] == labels[edges[:, 1]]
    groups = joined_regions(len(labels), edges[same])
    members = RegionPixels.of(groups[segments.labels], segments.first.trusted, int(groups.max()) + 1)
    chosen = np.flatnonzero(members.sizes >= _MIN_GROUP_SIZE)
    index = np.full(len(members.sizes), -1, np.int64)
    index[chosen] = np.arange(len(chosen))
    return fit(segments.first.values, members, chosen), index[groups]

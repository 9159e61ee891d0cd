"""Which plane every segment lies on: candidates, and labels that minimize the energy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.graph_cut import alpha_expansion, potts_energy
from depthcli.algorithms.regions import joined_regions
from depthcli.core.result import Clock
from depthcli.methods.stereo.segments.energy import Energy
from depthcli.methods.stereo.segments.planes import Members, PlaneFit, Planes, distinct
from depthcli.methods.stereo.segments.scene import Scene
from depthcli.methods.stereo.volume import CostVolume

_LEAST = 30  # trusted pixels of a group that gets a plane of its own


class Candidates(PlaneFit):
    """The planes that segments may lie on: fitted to them, without near-duplicates."""

    flat: bool = Field(False, description="offer the flat plane of every segment beside the sloping one")
    min_size: int = Field(100, ge=3, le=10**6, description="smaller segments contribute no plane, pixels")
    min_trusted: float = Field(
        0.5, ge=0, le=1, description="segments with a smaller part of trusted pixels contribute no plane"
    )
    same_slope: float = Field(0.01, ge=0, le=16, description="planes this similar in slope may be duplicates")
    same_offset: float = Field(0.25, ge=0, le=16384, description="planes this similar at their center too are, pixels")
    most: int = Field(400, ge=1, le=5000, description="planes kept, the best supported ones")

    def of_segments(self, scene: Scene) -> Planes | None:
        """The planes of the segments that are large and sure enough; None where nothing is trusted."""
        sizes, trusted, values = scene.graph.sizes, scene.trusted.sizes, scene.first.values
        chosen = np.flatnonzero((sizes > self.min_size) & (trusted >= np.maximum(self.min_trusted * sizes, 3)))
        if len(chosen) == 0:
            # No segment is large and sure enough: one flat plane for everything that is trusted.
            if not scene.first.trusted.any():
                return None
            everything = Members.of(np.zeros_like(scene.labels), scene.first.trusted, 1)
            return self.constant(values, everything, np.zeros(1, np.int64))
        own = self(values, scene.trusted, chosen)
        return Planes.joined(own, self.constant(values, scene.trusted, chosen)) if self.flat else own

    def distinct(self, planes: Planes) -> tuple[Planes, NDArray[np.int32]]:
        """As :func:`~depthcli.methods.stereo.segments.planes.distinct`, by these tolerances."""
        return distinct(planes, self.same_slope, self.same_offset, self.most)


@dataclass(frozen=True)
class Assignment:
    """Planes, the plane of every segment (n,), and the energy of the cheapest planes and of these."""

    planes: Planes
    labels: NDArray[np.int32]
    energy_before: float
    energy: float


def assign(
    scene: Scene, volume: CostVolume, candidates: Candidates, energy: Energy, rounds: int, sweeps: int, clock: Clock
) -> Assignment | None:
    """Minimize the energy (eq. 2.8) over the planes of all segments; None where nothing is trusted.

    Parameters
    ----------
    volume : costs for the matching-cost data term
    rounds : assignments; before each but the first, planes are fitted again to groups that share one
    sweeps : passes over all planes that the last of them makes at most; those before make half as many, two
        at most
    """
    own = candidates.of_segments(scene)
    if own is None:
        return None
    clock.stop("planes")
    weights = energy.boundaries(scene.graph)
    planes, _ = candidates.distinct(own)
    initial: NDArray[np.int32] | None = None
    for turn in range(rounds):
        if initial is not None:
            again, group = regrouped(scene, initial, candidates)
            planes, stands_for = candidates.distinct(Planes.joined(again, own))
            initial = np.where(group >= 0, stands_for[group], -1).astype(np.int32)
            clock.stop("planes")
        unary = energy(scene, volume, planes)
        cheapest = np.argmin(unary, axis=1).astype(np.int32)
        initial = cheapest if initial is None else np.where(initial < 0, cheapest, initial)
        clock.stop("data_term")
        last = turn + 1 == rounds
        solved = alpha_expansion(
            unary, scene.graph.edges, weights, initial, max_sweeps=sweeps if last else min(max(sweeps // 2, 1), 2)
        )
        initial = solved.labels
        clock.stop("expansion")
    return Assignment(planes, solved.labels, potts_energy(cheapest, unary, scene.graph.edges, weights), solved.energy)


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

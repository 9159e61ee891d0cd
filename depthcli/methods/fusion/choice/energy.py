"""Choice by graph cuts: the mix of proposals with the least energy. It needs no training and takes any proposals."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from pydantic import Field

from depthcli.algorithms.graph_cut import binary_cut
from depthcli.algorithms.plane_fitting.window_slopes import slopes
from depthcli.core.maps import Floats, Image8
from depthcli.kernels.color_steps import BEFORE, color_steps
from depthcli.methods.fusion.choice import ChoiceMethod, ChosenMap, Proposals
from depthcli.methods.fusion.map_costs import NEIGHBORS, VIEW_PLANES, disagreements, misfit

Weights = tuple[Floats, Floats]
"""Weights of the pairs along the rows, (H, W - 1), and along the columns, (H - 1, W)."""


class LeastEnergyChoice(ChoiceMethod):
    """The smooth mix of maps that agrees best with costs, other maps and the right view, by graph cuts.

    The energy of a map is a sum over its pixels plus a smoothness term, in which slopes cost nothing. A pixel costs
    ``cost_weight`` times the matching cost along the map, ``agreement_weight`` times the weighted share of the other
    maps that disagree, and ``visibility_weight`` times the contradiction with the right view. Each is averaged
    over pixels of similar color. The first map is the one with the largest weight. Every other map is offered in turn,
    the median first, and its best mix with the current map is kept (fusion moves: Lempitsky, Rother, Roth and Blake,
    PAMI 2010).
    """

    cost_weight: float = Field(2.0, ge=0, le=1e3, description="weight of the fused costs, in units of one measure")
    cost_truncation: float = Field(
        0.7, gt=0, le=16, description="limit of the matching cost, because the views may differ in light"
    )
    agreement_weight: float = Field(3.0, ge=0, le=1e3, description="weight of the other maps' disagreement")
    visibility_weight: float = Field(
        2.0, ge=0, le=1e3, description="weight of the contradiction between a map and the right view"
    )
    hidden: float = Field(
        0.5, ge=0, le=1, description="contradiction at pixels of a map that are hidden in the right view"
    )
    smoothness: float = Field(
        4.0, ge=0, le=1e3, description="cost of a misfit between neighbors, per pixel of disparity"
    )
    truncation: float = Field(2.0, gt=0, le=1e3, description="largest misfit between neighbors that counts, pixels")
    color_scale: float = Field(
        10.0, gt=0, le=1e4, description="color difference that makes misfits cheaper by 1/e, grey levels"
    )
    floor: float = Field(0.1, ge=0, le=1, description="smallest factor by which color differences make misfits cheaper")

    def __call__(self, proposals: Proposals) -> ChosenMap:
        image = proposals.pair.color8[0]
        maps, costs = proposals.values, self._costs(proposals)
        neighbors = neighbor_weights(image, self.smoothness, self.color_scale, self.floor)
        start = int(proposals.weights.argmax())
        current = ScoredMap(maps[start], slopes(maps[start], image), costs[start])
        for k, (values, cost) in enumerate(zip(maps, costs, strict=True)):
            if k != start:
                proposal = ScoredMap(values, slopes(values, image), cost)
                current = best_mix(current, proposal, neighbors, self.truncation)
        return ChosenMap(current.values)

    def _costs(self, proposals: Proposals) -> Floats:
        """Return the costs of every proposal at every pixel, (N, H, W)."""
        maps = proposals.values
        plane = {name: np.empty(maps.shape, np.float32) for name in VIEW_PLANES}
        proposals.compare(maps, plane, (self.cost_truncation, self.cost_truncation))
        contradiction = np.where(plane["hidden"] > 0, np.float32(self.hidden), plane["contradiction"])
        against = np.float32(self.agreement_weight) * disagreements(maps, proposals.weights)
        against += np.float32(self.visibility_weight) * contradiction
        return np.float32(self.cost_weight) * proposals.wide.mean(plane["cost"]) + proposals.narrow.mean(against)

    def bytes_per_pixel(self, count: int) -> int:
        return 12 * count + 1000


class ScoredMap(NamedTuple):
    """A map without gaps, its slopes, and its cost at every pixel."""

    values: Floats  # (H, W) float32 disparities, pixels
    slopes: Floats  # (2, H, W) float32 change to the next pixel of the row, of the column
    cost: Floats  # (H, W) float32


def neighbor_weights(image: Image8, strength: float, color_scale: float, floor: float) -> Weights:
    """Return weights ``strength max(exp(-color / color_scale), floor)``; color: the largest channel difference."""
    by_color = (strength * np.maximum(np.exp(-np.arange(256) / color_scale), floor)).astype(np.float32)
    across, down = by_color[color_steps(image, BEFORE, largest=True)]
    return across[:, 1:], down[1:]


def energy(candidate: ScoredMap, weights: Weights, truncation: float) -> float:
    """Return the sum of all costs of a map."""
    pairs = (_pair_costs(axis, candidate, candidate, weights, truncation) for axis in (0, 1))
    return float(candidate.cost.sum(dtype=np.float64)) + sum(float(costs.sum(dtype=np.float64)) for costs in pairs)


def _pair_costs(axis: int, first: ScoredMap, second: ScoredMap, weights: Weights, truncation: float) -> Floats:
    """Return costs of neighbors that do not continue each other along their slopes; the slopes cost nothing.

    ``weight min(truncation, mean of |d_q - d_p - g_p| and |d_q - d_p - g_q|)`` for a pixel p of ``first`` and the next
    pixel q of ``second`` in its row or column.
    """
    here, there = NEIGHBORS[axis]
    ends = first.values[here], second.values[there], first.slopes[axis][here], second.slopes[axis][there]
    return np.asarray(weights[axis] * np.minimum(np.float32(truncation), misfit(*ends)))


def best_mix(
    current: ScoredMap, proposal: ScoredMap, weights: Weights, truncation: float, min_difference: float = 0.25
) -> ScoredMap:
    """Return the mix of two maps with the least energy, or ``current`` itself if no mix is better.

    One minimum cut (fusion moves: Lempitsky et al., PAMI 2010). Pairs that it cannot represent cost more if exactly
    one of the two pixels switches, so the energies are compared at the end. ``current`` stays if the maps differ by
    less than ``min_difference`` pixels (chosen by hand).
    """
    shape = current.values.shape
    apart = np.abs(proposal.values - current.values) >= min_difference
    if not apart.any():
        return current
    # Pair costs are E00 + (E10 - E00) x_p + (E11 - E10) x_q + (E01 + E10 - E00 - E11) (1 - x_p) x_q, with x = 1
    # if a pixel switches. The last factor is raised to 0 if it is negative. Pixels that are not apart stay.
    score = (proposal.cost - current.cost).astype(np.float64)
    nodes = np.cumsum(apart).reshape(shape) - 1
    pairs = []
    for axis, (here, there) in enumerate(NEIGHBORS):
        ends = itertools.product((current, proposal), repeat=2)
        e00, e01, e10, e11 = (_pair_costs(axis, first, second, weights, truncation) for first, second in ends)
        both = apart[here] & apart[there]
        score[here] += e10 - e00
        score[there] += np.where(both, e11 - e10, e01 - e00)
        pairs.append((nodes[here][both], nodes[there][both], np.maximum(e01 + e10 - e00 - e11, 0)[both]))
    p, q, capacity = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    chosen = np.zeros(shape, np.bool_)
    chosen[apart] = binary_cut(score[apart], p, q, capacity.astype(np.float64))
    mix = ScoredMap(*(np.where(chosen, b, a) for a, b in zip(current, proposal, strict=True)))
    return mix if energy(mix, weights, truncation) < energy(current, weights, truncation) else current

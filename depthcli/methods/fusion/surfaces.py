"""Maps as surfaces: costs of their disparities, misfits of their neighbors, and the best mix of two of them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.graph_cut import binary_cut
from depthcli.core import memory
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.fusion.support import BLOCK_DEPTH, NO_VOTE, ColorSupport
from depthcli.methods.stereo.volume import CostVolume

_ALL, _BUT_LAST, _BUT_FIRST = slice(None), slice(None, -1), slice(1, None)
NEIGHBORS = (((_ALL, _BUT_LAST), (_ALL, _BUT_FIRST)), ((_BUT_LAST, _ALL), (_BUT_FIRST, _ALL)))
"""Pixels and the next ones in their rows; pixels and the next ones in their columns."""


def misfit(
    here: NDArray[np.float32],
    there: NDArray[np.float32],
    slope_here: NDArray[np.float32],
    slope_there: NDArray[np.float32],
    truncation: float,
) -> NDArray[np.float32]:
    """Return by how much the slopes of neighbors do not lead from one to the other, at most ``truncation``, pixels."""
    step = there - here
    mean = np.float32(0.5) * (np.abs(step - slope_here) + np.abs(step - slope_there))
    cost: NDArray[np.float32] = np.minimum(np.float32(truncation), mean)
    return cost


@dataclass(frozen=True)
class Surface:
    """A map without gaps, its slopes, and its cost at every pixel.

    Attributes
    ----------
    values : (H, W) float32 disparities, pixels
    slopes : (2, H, W) float32 change to the next pixel of the row, of the column
    cost : (H, W) float32
    """

    values: NDArray[np.float32]
    slopes: NDArray[np.float32]
    cost: NDArray[np.float32]

    def mixed(self, other: Surface, chosen: NDArray[np.bool_]) -> Surface:
        """Return ``other`` where ``chosen`` (H, W), this one elsewhere."""
        return Surface(
            np.where(chosen, other.values, self.values),
            np.where(chosen, other.slopes, self.slopes),
            np.where(chosen, other.cost, self.cost),
        )


@dataclass(frozen=True)
class Smoothness:
    """Costs of neighbors whose disparities do not continue each other along their slopes.

    ``weight min(truncation, mean of |d_q - d_p - g_p| and |d_q - d_p - g_q|)`` for a pixel p and the next one q in
    its row or column: a slope costs nothing, so that smoothness may be strong.

    Attributes
    ----------
    weights : of the pairs along the rows, (H, W - 1), and along the columns, (H - 1, W), float32
    truncation : pixels
    """

    weights: tuple[NDArray[np.float32], NDArray[np.float32]]
    truncation: float

    @classmethod
    def of(
        cls, image: NDArray[np.uint8], strength: float, color_scale: float, floor: float, truncation: float
    ) -> Smoothness:
        """Return weights ``strength max(exp(-color / color_scale), floor)``; color: the largest channel difference."""
        levels = image.astype(np.int16)
        colors = (np.abs(levels[there] - levels[here]).max(axis=2) for here, there in NEIGHBORS)
        across, down = ((strength * np.maximum(np.exp(-c / color_scale), floor)).astype(np.float32) for c in colors)
        return cls((across, down), truncation)

    def energy(self, surface: Surface) -> float:
        """Return the sum of all costs of a surface."""
        return float(surface.cost.sum(dtype=np.float64)) + sum(
            float(self._pair_costs(axis, surface, surface).sum(dtype=np.float64)) for axis in (0, 1)
        )

    def _pair_costs(self, axis: int, first: Surface, second: Surface) -> NDArray[np.float32]:
        # of the pixels of ``first`` with the next ones of ``second``, along the rows or along the columns
        here, there = NEIGHBORS[axis]
        slopes = first.slopes[axis][here], second.slopes[axis][there]
        return self.weights[axis] * misfit(first.values[here], second.values[there], *slopes, self.truncation)

    def move(self, current: Surface, proposal: Surface, min_difference: float) -> NDArray[np.bool_] | None:
        """Return the pixels (H, W) at which ``proposal`` replaces ``current`` in the best mix; None: nothing is gained.

        One minimum cut (fusion moves: Lempitsky et al., PAMI 2010). Pairs that it cannot represent cost more when
        exactly one of the two switches; so the energy is compared at the end.

        Parameters
        ----------
        min_difference : where the two differ by less, ``current`` stays, pixels
        """
        shape = current.values.shape
        apart = np.abs(proposal.values - current.values) >= min_difference
        if not apart.any():
            return None
        # Pair costs are E00 + (E10 - E00) x_p + (E11 - E10) x_q + (E01 + E10 - E00 - E11) (1 - x_p) x_q, with x = 1
        # where a pixel switches; the last factor is raised to 0 where it is negative. Pixels that are not apart stay.
        score = (proposal.cost - current.cost).astype(np.float64)
        nodes = np.cumsum(apart).reshape(shape) - 1
        pairs = []
        for axis, (here, there) in enumerate(NEIGHBORS):
            e00, e01, e10, e11 = (
                self._pair_costs(axis, first, second)
                for first, second in itertools.product((current, proposal), repeat=2)
            )
            both = apart[here] & apart[there]
            score[here] += e10 - e00
            score[there] += np.where(both, e11 - e10, e01 - e00)
            pairs.append((nodes[here][both], nodes[there][both], np.maximum(e01 + e10 - e00 - e11, 0)[both]))
        p, q, capacity = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
        chosen = np.zeros(shape, np.bool_)
        chosen[apart] = binary_cut(score[apart], p, q, capacity.astype(np.float64))
        if not chosen.any() or self.energy(current.mixed(proposal, chosen)) >= self.energy(current):
            return None
        return chosen


def matching_costs(
    maps: NDArray[np.float32], volume: CostVolume, truncation: float, support: ColorSupport
) -> NDArray[np.float32]:
    """Compute the mean over the support of the cost along every map; (N, H, W) float32, in units of the measure.

    Parameters
    ----------
    maps : (N, H, W) disparities 0 .. D - 1
    truncation : largest cost of a pixel, also of those whose match lies outside the right image
    """
    return _smoothed(maps, support, _along, volume.costs, np.float32(1.0 / volume.scale), np.float32(truncation))


def disagreements(
    maps: NDArray[np.float32], weights: NDArray[np.float32], support: ColorSupport
) -> NDArray[np.float32]:
    """Compute the mean over the support of the weighted share of the other maps that disagree; (N, H, W) float32.

    Maps within half a pixel agree; from there to one and a half their agreement fades.

    Parameters
    ----------
    maps : (N, H, W)
    weights : (N,) what a map counts for the others
    """
    return _smoothed(maps, support, _disagree, weights, weights.sum() - weights)


def agreement(
    values: NDArray[np.float32], maps: NDArray[np.float32], weights: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Compute the weighted share of the (N, H, W) ``maps`` that agree with (H, W) ``values``."""
    total = np.zeros(values.shape, np.float32)
    for one, weight in zip(maps, weights, strict=True):
        total += weight * np.clip(np.float32(1.5) - np.abs(one - values), 0, 1)
    return total / np.float32(weights.sum())


def contradictions(
    maps: NDArray[np.float32], right: NDArray[Any], hidden: float, support: ColorSupport
) -> NDArray[np.float32]:
    """Compute the mean over the support of how far the right view contradicts every map; (N, H, W) float32 in [0, 1].

    In front of what the right view sees a pixel could not be missed there: 1, fading between one and two pixels. Behind
    it, or outside the right image, it is hidden.

    Parameters
    ----------
    right : (H, W) disparities of the right view
    hidden : what a hidden pixel costs
    """
    return _smoothed(maps, support, _contradict, right, np.float32(hidden))


def _smoothed(maps: NDArray[np.float32], support: ColorSupport, fill: Any, *inputs: Any) -> NDArray[np.float32]:
    count, height, width = maps.shape
    out = np.empty(maps.shape, np.float32)
    block = memory.empty((height, width, BLOCK_DEPTH), np.float32)
    for first in range(0, count, BLOCK_DEPTH):
        block[:] = NO_VOTE
        fill(maps, first, *inputs, block)
        support.sum(block)
        for k in range(first, min(count, first + BLOCK_DEPTH)):
            out[k] = block[:, :, k - first] * support.share
    return out


@jit
def cost_between(costs: Any, value: Any) -> Any:
    """Return the cost of a pixel at a disparity between two whole ones."""
    d = min(int(value), costs.size - 1)
    cost = np.float32(costs[d])
    if d + 1 < costs.size:
        cost += (value - np.float32(d)) * (np.float32(costs[d + 1]) - cost)
    return cost


@parallel_jit
def _along(maps: Any, first: int, costs: Any, unit: Any, truncation: Any, block: Any) -> None:
    height, width, depth = costs.shape
    for y in prange(height):
        for k in range(min(block.shape[2], maps.shape[0] - first)):
            row = maps[first + k, y]
            for x in range(width):
                d = min(int(row[x]), depth - 1)
                if d > x:
                    block[y, x, k] = truncation
                    continue
                block[y, x, k] = min(cost_between(costs[y, x], row[x]) * unit, truncation)


@parallel_jit
def _disagree(maps: Any, first: int, weights: Any, others: Any, block: Any) -> None:
    count, height, width = maps.shape
    zero, one, no_agreement = np.float32(0), np.float32(1), np.float32(1.5)
    for y in prange(height):
        agreement = np.empty(width, np.float32)
        for k in range(min(block.shape[2], count - first)):
            agreement[:] = 0
            own = maps[first + k, y]
            for m in range(count):
                if m == first + k:
                    continue
                weight, other = weights[m], maps[m, y]
                for x in range(own.size):
                    agreement[x] += weight * min(max(no_agreement - abs(own[x] - other[x]), zero), one)
            for x in range(width):
                block[y, x, k] = one - agreement[x] / others[first + k] if others[first + k] > 0 else zero


@parallel_jit
def _contradict(maps: Any, first: int, right: Any, hidden: Any, block: Any) -> None:
    count, height, width = maps.shape
    one = np.float32(1)
    for y in prange(height):
        for k in range(min(block.shape[2], count - first)):
            row = maps[first + k, y]
            for x in range(width):
                u = int(np.floor(np.float32(x) - row[x] + np.float32(0.5)))
                if u < 0:
                    block[y, x, k] = hidden
                    continue
                nearer = row[x] - np.float32(right[y, u])
                if nearer > one:
                    block[y, x, k] = min(nearer - one, one)
                elif nearer < -one:
                    block[y, x, k] = hidden

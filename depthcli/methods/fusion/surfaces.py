"""Maps as surfaces: costs of their disparities, misfits of their neighbors, and the best mix of two of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.graph_cut import binary_cut
from depthcli.core import memory
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.fusion.support import LANES, NOTHING, ColorSupport
from depthcli.methods.stereo.volume import CostVolume


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
    weights : (2, H, W) float32 of the pairs along the rows and along the columns; 0 for those that leave the image
    truncation : pixels
    """

    weights: NDArray[np.float32]
    truncation: float

    @classmethod
    def of(
        cls, image: NDArray[np.uint8], strength: float, color_scale: float, floor: float, truncation: float
    ) -> Smoothness:
        """Return weights ``strength max(exp(-color / color_scale), floor)``; color: the largest channel difference."""
        levels = image.astype(np.int16)
        weights = np.zeros((2, *image.shape[:2]), np.float32)
        across = np.abs(levels[:, 1:] - levels[:, :-1]).max(axis=2)
        down = np.abs(levels[1:] - levels[:-1]).max(axis=2)
        weights[0, :, :-1] = strength * np.maximum(np.exp(-across / color_scale), floor)
        weights[1, :-1] = strength * np.maximum(np.exp(-down / color_scale), floor)
        return cls(weights, truncation)

    def energy(self, surface: Surface) -> float:
        """Return the sum of all costs of a surface."""
        rows = np.zeros(surface.values.shape[0], np.float64)
        _energy(surface.values, surface.slopes, surface.cost, self.weights, np.float32(self.truncation), rows)
        return float(rows.sum())

    def move(self, current: Surface, proposal: Surface, min_difference: float) -> NDArray[np.bool_] | None:
        """Return the pixels (H, W) at which ``proposal`` replaces ``current`` in the best mix; None: nothing is gained.

        One minimum cut (fusion moves: Lempitsky et al., PAMI 2010). Pairs that it cannot represent cost more when
        exactly one of the two switches; so the energy is compared at the end.

        Parameters
        ----------
        min_difference : where the two differ by less, ``current`` stays, pixels
        """
        shape = current.values.shape
        index = np.full(shape, -1, np.int64)
        apart = np.abs(proposal.values - current.values) >= min_difference
        count = int(apart.sum())
        if count == 0:
            return None
        index[apart] = np.arange(count)
        score = np.zeros(count, np.float64)
        p, q = np.empty(2 * count, np.int64), np.empty(2 * count, np.int64)
        capacity = np.empty(2 * count, np.float64)
        pairs = _binary_problem(
            current.values, current.slopes, current.cost, proposal.values, proposal.slopes, proposal.cost,
            self.weights, np.float32(self.truncation), index, score, p, q, capacity,
        )  # fmt: skip
        chosen = np.zeros(shape, np.bool_)
        chosen[apart] = binary_cut(score, p[:pairs], q[:pairs], capacity[:pairs])
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
    block = memory.empty((height, width, LANES), np.float32)
    for first in range(0, count, LANES):
        block[:] = NOTHING
        fill(maps, first, *inputs, block)
        support.sum(block)
        for k in range(first, min(count, first + LANES)):
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


@jit
def misfit(here: Any, there: Any, slope_here: Any, slope_there: Any, truncation: Any) -> Any:
    """Return by how much the slopes of two neighbors do not lead from one to the other, pixels."""
    step = there - here
    return min(truncation, np.float32(0.5) * (abs(step - slope_here) + abs(step - slope_there)))


@parallel_jit
def _energy(values: Any, slopes: Any, cost: Any, weights: Any, truncation: Any, rows: Any) -> None:
    height, width = values.shape
    for y in prange(height):
        total = 0.0
        for x in range(width):
            total += cost[y, x]
            if x + 1 < width:
                a, b = slopes[0, y, x], slopes[0, y, x + 1]
                total += weights[0, y, x] * misfit(values[y, x], values[y, x + 1], a, b, truncation)
            if y + 1 < height:
                a, b = slopes[1, y, x], slopes[1, y + 1, x]
                total += weights[1, y, x] * misfit(values[y, x], values[y + 1, x], a, b, truncation)
        rows[y] = total


@jit
def _binary_problem(  # type: ignore[no-untyped-def]
    values0, slopes0, cost0, values1, slopes1, cost1, weights, truncation, index, score, p, q, capacity
):
    """Cost of x = 1 (switch) minus cost of x = 0 of the nodes ``index`` >= 0, and the pairs between them.

    Pair costs are E00 + (E10 - E00) x_p + (E11 - E10) x_q + (E01 + E10 - E00 - E11) (1 - x_p) x_q; the last factor is
    raised to 0 where it is negative. A neighbor that is no node stays.
    """
    height, width = values0.shape
    pairs = 0
    for y in range(height):
        for x in range(width):
            i = index[y, x]
            if i >= 0:
                score[i] += cost1[y, x] - cost0[y, x]
            for axis in range(2):
                v, u = y + axis, x + 1 - axis
                if v >= height or u >= width:
                    continue
                j = index[v, u]
                if i < 0 and j < 0:
                    continue
                w = weights[axis, y, x]
                here0, there0 = values0[y, x], values0[v, u]
                here1, there1 = values1[y, x], values1[v, u]
                slope_here0, slope_there0 = slopes0[axis, y, x], slopes0[axis, v, u]
                slope_here1, slope_there1 = slopes1[axis, y, x], slopes1[axis, v, u]
                e00 = w * misfit(here0, there0, slope_here0, slope_there0, truncation)
                if j < 0:
                    score[i] += w * misfit(here1, there0, slope_here1, slope_there0, truncation) - e00
                elif i < 0:
                    score[j] += w * misfit(here0, there1, slope_here0, slope_there1, truncation) - e00
                else:
                    e10 = w * misfit(here1, there0, slope_here1, slope_there0, truncation)
                    e01 = w * misfit(here0, there1, slope_here0, slope_there1, truncation)
                    e11 = w * misfit(here1, there1, slope_here1, slope_there1, truncation)
                    score[i] += e10 - e00
                    score[j] += e11 - e10
                    p[pairs], q[pairs] = i, j
                    capacity[pairs] = max(e01 + e10 - e00 - e11, np.float32(0))
                    pairs += 1
    return pairs

"""Choice by a small network that was trained where maps like these are wrong, and its inputs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr

from depthcli.algorithms.filters import CORRELATED, correlation, local_moments
from depthcli.algorithms.pixel_network import TILE, TrainedNetwork, log_odds
from depthcli.algorithms.plane_fitting.window_slopes import slopes
from depthcli.core import memory
from depthcli.core.errors import InputError
from depthcli.kernels.exponential import exp_minus
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.fusion import map_costs as costs_of
from depthcli.methods.fusion.choice import ChoiceMethod, ChosenMap, Proposals
from depthcli.methods.fusion.map_costs import cost_between, nearest_matches, warped_right
from depthcli.methods.fusion.votes import BLOCK_DEPTH, NO_VOTE, ColorSupport

MAX_MAPS = BLOCK_DEPTH
"""Most maps that are chosen among: all shares of a pixel are averaged in one block."""

PROPOSAL_PLANES = (
    *("cost_wide", "jump_wide", "disagreement_wide", "contradiction_wide"),
    *("cost_region", "jump_region", "disagreement_region", "contradiction_region"),
    *("disagreement_narrow", "contradiction_narrow", "cost_narrow", "hidden_narrow"),
    *("decorrelation", "color_difference", "color_difference_5", "excess_cost", "right_view_difference"),
    *("match_column", "self_occlusion", "roughness", "roughness_9", "slope_x", "slope_y"),
    *("above_mean_11", "above_mean_25", "filled"),
)
"""Planes of every proposal, one value per pixel, in their order. ``narrow``, ``wide`` and ``region`` are means over
that support; numbers are the sides of windows in pixels.

| plane | what it measures |
|---|---|
| ``cost`` | fused costs along the map |
| ``disagreement`` | share of the other maps that disagree |
| ``decorrelation`` | 1 - correlation of the left image and the right one, warped by the map |
| ``color_difference`` | largest channel difference of these two, grey levels |
| ``contradiction``, ``hidden`` | by the right view: in front of what it sees; behind it, or outside |
| ``excess_cost`` | cost above the pixel's smallest one |
| ``right_view_difference`` | to the disparity of the match in the right view, pixels |
| ``match_column`` | column of the match in the right image, at most 20 from its border, pixels |
| ``self_occlusion`` | by how much a nearer pixel of the map covers the match, pixels |
| ``roughness`` | misfits of the four neighbors, pixels |
| ``slope_x``, ``slope_y`` | change to the next pixel of the row, of the column, pixels |
| ``above_mean`` | disparity above the mean of a window, pixels |
| ``filled`` | 0 measured, 1 filled, 2 filled and occluded |
| ``jump`` | steps to the neighbors beyond a pixel where the color stays the same |
"""
RELATIVE = (
    *("cost_wide", "cost_narrow", "decorrelation", "color_difference_5"),
    *("cost_region", "disagreement_region", "contradiction_region", "jump_wide", "jump_region"),
)
"""These planes are also given relative to the smallest value among the proposals (``<name>_relative``)."""
PIXEL_PLANES = ("min_cost", "deviation_5", "deviation_13", "gradient", "filled_share", "light_trust")
"""Planes of the pixel, the same for all proposals: its smallest cost, standard deviations of windows and gradient of
the left image (grey levels), share of the proposals that are filled, and how far its light is trusted (0 .. 1)."""

# Networks are trained with these; another value needs another training.
_MAX_DISTANCE = np.float32(4.0)  # between two proposals, pixels
_MAX_COLOR = np.float32(40.0)  # of color differences and deviations, grey levels
_MAX_MISFIT = 2.0  # between neighbors, pixels
_REACH = 9  # half side of the window that slopes are fitted in, pixels
_RELATIVE_INDICES = np.array([PROPOSAL_PLANES.index(name) for name in RELATIVE])


def input_names(kinds: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the inputs, in their order, for proposals of these kinds."""
    relative = (f"{name}_relative" for name in RELATIVE)
    distances = (f"distance_{k}_{kind}" for k, kind in enumerate(kinds))
    return (*PROPOSAL_PLANES, *relative, *distances, *PIXEL_PLANES)


@dataclass(frozen=True)
class NetworkInputs:
    """Inputs of a pair's proposals, as planes; :meth:`rows` puts them side by side."""

    values: NDArray[np.float32]  # (N, P) float32, the proposals' disparities at P pixels
    own: NDArray[np.float32]  # (len(PROPOSAL_PLANES), N, P) float32, planes of every proposal
    shared: NDArray[np.float32]  # (len(PIXEL_PLANES), P) float32, planes of the pixel

    @classmethod
    def of(cls, proposals: Proposals) -> NetworkInputs:
        """Compute the inputs of all pixels, which are numbered row by row."""
        maps, pair, volume = proposals.values, proposals.pair, proposals.volume
        count, height, width = maps.shape
        image = pair.color8[0]
        own = memory.empty((len(PROPOSAL_PLANES), count, height, width), np.float32)
        plane = {name: own[k] for k, name in enumerate(PROPOSAL_PLANES)}
        # The first three rows of names: four means over each support, of neighbors among these six.
        cost, jump, disagreement, contradiction, uncut, hidden = raw = np.empty((6, *maps.shape), np.float32)
        uncut[:] = costs_of.matching_costs(maps, volume, 1.5)
        np.minimum(uncut, np.float32(0.7), out=cost)
        jump[:] = costs_of.hidden_jumps(maps, image)
        disagreement[:] = costs_of.disagreements(maps, np.ones(count, np.float32))
        contradiction[:] = costs_of.contradictions(maps, proposals.right, -1.0)
        np.less(contradiction, 0, out=hidden, casting="unsafe")
        np.maximum(contradiction, 0, out=contradiction)
        supports = (proposals.wide, raw[:4]), (proposals.region, raw[:4]), (proposals.narrow, raw[2:])
        for k, (support, planes) in enumerate(supports):
            flat = -1, height, width
            support.mean(planes.reshape(flat), out=own[4 * k : 4 * k + 4].reshape(flat))
        grey = [channel.astype(np.float32) for channel in pair.grey8]
        shared = np.zeros((len(PIXEL_PLANES), height, width), np.float32)
        pixel = {name: shared[k] for k, name in enumerate(PIXEL_PLANES)}
        unit = np.float32(1 / volume.scale)
        _smallest(volume.costs, unit, pixel["min_cost"])
        for side in (5, 13):
            pixel[f"deviation_{side}"][:] = np.minimum(np.sqrt(local_moments(grey[0], side)[1]), _MAX_COLOR)
        pixel["gradient"][:] = np.minimum(np.abs(cv2.Sobel(grey[0], cv2.CV_32F, 1, 0)) / 8, 30)
        plane["filled"][:] = proposals.filled
        pixel["filled_share"][:] = (proposals.filled > 0).mean(axis=0)
        pixel["light_trust"][:] = 1 if pair.light_trust is None else pair.light_trust / np.float32(255)
        warped = np.empty((height, width), np.float32)
        moments = local_moments(grey[0], CORRELATED)
        compared = ("excess_cost", "right_view_difference", "match_column", "self_occlusion", "color_difference")
        views = (proposals.right, image, pair.color8[1], grey[1], pixel["min_cost"], warped)
        for k, values in enumerate(maps):
            _compare_views(values, volume.costs, unit, *views, *(plane[name][k] for name in compared))
            plane["color_difference_5"][k] = cv2.blur(plane["color_difference"][k], (5, 5))
            plane["decorrelation"][k] = 1 - correlation(grey[0], moments, warped)
            slope = slopes(values, image, _REACH)
            plane["slope_x"][k], plane["slope_y"][k] = slope
            rough = np.zeros_like(values)  # sum of the misfits of the four neighbors: left, right, upper, lower
            for axis, (here, there) in enumerate(costs_of.NEIGHBORS):
                ends = values[here], values[there], slope[axis][here], slope[axis][there]
                cost = costs_of.misfit(*ends, _MAX_MISFIT)
                rough[there] += cost
                rough[here] += cost
            plane["roughness"][k], plane["roughness_9"][k] = rough, cv2.blur(rough, (9, 9))
            for side in (11, 25):
                plane[f"above_mean_{side}"][k] = np.clip(values - cv2.blur(values, (side, side)), -6, 6)
        return cls(maps.reshape(count, -1), own.reshape(*own.shape[:2], -1), shared.reshape(len(shared), -1))

    @cached_property
    def _lowest(self) -> NDArray[np.float32]:
        return np.stack([self.own[k].min(axis=0) for k in _RELATIVE_INDICES])

    def of_proposal(self, n: int, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return the inputs of proposal ``n`` in the order of :func:`input_names`, (inputs, P) float32.

        ``out``: what another proposal of the same pixels was given, to be overwritten.
        """
        own, relative, near = np.cumsum([len(self.own), len(RELATIVE), len(self.values)])
        if out is None:
            out = memory.empty((near + len(self.shared), self.values.shape[1]), np.float32)
            out[near:] = self.shared
        out[:own] = self.own[:, n]
        for k, at in enumerate(_RELATIVE_INDICES):
            np.subtract(self.own[at, n], self._lowest[k], out=out[own + k])
        distances = out[relative:near]
        np.abs(np.subtract(self.values, self.values[n], out=distances), out=distances)
        np.minimum(distances, _MAX_DISTANCE, out=distances)
        return out

    def rows(self, pixels: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the inputs of some pixels, (len(pixels), N, inputs) float32."""
        return np.stack([self.of_proposal(n)[:, pixels].T for n in range(len(self.values))], axis=1)


@parallel_jit
def _smallest(costs, unit, out):
    for y in prange(costs.shape[0]):
        for x in range(costs.shape[1]):
            out[y, x] = np.float32(costs[y, x].min()) * unit


@parallel_jit
def _compare_views(
    values, costs, unit, right, image, other, grey, lowest, warped, excess, difference, column, hidden, color
):
    height, width = values.shape
    half = np.float32(0.5)
    for y in prange(height):
        nearest = nearest_matches(values[y])
        for x in range(width):
            value = values[y, x]
            excess[y, x] = cost_between(costs[y, x], value) * unit - lowest[y, x]
            column[y, x] = min(max(np.float32(x) - value, np.float32(-20)), np.float32(20))
            u = int(np.floor(np.float32(x) - value + half))
            if u < 0:
                difference[y, x] = np.float32(-6)
                hidden[y, x] = np.float32(0)
            else:
                difference[y, x] = min(max(value - np.float32(right[y, u]), np.float32(-5)), np.float32(5))
                hidden[y, x] = min(nearest[u] - value, np.float32(6))
            warped[y, x], largest = warped_right(x, value, image[y], other[y], grey[y])
            color[y, x] = min(largest, _MAX_COLOR)


class NetworkChoice(ChoiceMethod):
    """The proposal that a small network finds most likely to be right within a pixel.

    For every proposal of a pixel the network, the same one for all pixels, gets some forty inputs: the costs along it,
    which others agree, what the right view says, its shape. Its outputs become shares by a softmax over the
    proposals, are averaged over neighbors of similar color, and the largest share wins. Selecting by a trained
    classifier among what several scanline optimizations propose goes back to Schoenberger, Sinha and Pollefeys (ECCV
    2018); the probability of the winner is a confidence. `scripts/train_choice.py` trains networks for other proposals.
    """

    confidences: ClassVar[tuple[str, ...]] = ("probability",)

    weights: str = Field("accurate", description="a network of the package, or a .json file that training wrote")
    _trained: TrainedNetwork | None = PrivateAttr(None)

    @property
    def network_name(self) -> str | None:
        return self.weights

    def with_network(self, trained: TrainedNetwork, maps: tuple[str, ...]) -> Self:
        if trained.maps != maps:
            own, here = ", ".join(trained.maps), ", ".join(maps)
            hint = "train one (scripts/train_choice.py) or choose by 'energy'"
            raise InputError(f"network {self.weights!r} was trained for the maps {own}; here they are {here}: {hint}")
        units = [weights.shape[1] for weights, _ in trained.layers[:2]]
        if trained.inputs != input_names(maps) or any(n % TILE for n in units) or len(maps) > MAX_MAPS:
            raise InputError(f"network {self.weights!r} was trained for another version: its inputs are not these")
        copy = self.model_copy()
        copy._trained = trained
        return copy

    def __call__(self, proposals: Proposals) -> ChosenMap:
        if self._trained is None:
            raise ValueError(f"network {self.weights!r}: hand its arrays in with with_network first")
        count, height, width = proposals.values.shape
        odds = log_odds_of(self._trained, NetworkInputs.of(proposals)).reshape(count, height, width)
        return ChosenMap(*likeliest(proposals.values, odds, proposals.narrow))

    def bytes_per_pixel(self, count: int) -> int:
        return 4 * (count * (len(PROPOSAL_PLANES) + 12) + 90 + len(PIXEL_PLANES) + 2 * MAX_MAPS) + 100


def likeliest(
    maps: NDArray[np.float32], odds: NDArray[np.float32], support: ColorSupport
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the values whose share of the softmax of ``odds`` (N, H, W), averaged over the support, is largest.

    Returned with them is the probability that they are right, by their own odds; both (H, W).
    """
    _, height, width = maps.shape
    shares = memory.empty((height, width, MAX_MAPS), np.float32)
    _softmax(odds, shares)
    support.sum(shares)
    values, probability = (np.empty((height, width), np.float32) for _ in range(2))
    _take_largest(maps, odds, shares, values, probability)
    return values, probability


def log_odds_of(trained: TrainedNetwork, inputs: NetworkInputs) -> NDArray[np.float32]:
    """Return the log odds of every proposal to be right, (N, P) float32."""
    nothing = np.empty((0, inputs.values.shape[1]), np.float32)
    odds, planes = np.empty(inputs.values.shape, np.float32), None
    for n, offsets in enumerate(trained.layers[0][1]):
        planes = inputs.of_proposal(n, planes)
        odds[n] = log_odds(trained, offsets, planes, nothing)
    return odds


@parallel_jit
def _softmax(log_odds, shares):
    count, height, width = log_odds.shape
    for y in prange(height):
        for x in range(width):
            largest = log_odds[0, y, x]
            for n in range(1, count):
                largest = max(largest, log_odds[n, y, x])
            cells = shares[y, x]
            cells[:] = NO_VOTE
            total = np.float32(0)
            for n in range(count):
                cells[n] = exp_minus(largest - log_odds[n, y, x])
                total += cells[n]
            for n in range(count):
                cells[n] = cells[n] / total + NO_VOTE


@parallel_jit
def _take_largest(maps, log_odds, shares, values, probability):
    count, height, width = maps.shape
    one = np.float32(1)
    for y in prange(height):
        for x in range(width):
            best = 0
            for n in range(1, count):
                if shares[y, x, n] > shares[y, x, best]:
                    best = n
            values[y, x] = maps[best, y, x]
            odds = log_odds[best, y, x]
            e = exp_minus(abs(odds))
            probability[y, x] = one / (one + e) if odds > 0 else e / (one + e)

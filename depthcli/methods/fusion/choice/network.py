"""Choice by a small trained network, and the network's inputs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr

from depthcli.algorithms.filters import add, window_means
from depthcli.algorithms.pixel_network import (
    CHUNK,
    TILE,
    TrainedNetwork,
    at_least_wide,
    kernel_layers,
    run_layers,
    set_input,
)
from depthcli.algorithms.plane_fitting.window_slopes import slopes
from depthcli.core import memory
from depthcli.core.errors import InputError
from depthcli.core.maps import Floats
from depthcli.kernels.exponential import exp_minus
from depthcli.kernels.jit import empty, helper, jit, run_bands
from depthcli.kernels.lanes import WIDE, absolute_difference, load_like, minimum, splat_like, store, wide_zero
from depthcli.methods.fusion.choice import ChoiceMethod, ChosenMap, Proposals
from depthcli.methods.fusion.map_costs import disagreements, hidden_jumps, image_planes, misfit_of_pixels
from depthcli.methods.fusion.votes import BLOCK_DEPTH, NO_VOTE, Support

MAX_MAPS = BLOCK_DEPTH
"""Largest number of maps to choose among: all shares of a pixel are averaged in one block."""

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

Planes that are not in this table are described with ``map_costs.VIEW_PLANES``.

| plane | measure |
|---|---|
| ``disagreement`` | share of the other maps that disagree |
| ``decorrelation`` | 1 - correlation of the left image and the right one, warped by the map |
| ``roughness`` | misfits of the four neighbors, pixels |
| ``slope_x``, ``slope_y`` | change to the next pixel of the row, of the column, pixels |
| ``above_mean`` | disparity above the mean of a window, pixels |
| ``filled`` | 0 measured, 1 filled, 2 filled and occluded |
| ``jump`` | steps of more than a pixel to neighbors of the same color |
"""
RELATIVE = (
    *("cost_wide", "cost_narrow", "decorrelation", "color_difference_5"),
    *("cost_region", "disagreement_region", "contradiction_region", "jump_wide", "jump_region"),
)
"""Planes that are also given relative to the smallest value among the proposals (``<name>_relative``)."""
PIXEL_PLANES = ("min_cost", "deviation_5", "deviation_13", "gradient", "filled_share", "light_trust")
"""Planes of the pixel, the same for all proposals: its smallest cost, standard deviations of windows and gradient of
the left image (grey levels), share of the proposals that are filled, and trust in its light (0 .. 1)."""
AGREEING = 1.5
"""Proposals that are closer than this agree, pixels. Chosen on held-out data sets."""

# Networks are trained with these values; other values need another training.
_MAX_DISTANCE = np.float32(4.0)  # between two proposals, pixels
_MAX_COSTS = (0.7, 1.5)  # along a map: for means over the wide supports, over the narrow one
_MAX_MISFIT = np.float32(2.0)  # between neighbors, pixels
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

    values: Floats  # (N, P) float32, the proposals' disparities at P pixels
    own: Floats  # (len(PROPOSAL_PLANES), N, P) float32, planes of every proposal
    shared: Floats  # (len(PIXEL_PLANES), P) float32, planes of the pixel

    @classmethod
    def of(cls, proposals: Proposals) -> NetworkInputs:
        """Compute the inputs of all pixels, which are numbered row by row."""
        maps, image = proposals.values, proposals.pair.color8[0]
        count, height, width = maps.shape
        own = memory.empty((len(PROPOSAL_PLANES), *maps.shape), np.float32)
        plane = dict(zip(PROPOSAL_PLANES, own, strict=True))
        shared = memory.empty((len(PIXEL_PLANES), height, width), np.float32)
        pixel = dict(zip(PIXEL_PLANES, shared, strict=True))
        # The first three rows of names: means over each support, of four consecutive planes of these six.
        cost, jump, disagreement, contradiction, uncut, hidden = raw = memory.empty((6, *maps.shape), np.float32)
        warped = memory.empty(maps.shape, np.float32)
        views = {"cost": cost, "uncut_cost": uncut, "contradiction": contradiction, "hidden": hidden, "warped": warped}
        pixel["min_cost"][:] = proposals.compare(maps, plane | views, _MAX_COSTS)
        hidden_jumps(maps, image, jump)
        disagreements(maps, np.ones(count, np.float32), disagreement)
        supports = (proposals.wide, raw[:4]), (proposals.region, raw[:4]), (proposals.narrow, raw[2:])
        for k, (support, planes) in enumerate(supports):
            flat = -1, height, width
            support.mean(planes.reshape(flat), out=own[4 * k : 4 * k + 4].reshape(flat))
        image_planes(proposals.grey[0], (5, 13), pixel)
        plane["filled"][:] = proposals.filled
        pixel["filled_share"][:] = (proposals.filled > 0).mean(axis=0)
        pixel["light_trust"][:] = proposals.light_trust
        window_means(plane["color_difference"], 5, plane["color_difference_5"])
        proposals.decorrelation(warped, plane["decorrelation"])
        for k, values in enumerate(maps):
            plane["slope_x"][k], plane["slope_y"][k] = slopes(values, image, _REACH)
        run_bands(_misfits, height, maps, plane["slope_x"], plane["slope_y"], plane["roughness"])
        for rough, mean in zip(plane["roughness"], plane["roughness_9"], strict=True):
            cv2.blur(rough, (9, 9), dst=mean)  # many are 0, where sums in another order leave other remainders
        for side in (11, 25):
            above = window_means(maps, side, plane[f"above_mean_{side}"])
            np.clip(np.subtract(maps, above, out=above), -6, 6, out=above)
        return cls(maps.reshape(count, -1), own.reshape(*own.shape[:2], -1), shared.reshape(len(shared), -1))

    def rows(self, pixels: NDArray[np.int64]) -> Floats:
        """Return the inputs of some pixels in the order of :func:`input_names`, (len(pixels), N, inputs) float32."""
        own, values = self.own[:, :, pixels], self.values[:, pixels]
        compared = own[_RELATIVE_INDICES]
        relative = compared - compared.min(axis=1, keepdims=True)
        distances = np.minimum(np.abs(values[:, None] - values), _MAX_DISTANCE)
        shared = np.repeat(self.shared[:, None, pixels], len(values), axis=1)
        return np.concatenate([own, relative, distances, shared]).transpose(2, 1, 0)


@jit
def _misfits(begin, end, maps, slope_x, slope_y, out):
    # Sums over the four neighbors: left, right, upper, lower.
    count, height, width = maps.shape
    for y in range(begin, end):
        misfit = empty(width, np.float32)
        for n in range(count):
            row, total = maps[n, y], out[n, y]
            total[:] = 0
            _misfit_of_neighbors(row[:-1], row[1:], slope_x[n, y, :-1], slope_x[n, y, 1:], misfit)
            add(misfit, total[1:])
            add(misfit, total[:-1])
            for first in (y - 1, y):
                if 0 <= first < height - 1:
                    second, upper, lower = first + 1, slope_y[n, first], slope_y[n, first + 1]
                    _misfit_of_neighbors(maps[n, first], maps[n, second], upper, lower, misfit)
                    add(misfit, total)


@helper
def _misfit_of_neighbors(here, there, slope_here, slope_there, out):
    for x in range(here.size):
        out[x] = min(misfit_of_pixels(here[x], there[x], slope_here[x], slope_there[x]), _MAX_MISFIT)


class NetworkChoice(ChoiceMethod):
    """The proposal that a small network rates most likely to be correct within a pixel, mixed with those that agree.

    For every proposal of a pixel the network, the same one for all pixels, gets some forty inputs: the costs along it,
    the other maps that agree, its match in the right view, its shape. Its outputs become shares by a softmax over the
    proposals and are averaged over neighbors of similar color. The winner is the proposal with the largest share, to
    which agreeing proposals add half of theirs. The value is the mean of the proposals that agree, weighted by their
    shares. Schoenberger, Sinha and Pollefeys (ECCV 2018) introduced the selection by a trained classifier among the
    proposals of several scanline optimizations. The probability of the winner is a confidence.
    `scripts/train_choice.py` trains networks for other proposals.
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
        return ChosenMap(*likeliest(proposals.values, odds, proposals.narrow, AGREEING))

    def bytes_per_pixel(self, count: int) -> int:
        return 4 * (count * (len(PROPOSAL_PLANES) + 12) + 90 + len(PIXEL_PLANES) + 2 * MAX_MAPS) + 100


def likeliest(maps: Floats, odds: Floats, support: Support, agreeing: float = 0.0) -> tuple[Floats, Floats]:
    """Return the values with the largest share of the softmax of ``odds`` (N, H, W), averaged over the support.

    The agreement of two maps falls to 0 at ``agreeing`` pixels (0: none agrees). Half of the shares that agree count
    for a map, too, and the value is the mean weighted by shares and agreement. Also return the probability that the
    chosen map is correct, by its own odds. Both are (H, W) float32.
    """
    _, height, width = maps.shape
    shares = memory.empty((height, width, MAX_MAPS), np.float32)
    run_bands(_softmax, height, odds, shares)
    support.sum(shares)
    values, probability = (np.empty((height, width), np.float32) for _ in range(2))
    run_bands(_take_largest, height, maps, odds, shares, np.float32(agreeing), values, probability)
    return values, probability


def log_odds_of(trained: TrainedNetwork, inputs: NetworkInputs) -> Floats:
    """Return the log odds of every proposal to be correct, (N, P) float32."""
    own, shared, values = (at_least_wide(planes) for planes in (inputs.own, inputs.shared, inputs.values))
    odds = np.empty(values.shape, np.float32)
    network = trained.mean, trained.scale, trained.layers[0][1], *kernel_layers(trained)
    run_bands(
        _evaluate, -(-values.shape[1] // CHUNK), own, shared, values, _RELATIVE_INDICES, *network, odds.reshape(-1)
    )
    return odds[:, : inputs.values.shape[1]]


@jit
def _evaluate(begin, end, own, shared, values, relative, mean, scale, offsets, w1, w2, b2, w3, b3, out):
    # Inputs, in the order of NetworkInputs.rows, are only computed and stored for a few pixels at a time.
    count, pixels = values.shape
    n_own, n_relative = own.shape[0], relative.size
    last = mean.size - shared.shape[0]
    for task in range(begin, end):
        inputs = empty(mean.size * WIDE, np.float32)
        lowest = empty(n_relative * WIDE, np.float32)
        hidden = empty((w1.shape[0] + w2.shape[0]) * TILE * WIDE, np.float32)
        zero, start = wide_zero(), task * CHUNK
        largest = splat_like(zero, _MAX_DISTANCE)
        for at in range(start, min(pixels, start + CHUNK), WIDE):
            first = min(at, pixels - WIDE)  # the last ones overlap others, with the same result
            for k in range(shared.shape[0]):
                plane = load_like(zero, shared, k * pixels + first)
                set_input(plane, mean[last + k], scale[last + k], inputs, last + k)
            for k in range(n_relative):
                smallest = load_like(zero, own, relative[k] * count * pixels + first)
                for n in range(1, count):
                    plane = load_like(zero, own, (relative[k] * count + n) * pixels + first)
                    smallest = minimum(smallest, plane)
                store(lowest, k * WIDE, smallest)
            for n in range(count):
                for k in range(n_own):
                    plane = load_like(zero, own, (k * count + n) * pixels + first)
                    set_input(plane, mean[k], scale[k], inputs, k)
                for k in range(n_own, n_own + n_relative):
                    plane = load_like(zero, own, (relative[k - n_own] * count + n) * pixels + first)
                    above = plane - load_like(zero, lowest, (k - n_own) * WIDE)
                    set_input(above, mean[k], scale[k], inputs, k)
                value = load_like(zero, values, n * pixels + first)
                for k in range(n_own + n_relative, last):
                    other = load_like(zero, values, (k - n_own - n_relative) * pixels + first)
                    distance = minimum(absolute_difference(other, value), largest)
                    set_input(distance, mean[k], scale[k], inputs, k)
                run_layers(inputs, offsets[n], w1, w2, b2, w3, b3, hidden, out, n * pixels + first)


@jit
def _softmax(begin, end, log_odds, shares):
    count, _, width = log_odds.shape
    for y in range(begin, end):
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


@helper
def _agreement(first, second, reach):
    apart = abs(first - second)
    return np.float32(1) - apart / reach if apart < reach else np.float32(0)


@jit
def _take_largest(begin, end, maps, log_odds, shares, reach, values, probability):
    count, _, width = maps.shape
    one, half = np.float32(1), np.float32(0.5)
    for y in range(begin, end):
        for x in range(width):
            best, largest = 0, np.float32(-1)
            for n in range(count):
                score = shares[y, x, n]
                for m in range(count):
                    if m != n:
                        score += half * shares[y, x, m] * _agreement(maps[m, y, x], maps[n, y, x], reach)
                if score > largest:
                    best, largest = n, score
            chosen, weights, change = maps[best, y, x], shares[y, x, best], np.float32(0)
            for m in range(count):
                if m != best:
                    weight = shares[y, x, m] * _agreement(maps[m, y, x], chosen, reach)
                    weights += weight
                    change += weight * (maps[m, y, x] - chosen)
            values[y, x] = chosen + change / weights
            odds = log_odds[best, y, x]
            e = exp_minus(abs(odds))
            probability[y, x] = one / (one + e) if odds > 0 else e / (one + e)

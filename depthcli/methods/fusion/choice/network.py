"""Choice by a small network that was trained where maps like these are wrong."""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr

from depthcli.core import memory
from depthcli.core.errors import InputError
from depthcli.core.networks import TrainedNetwork
from depthcli.kernels.exponential import exp_minus
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.kernels.lanes import LANES, load, minimum, splat, store
from depthcli.methods.fusion.choice import ChoiceMethod, ChosenMap, Proposals
from depthcli.methods.fusion.choice._inputs import (
    PIXEL_PLANES,
    PROPOSAL_PLANES,
    RELATIVE_INDICES,
    NetworkInputs,
    current_name,
    gather,
    input_names,
)
from depthcli.methods.fusion.votes import BLOCK_DEPTH, NO_VOTE

INPUT_BOUND = np.float32(4.0)  # standard deviations; scripts/train_choice.py clips at the same
_MAX_MAPS = BLOCK_DEPTH  # all shares of a pixel are averaged in one block
TILE = 4  # units of a layer that are summed at a time: their sums stay in registers


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
            raise InputError(
                f"network {self.weights!r} was trained for the maps {', '.join(trained.maps)}; "
                f"here they are {', '.join(maps)}: train one (scripts/train_choice.py) or choose by 'energy'"
            )
        units = [weights.shape[1] for weights, _ in trained.layers[:2]]
        inputs = tuple(map(current_name, trained.inputs))
        if inputs != input_names(maps) or any(n % TILE for n in units) or len(maps) > _MAX_MAPS:
            raise InputError(f"network {self.weights!r} was trained for another version: its inputs are not these")
        copy = self.model_copy()
        copy._trained = trained
        return copy

    def __call__(self, proposals: Proposals) -> ChosenMap:
        if self._trained is None:
            raise ValueError(f"network {self.weights!r}: hand its arrays in with with_network first")
        count, height, width = proposals.values.shape
        log_odds = log_odds_of(self._trained, NetworkInputs.of(proposals)).reshape(count, height, width)
        shares = memory.empty((height, width, _MAX_MAPS), np.float32)
        softmax(log_odds, shares)
        proposals.narrow.sum(shares)
        values = np.empty((height, width), np.float32)
        probability = np.empty((height, width), np.float32)
        take_largest(proposals.values, log_odds, shares, values, probability)
        return ChosenMap(values, probability)

    def bytes_per_pixel(self, count: int) -> int:
        return 4 * (count * (len(PROPOSAL_PLANES) + 4) + len(PIXEL_PLANES) + 2 * _MAX_MAPS) + 100


def log_odds_of(trained: TrainedNetwork, inputs: NetworkInputs) -> NDArray[np.float32]:
    """Return the log odds of every proposal to be right, (N, P) float32."""
    out = np.empty(inputs.values.shape, np.float32)
    (w1, b1), (w2, b2), (w3, b3) = trained.layers
    planes = (inputs.values, inputs.own, inputs.shared, RELATIVE_INDICES, trained.mean, trained.scale)
    _log_odds(*planes, tiled(w1), b1, tiled(w2), b2, w3.ravel(), b3, out)
    return out


def tiled(weights: NDArray[np.float32]) -> NDArray[np.float32]:
    # (units / 4, inputs, 4): in the order in which the kernel reads them
    inputs, units = weights.shape
    return np.ascontiguousarray(weights.reshape(inputs, units // TILE, TILE).transpose(1, 0, 2))


@jit
def _positive(a):
    return splat(np.float32(0)) - minimum(splat(np.float32(0)) - a, splat(np.float32(0)))


@jit
def layer(source, inputs, weights, offsets, target):
    # Rectified units of LANES pixels: flat ``source`` and ``target`` hold LANES values an input, a unit.
    for tile in range(weights.shape[0]):
        w = weights[tile]
        a, b = splat(offsets[tile * TILE]), splat(offsets[tile * TILE + 1])
        c, d = splat(offsets[tile * TILE + 2]), splat(offsets[tile * TILE + 3])
        for i in range(inputs):
            x = load(source, i * LANES)
            a += splat(w[i, 0]) * x
            b += splat(w[i, 1]) * x
            c += splat(w[i, 2]) * x
            d += splat(w[i, 3]) * x
        store(target, (tile * TILE) * LANES, _positive(a))
        store(target, (tile * TILE + 1) * LANES, _positive(b))
        store(target, (tile * TILE + 2) * LANES, _positive(c))
        store(target, (tile * TILE + 3) * LANES, _positive(d))


@parallel_jit
def _log_odds(values, own, shared, relative, mean, scale, w1, b1, w2, b2, w3, b3, out):
    count, pixels = values.shape
    size = mean.size
    groups = (pixels + LANES - 1) // LANES
    chunk = 64
    for task in prange((groups + chunk - 1) // chunk):
        block = np.zeros((size, LANES), np.float32)
        flat = block.reshape(size * LANES)
        hidden = np.empty(w1.shape[0] * TILE * LANES, np.float32)
        second = np.empty(w2.shape[0] * TILE * LANES, np.float32)
        last = np.empty(LANES, np.float32)
        for group in range(task * chunk, min(groups, (task + 1) * chunk)):
            first = group * LANES
            for n in range(count):
                gather(values, own, shared, relative, n, first, block)
                for i in range(size):
                    cells = block[i]
                    for lane in range(LANES):
                        z = (cells[lane] - mean[i]) * scale[i]
                        cells[lane] = min(max(z, -INPUT_BOUND), INPUT_BOUND)
                layer(flat, size, w1, b1[n], hidden)
                layer(hidden, w1.shape[0] * TILE, w2, b2, second)
                total = splat(b3[0])
                for i in range(w3.size):
                    total += splat(w3[i]) * load(second, i * LANES)
                store(last, 0, total)
                for lane in range(min(LANES, pixels - first)):
                    out[n, first + lane] = last[lane]


@parallel_jit
def softmax(log_odds, shares):
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
def take_largest(maps, log_odds, shares, values, probability):
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

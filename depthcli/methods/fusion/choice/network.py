"""Choice by a small network that was trained where maps like these are wrong."""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr

from depthcli.algorithms.pixel_network import TILE, log_odds
from depthcli.core import memory
from depthcli.core.errors import InputError
from depthcli.core.networks import TrainedNetwork
from depthcli.kernels.exponential import exp_minus
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.fusion.choice import ChoiceMethod, ChosenMap, Proposals
from depthcli.methods.fusion.choice._inputs import (
    PIXEL_PLANES,
    PROPOSAL_PLANES,
    NetworkInputs,
    input_names,
)
from depthcli.methods.fusion.votes import BLOCK_DEPTH, NO_VOTE

_MAX_MAPS = BLOCK_DEPTH  # all shares of a pixel are averaged in one block


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
        if trained.inputs != input_names(maps) or any(n % TILE for n in units) or len(maps) > _MAX_MAPS:
            raise InputError(f"network {self.weights!r} was trained for another version: its inputs are not these")
        copy = self.model_copy()
        copy._trained = trained
        return copy

    def __call__(self, proposals: Proposals) -> ChosenMap:
        if self._trained is None:
            raise ValueError(f"network {self.weights!r}: hand its arrays in with with_network first")
        count, height, width = proposals.values.shape
        odds = log_odds_of(self._trained, NetworkInputs.of(proposals)).reshape(count, height, width)
        shares = memory.empty((height, width, _MAX_MAPS), np.float32)
        softmax(odds, shares)
        proposals.narrow.sum(shares)
        values = np.empty((height, width), np.float32)
        probability = np.empty((height, width), np.float32)
        take_largest(proposals.values, odds, shares, values, probability)
        return ChosenMap(values, probability)

    def bytes_per_pixel(self, count: int) -> int:
        return 4 * (count * (len(PROPOSAL_PLANES) + 6) + 90 + len(PIXEL_PLANES) + 2 * _MAX_MAPS) + 100


def log_odds_of(trained: TrainedNetwork, inputs: NetworkInputs) -> NDArray[np.float32]:
    """Return the log odds of every proposal to be right, (N, P) float32."""
    nothing = np.empty((0, inputs.values.shape[1]), np.float32)
    offsets = trained.layers[0][1]
    return np.stack([log_odds(trained, row, inputs.of_proposal(n), nothing) for n, row in enumerate(offsets)])


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

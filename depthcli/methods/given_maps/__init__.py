"""Disparity maps that any program made: how likely every pixel is to be right, what is hidden, the best of several.

In: a pair and maps of its left view. Out: a :class:`MapJudgment` of the first one, to which the others are witnesses;
or, of :mod:`.fusion`, one map. :class:`MapJudge` computes the costs of the pair (``_evidence``, those of the preset
``stereo fast``), planes of what they, the map's shape and the other maps say of every pixel (``_planes``), and has a
small network weigh them (``_network``). Single planes are measures of their own (``measures``).
`scripts/train_confidence.py` trains the network on tuning scenes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PrivateAttr

from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.networks import TrainedNetwork
from depthcli.core.result import Clock, Result
from depthcli.methods.given_maps._evidence import BYTES_PER_CELL, BYTES_PER_PIXEL, Evidence
from depthcli.methods.given_maps._network import log_odds
from depthcli.methods.given_maps._planes import ALONE, INPUTS, alone_planes, other_planes
from depthcli.methods.given_maps.measures import Judged, map_measures, measure_name, measured
from depthcli.methods.stereo.refinement.background_fill import fill_background

__all__ = [
    "HIDDEN",
    "RIGHT_NAMES",
    "THRESHOLDS",
    "MapJudge",
    "MapJudgment",
    "Networks",
    "judged_maps",
    "map_measures",
    "odds_of",
]

THRESHOLDS = (0.5, 1.0, 2.0, 4.0)
"""Pixels; the first layer of the network has a row of offsets for each."""
HIDDEN = "hidden"
"""Name of the offsets of the network that says what is hidden."""
RIGHT_NAMES = tuple(f"within {threshold:g}" for threshold in THRESHOLDS)


@dataclass(kw_only=True)
class MapJudgment(Result):
    """How likely every pixel of a map is to be right.

    Attributes
    ----------
    probability : (H, W) float32 in [0, 1]: of pixels with p, a share of p is right; 0 where the map has no value
    status : (H, W) uint8, bits of :class:`depthcli.core.maps.Status`: ``OCCLUDED``, hidden in the right view;
        ``OUT_OF_RANGE``, hidden since its match lies outside the right image; ``MISMATCH``, visible and more likely
        wrong than right; ``NO_DATA``, the map has no value; 0, none of these
    """

    probability: NDArray[np.float32]
    status: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Networks:
    """The networks that judge: of being right, with offsets for each threshold, and of being hidden.

    Raises
    ------
    InputError
        They were trained for other inputs.
    """

    right: TrainedNetwork
    hidden: TrainedNetwork

    def __post_init__(self) -> None:
        expected = ((self.right, RIGHT_NAMES, INPUTS), (self.hidden, (HIDDEN,), ALONE))
        for network, names, inputs in expected:
            units = [weights.shape[1] for weights, _ in network.layers[:2]]
            if network.maps != names or network.inputs != inputs or any(n % 4 for n in units):
                raise InputError("the network was trained for another version: its inputs are not these")

    def offsets(self, within: float) -> NDArray[np.float32]:
        """Return the offsets of the first layer for a threshold, between those it was trained for."""
        rows = self.right.layers[0][1]
        at = np.interp(np.log2(within), np.log2(THRESHOLDS), np.arange(len(THRESHOLDS)))
        low = min(int(at), len(rows) - 2)
        offsets: NDArray[np.float32] = rows[low] + np.float32(at - low) * (rows[low + 1] - rows[low])
        return offsets


class MapJudge(BaseModel):
    """Judges the map of a pair."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    within: float = Field(1.0, ge=0.25, le=8, description="error up to which a value counts as right, pixels")
    measures: tuple[Annotated[str, AfterValidator(measure_name)], ...] = Field(
        (), description="single measures that are also computed"
    )
    _networks: Networks | None = PrivateAttr(None)

    def with_networks(self, networks: Networks) -> Self:
        """Return a copy that judges by these networks."""
        copy = self.model_copy()
        copy._networks = networks
        return copy

    def __call__(
        self,
        pair: StereoPair,
        maps: Sequence[NDArray[np.float32]],
        max_disparity: int,
        right: NDArray[np.float32] | None = None,
    ) -> MapJudgment:
        """Judge the first of the maps of a pair; the others are witnesses.

        Parameters
        ----------
        maps : (H, W) float32 disparities each, pixels from 0 on, NaN = no value
        max_disparity : largest disparity whose costs are computed, pixels
        right : (H, W) float32 disparities of the right view by the same program, NaN = no value; for ``left_right``

        Raises
        ------
        ValueError
            There is no map, or one has not the size of the images.
        """
        if self._networks is None:
            raise ValueError("hand the networks in with with_networks first")
        clock = Clock()
        evidence = Evidence.of(pair, max_disparity, clock)
        clock.start("planes")
        judged = judged_maps(evidence, maps)
        clock.start("network")
        odds = odds_of(self._networks, judged[0], self.within)
        probability = np.where(judged[0].missing, np.float32(0), _logistic(odds))
        status = status_of(self._networks, judged[0], probability)
        confidence = {name: measured(name, judged[0], evidence, right) for name in self.measures}
        return MapJudgment(seconds=clock.seconds, confidence=confidence, probability=probability, status=status)

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int, count: int) -> int:
        """Estimate the peak working memory for ``count`` maps of (H, W) ``shape``, bytes."""
        return shape[0] * shape[1] * (
            (max_disparity + 1) * BYTES_PER_CELL + BYTES_PER_PIXEL + 4 * count * (len(INPUTS) + 4)
        ) + (64 << 20)


def judged_maps(evidence: Evidence, maps: Sequence[NDArray[np.float32]], median: bool = False) -> list[Judged]:
    """Return the maps of a pair with their planes; gaps are filled from the background, and known as gaps.

    Parameters
    ----------
    median : whether the median of the maps is one more of them

    Raises
    ------
    ValueError
        There is no map, or one has not the size of the images.
    """
    shape, largest = evidence.pair.shape, evidence.volume.n_disparities - 1
    if not maps or any(one.shape != shape for one in maps):
        raise ValueError(f"want maps of the images' size {shape}, got {[one.shape for one in maps]}")
    shared = evidence.pixel_planes()
    whole, gaps = [], []
    for one in maps:
        missing = ~np.isfinite(one)
        holed = DisparityMap(np.where(missing, np.float32(np.nan), one), np.zeros(shape, np.uint8))
        whole.append(np.nan_to_num(fill_background(holed).values).clip(0, largest))
        gaps.append(missing)
    if median:  # of an even number the lower one in the middle: a mean would be a value that nobody proposed
        whole.append(np.partition(np.stack(whole), (len(whole) - 1) // 2, axis=0)[(len(whole) - 1) // 2])
        gaps.append(np.zeros(shape, np.bool_))
    alone = [alone_planes(values, gap, evidence, shared) for values, gap in zip(whole, gaps, strict=True)]
    others = other_planes(np.stack(whole), alone, evidence)
    return [Judged(*parts) for parts in zip(whole, gaps, alone, others, strict=True)]


def odds_of(networks: Networks, judged: Judged, within: float) -> NDArray[np.float32]:
    """Return the log odds (H, W) that the values of a map are right within so many pixels."""
    return log_odds(networks.right, networks.offsets(within), (judged.alone, judged.others))


def status_of(networks: Networks, judged: Judged, probability: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the status of a map, as that of a :class:`MapJudgment`."""
    hidden = log_odds(networks.hidden, networks.hidden.layers[0][1][0], (judged.alone, judged.others[:0])) > 0
    outside = np.arange(judged.values.shape[1], dtype=np.float32) - judged.values < -0.5
    status = np.where(probability < 0.5, Status.MISMATCH, Status.MEASURED)
    status = np.where(outside, Status.OUT_OF_RANGE, np.where(hidden, Status.OCCLUDED, status))
    return np.where(judged.missing, Status.NO_DATA, status).astype(np.uint8)


def _logistic(odds: NDArray[np.float32]) -> NDArray[np.float32]:
    share: NDArray[np.float32] = np.float32(1) / (np.float32(1) + np.exp(-odds.clip(-30, 30)))
    return share

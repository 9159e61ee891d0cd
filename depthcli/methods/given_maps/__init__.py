"""Disparity maps that any program made: how likely every pixel is to be right, what is hidden, the best of several.

In: a pair and maps of its left view. Out: a :class:`MapJudgment` of the first one, to which the others are witnesses;
or, of :mod:`.fusion`, one map. :class:`MapJudge` computes the costs of the pair (``_evidence``, those of the preset
``stereo fast``), planes of what they, the map's shape and the other maps say of every pixel (``_planes``), and has a
small network weigh them (``algorithms.pixel_network``). Single planes are measures of their own (``measures``).
`scripts/train_confidence.py` trains the network on tuning scenes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, PrivateAttr

from depthcli.algorithms.pixel_network import TILE, log_odds
from depthcli.core.errors import InputError
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.method import ConfigModel
from depthcli.core.networks import TrainedNetwork
from depthcli.core.result import Clock, Result
from depthcli.methods.given_maps._evidence import BYTES_PER_CELL, BYTES_PER_PIXEL, Evidence
from depthcli.methods.given_maps._planes import (
    ALONE,
    INPUTS,
    ONE_VIEW,
    alone_planes,
    one_view_planes,
    other_planes,
    pixel_planes,
)
from depthcli.methods.given_maps.measures import Judged, map_measures, measure_name, measured, measured_in_one_view
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
    """The networks that judge: of being right, of being hidden, and of being right where there is no right image.

    Raises
    ------
    InputError
        They were trained for other inputs.
    """

    right: TrainedNetwork
    hidden: TrainedNetwork
    one_view: TrainedNetwork

    def __post_init__(self) -> None:
        expected = (
            (self.right, RIGHT_NAMES, INPUTS),
            (self.hidden, (HIDDEN,), ALONE),
            (self.one_view, RIGHT_NAMES, ONE_VIEW),
        )
        for network, names, inputs in expected:
            units = [weights.shape[1] for weights, _ in network.layers[:2]]
            if network.maps != names or network.inputs != inputs or any(n % TILE for n in units):
                raise InputError("the network was trained for another version: its inputs are not these")


def offsets(network: TrainedNetwork, within: float) -> NDArray[np.float32]:
    """Return the offsets of the first layer for a threshold, between those that the network was trained for."""
    rows = network.layers[0][1]
    at = np.interp(np.log2(within), np.log2(THRESHOLDS), np.arange(len(THRESHOLDS)))
    low = min(int(at), len(rows) - 2)
    between: NDArray[np.float32] = rows[low] + np.float32(at - low) * (rows[low + 1] - rows[low])
    return between


class UsesNetworks(ConfigModel):
    """What judges maps by the networks, which are handed in."""

    within: float = Field(1.0, ge=0.25, le=8, description="error up to which a value counts as right, pixels")
    _networks: Networks | None = PrivateAttr(None)

    def with_networks(self, networks: Networks) -> Self:
        """Return a copy that judges by these networks."""
        copy = self.model_copy()
        copy._networks = networks
        return copy

    @property
    def networks(self) -> Networks:
        """The networks; ValueError where they were not handed in."""
        if self._networks is None:
            raise ValueError("hand the networks in with with_networks first")
        return self._networks

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int, count: int) -> int:
        """Estimate the peak working memory for ``count`` maps of (H, W) ``shape``, bytes."""
        per_pixel = (max_disparity + 1) * BYTES_PER_CELL + BYTES_PER_PIXEL + 4 * count * (len(INPUTS) + 4)
        return shape[0] * shape[1] * per_pixel + (64 << 20)


class MapJudge(UsesNetworks):
    """Judges the map of a pair."""

    measures: tuple[Annotated[str, AfterValidator(measure_name)], ...] = Field(
        (), description="single measures that are also computed"
    )

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
        networks, clock = self.networks, Clock()
        evidence = Evidence.of(pair, max_disparity, clock)
        clock.start("planes")
        judged = judged_maps(evidence, maps)
        clock.start("network")
        odds = odds_of(networks, judged[0], self.within)
        probability = np.where(judged[0].missing, np.float32(0), _logistic(odds))
        status = status_of(networks, judged[0], probability)
        confidence = {name: measured(name, judged[0], evidence, right) for name in self.measures}
        return MapJudgment(seconds=clock.seconds, confidence=confidence, probability=probability, status=status)

    def by_one_view(self, left: Image, values: NDArray[np.float32], max_disparity: int) -> MapJudgment:
        """Judge a map by its shape and the left image, where there is no right image: far less is known then.

        Nothing is said about what is hidden; measures that want the right image are left out.

        Parameters
        ----------
        values : (H, W) float32 disparities, pixels from 0 on, NaN = no value
        max_disparity : largest disparity, pixels

        Raises
        ------
        ValueError
            The map has not the size of the image.
        """
        network = self.networks.one_view
        if values.shape != left.shape[:2]:
            raise ValueError(f"want a map of the image's size {left.shape[:2]}, got {values.shape}")
        clock = Clock()
        clock.start("planes")
        whole, missing = without_gaps(values, max_disparity)
        grey = StereoPair(left, left).grey8[0].astype(np.float32)
        planes = one_view_planes(whole, grey, max_disparity)
        clock.start("network")
        odds = log_odds(network, offsets(network, self.within), planes, planes[:0])
        probability = np.where(missing, np.float32(0), _logistic(odds))
        status = np.where(probability < 0.5, Status.MISMATCH, Status.MEASURED)
        status = np.where(missing, Status.NO_DATA, status).astype(np.uint8)
        found = {name: measured_in_one_view(name, planes, missing) for name in self.measures}
        confidence = {name: values for name, values in found.items() if values is not None}
        return MapJudgment(seconds=clock.seconds, confidence=confidence, probability=probability, status=status)


def judged_maps(evidence: Evidence, maps: Sequence[NDArray[np.float32]], known: Sequence[Judged] = ()) -> list[Judged]:
    """Return the maps of a pair with their planes; gaps are filled from the background, and known as gaps.

    Parameters
    ----------
    known : further maps, first of all, whose own planes are there already

    Raises
    ------
    ValueError
        There is no map, or one has not the size of the images.
    """
    shape, largest = evidence.pair.shape, evidence.volume.n_disparities - 1
    if not (maps or known) or any(one.shape != shape for one in maps):
        raise ValueError(f"want maps of the images' size {shape}, got {[one.shape for one in maps]}")
    parts = [(one.values, one.missing, one.alone) for one in known]
    shared = pixel_planes(evidence)
    for one in maps:
        whole, missing = without_gaps(one, largest)
        parts.append((whole, missing, alone_planes(whole, missing, evidence, shared)))
    others = other_planes(np.stack([values for values, _, _ in parts]), [alone for _, _, alone in parts], evidence)
    return [Judged(*part, other) for part, other in zip(parts, others, strict=True)]


def without_gaps(values: NDArray[np.float32], max_disparity: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return a map (H, W) whose gaps are filled from the background, and where they are."""
    missing = ~np.isfinite(values)
    holed = DisparityMap(np.where(missing, np.float32(np.nan), values), np.zeros(values.shape, np.uint8))
    return np.nan_to_num(fill_background(holed).values).clip(0, max_disparity), missing


def odds_of(networks: Networks, judged: Judged, within: float) -> NDArray[np.float32]:
    """Return the log odds (H, W) that the values of a map are right within so many pixels."""
    return log_odds(networks.right, offsets(networks.right, within), judged.alone, judged.others)


def status_of(networks: Networks, judged: Judged, probability: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the status of a map, as that of a :class:`MapJudgment`."""
    hidden = log_odds(networks.hidden, networks.hidden.layers[0][1][0], judged.alone, judged.others[:0]) > 0
    return with_reasons(judged.values, judged.missing, probability, hidden)


def with_reasons(
    values: NDArray[np.float32],
    missing: NDArray[np.bool_],
    probability: NDArray[np.float32],
    hidden: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Return the status (H, W) of values without gaps, by what is hidden in the right view and what is likely right."""
    outside = np.arange(values.shape[1], dtype=np.float32) - values < -0.5
    status = np.where(probability < 0.5, Status.MISMATCH, Status.MEASURED)
    status = np.where(outside, Status.OUT_OF_RANGE, np.where(hidden, Status.OCCLUDED, status))
    return np.where(missing, Status.NO_DATA, status).astype(np.uint8)


def _logistic(odds: NDArray[np.float32]) -> NDArray[np.float32]:
    share: NDArray[np.float32] = np.float32(1) / (np.float32(1) + np.exp(-odds.clip(-30, 30)))
    return share

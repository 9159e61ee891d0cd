"""How given maps are judged and fused; what Python's functions and the commands have in common."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.api import _save
from depthcli.api.results import Disparity
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import Status
from depthcli.core.text import show_bytes
from depthcli.io.formats.images import png_bytes
from depthcli.io.formats.networks import network_path, read_network
from depthcli.methods.given_maps import MapJudge, MapJudgment, Networks, map_measures
from depthcli.methods.given_maps.fusion import MAX_MAPS, GivenMapsFusion
from depthcli.methods.stereo.search_range import SearchRange
from depthcli.methods.stereo.volume import StereoResult

_TOP_SHARE = 0.999  # of the values; larger ones do not widen the range of the costs
_MAX_OUTSIDE = 0.5  # share of a map's values that may lie outside of the range
_MIN_EXPECTED = 0.3  # mean probability below which a map has a warning


@dataclass(frozen=True, eq=False)
class MapConfidence:
    """How sure a disparity map is.

    Attributes
    ----------
    values : (H, W) float32, the map that was judged, pixels, NaN = no value
    probability : (H, W) float32 in [0, 1]: of pixels with p, a share of p is right; 0 where there is no value
    status : (H, W) uint8, bits of :class:`Status`: ``OCCLUDED``, hidden in the right view; ``OUT_OF_RANGE``, its match
        lies outside the right image; ``MISMATCH``, visible, and more likely wrong than right; ``NO_DATA``, no value
    measures : name -> (H, W) float32, larger is surer, NaN = no value; those that were asked for
    max_disparity : largest disparity whose costs were computed, pixels
    seconds : stage -> time
    warnings : what looks wrong, one line each
    """

    values: NDArray[np.float32]
    probability: NDArray[np.float32]
    status: NDArray[np.uint8]
    measures: Mapping[str, NDArray[np.float32]]
    max_disparity: int
    seconds: Mapping[str, float]
    warnings: tuple[str, ...] = field(default_factory=tuple)

    def kept(self, share: float | None = None, threshold: float | None = None) -> NDArray[np.float32]:
        """Return the map without its doubtful pixels, (H, W) float32, pixels, NaN = no value.

        Parameters
        ----------
        share : share of the map's pixels that stay, those of the highest probability; of equal ones all stay
        threshold : smallest probability of a pixel that stays

        Raises
        ------
        ConfigError
            Both are given, or one is not in 0 .. 1.
        """
        if share is not None and threshold is not None:
            raise ConfigError("share and threshold exclude each other")
        limit = _in_unit("threshold", threshold) if threshold is not None else 0.0
        known = self.probability[np.isfinite(self.values)]
        if share is not None and known.size:
            place = min(max(math.ceil(_in_unit("share", share) * known.size), 1), known.size)
            limit = float(np.partition(known, known.size - place)[known.size - place])
        return np.where(self.probability >= np.float32(limit), self.values, np.float32(np.nan))

    def save(self, folder: str | Path, share: float | None = None, threshold: float | None = None) -> None:
        """Write what ``depthcli confidence`` writes into ``folder``, which is created where it is missing.

        Parameters
        ----------
        share, threshold : as for :meth:`kept`, of the map that is written
        """
        kept = self.kept(share, threshold)
        _save.save_map_confidence(
            self.probability, self.status, kept, self.measures, _save.made(folder), self.max_disparity
        )

    def _repr_png_(self) -> bytes:
        return png_bytes(_save.probability_picture(self.probability))


def _in_unit(name: str, value: float) -> float:
    if not 0 <= value <= 1:
        raise ConfigError(f"{name}: want a number from 0 to 1 (got {value:g})")
    return value


@cache
def networks() -> Networks:
    """Return the networks of the package."""
    return Networks(*(read_network(network_path(name)) for name in ("map_right", "map_hidden", "map_one_view")))


def judge_of(within: float = 1.0, measures: Sequence[str] = ()) -> MapJudge:
    """Return what judges maps; ConfigError for an unknown measure, or a threshold out of bounds."""
    known = map_measures()
    wanted = tuple(known) if "all" in measures else tuple(dict.fromkeys(measures))
    if unknown := [name for name in wanted if name not in known]:
        raise ConfigError(f"measures: no measure called {unknown[0]!r}; one of: all, {', '.join(known)}")
    return MapJudge(within=_threshold(within), measures=wanted).with_networks(networks())


def fusion_of(within: float = 1.0, surfaces: bool = False) -> GivenMapsFusion:
    """Return what fuses maps; ConfigError for a threshold out of bounds."""
    return GivenMapsFusion(within=_threshold(within), surfaces=surfaces).with_networks(networks())


def _threshold(within: float) -> float:
    if not 0.25 <= within <= 8:
        raise ConfigError(f"within: want 0.25 to 8 pixels (got {within:g})")
    return within


def judge_by_one_view(
    method: MapJudge, left: Image, values: NDArray[np.float32], max_disparity: int | None
) -> MapConfidence:
    """Judge a map where there is no right image. Parameters and errors as for :func:`judge`."""
    top, clean, warnings = _prepared(left.shape[1], {"disparity": values}, max_disparity)
    made = method.by_one_view(left, clean[0], top)
    known = np.where(np.isfinite(values) & (values >= 0), values, np.float32(np.nan))
    note = "no right image: judged by the map's shape and the left image alone, which say far less"
    return MapConfidence(known, made.probability, made.status, made.confidence, top, made.seconds, (note, *warnings))


def judge(
    method: MapJudge,
    pair: StereoPair,
    maps: Mapping[str, NDArray[np.float32]],
    max_disparity: int | None,
    right: NDArray[np.float32] | None,
    memory: int,
) -> MapConfidence:
    """Judge the first of the maps; what Python's function and the command have in common.

    Parameters
    ----------
    maps : by the names that messages call them
    max_disparity : largest disparity of the costs, pixels; None: that of the maps
    memory : bytes that may be used

    Raises
    ------
    InputError
        The maps do not fit, or the memory does not suffice.
    """
    top, clean, warnings = _prepared(pair.shape[1], maps, max_disparity)
    _check_memory(method.peak_bytes(pair.shape, top, len(clean)), memory)
    made = method(pair, clean, top, right)
    first = next(iter(maps.values()))
    values = np.where(np.isfinite(first) & (first >= 0), first, np.float32(np.nan))
    beyond = np.isfinite(values) & np.isnan(clean[0])
    status = np.where(beyond, np.uint8(Status.MISMATCH), made.status)
    return MapConfidence(
        values, made.probability, status, made.confidence, top, made.seconds,
        (*warnings, *_doubts(made, values)),
    )  # fmt: skip


def fused(
    method: GivenMapsFusion,
    pair: StereoPair,
    maps: Mapping[str, NDArray[np.float32]],
    max_disparity: int | None,
    memory: int,
) -> Disparity:
    """Fuse maps; what Python's function and the command have in common. Parameters and errors as for :func:`judge`."""
    if not 1 <= len(maps) <= MAX_MAPS:
        raise InputError(f"maps: want 1 to {MAX_MAPS} (got {len(maps)})")
    top, clean, warnings = _prepared(pair.shape[1], maps, max_disparity)
    _check_memory(method.peak_bytes(pair.shape, top, len(clean)), memory)
    found, judgment = method(pair, clean, top)
    result = StereoResult(
        disparity=found, seconds=judgment.seconds, confidence={"probability": judgment.probability}
    )  # fmt: skip
    return Disparity(
        found.values, found.status, pair.left, SearchRange(0, top), result, dict(judgment.seconds), tuple(warnings)
    )


def _prepared(
    width: int, maps: Mapping[str, NDArray[np.float32]], max_disparity: int | None
) -> tuple[int, list[NDArray[np.float32]], list[str]]:
    # Largest disparity, the maps with what lies within the range, and warnings.
    if max_disparity is not None and not max_disparity >= 1:
        raise InputError(f"max_disparity: want at least 1 (got {max_disparity})")
    finite = {name: one[np.isfinite(one)] for name, one in maps.items()}
    for name, known in finite.items():
        if known.size and np.count_nonzero(known < 0) > _MAX_OUTSIDE * known.size:
            raise InputError(
                f"{name}: most disparities are negative; want pixels from 0 on, by which matches lie to the left "
                "in the right image: is the sign swapped?"
            )
    if not any(known.size for known in finite.values()):
        raise InputError(f"{', '.join(maps)}: no value at any pixel")
    top = max_disparity
    if top is None:
        highest = [float(np.quantile(known, _TOP_SHARE)) for known in finite.values() if known.size]
        top = min(max(math.ceil(max(highest, default=1.0)), 1), width - 1)
    warnings = []
    clean = []
    for name, one in maps.items():
        with np.errstate(invalid="ignore"):
            inside = np.isfinite(one) & (one >= 0) & (one <= top + 0.5)
        clean.append(np.where(inside, one, np.float32(np.nan)))
        beyond = np.count_nonzero(finite[name] > top + 0.5)
        if beyond > 0.01 * max(finite[name].size, 1):
            warnings.append(
                f"{100 * beyond / finite[name].size:.0f} % of {name} lies above the largest disparity, {top} px; see "
                "--max-disparity"
            )
    return top, clean, warnings


def _doubts(made: MapJudgment, values: NDArray[np.float32]) -> list[str]:
    known = np.isfinite(values)
    if not known.any():
        return ["the map has no value at any pixel"]
    expected = float(made.probability[known].mean())
    if expected < _MIN_EXPECTED:
        return [
            f"only {100 * expected:.0f} % of the values are likely right: a map of another pair, views swapped, not "
            "rectified, or another scale?"
        ]
    return []


def _check_memory(need: int, memory: int) -> None:
    if need > memory:
        raise InputError(
            f"needs about {show_bytes(need)} of memory, {show_bytes(memory)} may be used; see --max-memory"
        )

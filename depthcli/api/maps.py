"""Disparity maps that any program made: ``map_confidence`` says how sure they are, ``fuse_maps`` takes the best."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from depthcli.api.bounds import networks
from depthcli.api.inputs import as_image, as_map, as_pair
from depthcli.api.results import Disparity
from depthcli.api.saving import made, write_details, write_disparity
from depthcli.core.bound import Bound
from depthcli.core.config_file import load_config
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.result import Result
from depthcli.core.yaml_source import ConfigData
from depthcli.io.formats.disparity import check_sign
from depthcli.io.formats.images import png_bytes, write_png
from depthcli.io.formats.pictures import preview
from depthcli.kernels.jit import one_at_a_time
from depthcli.methods.given_maps import MEASURES, judge, judge_by_one_view, peak_bytes
from depthcli.methods.given_maps.fusion import MAX_MAPS, N_ADDED, fuse
from depthcli.methods.stereo.search_range import SearchRange, matched_range
from depthcli.methods.stereo.volume import StereoResult
from depthcli.run.resources import available_memory, check_memory

_TOP_SHARE = 0.999  # of the values; larger ones do not widen the range of the costs
_MAX_BEYOND = 0.01  # share of a map's values above the range; with more it has a warning
_MIN_EXPECTED = 0.3  # mean probability below which a map has a warning


@dataclass(frozen=True, eq=False)
class MapConfidence:
    """How sure a disparity map is: arrays of (H, W) pixels.

    ``status`` has bits of :class:`Status`: ``OCCLUDED``, hidden in the right view; ``OUT_OF_RANGE``, its match lies
    outside the right image; ``MISMATCH``, visible, and more likely wrong than right; ``NO_DATA``, no value.
    """

    values: NDArray[np.float32]  # the map that was judged, pixels, NaN = no value
    bound: NDArray[np.float32]  # of the error, pixels: a share ``level`` of the errors is not larger; NaN = no value
    probability: NDArray[np.float32]  # of pixels with p, a share of p is right; 0 where there is no value
    status: NDArray[np.uint8]
    measures: Mapping[str, NDArray[np.float32]]  # those that were asked for; larger is surer, NaN = no value
    max_disparity: int  # the largest one whose costs were computed, pixels
    seconds: Mapping[str, float]  # stage -> time
    warnings: tuple[str, ...] = ()  # what looks wrong, one line each

    def kept(self, share: float | None = None, threshold: float | None = None) -> NDArray[np.float32]:
        """Return the map without its doubtful pixels, (H, W) float32, pixels, NaN = no value.

        ``share`` of the map's pixels stay, those of the highest probability (of equal ones all), or those of at least
        the probability ``threshold``. ConfigError where both are given, or one is not in 0 .. 1.
        """
        if share is not None and threshold is not None:
            raise ConfigError("share and threshold exclude each other")
        for name, value in (("share", share), ("threshold", threshold)):
            if value is not None and not 0 <= value <= 1:
                raise ConfigError(f"{name}: expected a number from 0 to 1 (got {value:g})")
        limit = threshold or 0.0
        known = self.probability[np.isfinite(self.values)]
        if share is not None and known.size:
            place = min(max(math.ceil(share * known.size), 1), known.size)
            limit = float(np.partition(known, known.size - place)[known.size - place])
        return np.where(self.probability >= np.float32(limit), self.values, np.float32(np.nan))

    def save(self, folder: str | Path, share: float | None = None, threshold: float | None = None) -> None:
        """Write what ``depthcli confidence`` writes, the map as :meth:`kept` returns it, into a folder old or new."""
        kept, files = self.kept(share, threshold), made(folder)
        write_png(files / "probability.png", self._picture())
        picture = preview(kept, self.max_disparity)
        write_disparity(kept, self.status, picture, files, self.bound, self.probability)
        write_details(Result(confidence=dict(self.measures)), files)

    def _picture(self) -> NDArray[np.uint8]:
        return np.asarray(np.rint(self.probability * np.float32(255)), np.uint8)

    def _repr_png_(self) -> bytes:
        return png_bytes(self._picture())


def map_confidence(
    left: ArrayLike,
    right: ArrayLike | None,
    disparity: ArrayLike,
    *,
    max_disparity: int | None = None,
    witnesses: Sequence[ArrayLike] = (),
    right_disparity: ArrayLike | None = None,
    within: float = 1.0,
    level: float = 0.9,
    measures: Sequence[str] = (),
) -> MapConfidence:
    """Return how wrong each value of a disparity map of a rectified pair may be that any program made.

    ConfigError for an unknown measure, or a number out of bounds; InputError for images and maps that do not fit each
    other, negative disparities, or too little memory.

    Parameters
    ----------
    left, right : the images, as for :func:`stereo`; right None: there is none, and the map is judged by its shape and
        the left image alone, which say far less. Witnesses, most measures and hidden pixels need a right image
    disparity : (H, W) pixels, the left view's map; NaN, infinite and negative ones = no value
    max_disparity : largest disparity that is compared with, pixels; None: as the pair says; values above are wrong
    witnesses : maps of the same view by other methods, which make the judgment better
    right_disparity : (H, W) pixels, the map of the right view by the same program, for the measure ``left_right``
    within : error up to which a value counts as right in ``probability``, pixels, 0.25 to 8
    level : share of the errors that the ``bound`` is not smaller than, 0.5 to 0.99
    measures : names of single measures that are wanted, too, or ``all``; the error for another name lists them

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> left = np.random.default_rng(0).integers(0, 256, (48, 96), np.uint8)
    >>> right = np.roll(left, -8, axis=1)
    >>> disparity = np.full((48, 96), 8.0)
    >>> disparity[20:30, 40:60] = 3
    >>> sure = depthcli.map_confidence(left, right, disparity).probability
    >>> bool(sure[5:15, 40:60].mean() > sure[20:30, 40:60].mean())
    True
    """
    if right is None and (witnesses or right_disparity is not None):
        raise ConfigError("right: witnesses and right_disparity need a right image")
    images = as_image(left, "left") if right is None else as_pair(left, right)
    given = {"disparity": disparity, **{f"witnesses[{k}]": one for k, one in enumerate(witnesses)}}
    shape = (images.shape[0], images.shape[1])
    maps = {name: as_map(one, name, shape) for name, one in given.items()}
    other = None if right_disparity is None else as_map(right_disparity, "right_disparity", shape)
    with one_at_a_time():
        promise = _promise(level, within)
        return judged(images, maps, max_disparity, promise, measures_named(measures), other, available_memory())


def fuse_maps(
    left: ArrayLike,
    right: ArrayLike,
    maps: Sequence[ArrayLike],
    *,
    max_disparity: int | None = None,
    within: float = 1.0,
    surfaces: bool = False,
    bound: bool = False,
    level: float = 0.9,
) -> Disparity:
    """Return the best of several disparity maps of a rectified pair at every pixel; one is completed and corrected.

    The map has a value everywhere. ConfigError and InputError as for :func:`map_confidence`; no map, or more than 14.

    Parameters
    ----------
    left, right : the images, as for :func:`stereo`
    maps : (H, W) pixels each, maps of the left view by any programs; NaN, infinite and negative ones = no value
    max_disparity : largest disparity that is compared with, pixels; None: as the pair says; values above are wrong
    within : error up to which a value counts as right in ``confidence["probability"]``, pixels, 0.25 to 8
    surfaces : whether planes of segments are proposed, too; slower
    bound : whether ``bound`` and ``probability`` of the fused map are computed, by judging it once more
    level : share of the errors that the ``bound`` is not smaller than, 0.5 to 0.99

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> left = np.random.default_rng(0).integers(0, 256, (48, 96), np.uint8)
    >>> right = np.roll(left, -8, axis=1)
    >>> upper, lower = np.full((48, 96), 8.0), np.full((48, 96), 8.0)
    >>> upper[:24], lower[24:] = 3, 2
    >>> bool(np.mean(np.abs(depthcli.fuse_maps(left, right, [upper, lower]).values - 8) < 1) > 0.9)
    True
    """
    pair = as_pair(left, right)
    arrays = {f"maps[{k}]": as_map(one, f"maps[{k}]", pair.shape) for k, one in enumerate(maps)}
    with one_at_a_time():
        promise = _promise(level, within)
        return fused(pair, arrays, max_disparity, promise, surfaces, available_memory(), bound=bound)


def measures_named(names: Sequence[str]) -> list[str]:
    """Return the names of measures, each once, "all" for all of them; ConfigError where there is no such measure."""
    if unknown := [name for name in names if name not in ("all", *MEASURES)]:
        raise ConfigError(f"measures: no measure called {unknown[0]!r}; one of: all, {', '.join(MEASURES)}")
    return list(MEASURES) if "all" in names else list(dict.fromkeys(names))


def judged(
    images: StereoPair | Image,
    maps: Mapping[str, NDArray[np.float32]],
    max_disparity: int | None,
    promise: Bound,
    measures: Sequence[str],
    right: NDArray[np.float32] | None,
    memory: int,
) -> MapConfidence:
    """Return how sure the first of the maps is, which have the names that messages call them.

    ``images`` are the pair, or the left image where there is no right one. InputError where the maps do not fit, or
    ``memory`` bytes do not suffice.
    """
    shape = images.shape if isinstance(images, StereoPair) else images.shape[:2]
    top, clean, warnings = _prepared(images, maps, max_disparity)
    first = next(iter(maps.values()))
    known = np.isfinite(first) & (first >= 0)
    if not isinstance(images, StereoPair):
        found = judge_by_one_view(networks(), images, clean[0], top, promise.within, measures, promise.level)
        status = found.status
        note = "no right image: judged by the map's shape and the left image alone, which say far less"
        warnings.insert(0, note)
    else:
        size = f"{shape[1]} x {shape[0]} pixels, {top + 1} disparities"
        check_memory(peak_bytes(images.shape, top, len(clean)), memory, size)
        found = judge(networks(), images, clean, top, promise.within, measures, right, promise.level)
        status = np.where(known & np.isnan(clean[0]), np.uint8(Status.MISMATCH), found.status)
        expected = float(found.probability[known].mean()) if known.any() else 0.0
        if not known.any():
            warnings.append("the map has no value at any pixel")
        elif expected < _MIN_EXPECTED:
            warnings.append(
                f"only {100 * expected:.0f} % of the values are likely right: a map of another pair, views swapped, "
                "not rectified, or another scale?"
            )
    values = np.where(known, first, np.float32(np.nan))
    # The truth of a value above the largest disparity lies in 0 .. ``top``.
    bound = np.where(known & np.isnan(clean[0]), values, found.bound)
    details = found.confidence, top, found.seconds, tuple(warnings)
    return MapConfidence(values, bound, found.probability, status, *details)


def fused(
    pair: StereoPair,
    maps: Mapping[str, NDArray[np.float32]],
    max_disparity: int | None,
    promise: Bound,
    surfaces: bool,
    memory: int,
    status: Mapping[str, NDArray[np.uint8]] | None = None,
    bound: bool = False,
) -> Disparity:
    """Return one map of several, of which some have a (H, W) ``status``; errors as of :func:`judged`."""
    if not 1 <= len(maps) <= MAX_MAPS:
        raise InputError(f"maps: expected 1 to {MAX_MAPS} (got {len(maps)})")
    top, clean, warnings = _prepared(pair, maps, max_disparity)
    size = f"{pair.shape[1]} x {pair.shape[0]} pixels, {top + 1} disparities"
    check_memory(peak_bytes(pair.shape, top, len(clean) + N_ADDED), memory, size)
    empty = np.zeros(pair.shape, np.uint8)
    pairs = zip(clean, [(status or {}).get(name, empty) for name in maps], strict=True)
    measured = [np.isfinite(one) & DisparityMap(one, known).measured for one, known in pairs]
    level = promise.level if bound else None
    best = fuse(networks(), pair, clean, top, promise.within, surfaces, measured, level)
    found, confidence = best.disparity, {} if bound else {"probability": best.probability}
    result = StereoResult(disparity=found, seconds=best.seconds, confidence=confidence)
    details = SearchRange(0, top), result, best.seconds, tuple(warnings)
    one = Disparity(found.values, found.status, pair.left, *details)
    return replace(one, bound=best.bound, probability=best.probability) if bound else one


def _promise(level: float, within: float) -> Bound:
    values = {"level": float(level), "within": float(within)}
    return load_config(Bound, ConfigData("bound", {}), values=values)


def _prepared(
    images: StereoPair | Image, maps: Mapping[str, NDArray[np.float32]], max_disparity: int | None
) -> tuple[int, list[NDArray[np.float32]], list[str]]:
    """Return the largest disparity, the maps without values outside of the range, and warnings.

    Where none is given, the pair says it, not the maps, whose scale may be wrong; the maps do where the pair cannot.
    """
    if max_disparity is not None and not max_disparity >= 1:
        raise InputError(f"max_disparity: must be at least 1 (got {max_disparity})")
    finite = {name: one[np.isfinite(one)] for name, one in maps.items()}
    for name, known in finite.items():
        check_sign(name, known)
    if not any(known.size for known in finite.values()):
        raise InputError(f"{', '.join(maps)}: no value at any pixel")
    warnings, clean, top = [], [], max_disparity
    if top is None and isinstance(images, StereoPair):
        try:
            top = min(matched_range(images).suggested.max_disparity, images.shape[1] - 1)
        except InputError as error:
            warnings.append(f"the largest disparity is that of the maps: {error}")
    if top is None:
        highest = max(float(np.quantile(known, _TOP_SHARE)) for known in finite.values() if known.size)
        top = min(max(math.ceil(highest), 1), images.shape[1] - 1)
    for name, one in maps.items():
        with np.errstate(invalid="ignore"):
            inside = np.isfinite(one) & (one >= 0) & (one <= top + 0.5)
        clean.append(np.where(inside, one, np.float32(np.nan)))
        beyond = np.count_nonzero(finite[name] > top + 0.5) / max(finite[name].size, 1)
        if beyond > _MAX_BEYOND:
            above = f"{100 * beyond:.0f} % of {name} lies above the largest disparity, {top} px"
            warnings.append(f"{above}; see max_disparity")
    return top, clean, warnings

"""Judge disparity maps of any program (``confidence``), or fuse several (``fuse maps``)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from depthcli.core import config_file
from depthcli.core.bound import Bound
from depthcli.core.context import Context
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.result import Result
from depthcli.core.yaml_source import ConfigData
from depthcli.evaluation import protocols
from depthcli.io.formats.disparity import check_sign, read_foreign_map, read_status
from depthcli.io.formats.files import made
from depthcli.io.formats.images import png_bytes, read_image, write_drawn
from depthcli.io.scenes import GivenMap, MapsScene, Scene, StereoScene, check_same_size
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.stereo_pairs import load_pair, view_size
from depthcli.methods.given_maps import MEASURES, judge, judge_by_one_view, peak_bytes
from depthcli.methods.given_maps.fusion import MAX_MAPS, N_ADDED, fuse
from depthcli.methods.stereo.search_range import SearchRange, matched_range
from depthcli.methods.stereo.volume import StereoResult
from depthcli.problems.inputs import as_image, as_map, as_pair
from depthcli.problems.map_checks import networks
from depthcli.problems.problem import MAP_FILES, Inputs, Problem, ResultT, Shown
from depthcli.problems.results import Disparity, write_details, write_disparity
from depthcli.run.job import available_memory, check_memory
from depthcli.show.table import SIZE, Row, median, number, percent, share, size_of
from depthcli.show.view import STATUS_PALETTE, View

_TOP_SHARE = 0.999  # quantile of the values; larger values do not widen the search range
_MAX_BEYOND = 0.01  # share of a map's values above the range, beyond which it has a warning
_MIN_EXPECTED = 0.3  # mean probability below which a map has a warning


@dataclass(frozen=True, eq=False)
class MapConfidence:
    """The reliability of a disparity map, as arrays of (H, W) pixels.

    ``status`` has bits of :class:`Status`: ``OCCLUDED``, hidden in the right view; ``OUT_OF_RANGE``, the match is
    outside the right image; ``MISMATCH``, visible and probably incorrect; ``NO_DATA``, no value.
    """

    values: NDArray[np.float32]  # the judged map, pixels, NaN = no value
    bound: NDArray[np.float32]  # error bound, pixels: a share ``level`` of errors is within it; NaN = no value
    probability: NDArray[np.float32]  # probability that the value is correct; 0 if there is no value
    status: NDArray[np.uint8]
    measures: Mapping[str, NDArray[np.float32]]  # requested measures; larger is more certain, NaN = no value
    max_disparity: int  # largest disparity with computed costs, pixels
    seconds: Mapping[str, float]  # stage -> time
    warnings: tuple[str, ...] = ()  # one line per warning

    def kept(self, share: float | None = None, threshold: float | None = None) -> NDArray[np.float32]:
        """Return the map without unreliable pixels, (H, W) float32, pixels, NaN = no value.

        Keep the ``share`` of the map's pixels with the highest probability, including ties, or the pixels whose
        probability is at least ``threshold``. Raise ConfigError if both are given, or one is not in 0 .. 1.
        """
        if share is not None and threshold is not None:
            raise ConfigError("share and threshold exclude each other")
        for name, value in (("share", share), ("threshold", threshold)):
            if value is not None and not 0 <= value <= 1:
                raise ConfigError(f"{name}: expected a number from 0 to 1 (got {value:g})")
        limit = threshold or 0.0
        known = self.probability[np.isfinite(self.values)]
        if share is not None and known.size:
            count = min(math.ceil(share * known.size), known.size)
            limit = float(np.partition(known, known.size - count)[known.size - count]) if count else np.inf
        return np.where(self.probability >= np.float32(limit), self.values, np.float32(np.nan))

    def save(self, folder: str | Path, share: float | None = None, threshold: float | None = None) -> None:
        """Write the files of ``depthcli confidence``, with the map of :meth:`kept`; create the folder if needed."""
        kept, files = self.kept(share, threshold), made(folder)
        write_drawn(files / "probability.png", self._picture)
        view = View(kept, "px", (0, self.max_disparity), bound=self.bound)
        write_disparity(view, self.status, files, self.probability)
        write_details(Result(confidence=dict(self.measures)), files)

    def _picture(self) -> NDArray[np.uint8]:
        return np.asarray(np.rint(self.probability * np.float32(255)), np.uint8)

    def _repr_png_(self) -> bytes:
        return png_bytes(self._picture())


@dataclass(frozen=True, eq=False)
class MapInputs(Inputs):
    """Images, and maps of their left view."""

    images: StereoPair | Image  # the pair, or the left image without a right one
    maps: Mapping[str, NDArray[np.float32]]  # name in messages -> (H, W), pixels, NaN = no value
    max_disparity: int | None = None  # pixels; None: estimated from the pair
    right: NDArray[np.float32] | None = None  # (H, W), the map of the right view
    status: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)  # name of a map -> (H, W), if it has one
    save_options: Mapping[str, Any] = field(default_factory=dict)
    warnings: Sequence[str] = ()

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the images."""
        return self.images.shape[0], self.images.shape[1]

    def within_range(self) -> tuple[int, list[NDArray[np.float32]], list[str]]:
        """Return the largest disparity, the maps without values outside of the range, and warnings.

        By default, the largest disparity is estimated from the pair, since the scale of the maps may be wrong. If that
        is impossible, it is estimated from the maps.
        """
        images, maps, max_disparity = self.images, self.maps, self.max_disparity
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
                warnings.append(f"the largest disparity is estimated from the maps: {error}")
        if top is None:
            highest = max(float(np.quantile(known, _TOP_SHARE)) for known in finite.values() if known.size)
            top = min(max(math.ceil(highest), 1), images.shape[1] - 1)
        for name, one in maps.items():
            with np.errstate(invalid="ignore"):
                inside = np.isfinite(one) & (one >= 0) & (one <= top + 0.5)
            clean.append(np.where(inside, one, np.float32(np.nan)))
            beyond = np.count_nonzero(finite[name] > top + 0.5) / max(finite[name].size, 1)
            if beyond > _MAX_BEYOND:
                above = f"{100 * beyond:.0f} % of {name} is above the largest disparity, {top} px"
                warnings.append(f"{above}; see max_disparity")
        return top, clean, warnings


class ConfidenceOptions(TypedDict, total=False):
    """The options of ``confidence``, as in ``run.yaml``; those of files are not needed for arrays."""

    max_disparity: int | None
    bound: dict[str, float]  # level and within
    measures: list[str]
    keep: float | None  # share of the pixels
    threshold: float | None  # smallest probability


class FuseMapsOptions(TypedDict, total=False):
    """The options of ``fuse maps``, as in ``run.yaml``."""

    max_disparity: int | None
    within: float
    surfaces: bool
    bound: dict[str, float] | None  # level and within


@dataclass(frozen=True)
class GivenMaps(Problem[MapsScene, MapInputs, ResultT]):
    """Maps of pairs, found in runs."""

    layouts = PAIRS
    n_added: ClassVar[int] = 0
    """Number of maps that are compared with the given maps."""

    config: ConfidenceOptions | FuseMapsOptions

    def truth_scenes(self, scenes: Sequence[MapsScene]) -> Sequence[Scene]:
        """Return the pairs without their maps."""
        return [scene.pair for scene in scenes]

    def settings(self, scene: MapsScene) -> dict[str, str]:
        """Return the coding of the maps and the scene's range."""
        maps = scene.maps if scene.right_map is None else (*scene.maps, scene.right_map)
        coding = ", ".join(f"{one.scale} {one.invalid}" for one in maps)
        return {"max_disparity": str(scene.max_disparity), "coding": coding}

    def memory(self, scene: MapsScene) -> int | None:
        """Return an estimate from the left image's size, or None if the range is not given."""
        top = self.max_disparity(scene)
        return None if top is None else peak_bytes(view_size(scene), top, len(scene.maps) + self.n_added)

    def max_disparity(self, scene: MapsScene) -> int | None:
        """Return the largest disparity from the options or the scene, or None."""
        return self.config["max_disparity"] or scene.max_disparity

    def inputs(self, scene: MapsScene, images: StereoPair | Image) -> MapInputs:
        """Return the images with the maps of a scene. Raise InputError for maps of another size."""
        maps = {one.run: _loaded(one, scene, images.shape) for one in scene.maps}
        absent = [f"no map of {run}: it is left out" for run in scene.absent]
        return MapInputs(images, maps, self.max_disparity(scene), warnings=absent)

    def check_memory(self, inputs: MapInputs, max_disparity: int, context: Context) -> None:
        """Raise InputError if there is not enough memory."""
        height, width = inputs.shape
        need = peak_bytes(inputs.shape, max_disparity, len(inputs.maps) + self.n_added)
        check_memory(need, context.memory, f"{width} x {height} pixels, {max_disparity + 1} disparities")


@dataclass(frozen=True)
class Confidence(GivenMaps[MapConfidence]):
    """Judge the first map of a scene."""

    config: ConfidenceOptions

    command = "confidence"
    writes = (*MAP_FILES, "probability.png")
    shown = Shown(
        (SIZE, *map(percent, ("density", "expected_right", "hidden")), number("median_bound", "{:.3g} px")),
        palette=STATUS_PALETTE,
        protocol="middlebury-v2",
    )

    def load(self, scene: MapsScene, context: Context) -> MapInputs:
        """Return the images and maps of a scene; the first map is the judged one."""
        if scene.right is None and len(scene.maps) > 1:
            raise InputError(f"{scene.left.parent}: no right image, without which there are no witnesses")
        context.clock.start("load")
        inputs = self.inputs(scene, read_image(scene.left) if scene.right is None else load_pair(scene))
        right = None
        if scene.right is not None and scene.right_map is not None:
            right = _loaded(scene.right_map, scene, inputs.shape)
        save_options = {"share": self.config["keep"], "threshold": self.config["threshold"]}
        return replace(inputs, right=right, save_options=save_options)

    def solve(self, inputs: MapInputs, context: Context) -> MapConfidence:
        """Judge the first map. Raise InputError for unsuitable maps or too little memory."""
        context.clock.start("other")
        images, measures, promise = inputs.images, self.config["measures"], Bound(**self.config["bound"])
        top, clean, warnings = inputs.within_range()
        first = next(iter(inputs.maps.values()))
        known = np.isfinite(first) & (first >= 0)
        if not isinstance(images, StereoPair):
            judgment = judge_by_one_view(networks(), images, clean[0], top, promise.within, measures, promise.level)
            status = judgment.status
            note = "no right image: judged by the map's shape and the left image alone, which is far less reliable"
            warnings.insert(0, note)
        else:
            self.check_memory(inputs, top, context)
            right = inputs.right
            judgment = judge(networks(), images, clean, top, promise.within, measures, right, promise.level)
            status = np.where(known & np.isnan(clean[0]), np.uint8(Status.MISMATCH), judgment.status)
            expected = float(judgment.probability[known].mean()) if known.any() else 0.0
            if not known.any():
                warnings.append("the map has no value at any pixel")
            elif expected < _MIN_EXPECTED:
                warnings.append(
                    f"only {100 * expected:.0f} % of the values are likely right: a map of another pair, views "
                    "swapped, not rectified, or another scale?"
                )
        values = np.where(known, first, np.float32(np.nan))
        # For a value above the largest disparity, the true disparity is assumed to be in 0 .. ``top``.
        bound = np.where(known & np.isnan(clean[0]), values, judgment.bound)
        context.clock.include(judgment.seconds)
        return MapConfidence(
            values, bound, judgment.probability, status, measures=judgment.confidence, max_disparity=top,
            seconds=judgment.seconds, warnings=tuple(warnings),
        )  # fmt: skip

    def row(self, inputs: MapInputs, result: MapConfidence) -> Row:
        """Return size, range, density, mean probability, share of hidden pixels, and median bound."""
        known = np.isfinite(result.values)
        hidden = (result.status & int(Status.OCCLUDED | Status.OUT_OF_RANGE)) != 0
        return {
            **size_of(inputs.images),
            "max_disparity": result.max_disparity,
            "density": share(np.isfinite(result.kept(**inputs.save_options))),
            "expected_right": share(result.probability[known]) if known.any() else None,
            "hidden": share(hidden),
            "median_bound": median(result.bound),
        }


@dataclass(frozen=True)
class FuseMaps(GivenMaps[Disparity]):
    """Fuse the maps of a scene by choosing the best value per pixel."""

    config: FuseMapsOptions

    command = "fuse-maps"
    n_added = N_ADDED
    writes = MAP_FILES
    shown = Shown(
        (
            SIZE,
            number("maps", "{}"),
            *map(percent, ("expected_right", "measured")),
            number("median_bound", "{:.3g} px"),
        ),
        palette=STATUS_PALETTE,
        protocol="middlebury-v2",
    )

    def load(self, scene: MapsScene, context: Context) -> MapInputs:
        """Return the pair and maps of a scene, with the status maps of this program's runs."""
        context.clock.start("load")
        inputs = self.inputs(scene, load_pair(scene))
        status = {one.run: read_status(one.status) for one in scene.maps if one.status is not None}
        for name, codes in status.items():
            check_same_size(scene.folder / f"status.png of {name}", codes.shape, scene.left, inputs.shape)
        return replace(inputs, status=status)

    def solve(self, inputs: MapInputs, context: Context) -> Disparity:
        """Fuse the maps. Raise InputError for unsuitable maps or too little memory."""
        pair, maps = inputs.images, inputs.maps
        assert isinstance(pair, StereoPair)
        context.clock.start("other")
        if not 1 <= len(maps) <= MAX_MAPS:
            raise InputError(f"maps: expected 1 to {MAX_MAPS} (got {len(maps)})")
        top, clean, warnings = inputs.within_range()
        self.check_memory(inputs, top, context)
        empty = np.zeros(pair.shape, np.uint8)
        coded = zip(clean, [inputs.status.get(name, empty) for name in maps], strict=True)
        measured = [np.isfinite(values) & DisparityMap(values, status).measured for values, status in coded]
        promise = self.config["bound"]
        within, level = (self.config["within"], None) if promise is None else (promise["within"], promise["level"])
        best = fuse(networks(), pair, clean, top, within, self.config["surfaces"], measured, level)
        context.clock.include(best.seconds)
        disparity, confidence = best.disparity, {"probability": best.probability} if level is None else {}
        result = StereoResult(disparity=disparity, seconds=best.seconds, confidence=confidence)
        fused = Disparity(
            disparity.values, disparity.status, pair.left, search=SearchRange(0, top), details=result,
            seconds=best.seconds, warnings=tuple(warnings),
        )  # fmt: skip
        return fused if level is None else replace(fused, bound=best.bound, probability=best.probability)

    def row(self, inputs: MapInputs, result: Disparity) -> Row:
        """Return size, range, number of maps, mean probability, median bound, and share of measured pixels."""
        sure = result.confidence["probability"] if result.probability is None else result.probability
        return {
            **size_of(inputs.images),
            "max_disparity": result.search.max_disparity,
            "maps": len(inputs.maps),
            "expected_right": share(sure),
            **({} if result.bound is None else {"median_bound": median(result.bound)}),
            "measured": share(result.measured),
        }


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
    """Return the error bound and the probability of each value in a disparity map from any program.

    Raise ConfigError for an unknown measure or a number out of bounds; raise InputError for images and maps of
    different sizes, negative disparities, or too little memory.

    Parameters
    ----------
    left, right : the images, as for :func:`stereo`. Without a right image (None), the map's shape and the left image
        are used, which are far less informative. Witnesses, most measures and hidden pixels need a right image
    disparity : (H, W) pixels, the left view's map; NaN, infinite and negative numbers = no value
    max_disparity : largest disparity to compare with, pixels; larger values are incorrect; None: estimated from the
        pair
    witnesses : maps of the same view from other methods, which improve the judgment
    right_disparity : (H, W) pixels, the right view's map from the same program, for the measure ``left_right``
    within : error up to which a value counts as correct in ``probability``, pixels, 0.25 to 8
    level : share of errors within ``bound``, 0.5 to 0.99
    measures : names of single measures to compute, too, or ``all``; an unknown name raises an error that lists them

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
    options = ConfidenceOptions(
        max_disparity=max_disparity, bound=_promise(level, within), measures=measures_named(measures)
    )
    return Confidence(options).solve(MapInputs(images, maps, max_disparity, other), Context(available_memory()))


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
    """Return a map with the best value of several disparity maps at every pixel; a single map is completed.

    The map has a value everywhere. Raise ConfigError and InputError as :func:`map_confidence`, and InputError for no
    map or more than 14.

    Parameters
    ----------
    left, right : the images, as for :func:`stereo`
    maps : (H, W) pixels each, maps of the left view from any programs; NaN, infinite and negative numbers = no value
    max_disparity : largest disparity to compare with, pixels; larger values are incorrect; None: estimated from the
        pair
    within : error up to which a value counts as correct in ``confidence["probability"]``, pixels, 0.25 to 8
    surfaces : whether planes of segments are proposed, too; slower
    bound : whether to judge the fused map again, which gives its ``bound`` and ``probability``
    level : share of errors within ``bound``, 0.5 to 0.99

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
    promise = _promise(level, within)
    options = FuseMapsOptions(within=promise["within"], bound=promise if bound else None, surfaces=surfaces)
    return FuseMaps(options).solve(MapInputs(pair, arrays, max_disparity), Context(available_memory()))


def measures_named(names: Sequence[str], option: str = "measures") -> list[str]:
    """Return distinct names of measures; "all" stands for all of them. Raise ConfigError for unknown names."""
    if unknown := [name for name in names if name not in ("all", *MEASURES)]:
        raise ConfigError(f"{option}: no measure called {unknown[0]!r}; one of: all, {', '.join(MEASURES)}")
    return list(MEASURES) if "all" in names else list(dict.fromkeys(names))


def _promise(level: float, within: float) -> dict[str, float]:
    values = {"level": float(level), "within": float(within)}
    return config_file.load_config(Bound, ConfigData("bound"), values=values).model_dump()


def _loaded(one: GivenMap, scene: StereoScene, shape: tuple[int, ...]) -> NDArray[np.float32]:
    values = read_foreign_map(one.path, one.scale, one.invalid, is_kitti=protocols.has_kitti_codes(scene.protocol))
    check_same_size(one.path, values.shape, scene.left, shape)
    return values

"""Rectified pairs to disparity maps: configs, files and arrays, how they are matched, what reports and Python get."""

from __future__ import annotations

import contextlib
import threading
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, Literal, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from depthcli import device
from depthcli.core.bound import Bound
from depthcli.core.context import Context, Latest
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Status, without_smoothed
from depthcli.core.method import RootConfig, parts_of
from depthcli.core.text import show_bytes
from depthcli.device import Device, DeviceError
from depthcli.io.formats.files import collected_warnings
from depthcli.io.formats.images import pair_of
from depthcli.io.scenes import StereoScene
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.stereo_pairs import load_pair, view_size
from depthcli.methods.given_maps import bounds, peak_bytes
from depthcli.methods.stereo.matching import Limits, TileMode, device_table, host_bytes, match
from depthcli.methods.stereo.networks import Network, network_device, networks_in
from depthcli.methods.stereo.pipeline import Pipeline
from depthcli.methods.stereo.pipeline.command import Program
from depthcli.methods.stereo.search_range import MatchedRange, SearchRange, complete_range, matched_beyond
from depthcli.methods.stereo.stages import PairMatcher
from depthcli.methods.stereo.volume import StereoResult
from depthcli.problems.given_maps import networks
from depthcli.problems.inputs import Overrides, as_image, load_config, paired
from depthcli.problems.problem import MAP_FILES, Problem, Shown
from depthcli.problems.rectified import (
    METRIC_COLUMNS,
    Calibration,
    Rectified,
    calibration_files,
    metric_columns,
    rectified_scene,
    sequence_range,
)
from depthcli.problems.results import Disparity
from depthcli.run.resources import available_memory, check_memory
from depthcli.show.table import SIZE, Row, median, number, percent, share
from depthcli.show.view import STATUS_PALETTE

_MAX_DISPARITY = 16383  # pixels, 14 bits: wider than the images that any method here can match
_MIN_MEASURED_SHARE = 0.5  # of the pixels; with fewer a map has a warning
# Shares of the measured pixels at an end of the search range. Above the first, a map has a warning. Of ranges that end
# at three quarters of the largest disparity a third has fewer: above the second, the pair is asked for its own range.
_MAX_SHARE_AT_END, _MIN_SHARE_AT_END = 0.05, 0.01
_REASONS = [int(bit) for bit in (Status.OCCLUDED, Status.MISMATCH, Status.OUT_OF_RANGE, Status.NO_DATA)]

_End = Annotated[int, Field(ge=-_MAX_DISPARITY, le=_MAX_DISPARITY)] | Literal["auto"] | None


class PairConfig(RootConfig):
    """The common keys of the configs of all commands that match pairs."""

    max_disparity: _End = Field(
        None,
        description="largest disparity searched, pixels; auto: as the pair itself says; null: the scene's; where it "
        "has none, auto, and for pairs rectified by a calibration as the first frames of a sequence say",
    )
    min_disparity: _End = Field(
        None,
        description="smallest disparity searched, pixels; auto: as the pair itself says; null: the scene's, else 0",
    )
    calibration: Calibration | None = Field(
        None, description="calibration by which pairs are rectified first; null: they are rectified already"
    )
    bound: Bound | None = Field(
        None, description="bound of the errors and probability of a small one that are computed, too; true: the usual"
    )
    tiles: TileMode = Field(
        "auto",
        description="whether pairs are matched in tiles, coarse to fine where costs are not local; auto: where the "
        "whole pair would need more than tile_memory",
    )
    tile_memory: int = Field(
        3072,
        ge=300,
        le=1 << 20,
        description="memory that a pair matched in tiles may take, MiB; less where less is free",
    )

    @field_validator("bound", mode="before")
    @classmethod
    def _usual(cls, data: Any) -> Any:
        return {} if data is True else None if data is False else data

    @model_validator(mode="after")
    def _has_a_range(self) -> Self:
        smallest, largest = 0 if self.min_disparity is None else self.min_disparity, self.max_disparity
        if isinstance(largest, int) and isinstance(smallest, int) and largest <= smallest:
            problem = PydanticCustomError(
                "empty_range", "should be greater than the smallest disparity, {smallest}", {"smallest": smallest}
            )
            error: InitErrorDetails = {"type": problem, "loc": ("max_disparity",), "input": largest}
            raise ValidationError.from_exception_data(type(self).__name__, [error])
        return self


class StereoConfig(PairConfig):
    """The config of ``stereo``: a pipeline with its parameters, and the device that it runs on."""

    command: ClassVar[str] = "stereo"

    pipeline: Pipeline = Field(description="the data flow from image pair to map")
    device: str = Field(
        "cpu", description="where pairs are matched: cpu, auto (GPU if any), opencl, cuda, opencl:N or cuda:N"
    )


PairConfigT = TypeVar("PairConfigT", bound=PairConfig)


def with_reading(config: PairConfigT, fields: Mapping[str, Any]) -> PairConfigT:
    """Return the config with these fields of its calibration; ConfigError if it has no calibration."""
    if config.calibration is None:
        raise ConfigError(f"--{next(iter(fields))}: there is no calibration; give --calibration FILE, too")
    return config.model_copy(update={"calibration": config.calibration.model_copy(update=dict(fields))})


@dataclass(frozen=True, eq=False)
class PairInputs:
    """A pair, how it is matched, and the ends of its search range."""

    pair: StereoPair
    matcher: PairMatcher
    ends: tuple[int | str, int | str | None]  # pixels or "auto"; the upper one None: as the pair itself suggests
    sequence: MatchedRange | None = None  # what the frames of the pair's sequence say of the range
    rectified: Rectified | None = None  # the views, where a calibration rectified them

    saving: ClassVar[Mapping[str, Any]] = {}

    @property
    def later(self) -> Callable[[Path], None] | None:
        """What writes the rectified view and its calibration; None for a pair that was rectified before."""
        return None if self.rectified is None else self.rectified.save

    @property
    def warnings(self) -> Sequence[str]:
        """What looks wrong with the calibration."""
        return () if self.rectified is None else self.rectified.warnings


@dataclass(frozen=True)
class Pairs(Problem[StereoScene, PairInputs, Disparity], Generic[PairConfigT]):
    """Pairs to the maps of their left views; ``stereo`` and ``fuse`` differ in what matches a pair."""

    model: ClassVar[type[PairConfig]]
    rows = PAIRS
    writes = (*MAP_FILES, "left.png", "calib.txt")
    shown = Shown(
        (SIZE, *map(percent, ("density", "measured")), number("median_bound", "{:.3g} px"), *METRIC_COLUMNS),
        palette=STATUS_PALETTE,
        # Each reason, alone and filled.
        legend=(0, *_REASONS, *(bit | int(Status.FILLED) for bit in _REASONS)),
        protocol="middlebury-v2",
    )

    config: PairConfigT

    @classmethod
    def ready(cls, config: PairConfigT) -> Self:
        """Return the problem of a config; ConfigError or InputError where its calibration cannot be read."""
        if config.calibration is not None:
            with collected_warnings():  # which every pair has
                config.calibration.rig()
        return cls(config)

    @abstractmethod
    def matcher(self, scene: StereoScene | None = None) -> PairMatcher:
        """Return what matches the pair of a scene, or of arrays."""

    def device(self) -> Device | None:
        """Return the device to match on, None for the processor."""
        return None

    def device_column(self) -> Row:
        """Return the report's columns of the device."""
        return {}

    def limits(self, memory: int) -> Limits:
        """Return where a pair may be matched, with at most ``memory`` bytes."""
        return Limits(memory, self.config.tiles, self.config.tile_memory << 20, self.device())

    def ends(self, scene: StereoScene | None = None) -> tuple[int | str, int | str | None]:
        """Return the ends of the range that the config, or else the scene, gives.

        If neither gives the upper one it is "auto", or None for pairs that a calibration rectifies: then both ends
        come from the pair itself.
        """
        config = self.config
        low, top = config.min_disparity, config.max_disparity
        if low is None:
            low = 0 if scene is None else scene.min_disparity
        if top is None and scene is not None:
            top = scene.max_disparity
        return low, "auto" if top is None and config.calibration is None else top

    def range_frames(self, scene: StereoScene) -> tuple[StereoScene, ...]:
        """Return the frames of the scene's sequence that give its range together; none where they do not.

        They give the range of pairs that a calibration rectifies, and of videos, but an end that the user calls "auto"
        comes from each pair by itself.
        """
        config = self.config
        if config.max_disparity is not None or config.min_disparity == "auto" or scene.max_disparity is not None:
            return ()
        return scene.sequence if config.calibration is not None or scene.frame_number is not None else ()

    def files(self, scene: StereoScene) -> dict[str, Path]:
        """Return the files of the pair, the calibration that rectifies it, and the frames that give its range."""
        files = scene.input_files
        if self.config.calibration is not None:
            files |= calibration_files(self.config.calibration)
        for k, frame in enumerate(self.range_frames(scene)):
            files |= {f"range_{k}_{role}": file for role, file in frame.input_files.items()}
        return files

    def settings(self, scene: StereoScene) -> dict[str, str]:
        """Return the search range, which may come from a file in the folder of the images."""
        low, top = self.ends(scene)
        return {"max_disparity": str(top), **({} if low == 0 else {"min_disparity": str(low)})}

    def memory(self, scene: StereoScene) -> int | None:
        """Estimate by the left image's size; None if the range comes from the pair itself."""
        return self._bytes(scene) if all(isinstance(end, int) for end in self.ends(scene)) else None

    def memory_bound(self, scene: StereoScene) -> int | None:
        """Estimate by the left image's size; None for programs, networks, devices and videos: these serve one scene."""
        alone = getattr(self.config, "device", "cpu") != "cpu" or scene.frame_number is not None
        if alone or any(isinstance(part, Network | Program) for part in parts_of(self.config)):
            return None
        return self._bytes(scene)

    def _bytes(self, scene: StereoScene) -> int:
        """Estimate the bytes of matching a pair over its range, or over the widest one where that is not known."""
        height, width = view_size(scene)
        low, top = self.ends(scene)
        low = low if isinstance(low, int) and top is not None else 1 - width
        top = min(top, width - 1) if isinstance(top, int) else width - 1
        return host_bytes(self.matcher(scene), (height, width), max(top - low, 1), self.limits(0))

    def load(self, scene: StereoScene, context: Context) -> PairInputs:
        """Return the pair of a scene, rectified if a calibration is given, and its range."""
        calibration, sequence, clock = self.config.calibration, None, context.clock
        matcher = self.matcher(scene)
        if frames := self.range_frames(scene):
            clock.start("range")
            sequence = sequence_range(calibration, frames, context.latest)
        if calibration is None:
            clock.start("load")
            pair = load_pair(scene)
            if scene.right is not None and scene.frame_number is None and not scene.halves:
                context.originals = pair, (scene.left, scene.right)
            return PairInputs(pair, matcher, self.ends(scene), sequence)
        clock.start("rectify")
        rectified = rectified_scene(calibration, scene, context.latest)
        pair = pair_of(rectified.left, rectified.right, (scene.left, scene.right or scene.left))
        return PairInputs(pair, matcher, self.ends(scene), sequence, rectified)

    def take(self, left: ArrayLike, right: ArrayLike, context: Context) -> PairInputs:
        """Return the pair of two arrays, rectified if a calibration is given."""
        views, calibration = (as_image(left, "left"), as_image(right, "right")), self.config.calibration
        if calibration is None:
            return PairInputs(paired(*views, left), self.matcher(), self.ends())
        rectified = Rectified.of(calibration, *views, context.latest)
        pair = paired(rectified.left, rectified.right, left)
        return PairInputs(pair, self.matcher(), self.ends(), rectified=rectified)

    def solve(self, inputs: PairInputs, context: Context) -> Disparity:
        """Match the pair, and bound the errors of its map if the config asks for it.

        InputError if too few pixels match for the range, or the memory is too little.
        """
        disparity = match_pair(inputs, self.limits(context.memory), context)
        if self.config.bound is None:
            return disparity
        context.clock.start("bound")
        return with_bound(disparity, inputs.pair, self.config.bound, context)

    def row(self, inputs: PairInputs, result: Disparity) -> Row:
        """Return size, range, facts of the rectification, density, bound, and figures of the method."""
        pair, search, key_points = inputs.pair, result.search, result.key_points
        return {
            "width": pair.shape[1],
            "height": pair.shape[0],
            "max_disparity": search.max_disparity,
            **({"min_disparity": search.min_disparity} if search.min_disparity or key_points else {}),
            **({} if inputs.rectified is None else inputs.rectified.facts | self._depths(inputs.rectified, result)),
            **key_points,
            "density": share(result.valid),
            "measured": share(result.measured),
            **bound_columns(result),
            **({"bits": pair.bits} if partly_used(pair) else {}),
            **{name: float(value) for name, value in result.details.figures.items()},
            **self.device_column(),
        }

    @staticmethod
    def _depths(rectified: Rectified, result: Disparity) -> Row:
        """Return the report's columns of what the disparities of a rectified pair are in meters."""
        geometry = rectified.rig.geometry
        return metric_columns(geometry, result.search, median(geometry.depth(result.values)[result.valid]))

    def notes(self, scenes: Sequence[StereoScene], rows: Sequence[Row]) -> list[str]:
        """Return a line with the search range of scenes for which neither the config nor their files give one."""
        if self.config.max_disparity is not None or self.config.calibration is not None:
            return []
        unknown = {scene.name for scene in scenes if not scene.problem and scene.max_disparity is None}
        if not unknown:
            return []
        ends = [row["max_disparity"] for row in rows if row["scene"] in unknown and "max_disparity" in row]
        if not ends:
            return []
        which = "the search range is" if len(ends) == 1 else f"the search ranges of {len(ends)} scenes are"
        span = f"{ends[0]}" if len(set(ends)) == 1 else f"{min(ends)} to {max(ends)}"
        return [
            f"{which} not known: --max-disparity auto was taken, which gives {span} px (max_disparity in report.csv)"
        ]


def bound_columns(result: Disparity) -> Row:
    """Return the report's columns of a bound: its median, and the mean probability of a value."""
    if result.bound is None or result.probability is None:
        return {}
    correct = result.probability[result.valid]
    return {"median_bound": median(result.bound), "expected_right": share(correct) if correct.size else None}


@dataclass(frozen=True)
class Stereo(Pairs[StereoConfig]):
    """Pairs matched by a pipeline, here or on a device."""

    command = "stereo"
    model = StereoConfig

    @classmethod
    def ready(cls, config: StereoConfig) -> Self:
        """Return the problem with its device found and its networks opened; ConfigError where that fails."""
        return cls(with_address(super().ready(config).config))

    def matcher(self, scene: StereoScene | None = None) -> PairMatcher:
        """Return the pipeline."""
        return self.config.pipeline

    def device(self) -> Device | None:
        """Return the device that the config names; None for the processor, and if the pipeline opens it itself."""
        if self.config.device == "cpu" or not self.config.pipeline.uses_devices:
            return None
        return device.open_device(self.config.device)

    def device_column(self) -> Row:
        """Return the device, where the config names one."""
        config, opened = self.config, self.device()
        if config.device == "cpu":
            return {}
        if opened is None:
            return {"device": config.device}
        where = f"{opened.info.address}, {opened.info.name}"
        if type(config.pipeline) not in device_table():
            where = f"cpu: {config.pipeline.method_name()} has no kernels for {where}"
        return {"device": where}


def match_pair(inputs: PairInputs, limits: Limits, context: Context) -> Disparity:
    """Return the map of a pair; InputError where the range is empty, too few pixels match, or memory is short.

    The clock of ``context`` books ``range``, where the range is found, the stages of the method, and ``other``.
    """
    pair, clock = inputs.pair, context.clock
    if inputs.sequence is None and (inputs.ends[1] is None or "auto" in inputs.ends):
        clock.start("range")
    search, key_points = complete_range(*inputs.ends, pair, inputs.sequence)
    clock.start("other")
    widest, requested = max(pair.shape[1] - 1, search.min_disparity + 1), search.max_disparity
    search = SearchRange(search.min_disparity, min(requested, widest))
    matched = match(inputs.matcher, search.shift(pair), search.shifted_max_disparity, limits, context)
    result = search.restore(matched, pair.shape[1])
    clock.include(result.seconds)
    disparity, seconds = result.disparity, dict(clock.seconds)
    warnings = _warnings(pair, search, key_points, result, limits)
    if requested > widest:
        text = f"no pixel of images {pair.shape[1]} wide has a disparity above {widest}: not searched up to {requested}"
        warnings = (text, *warnings)
    status = without_smoothed(disparity.status)
    return Disparity(disparity.values, status, pair.left, search, result, seconds, warnings, key_points)


def _warnings(
    pair: StereoPair, search: SearchRange, key_points: Mapping[str, int], result: StereoResult, limits: Limits
) -> tuple[str, ...]:
    """Return a line for each thing that looks wrong with a map."""
    found, warnings = result.disparity, []
    if partly_used(pair):
        warnings.append(f"samples of {pair.bits} bits in {pair.left.dtype} files; scaled accordingly")
    if flat := [name for name, image in (("left", pair.left), ("right", pair.right)) if image.min() == image.max()]:
        warnings.append(f"the {' and the '.join(flat)} image has one level alone: nothing can be matched")
    elif np.array_equal(pair.left, pair.right):
        warnings.append("both images are the same: the disparity is 0 or chance; was one file given twice?")
    measured = np.count_nonzero(found.measured) / found.values.size
    if measured < _MIN_MEASURED_SHARE:
        warnings.append(
            f"only {100 * measured:.0f} % of the map was measured, the rest is filled in or empty: views swapped, "
            "not rectified, search range too small, or no texture?"
        )
    bounds = ((search.min_disparity, "min_disparity"), (search.max_disparity, "max_disparity"))
    shares = search.share_at_ends(found)
    for part, (end, option) in zip(shares, bounds, strict=True):
        if part > _MAX_SHARE_AT_END:
            warnings.append(
                f"{100 * part:.0f} % of the measured pixels lie at the end of the search range, {end}; see {option}"
            )
    if _MIN_SHARE_AT_END < shares[1] <= _MAX_SHARE_AT_END and (top := matched_beyond(pair, search)) is not None:
        warnings.append(
            f"the images match at disparities up to {top}, searched up to {bounds[1][0]}; see max_disparity"
        )
    if key_points and search.min_disparity > key_points["range_low"] and key_points["range_low"] < 0:
        warnings.append(f"the images match at disparities down to {key_points['range_low']}; see min_disparity")
    if search.min_disparity < 0:
        warnings.append("disp_left.png cannot hold negative disparities: no value there; disp_left.pfm has them")
    if result.figures.get("exact") == 0 and limits.memory < limits.tile_memory:
        warnings.append(
            f"matched in {result.figures['tiles']:.0f} tiles at {result.figures['levels']:.0f} sizes, since only "
            f"{show_bytes(limits.memory)} of memory may be used: with more the map is another one"
        )
    return tuple(warnings)


def with_address(config: StereoConfig) -> StereoConfig:
    """Return the config with the address of its device, and its networks opened there; ConfigError where one fails."""
    address = config.device
    try:
        if address != "cpu" and config.pipeline.uses_devices:
            info = device.find_device(address)
            address = "cpu" if info is None else info.address
        elif address != "cpu":
            address = network_device(address)
    except (DeviceError, InputError) as error:
        raise ConfigError(str(error)) from error
    return with_opened_networks(config.model_copy(update={"device": address}), address)


def with_opened_networks(config: PairConfigT, address: str) -> PairConfigT:
    """Return the config with its networks opened and checked; ConfigError where one cannot be used.

    On a device other than CUDA's they run on the processor.
    """
    if not any(networks_in(config)):
        return config
    config = config.model_copy(deep=True)
    for network in networks_in(config):
        try:
            network.prepare(address if address.startswith("cuda") else "cpu")
        except InputError as error:
            raise ConfigError(str(error)) from error
    return config


def partly_used(pair: StereoPair) -> bool:
    """Return whether the samples have fewer bits than their type."""
    return pair.bits is not None and pair.bits < 8 * pair.left.dtype.itemsize


def with_bound(disparity: Disparity, pair: StereoPair, promise: Bound, context: Context) -> Disparity:
    """Return the map of a pair with its ``bound`` and ``probability``, which cost somewhat more than ``stereo fast``.

    InputError where the memory does not suffice.
    """
    search = disparity.search
    shifted, width = search.shift(pair), disparity.values.shape[1]
    # Where the range begins above 0, the first columns have no match at all.
    first, top = max(search.min_disparity, 0), search.shifted_max_disparity
    values, filled = np.full(shifted.shape, np.nan, np.float32), np.zeros(shifted.shape, np.bool_)
    values[:, : width - first] = disparity.values[:, first:] - np.float32(search.min_disparity)
    filled[:, : width - first] = (disparity.status[:, first:] & np.uint8(Status.FILLED)) > 0
    size = f"a bound of {shifted.shape[1]} x {shifted.shape[0]} pixels, {top + 1} disparities"
    check_memory(peak_bytes(shifted.shape, top, 1), context.memory, size)
    probable, bounded = bounds(networks(), shifted, values, filled, top, promise.within, promise.level, context)
    known = np.isfinite(disparity.values)
    # A value without a match may be any of the range.
    bound = np.where(known, np.float32(max(top, 1)), np.float32(np.nan))
    probability = np.zeros(disparity.values.shape, np.float32)
    bound[:, first:] = np.where(known[:, first:], bounded[:, : width - first], np.float32(np.nan))
    probability[:, first:] = probable[:, : width - first]
    return replace(disparity, bound=bound, probability=probability, seconds=dict(context.clock.seconds))


End = int | Literal["auto"] | None
"""An end of the search range: pixels, "auto": as the pair itself says, or None: what the config says."""


def stereo(
    left: ArrayLike,
    right: ArrayLike,
    max_disparity: End = None,
    preset: str | Path | StereoConfig = "accurate",
    overrides: Overrides | None = None,
    **fields: object,
) -> Disparity:
    """Return the map of a pair, rectified or, with ``calibration="stereo.yml"``, as the cameras took it.

    ConfigError for an unknown preset, or keys and values that do not fit; InputError for images that cannot be matched,
    too few matches where they say the range, or too little memory. ``warnings`` says what looks wrong with the map.

    Parameters
    ----------
    left, right : (H, W) grey or (H, W, 3) RGB (OpenCV reads BGR: ``image[..., ::-1]``); uint8, uint16, or floats from
        0 to 1. Where one is grey and the other in color, both become grey
    max_disparity : largest disparity searched, pixels; "auto": as the pair itself says; None: what the config
        says, else "auto", with a warning
    preset : name of a preset of ``depthcli stereo``, path of a YAML file, or a config
    overrides : config keys -> values, as ``--set`` has them, such as ``{"cost.window": 9}``
    **fields : the same for keys that are Python names, such as ``min_disparity=-8``; ``bound=True``: the map then has a
        ``bound`` of its errors and a ``probability``; or ``calibration``: a file, a list of files, or a mapping as in a
        config; the map is then that of the rectified left image

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> left = np.random.default_rng(0).integers(0, 256, (48, 96), np.uint8)
    >>> right = np.roll(left, -8, axis=1)  # all is seen at a disparity of 8 pixels
    >>> disparity = depthcli.stereo(left, right, max_disparity=16, preset="fast")
    >>> float(np.median(disparity.values[disparity.measured]))
    8.0
    """
    config = load_config(StereoConfig, preset, overrides, **with_range(fields, max_disparity))
    return Matcher(Stereo.ready(config))(left, right)


class Matcher:
    """Matches many pairs by one config: what :func:`matcher` returns. It may be called from several threads."""

    def __init__(self, problem: Pairs[Any]) -> None:
        self.config = problem.config
        self._problem, self._latest = problem, Latest()
        # A device has one queue of work.
        self._turn = contextlib.nullcontext() if problem.device() is None else threading.Lock()

    def __call__(self, left: ArrayLike, right: ArrayLike) -> Disparity:
        """Return the map of a pair, which is given as for :func:`stereo`, with the same result and errors."""
        context = Context(available_memory(), latest=self._latest)
        inputs = self._problem.take(left, right, context)
        disparity = replace(self._solved(inputs, context), rectified=inputs.rectified)
        if self.config.max_disparity is not None or inputs.ends[1] is None:
            return disparity
        text = f'max_disparity is not given: "auto" was taken, which gives {disparity.search.max_disparity} px'
        return replace(disparity, warnings=(*disparity.warnings, text))

    def _solved(self, inputs: PairInputs, context: Context) -> Disparity:
        with self._turn:
            return self._problem.solve(inputs, context)

    def load_kernels(self) -> None:
        """Match small pairs, grey and in color, so that the first pair of the user takes no longer than the next."""
        method = self._problem.matcher()
        if isinstance(method, Program) or getattr(method, "volumes", None):
            return
        top = self.config.max_disparity
        top = min(top, 32) if isinstance(top, int) and top > 0 else 32
        noise = np.random.default_rng(0).integers(0, 256, (32, 96, 3), np.uint8)
        for image in (noise[..., 0].copy(), noise):
            pair = StereoPair(image, np.roll(image, -2, axis=1), 8)
            self._solved(PairInputs(pair, method, (0, top)), Context(available_memory()))


def with_range(fields: dict[str, object], max_disparity: End) -> dict[str, object]:
    """Return overrides of a config with the largest disparity, if one is given."""
    return fields if max_disparity is None else {**fields, "max_disparity": max_disparity}

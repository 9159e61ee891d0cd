"""Match rectified pairs: configs, inputs from files and arrays, matching, reports, and the Python functions."""

from __future__ import annotations

import contextlib
import threading
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, Literal, NamedTuple, Self, TypeVar

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
from depthcli.device import DeviceError
from depthcli.io.formats.files import collected_warnings
from depthcli.io.formats.images import pair_of
from depthcli.io.scenes import StereoScene
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.stereo_pairs import load_pair, view_size
from depthcli.methods.stereo.matching import Limits, TileMode, device_table, host_bytes, match
from depthcli.methods.stereo.networks import Network, network_device, networks_in
from depthcli.methods.stereo.pipeline import Pipeline
from depthcli.methods.stereo.pipeline.command import Program
from depthcli.methods.stereo.search_range import (
    MAX_DISPARITY,
    MatchedRange,
    SearchRange,
    complete_range,
)
from depthcli.methods.stereo.stages import PairMatcher
from depthcli.problems.inputs import Overrides, as_image, load_config, paired
from depthcli.problems.map_checks import doubts, with_bound
from depthcli.problems.problem import MAP_FILES, Inputs, Problem, Shown
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
from depthcli.run.job import available_memory
from depthcli.show.table import SIZE, Row, median, number, percent, share, size_of
from depthcli.show.view import STATUS_PALETTE

_REASONS = [int(bit) for bit in (Status.OCCLUDED, Status.MISMATCH, Status.OUT_OF_RANGE, Status.NO_DATA)]

End = Annotated[int, Field(ge=-MAX_DISPARITY, le=MAX_DISPARITY)] | Literal["auto"] | None
"""An end of the search range: pixels, "auto" (estimated from the pair), or None (from the config)."""


class PairConfig(RootConfig):
    """The common config keys of all commands that match pairs."""

    max_disparity: End = Field(
        None,
        description="largest disparity searched, pixels; auto: estimated from the pair; null: from the scene, or auto "
        "(frames of a sequence that a calibration rectifies share the range of the first ones)",
    )
    min_disparity: End = Field(
        None,
        description="smallest disparity searched, pixels; auto: estimated from the pair; null: from the scene, or 0",
    )
    calibration: Calibration | None = Field(
        None, description="calibration that rectifies pairs first; null: pairs are already rectified"
    )
    bound: Bound | None = Field(
        None, description="also compute error bound and probability of a small error; true: with the defaults"
    )
    tiles: TileMode = Field(
        "auto",
        description="whether pairs are matched in tiles, or coarse to fine if costs are not local; auto: if the whole "
        "pair needs more than tile_memory",
    )
    tile_memory: int = Field(
        3072,
        ge=300,
        le=1 << 20,
        description="memory for a pair matched in tiles, MiB; smaller if less memory is free",
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
    """The config of ``stereo``: a pipeline with its parameters, and the device."""

    command: ClassVar[str] = "stereo"

    pipeline: Pipeline = Field(description="the data flow from image pair to map")
    device: str = Field(
        "cpu", description="where pairs are matched: cpu, auto (GPU if any), opencl, cuda, opencl:N or cuda:N"
    )


PairConfigT = TypeVar("PairConfigT", bound=PairConfig)


class Ends(NamedTuple):
    """The ends of a search range: pixels, or "auto", estimated from the pair; None at the top: both are estimated."""

    low: int | str
    top: int | str | None

    @property
    def are_known(self) -> bool:
        """Return whether no end is estimated."""
        return isinstance(self.low, int) and isinstance(self.top, int)


@dataclass(frozen=True, eq=False)
class PairInputs(Inputs):
    """A pair with its matcher and the ends of its search range."""

    pair: StereoPair
    matcher: PairMatcher
    ends: Ends
    sequence: MatchedRange | None = None  # the range from the frames of the pair's sequence
    rectified: Rectified | None = None  # the views, if a calibration rectified them
    warnings: Sequence[str] = ()
    write_meanwhile: Callable[[Path], None] | None = None


@dataclass(frozen=True)
class Pairs(Problem[StereoScene, PairInputs, Disparity], Generic[PairConfigT]):
    """Compute maps of the left views of pairs; ``stereo`` and ``fuse`` differ in their matchers."""

    model: ClassVar[type[Any]]
    layouts = PAIRS
    writes = (*MAP_FILES, "left.png", "calib.txt")
    shown = Shown(
        (SIZE, *map(percent, ("density", "measured")), number("median_bound", "{:.3g} px"), *METRIC_COLUMNS),
        palette=STATUS_PALETTE,
        # Each reason, without and with a filled value.
        legend=(0, *_REASONS, *(bit | int(Status.FILLED) for bit in _REASONS)),
        protocol="middlebury-v2",
    )

    config: PairConfigT

    @classmethod
    def ready(cls, config: PairConfigT) -> Self:
        """Return the problem with open and checked networks. Raise ConfigError or InputError for unusable files.

        On devices other than CUDA, networks run on the CPU.
        """
        if config.calibration is not None:
            with collected_warnings():  # every pair repeats them
                config.calibration.rig()
        if any(networks_in(config)):
            address = getattr(config, "device", "cpu")
            config = config.model_copy(deep=True)
            for network in networks_in(config):
                try:
                    network.prepare(address if address.startswith("cuda") else "cpu")
                except InputError as error:
                    raise ConfigError(str(error)) from error
        return cls(config)

    @classmethod
    def of(
        cls,
        preset: str | Path | RootConfig,
        max_disparity: End,
        overrides: Overrides | None,
        fields: Mapping[str, object],
    ) -> Self:
        """Return the problem for the arguments of a Python function. Raise ConfigError as :func:`stereo`."""
        given = {} if max_disparity is None else {"max_disparity": max_disparity}
        return cls.ready(load_config(cls.model, preset, overrides, **fields, **given))

    @abstractmethod
    def matcher(self, scene: StereoScene | None = None) -> PairMatcher:
        """Return the matcher for a scene's pair, or for arrays."""

    @abstractmethod
    def limits(self, memory: int) -> Limits:
        """Return the limits for matching a pair with at most ``memory`` bytes."""

    def ends(self, scene: StereoScene | None = None) -> Ends:
        """Return the ends of the search range from the config or, by default, from the scene.

        If neither has an upper end, it is "auto". For pairs that a calibration rectifies it is None, and a lower end
        that neither has is "auto": both are estimated from the pair.
        """
        config = self.config
        low, top = config.min_disparity, config.max_disparity
        if low is None:
            low = 0 if scene is None else scene.min_disparity
        if top is None and scene is not None:
            top = scene.max_disparity
        if top is None and config.calibration is not None:
            return Ends("auto" if low == 0 and config.min_disparity is None else low, None)
        return Ends(low, "auto" if top is None else top)

    def range_frames(self, scene: StereoScene) -> tuple[StereoScene, ...]:
        """Return the frames of the scene's sequence from which its range is estimated, or an empty tuple.

        Frames share a range in videos and in sequences that a calibration rectifies. If the user sets an end to "auto",
        it is estimated from each pair alone.
        """
        config = self.config
        if config.max_disparity is not None or config.min_disparity == "auto" or scene.max_disparity is not None:
            return ()
        return scene.sequence if config.calibration is not None or scene.frame_number is not None else ()

    def files(self, scene: StereoScene) -> dict[str, Path]:
        """Return role -> file for the pair, its calibration, and the frames that give its range."""
        files = scene.input_files
        if self.config.calibration is not None:
            files |= calibration_files(self.config.calibration)
        for k, frame in enumerate(self.range_frames(scene)):
            files |= {f"range_{k}_{role}": file for role, file in frame.input_files.items()}
        return files

    def settings(self, scene: StereoScene) -> dict[str, str]:
        """Return the search range, which may come from a file next to the images."""
        low, top = self.ends(scene)
        by_default = low == 0 or (low == "auto" and self.config.min_disparity is None)
        return {"max_disparity": str(top), **({} if by_default else {"min_disparity": str(low)})}

    def memory(self, scene: StereoScene) -> int | None:
        """Return an estimate from the left image's size, or None if the range is estimated from the pair."""
        return self._bytes(scene) if self.ends(scene).are_known else None

    def memory_bound(self, scene: StereoScene) -> int | None:
        """Return an estimate from the left image's size; None for programs, networks, devices and videos.

        These can compute only one scene at a time.
        """
        alone = getattr(self.config, "device", "cpu") != "cpu" or scene.frame_number is not None
        if alone or any(isinstance(part, Network | Program) for part in parts_of(self.config)):
            return None
        return self._bytes(scene)

    def _bytes(self, scene: StereoScene) -> int:
        """Return an estimate of the bytes for matching a pair over its range, or over the widest possible range."""
        height, width = view_size(scene)
        low, top = self.ends(scene)
        low = low if isinstance(low, int) and top is not None else 1 - width
        top = min(top, width - 1) if isinstance(top, int) else width - 1
        return host_bytes(self.matcher(scene), (height, width), max(top - low, 1), self.limits(0))

    def load(self, scene: StereoScene, context: Context) -> PairInputs:
        """Return a scene's pair, rectified if there is a calibration, with its range."""
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
        return PairInputs(
            pair, matcher, self.ends(scene), sequence, rectified, rectified.warnings, write_meanwhile=rectified.save
        )

    def take(self, left: ArrayLike, right: ArrayLike, context: Context) -> PairInputs:
        """Return the pair of two arrays, rectified if there is a calibration."""
        views, calibration = (as_image(left, "left"), as_image(right, "right")), self.config.calibration
        if calibration is None:
            return PairInputs(paired(*views, left), self.matcher(), self.ends())
        rectified = Rectified.of(calibration, *views, context.latest)
        pair = paired(rectified.left, rectified.right, left)
        return PairInputs(pair, self.matcher(), self.ends(), rectified=rectified)

    def solve(self, inputs: PairInputs, context: Context) -> Disparity:
        """Match the pair, and compute the error bound if the config requests it.

        The clock records ``range`` if the range is estimated, the stages of the method, ``other``, and ``bound``.

        Raise InputError if too few pixels match to estimate the range, or there is not enough memory.
        """
        pair, clock, limits = inputs.pair, context.clock, self.limits(context.memory)
        if inputs.sequence is None and not inputs.ends.are_known:
            clock.start("range")
        search, key_points = complete_range(*inputs.ends, pair, inputs.sequence)
        clock.start("other")
        widest, requested = max(pair.shape[1] - 1, search.min_disparity + 1), search.max_disparity
        search = SearchRange(search.min_disparity, min(requested, widest))
        matched = match(inputs.matcher, search.shift(pair), search.shifted_max_disparity, limits, context)
        result = search.restore(matched, pair.shape[1])
        clock.include(result.seconds)
        values, status, seconds = result.disparity.values, result.disparity.status, dict(clock.seconds)
        warnings = doubts(pair, search, key_points, result, limits)
        if requested > widest:
            text = f"no pixel of images {pair.shape[1]} wide has a disparity above {widest}"
            warnings = (f"{text}: not searched up to {requested}", *warnings)
        disparity = Disparity(
            values, without_smoothed(status), pair.left, search=search, details=result, seconds=seconds,
            warnings=warnings, key_points=key_points,
        )  # fmt: skip
        if self.config.bound is None:
            return disparity
        clock.start("bound")
        return with_bound(disparity, pair, self.config.bound, context)

    def row(self, inputs: PairInputs, result: Disparity) -> Row:
        """Return size, range, facts of the rectification, density, bound, and figures of the method."""
        pair, search, key_points, facts, bound = inputs.pair, result.search, result.key_points, Row(), Row()
        if inputs.rectified is not None:
            geometry = inputs.rectified.rig.geometry
            depth = median(geometry.depth(result.values)[result.valid])
            facts = inputs.rectified.facts | metric_columns(geometry, search, depth)
        if result.bound is not None and result.probability is not None:
            correct = result.probability[result.valid]
            bound = {"median_bound": median(result.bound), "expected_right": share(correct) if correct.size else None}
        return {
            **size_of(pair),
            "max_disparity": search.max_disparity,
            **({"min_disparity": search.min_disparity} if search.min_disparity or key_points else {}),
            **facts,
            **key_points,
            "density": share(result.valid),
            "measured": share(result.measured),
            **bound,
            **({"bits": pair.bits} if pair.top < np.iinfo(pair.left.dtype).max else {}),
            **{name: float(value) for name, value in result.details.figures.items()},
        }

    def notes(self, scenes: Sequence[StereoScene], rows: Sequence[Row]) -> list[str]:
        """Return a line about scenes whose search range neither the config nor their files give."""
        unknown = {scene.name for scene in scenes if not scene.problem and scene.max_disparity is None}
        if not unknown or self.config.max_disparity is not None or self.config.calibration is not None:
            return []
        ends = [row["max_disparity"] for row in rows if row["scene"] in unknown and "max_disparity" in row]
        if not ends:
            return []
        which = "the search range is" if len(ends) == 1 else f"the search ranges of {len(ends)} scenes are"
        span = f"{ends[0]}" if len(set(ends)) == 1 else f"{min(ends)} to {max(ends)}"
        return [
            f"{which} not known: --max-disparity auto was taken, which gives {span} px (max_disparity in report.csv)"
        ]


@dataclass(frozen=True)
class Stereo(Pairs[StereoConfig]):
    """Match pairs with the configured pipeline, on the CPU or a device."""

    command = "stereo"
    model = StereoConfig

    @classmethod
    def ready(cls, config: StereoConfig) -> Self:
        """Return the problem with the address of its device. Raise ConfigError or InputError on failure."""
        address = config.device
        try:
            if address != "cpu" and config.pipeline.uses_devices:
                info = device.find_device(address)
                address = "cpu" if info is None else info.address
            elif address != "cpu":
                address = network_device(address)
        except (DeviceError, InputError) as error:
            raise ConfigError(str(error)) from error
        return super().ready(config.model_copy(update={"device": address}))

    def matcher(self, scene: StereoScene | None = None) -> PairMatcher:
        """Return the pipeline of the config."""
        return self.config.pipeline

    def limits(self, memory: int) -> Limits:
        """Return the limits, with the device unless it is the CPU or the pipeline opens the device itself."""
        config, opened = self.config, None
        if config.device != "cpu" and config.pipeline.uses_devices:
            opened = device.open_device(config.device)
        return Limits(memory, config.tiles, config.tile_memory << 20, opened)

    def row(self, inputs: PairInputs, result: Disparity) -> Row:
        """Return the row, with the device if the config names one."""
        where, opened, pipeline = self.config.device, self.limits(0).device, self.config.pipeline
        if opened is not None:
            where = f"{opened.info.address}, {opened.info.name}"
            if type(pipeline) not in device_table():
                where = f"cpu: {pipeline.method_name()} has no kernels for {where}"
        return super().row(inputs, result) | ({} if where == "cpu" else {"device": where})


def stereo(
    left: ArrayLike,
    right: ArrayLike,
    max_disparity: End = None,
    preset: str | Path | StereoConfig = "accurate",
    overrides: Overrides | None = None,
    **fields: object,
) -> Disparity:
    """Return the disparity map of a rectified pair, or of an unrectified pair with ``calibration="stereo.yml"``.

    Raise ConfigError for an unknown preset, unknown keys or invalid values; raise InputError for images that cannot be
    matched, too few matches to estimate the range, or too little memory. ``warnings`` lists doubtful properties of the
    map.

    Parameters
    ----------
    left, right : (H, W) grey or (H, W, 3) RGB (OpenCV reads BGR: ``image[..., ::-1]``); uint8, uint16, or floats from
        0 to 1. If one is grey and the other color, both become grey
    max_disparity : largest disparity to search, pixels; "auto": estimated from the pair; None: the config's or, if it
        has none, "auto" with a warning
    preset : name of a preset of ``depthcli stereo``, path of a YAML file, or a config
    overrides : config keys -> values, as in ``--set``, such as ``{"cost.window": 9}``
    **fields : overrides for keys that are Python names, such as ``min_disparity=-8``. With ``bound=True``, the map has
        ``bound`` and ``probability``. ``calibration`` is a file, a list of files, or a mapping as in a config; the map
        then describes the rectified left image

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> left = np.random.default_rng(0).integers(0, 256, (48, 96), np.uint8)
    >>> right = np.roll(left, -8, axis=1)  # all is seen at a disparity of 8 pixels
    >>> disparity = depthcli.stereo(left, right, max_disparity=16, preset="fast")
    >>> float(np.median(disparity.values[disparity.measured]))
    8.0
    """
    return Matcher(Stereo.of(preset, max_disparity, overrides, fields))(left, right)


class Matcher:
    """Match many pairs with one config; :func:`matcher` returns it. It may be called from several threads."""

    def __init__(self, problem: Pairs[Any]) -> None:
        self.config = problem.config
        self._problem, self._latest = problem, Latest()
        # A device has one queue, so that threads take turns.
        self._turn = contextlib.nullcontext() if problem.limits(0).device is None else threading.Lock()

    def __call__(self, left: ArrayLike, right: ArrayLike) -> Disparity:
        """Return the map of a pair, with the same inputs, result and errors as :func:`stereo`."""
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
        """Match small grey and color pairs, so that the user's first pair takes no longer than the next."""
        method = self._problem.matcher()
        if isinstance(method, Program) or getattr(method, "volumes", None):
            return
        top = self.config.max_disparity
        top = min(top, 32) if isinstance(top, int) and top > 0 else 32
        noise = np.random.default_rng(0).integers(0, 256, (32, 96, 3), np.uint8)
        for image in (noise[..., 0].copy(), noise):
            pair = StereoPair(image, np.roll(image, -2, axis=1), 8)
            self._solved(PairInputs(pair, method, Ends(0, top)), Context(available_memory()))

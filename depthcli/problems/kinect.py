"""Clean and complete the depth of a Kinect or similar sensor: ``refine-kinect`` and ``refine_depth``."""

from __future__ import annotations

import hashlib
import itertools
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from depthcli.core.cameras.camera import Intrinsics, Place, sensor_fb
from depthcli.core.cameras.color_and_depth import registered
from depthcli.core.context import Clock, Context
from depthcli.core.errors import DepthcliError, InputError
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DEPTH_STATUS_HELP, DepthStatus
from depthcli.core.result import DepthResult
from depthcli.io.formats.depth import MILLIMETERS, sensor_warning
from depthcli.io.formats.disparity import read_plane
from depthcli.io.formats.files import collected_warnings, naming
from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.plain_text import numbers
from depthcli.io.rgbd_frames import check_center, frame_size, load_frame
from depthcli.io.scenes import RgbdScene, Scene, SequenceScene, sequences
from depthcli.methods.kinect.bounds import BYTES_PER_PIXEL
from depthcli.methods.kinect.pipeline import Pipeline, SequencePipeline, frame_by_frame
from depthcli.problems.frames import DepthConfig, DepthProblem, FrameInputs, RefinedDepth
from depthcli.problems.inputs import Overrides, as_color8, as_depth, load_config
from depthcli.problems.problem import DEPTH_FILES, Shown
from depthcli.run.console import Reporter
from depthcli.run.job import Outcome, available_memory, check_memory
from depthcli.show.table import SIZE, Row, number, percent, share
from depthcli.show.view import DEPTH_STATUS_PALETTE

Image = NDArray[Any]
FrameOrSequence: TypeAlias = RgbdScene | SequenceScene


class RefineKinectConfig(DepthConfig):
    """A pipeline with its parameters."""

    command: ClassVar[str] = "refine-kinect"

    pipeline: Pipeline = Field(description="the data flow from frame to refined depth")

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Return an estimate of the peak working memory for a frame of ``shape``, in bytes."""
        return max(self.pipeline.peak_bytes(shape), BYTES_PER_PIXEL * shape[0] * shape[1])


class _Sensor(NamedTuple):
    """The depth camera of frames in arrays."""

    fb: float | None  # focal length x baseline, pixel meters; None: by the color camera, or a Kinect's
    camera: Intrinsics | None  # None: depth is registered to color
    place: Place | None  # its pose in the color camera's frame; None: the same

    @classmethod
    def of(
        cls,
        fb: float | None,
        intrinsics: Sequence[float] | None,
        to_color: tuple[ArrayLike, ArrayLike] | None,
    ) -> Self:
        """Return the camera for the arguments of :func:`refine_depth`. Raise InputError for impossible numbers."""
        camera = place = None
        if intrinsics is not None:
            camera = Intrinsics(*numbers(list(intrinsics), "depth_intrinsics", (4,)).tolist())
        if to_color is not None:
            if len(to_color) != 2:
                raise InputError(f"depth_to_color: expected rotation and translation (got {len(to_color)} parts)")
            turn, shift = (np.ravel(np.asarray(part)).tolist() for part in to_color)
            rotation = numbers(turn, "depth_to_color: rotation", (9,)).tolist()
            place = tuple(rotation), tuple(numbers(shift, "depth_to_color: translation", (3,)).tolist())
        return cls(fb, camera, place)


@dataclass(frozen=True)
class RefineKinect(DepthProblem[FrameOrSequence, RefineKinectConfig]):
    """Refine single frames, or the frames of sequences in order."""

    command = "refine-kinect"
    model = RefineKinectConfig
    writes = (*DEPTH_FILES, "probability.pfm", "confidence_*")
    shown = Shown(
        (SIZE, *map(percent, ("known", "kept", "filled", "corrected")), number("median_bound", "{:.3g} m")),
        palette=DEPTH_STATUS_PALETTE,
        protocol="depth",
    )

    step: Callable[[RgbdFrame], DepthResult] | None = None  # refines the next frame of a sequence

    def load(self, scene: FrameOrSequence, context: Context) -> FrameInputs:
        """Return a scene's frame with depth registered to color."""
        assert isinstance(scene, RgbdScene)
        context.clock.start("load")
        config = self.config
        if not scene.raw:
            scene = replace(scene, intrinsics=config.intrinsics or scene.intrinsics).with_scale(config.depth_scale)
        frame, way = load_frame(scene), ""
        if frame.interpolated or scene.depth_intrinsics is not None:
            way = "by both cameras" if scene.depth_intrinsics else "assumed"
        warnings = [] if scene.raw else _scale_warnings(scene, frame)
        coding = scene.depth_scale or MILLIMETERS, 3 if scene.rotated else 0
        return FrameInputs(frame, *coding, way, warnings=warnings)

    def take(
        self,
        color: Image | None,
        depth: Image,
        sensor: _Sensor,
        where: str = "",
        size: tuple[int, ...] | None = None,
    ) -> FrameInputs:
        """Return the frame of two arrays, with depth registered to color; messages begin with ``where``.

        Raise InputError if the arrays do not fit together, or the frame has not the ``size`` of the sequence's first.
        """
        config, camera, name = self.config, self.config.camera, f"{where}depth"
        with collected_warnings() as lines:
            measured = as_depth(depth, name, config.depth_scale)
            image = None if color is None else as_color8(color, f"{where}color")
            height, width = measured.shape if image is None else image.shape[:2]
            check_center(f"{where}intrinsics", camera, (height, width))
            check_center(f"{where}depth_intrinsics", sensor.camera, measured.shape)
        if size not in (None, (height, width)):
            raise InputError(f"{where}{width} x {height}, but frame 0 is {size[1]} x {size[0]}")
        if image is None:
            camera = camera or sensor.camera
            frame = RgbdFrame.without_color(measured, sensor.fb or sensor_fb(camera), camera)
        else:
            with naming(name):
                found = registered(measured, (height, width), camera, sensor.camera, sensor.place)
            lines += [f"{name}: {found.note}"] if found.note else []
            frame = RgbdFrame(image, found.depth, sensor.fb or sensor_fb(camera), camera, found.interpolated)
        scale = config.depth_scale or MILLIMETERS
        if np.asarray(depth).dtype.kind != "f" and (text := sensor_warning(name, frame.depth, scale)):
            lines.append(text)
        return FrameInputs(frame, scale, warnings=lines)

    def solve(self, inputs: FrameInputs, context: Context) -> RefinedDepth:
        """Refine the frame and select the pixels of its cloud. Raise InputError if there is not enough memory."""
        config, frame = self.config, inputs.frame
        assert isinstance(frame, RgbdFrame)
        height, width = frame.shape
        check_memory(config.peak_bytes(frame.shape), context.memory, f"{width} x {height} pixels")
        return self.refined(self.step or config.pipeline, frame, inputs, context)

    def shares(self, result: RefinedDepth) -> Row:
        """Return the shares of pixels that were kept, filled or corrected, and of each reason."""
        bits = [bit for bit in DEPTH_STATUS_HELP if bit not in (DepthStatus.KEPT, DepthStatus.SAMPLED)]
        row = {name: share(getattr(result, name)) for name in ("kept", "filled", "corrected")}
        return row | {str(bit.name).lower(): share((result.status & bit) != 0) for bit in bits}

    def units(self, scenes: Sequence[Any], reporter: Reporter) -> Sequence[FrameOrSequence]:
        """Return the frames, or their sequences if the pipeline carries state from frame to frame."""
        frames = super().units(scenes, reporter)
        carries = isinstance(self.config.pipeline, SequencePipeline)
        return cast("Sequence[FrameOrSequence]", sequences(frames)) if carries else frames

    def compute(self, scene: FrameOrSequence, folder: Path, context: Context) -> Outcome:
        """Refine a frame, or each frame of a sequence into its own folder; numbers of a sequence are means."""
        if isinstance(scene, RgbdScene):
            return super().compute(scene, folder, context)
        along = replace(self, step=frame_by_frame(self.config.pipeline))
        outcomes: list[Outcome] = []
        problems = []
        for frame in scene.frames:
            target = folder / frame.name.rpartition("/")[2]
            try:
                target.mkdir()
                outcomes.append(along.compute(frame, target, replace(context, clock=Clock())))
            except DepthcliError as error:  # continue with the next frame, with the same state
                target.rmdir()
                problems.append(f"{frame.name}: {error}")
        if not outcomes:
            raise InputError(problems[0])
        facts = {"frames": len(outcomes), "frames_failed": len(problems), **outcomes[0].facts}
        for key in dict.fromkeys(key for each in outcomes for key in each.facts):
            if known := [value for each in outcomes if isinstance(value := each.facts.get(key), float)]:
                facts[key] = round(sum(known) / len(known), 6)
        if "motion" in facts:
            runs = itertools.groupby(each.facts["motion"] for each in outcomes)
            facts["motion"] = ", ".join(f"{len(list(run))} {motion}" for motion, run in runs)
        seconds = {key: sum(each.seconds.get(key, 0.0) for each in outcomes) for key in outcomes[0].seconds}
        warnings = [line for each in outcomes for line in each.warnings]
        return Outcome(facts, seconds, [*problems, *dict.fromkeys(warnings)])

    def settings(self, scene: FrameOrSequence) -> dict[str, str]:
        """Return the scale of the depth, and the cameras and poses from the layout."""
        frames = _frames(scene)
        first = frames[0]
        scale = self.config.depth_scale or first.depth_scale or MILLIMETERS
        found = {"depth_scale": str(scale), "camera": f"{first.intrinsics} {first.fb} {first.rotated} {first.raw}"}
        if first.depth_intrinsics is not None:
            found["depth_camera"] = f"{first.depth_intrinsics} {first.depth_to_color}"
        if isinstance(scene, SequenceScene) and any(frame.pose is not None for frame in frames):
            found["poses"] = hashlib.sha256(repr([frame.pose for frame in frames]).encode()).hexdigest()[:16]
        return found

    def memory(self, scene: FrameOrSequence) -> int:
        """Return an estimate from the size of the frame, or of a sequence's first frame."""
        return self.config.peak_bytes(frame_size(_frames(scene)[0]))

    def truth_scenes(self, scenes: Sequence[FrameOrSequence]) -> Sequence[Scene]:
        """Return all frames, including the frames of sequences."""
        frames = [frame for scene in scenes for frame in _frames(scene)]
        return sorted((frame.with_scale(self.config.depth_scale) for frame in frames), key=lambda frame: frame.name)


def _scale_warnings(scene: RgbdScene, frame: RgbdFrame) -> list[str]:
    """Return warnings about depths that are implausible for the sensor, with a plausible scale."""
    codes = read_plane(scene.depth)
    if codes.dtype.kind not in "iu":
        return []
    # Rotation by 3 bits leaves the three low bits free.
    is_image = scene.depth.suffix.lower() in IMAGE_SUFFIXES
    if not scene.rotated and is_image and np.mean((codes[codes > 0] & 7) == 0) > 0.5:
        return [f"{scene.depth}: most codes are multiples of 8, as in SUN RGB-D; if it is: --layout sun-rgbd"]
    text = sensor_warning(scene.depth, frame.depth, scene.depth_scale or MILLIMETERS)
    return [text] if text else []


def _frames(scene: FrameOrSequence) -> Sequence[RgbdScene]:
    return scene.frames if isinstance(scene, SequenceScene) else (scene,)


Preset: TypeAlias = str | Path | RefineKinectConfig


@typing.overload
def refine_depth(color: Image | None, depth: Image, preset: Preset = ..., **options: Any) -> RefinedDepth: ...
@typing.overload
def refine_depth(
    color: Sequence[Image], depth: Sequence[Image], preset: Preset = ..., **options: Any
) -> list[RefinedDepth]: ...
def refine_depth(
    color: Image | Sequence[Image | None] | None,
    depth: Image | Sequence[Image],
    preset: Preset = "accurate",
    overrides: Overrides | None = None,
    *,
    fb: float | None = None,
    depth_intrinsics: Sequence[float] | None = None,
    depth_to_color: tuple[ArrayLike, ArrayLike] | None = None,
    **fields: object,
) -> RefinedDepth | list[RefinedDepth]:
    """Return the cleaned and completed depth map of a Kinect or similar sensor, or a list of such maps.

    Raise ConfigError for an unknown preset, unknown keys or invalid values; raise InputError for arrays that are no
    images or maps, no known depth, different sizes without known cameras, or too little memory.

    Parameters
    ----------
    color : (H, W, 3) RGB or (H, W) grey, as for :func:`depthcli.stereo`; or a list with the frames of a sequence. If
        None, gaps are filled and noise is removed by geometry alone
    depth : (H, W), registered to the color image; or a list of the same length. Floats are meters and integers
        millimeters, or both are codes if ``depth_scale`` (codes per meter) is given; numbers that are not positive are
        unknown. A smaller map of the same aspect ratio is scaled
    preset : name of a preset of ``depthcli refine-kinect``, path of a YAML file, or a config. ``"sequence"`` carries
        state along a list; others refine each frame alone
    overrides : config keys -> values, as in ``--set``
    fb : focal length x baseline of the sensor, pixel meters; None: from the ``intrinsics``, or a Kinect's without them
    depth_intrinsics : fx, fy, cx, cy of the depth camera, pixels of ``depth``, which may have any size. Together with
        the color camera's ``intrinsics``, they register the depth to the color image. None: it is registered
    depth_to_color : rotation (3, 3) and translation (3,), meters, from the depth camera's frame to the color camera's;
        None: both cameras have the same pose
    **fields : config keys that are Python names, such as ``intrinsics=(fx, fy, cx, cy)`` and ``depth_scale=5000``

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> color = np.full((48, 64, 3), 128, np.uint8)
    >>> measured = np.full((48, 64), 2.0, np.float32)  # a wall at 2 m
    >>> measured[20:24, 20:30] = np.nan
    >>> refined = depthcli.refine_depth(color, measured, preset="nearest")
    >>> bool(np.isnan(refined.values).any()), int(refined.filled.sum())
    (False, 40)
    """
    config = load_config(RefineKinectConfig, preset, overrides, **fields)
    sensor = _Sensor.of(fb, depth_intrinsics, depth_to_color)
    single = not isinstance(color, list | tuple) and not isinstance(depth, list | tuple)
    colors, depths = ([color], [depth]) if single else (color, depth)
    if colors is None:
        colors = [None] * len(depth)
    if not isinstance(colors, list | tuple) or not isinstance(depths, list | tuple) or len(colors) != len(depths):
        raise InputError("color, depth: give two images, or two lists of as many")
    problem = RefineKinect(config, frame_by_frame(config.pipeline))
    results: list[RefinedDepth] = []
    for index, images in enumerate(zip(colors, depths, strict=True)):
        where, size = "" if single else f"frame {index}: ", results[0].values.shape if results else None
        inputs = problem.take(*images, sensor, where, size)
        result = problem.solve(inputs, Context(available_memory()))
        results.append(replace(result, warnings=(*inputs.warnings, *result.warnings)))
    return results[0] if single else results

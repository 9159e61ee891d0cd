"""Clean and complete the depth maps of a Kinect."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from depthcli.commands._clouds import check_limits, empty_cloud
from depthcli.commands._old_batch import DEPTH_RESULTS, ConfigCommand
from depthcli.core.errors import ConfigError, DepthcliError, InputError
from depthcli.core.option import Option
from depthcli.core.text import short
from depthcli.io.layouts import Folder
from depthcli.io.layouts.rgbd import cameras
from depthcli.io.scenes import Scene
from depthcli.io.scenes.rgbd import RgbdScene
from depthcli.io.scenes.rgbd_sequence import SequenceScene, sequences
from depthcli.run.batch import Outcome
from depthcli.run.command import Values
from depthcli.run.console import SIZE, Column, Reporter, percent
from depthcli.run.json_csv import Row

if TYPE_CHECKING:
    from depthcli.core.frames import RgbdFrame
    from depthcli.core.result import DepthResult
    from depthcli.io.formats.pictures import Palette
    from depthcli.methods.kinect.config import RefineKinectConfig


class RefineKinectCommand(ConfigCommand["RefineKinectConfig", Scene]):
    """Refines single frames, or sequences where the method carries state from frame to frame."""

    kinds: ClassVar[tuple[type[Scene], ...]] = (RgbdScene,)
    # Frames of a sequence have folders of their own.
    results: ClassVar[tuple[str, ...]] = (*DEPTH_RESULTS, *(f"*/{name}" for name in DEPTH_RESULTS))
    shown_as: ClassVar[str] = "depth"

    page = "how_to/kinect"
    examples = (
        "depthcli refine-kinect accurate --input frames --output runs/refined",
        "depthcli refine-kinect fast --color color.png --depth depth.png -o one --ply",
    )

    @property
    def options(self) -> tuple[Option, ...]:
        ply = Option("ply", bool, "Also write a colored point cloud of every frame.", default=False, group="Output")
        return (
            *super().options,
            ply,
            Option("intrinsics", str, "Of the color camera, pixels: fx,fy,cx,cy.", "NUMBERS", group="Input"),
            Option("depth_intrinsics", str, "Of the depth camera, if not registered.", "NUMS", group="Input"),
            Option("mask", str, "Pixels of clouds: all, measured, confident:0.8.", "WHICH", group="Output"),
            Option("near", float, "Nearest depth of point clouds.", "METERS", group="Output"),
            Option("far", float, "Farthest depth of point clouds.", "METERS", group="Output"),
        )  # fmt: skip

    def config_model(self) -> type[RefineKinectConfig]:
        from depthcli.methods.kinect.config import RefineKinectConfig

        return RefineKinectConfig

    def run(self, values: Values, reporter: Reporter) -> int:
        """Refine every scene; ``--ply`` and what it needs override the config. Return the exit code."""
        given = {name: values[name] for name in ("mask", "near", "far") if values[name] is not None}
        if values["intrinsics"] is not None:
            _camera(values, "intrinsics")
            given["intrinsics"] = f"[{values['intrinsics']}]"
        settings = [*(values["set"] or ()), *(["ply=true"] if values["ply"] else ())]
        settings += [f"{name}={value}" for name, value in given.items()]
        said = dict.fromkeys(("ply", "mask", "near", "far", "intrinsics"))  # by the settings
        return super().run({**values, **said, "set": settings}, reporter)

    def run_on(self, config: RefineKinectConfig, scenes: Sequence[Scene], values: Values, reporter: Reporter) -> int:
        from depthcli.api.results import parse_mask
        from depthcli.methods.kinect.pipeline import SequencePipeline

        check_limits(config.near, config.far)
        parse_mask(config.mask)  # a wrong share is an error before any frame is opened
        if values.get("color") is not None:
            scenes = [_with_meta(scene) for scene in scenes]
        if values.get("depth_intrinsics") is not None:
            camera = _camera(values, "depth_intrinsics")
            scenes = [
                replace(s, depth_intrinsics=camera) if isinstance(s, RgbdScene) and not s.raw else s for s in scenes
            ]
        frames = [scene for scene in scenes if isinstance(scene, RgbdScene) and not (scene.problem or scene.raw)]
        n_without = sum(frame.intrinsics is None for frame in frames)
        if config.ply and config.intrinsics is None and n_without:
            reporter.info(
                f"warning: {n_without} of {len(frames)} frames have no intrinsics; point clouds take those of a "
                "typical Kinect (fx, fy 525 at a width of 640); see --intrinsics, or meta.json"
            )
        if isinstance(config.pipeline, SequencePipeline):
            scenes = sequences(scenes)
        return super().run_on(config, scenes, values, reporter)

    def settings(self, config: RefineKinectConfig, scene: Scene) -> dict[str, str]:
        first = _first_frame(scene)
        if first is None:
            return {}
        scale = config.depth_scale or first.depth_scale
        said = {"depth_scale": str(scale), "camera": f"{first.intrinsics} {first.fb} {first.rotated} {first.raw}"}
        if first.depth_intrinsics is not None:
            said["depth_camera"] = f"{first.depth_intrinsics} {first.depth_to_color}"
        frames = scene.frames if isinstance(scene, SequenceScene) else ()
        if any(frame.pose is not None for frame in frames):
            said["poses"] = hashlib.sha256(repr([frame.pose for frame in frames]).encode()).hexdigest()[:16]
        return said

    def memory_of(self, config: RefineKinectConfig, scene: Scene) -> int | None:
        first = _first_frame(scene)
        return None if first is None else config.pipeline.peak_bytes(first.frame_size())

    def columns(self) -> tuple[Column, ...]:

        return (SIZE, *(Column(name, percent(name)) for name in ("known", "kept", "filled", "corrected")))

    def palette(self) -> Palette:
        from depthcli.io.formats.pictures import DEPTH_STATUS_PALETTE

        return DEPTH_STATUS_PALETTE

    def compute(self, config: RefineKinectConfig, scene: Scene, folder: Path, memory: int) -> Outcome:
        """Refine a frame, or the frames of a sequence in order.

        Raises
        ------
        InputError
            The files cannot be used, or ``memory`` bytes do not suffice.
        """
        if isinstance(scene, SequenceScene):
            return _refine_sequence(config, scene, folder, memory)
        assert isinstance(scene, RgbdScene)
        return _refine_frame(config, scene, folder, memory, lambda frame: config.pipeline(frame))


def _with_meta(scene: Scene) -> Scene:
    """Return the frame of ``--color`` with the cameras of a meta.json beside it."""
    assert isinstance(scene, RgbdScene)
    return replace(scene, **cameras(Folder(scene.folder, scene.name, "", "").meta))


def _camera(values: Values, name: str) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of an option; ConfigError where they cannot be those of a camera."""
    try:
        fx, fy, cx, cy = (float(number) for number in values[name].split(","))
    except ValueError:
        fx = fy = cx = cy = math.nan
    if not (all(map(math.isfinite, (fx, fy, cx, cy))) and min(fx, fy) > 0):
        flag = f"--{name.replace('_', '-')}"
        raise ConfigError(f"{flag}: want fx,fy,cx,cy in pixels, focal lengths above 0 (got {short(values[name])})")
    return fx, fy, cx, cy


def _first_frame(scene: Scene) -> RgbdScene | None:
    first = scene.frames[0] if isinstance(scene, SequenceScene) else scene
    return first if isinstance(first, RgbdScene) else None


def _refine_sequence(config: RefineKinectConfig, scene: SequenceScene, folder: Path, memory: int) -> Outcome:
    """Refine the frames in order, each into a folder of its own; return means of their facts and sums of seconds."""
    from depthcli.methods.kinect.pipeline import frame_by_frame

    step = frame_by_frame(config.pipeline)
    outcomes: list[Outcome] = []
    problems = []
    for frame in scene.frames:
        target = folder / frame.name.rpartition("/")[2]
        try:
            target.mkdir()
            outcomes.append(_refine_frame(config, frame, target, memory, step))
        except DepthcliError as error:  # the other frames are written; the state is kept across the gap
            target.rmdir()
            problems.append(f"{frame.name}: {error}")
    if not outcomes:
        raise InputError(problems[0])
    facts = {"frames": len(outcomes), "frames_failed": len(problems), **outcomes[0].facts}
    for key, value in outcomes[0].facts.items():
        if isinstance(value, float):
            facts[key] = round(sum(each.facts[key] for each in outcomes) / len(outcomes), 6)
    if "motion" in facts:
        runs = itertools.groupby(each.facts["motion"] for each in outcomes)
        facts["motion"] = ", ".join(f"{len(list(run))} {motion}" for motion, run in runs)
    seconds = {key: sum(each.seconds.get(key, 0.0) for each in outcomes) for key in outcomes[0].seconds}
    warnings = [line for each in outcomes for line in each.warnings]
    return Outcome(facts, seconds, [*problems, *dict.fromkeys(warnings)])


def _refine_frame(
    config: RefineKinectConfig,
    scene: RgbdScene,
    folder: Path,
    memory: int,
    refine: Callable[[RgbdFrame], DepthResult],
) -> Outcome:
    import numpy as np

    from depthcli.api.depth import refined_frame
    from depthcli.api.results import share
    from depthcli.core.maps import DepthStatus
    from depthcli.core.result import Clock
    from depthcli.io.formats.depth import beyond_png
    from depthcli.run.resources import check_memory

    clock = Clock()
    clock.start("load")
    if config.depth_scale is not None and not scene.raw:
        scene = replace(scene, depth_scale=config.depth_scale)
    if config.intrinsics is not None and not scene.raw:
        scene = replace(scene, intrinsics=config.intrinsics)
    frame = scene.load()
    height, width = frame.shape
    check_memory(config.pipeline.peak_bytes(frame.shape), memory, f"{width} x {height} pixels")
    found = refined_frame(config, frame, refine, clock, scene.depth_scale, 3 if scene.rotated else 0)
    clock.start("save")
    found.save(folder)
    facts: Row = {
        "width": width,
        "height": height,
        "known": share(np.isfinite(frame.depth)),
        "kept": share(found.kept),
        "filled": share(found.filled),
        "corrected": share(found.corrected),
        **{
            bit.name.lower(): share((found.status & bit) != 0)
            for bit in DepthStatus
            if bit and bit.name and bit != DepthStatus.SAMPLED
        },
        "density": round(found.density, 6),
        **{name: float(value) for name, value in found.details.figures.items()},
        **found.details.words,
    }
    if frame.interpolated or scene.depth_intrinsics is not None:
        facts["registered"] = "by both cameras" if scene.depth_intrinsics else "assumed"
    warnings = [] if scene.raw else _scale_warnings(scene, frame)
    _, beyond = beyond_png(found.values, scene.depth_scale)
    warnings += [f"{beyond}; see --depth-scale"] if beyond else []
    if found.cloud is not None:
        facts["intrinsics"] = "of the camera" if frame.intrinsics else "typical"
        warnings += empty_cloud(found.values, found.cloud)
    return Outcome(facts, clock.seconds, warnings)


def _scale_warnings(scene: RgbdScene, frame: RgbdFrame) -> list[str]:
    """Return a warning where no such sensor sees the depths, with the scale that would make them plausible."""
    import numpy as np

    from depthcli.io.formats.depth import SENSOR, implausible_depth
    from depthcli.io.formats.disparity import read_plane
    from depthcli.io.formats.images import IMAGE_SUFFIXES

    if not scene.rotated and scene.depth.suffix.lower() in IMAGE_SUFFIXES:
        codes = read_plane(scene.depth)
        # The three low bits are free where codes are rotated by 3.
        if codes.dtype.kind in "iu" and np.mean((codes[codes > 0] & 7) == 0) > 0.5:
            return [f"{scene.depth}: most codes are multiples of 8, as in SUN RGB-D; if it is: --layout sun-rgbd"]
    if implausible_depth(scene.depth, frame.depth, scene.depth_scale):  # said when it was read
        return []
    text = implausible_depth(scene.depth, frame.depth, scene.depth_scale, SENSOR)
    return [f"{text}; see --depth-scale"] if text else []


COMMAND = RefineKinectCommand()

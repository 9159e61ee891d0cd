"""What ``refine-kinect`` computes of a frame, or of a sequence of frames."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias, cast

import numpy as np

from depthcli.api.depth import refined_frame
from depthcli.api.saving import check_limits, empty_cloud, parse_mask
from depthcli.commands._batch import config_of
from depthcli.commands._options import DepthOptions, RunOptions, SceneOptions
from depthcli.commands._scenes import camera_of, depth_settings, find_scenes, say_typical_cameras
from depthcli.core.context import Context
from depthcli.core.errors import DepthcliError, InputError
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthStatus
from depthcli.core.result import Clock, DepthResult
from depthcli.io.formats.depth import sensor_warning
from depthcli.io.formats.disparity import read_plane
from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.pictures import DEPTH_STATUS_PALETTE
from depthcli.io.rgbd_frames import frame_size, load_frame
from depthcli.io.scenes import Folder, RgbdScene, Scene, SequenceScene, sequences
from depthcli.io.scenes.frames import FRAMES, cameras
from depthcli.methods.kinect.config import RefineKinectConfig
from depthcli.methods.kinect.pipeline import SequencePipeline, frame_by_frame
from depthcli.problems.problem import SceneJob, Shown
from depthcli.run.console import SIZE, number, percent
from depthcli.run.job import Outcome
from depthcli.run.json_csv import Row, median, share
from depthcli.run.resources import check_memory

FrameOrSequence: TypeAlias = RgbdScene | SequenceScene


def prepare(
    config: str,
    frames: SceneOptions,
    run: RunOptions,
    settings: Sequence[str | tuple[str, str]] | None,
    depths: DepthOptions,
    depth_intrinsics: str | None = None,
) -> tuple[RefineKinect, list[FrameOrSequence]]:
    """Return the batch of ``refine-kinect`` with this config, and the frames or sequences that the options name."""
    found = config_of(RefineKinectConfig, config, settings, **depth_settings(depths))
    check_limits(found.near, found.far)
    parse_mask(found.mask)  # a wrong share is an error before any frame is opened
    scenes = find_scenes(FRAMES, frames, run)
    if getattr(frames, "color", None) is not None:  # a meta.json in the folder of the files may describe the cameras
        scenes = [replace(s, **cameras(Folder(s.folder, s.name, "", "").meta)) for s in scenes]
    if depth_intrinsics is not None:
        camera = camera_of("--depth-intrinsics", depth_intrinsics)
        scenes = [s if s.raw else replace(s, depth_intrinsics=camera) for s in scenes]
    if found.ply and found.intrinsics is None:
        say_typical_cameras(scenes, run.reporter)
    units = sequences(scenes) if isinstance(found.pipeline, SequencePipeline) else scenes
    return RefineKinect(found), cast("list[FrameOrSequence]", units)


@dataclass(frozen=True)
class RefineKinect(SceneJob[FrameOrSequence]):
    """Refines frames, or the frames of sequences in order."""

    command = "refine-kinect"
    shown = Shown(
        (SIZE, *map(percent, ("known", "kept", "filled", "corrected")), number("median_bound", "{:.3g} m")),
        palette=DEPTH_STATUS_PALETTE,
        protocol="depth",
    )

    config: RefineKinectConfig

    def truth_scenes(self, scenes: Sequence[FrameOrSequence]) -> Sequence[Scene]:
        """Return the frames, of sequences, too."""
        frames = [each for scene in scenes for each in (scene.frames if isinstance(scene, SequenceScene) else (scene,))]
        return sorted(frames, key=lambda frame: frame.name)

    def settings(self, scene: FrameOrSequence) -> dict[str, str]:
        """Return the cameras that the layout or the options describe."""
        frames = scene.frames if isinstance(scene, SequenceScene) else (scene,)
        first = frames[0]
        scale = self.config.depth_scale or first.depth_scale
        found = {"depth_scale": str(scale), "camera": f"{first.intrinsics} {first.fb} {first.rotated} {first.raw}"}
        if first.depth_intrinsics is not None:
            found["depth_camera"] = f"{first.depth_intrinsics} {first.depth_to_color}"
        if isinstance(scene, SequenceScene) and any(frame.pose is not None for frame in frames):
            found["poses"] = hashlib.sha256(repr([frame.pose for frame in frames]).encode()).hexdigest()[:16]
        return found

    def memory(self, scene: FrameOrSequence) -> int:
        """Estimate by the size of the image, or of the first one."""
        first = scene.frames[0] if isinstance(scene, SequenceScene) else scene
        return self.config.peak_bytes(frame_size(first))

    def compute(self, scene: FrameOrSequence, folder: Path, context: Context) -> Outcome:
        """Refine a frame; or the frames of a sequence, each into a folder, with means of their facts."""
        if isinstance(scene, RgbdScene):
            return self._frame(scene, folder, context, lambda frame: self.config.pipeline(frame))
        step = frame_by_frame(self.config.pipeline)
        outcomes: list[Outcome] = []
        problems = []
        for frame in scene.frames:
            target = folder / frame.name.rpartition("/")[2]
            try:
                target.mkdir()
                outcomes.append(self._frame(frame, target, context, step))
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

    def _frame(
        self, scene: RgbdScene, folder: Path, context: Context, refine: Callable[[RgbdFrame], DepthResult]
    ) -> Outcome:
        config, clock = self.config, Clock()
        clock.start("load")
        if not scene.raw:
            scale, intrinsics = config.depth_scale or scene.depth_scale, config.intrinsics or scene.intrinsics
            scene = replace(scene, depth_scale=scale, intrinsics=intrinsics)
        frame = load_frame(scene)
        height, width = frame.shape
        check_memory(config.peak_bytes(frame.shape), context.memory, f"{width} x {height} pixels")
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
            "density": share(found.valid),
            "median_bound": median(found.bound),
            **{name: float(value) for name, value in found.details.figures.items()},
            **found.details.words,
        }
        if frame.interpolated or scene.depth_intrinsics is not None:
            facts["registered"] = "by both cameras" if scene.depth_intrinsics else "assumed"
        warnings = [*([] if scene.raw else _scale_warnings(scene, frame)), *found.warnings]
        if found.cloud is not None:
            facts["intrinsics"] = "of the camera" if frame.intrinsics else "typical"
            warnings += empty_cloud(found.values, found.cloud)
        return Outcome(facts, clock.seconds, warnings)


def _scale_warnings(scene: RgbdScene, frame: RgbdFrame) -> list[str]:
    """Return a warning where no such sensor sees depths of codes, with the scale that would make them plausible."""
    codes = read_plane(scene.depth)
    if codes.dtype.kind not in "iu":
        return []
    # The three low bits are free where codes are rotated by 3.
    is_image = scene.depth.suffix.lower() in IMAGE_SUFFIXES
    if not scene.rotated and is_image and np.mean((codes[codes > 0] & 7) == 0) > 0.5:
        return [f"{scene.depth}: most codes are multiples of 8, as in SUN RGB-D; if it is: --layout sun-rgbd"]
    text = sensor_warning(scene.depth, frame.depth, scene.depth_scale)
    return [text] if text else []

"""Clean and complete the depth maps of a Kinect or a sensor like it, guided by their color images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from depthcli.batch.command import Outcome, Values
from depthcli.batch.console import SIZE, Column, Reporter, percent
from depthcli.commands._batch import DEPTH_RESULTS, ConfigCommand
from depthcli.core.errors import DepthcliError, InputError
from depthcli.core.option import Option
from depthcli.data.scenes import Scene
from depthcli.data.scenes.rgbd import RgbdScene
from depthcli.data.scenes.rgbd_sequence import SequenceScene, sequences

if TYPE_CHECKING:
    from depthcli.core.frames import RgbdFrame
    from depthcli.core.result import RefinedDepth
    from depthcli.data.formats.pictures import Palette
    from depthcli.methods.kinect.config import RefineKinectConfig

_METRIC_SUFFIXES = (".pfm", ".npy")


class RefineKinectCommand(ConfigCommand["RefineKinectConfig", Scene]):
    """Refines single frames, or sequences where the method carries state from frame to frame."""

    kinds: ClassVar[tuple[type[Scene], ...]] = (RgbdScene,)
    # Frames of a sequence have folders of their own.
    results: ClassVar[tuple[str, ...]] = (*DEPTH_RESULTS, *(f"*/{name}" for name in DEPTH_RESULTS))

    @property
    def options(self) -> tuple[Option, ...]:
        ply = Option("ply", bool, "Also write a colored point cloud of every frame.", default=False)
        return (*super().options, ply)

    def config_model(self) -> type[RefineKinectConfig]:
        from depthcli.methods.kinect.config import RefineKinectConfig

        return RefineKinectConfig

    def run(self, values: Values, reporter: Reporter) -> int:
        """Refine every scene; ``--ply`` overrides the key of the config. Return the exit code."""
        settings = [*(values["set"] or ()), *(["ply=true"] if values["ply"] else ())]
        return super().run({**values, "set": settings}, reporter)

    def run_on(self, config: RefineKinectConfig, scenes: Sequence[Scene], values: Values, reporter: Reporter) -> int:
        from depthcli.methods.kinect.pipeline import SequencePipeline

        if isinstance(config.pipeline, SequencePipeline):
            scenes = sequences(scenes)
        return super().run_on(config, scenes, values, reporter)

    def settings(self, config: RefineKinectConfig, scene: Scene) -> dict[str, str]:
        first = _first_frame(scene)
        if first is None:
            return {}
        scale = config.depth_scale or first.depth_scale
        return {"depth_scale": str(scale), "camera": f"{first.intrinsics} {first.fb} {first.rotated} {first.raw}"}

    def memory_of(self, config: RefineKinectConfig, scene: Scene) -> int | None:
        from depthcli.data.formats.headers import image_size

        first = _first_frame(scene)
        return None if first is None else config.pipeline.peak_bytes(image_size(first.color)[:2])

    def columns(self) -> tuple[Column, ...]:

        return (SIZE, *(Column(name, percent(name)) for name in ("known", "kept", "filled", "corrected")))

    def palette(self) -> Palette:
        from depthcli.data.formats.pictures import DEPTH_STATUS_PALETTE

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


def _first_frame(scene: Scene) -> RgbdScene | None:
    first = scene.frames[0] if isinstance(scene, SequenceScene) else scene
    return first if isinstance(first, RgbdScene) else None


def _refine_sequence(config: RefineKinectConfig, scene: SequenceScene, folder: Path, memory: int) -> Outcome:
    """Refine the frames in order, each into a folder of its own; return means of their facts and sums of seconds."""
    from depthcli.methods.kinect.pipeline import SequencePipeline

    assert isinstance(config.pipeline, SequencePipeline)
    pipeline, state = config.pipeline, None

    def step(frame: RgbdFrame) -> RefinedDepth:
        nonlocal state
        result, state = pipeline.step(frame, state)
        return result

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
    seconds = {key: sum(each.seconds.get(key, 0.0) for each in outcomes) for key in outcomes[0].seconds}
    warnings = [line for each in outcomes for line in each.warnings]
    return Outcome(facts, seconds, [*problems, *dict.fromkeys(warnings)])


def _refine_frame(
    config: RefineKinectConfig,
    scene: RgbdScene,
    folder: Path,
    memory: int,
    refine: Callable[[RgbdFrame], RefinedDepth],
) -> Outcome:
    import numpy as np

    from depthcli.batch.resources import check_memory
    from depthcli.commands._save import save_depth, share
    from depthcli.core.maps import DepthStatus
    from depthcli.core.result import Clock

    clock = Clock()
    if config.depth_scale is not None and not scene.raw:
        scene = replace(scene, depth_scale=config.depth_scale)
    frame = scene.load()
    height, width = frame.shape
    if config.ply and frame.intrinsics is None:
        raise InputError(f"{scene.folder}: a point cloud needs the camera's intrinsics; give them in meta.json")
    check_memory(config.pipeline.peak_bytes(frame.shape), memory, f"{width} x {height} pixels")
    clock.stop("load")
    result = refine(frame)
    clock.stop_stages(result.seconds)
    status = result.depth.status
    filled = DepthStatus.GAP_FILLED | DepthStatus.FALLBACK | DepthStatus.CARRIED
    facts = {
        "width": width,
        "height": height,
        "known": share(np.isfinite(frame.depth)),
        "kept": share((status & (filled | DepthStatus.CORRECTED | DepthStatus.EMPTY)) == 0),
        "filled": share((status & filled) != 0),
        "corrected": share((status & DepthStatus.CORRECTED) != 0),
        **{
            bit.name.lower(): share((status & bit) != 0)
            for bit in DepthStatus
            if bit and bit.name and bit != DepthStatus.SAMPLED
        },
        "density": round(result.depth.density, 6),
        **{name: float(value) for name, value in result.figures.items()},
    }
    cloud = (frame.intrinsics, frame.color) if config.ply and frame.intrinsics is not None else None
    save_depth(result, folder, scene.depth_scale, 3 if scene.rotated else 0, cloud)
    clock.stop("save")
    return Outcome(facts, clock.seconds, [] if scene.raw else _scale_warnings(scene, frame))


def _scale_warnings(scene: RgbdScene, frame: RgbdFrame) -> list[str]:
    """Return a warning where no such sensor sees the depths, with the scale that would make them plausible."""
    import numpy as np

    from depthcli.data.formats.depth import SENSOR, implausible_depth, read_codes

    if not scene.rotated and scene.depth.suffix not in _METRIC_SUFFIXES:
        codes = read_codes(scene.depth)
        if np.mean((codes[codes > 0] & 7) == 0) > 0.5:  # the three low bits are free where codes are rotated by 3
            return [f"{scene.depth}: most codes are multiples of 8, as in SUN RGB-D; if it is: --layout sun-rgbd"]
    text = implausible_depth(scene.depth, frame.depth, scene.depth_scale, SENSOR)
    return [text] if text else []


COMMAND = RefineKinectCommand()

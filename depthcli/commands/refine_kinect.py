"""Clean and complete the depth maps of a Kinect or a sensor like it, guided by their color images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from depthcli.batch.command import Values
from depthcli.commands._batch import ConfigCommand
from depthcli.core.errors import DepthcliError, InputError
from depthcli.core.option import Option
from depthcli.data.scenes import Scene
from depthcli.data.scenes.rgbd import RgbdScene
from depthcli.data.scenes.rgbd_sequence import SequenceScene, sequences

if TYPE_CHECKING:
    from depthcli.batch.console import Column, Reporter
    from depthcli.batch.task import Outcome
    from depthcli.core.frames import RgbdFrame
    from depthcli.data.formats.pictures import Palette
    from depthcli.methods.kinect.config import RefineKinectConfig
    from depthcli.methods.kinect.result import RefinedDepth

_PLAUSIBLE = (0.2, 20.0)  # meters: the median depth of a room
_USUAL_SCALES = (1000.0, 5000.0, 256.0, 10_000.0, 100.0)


class RefineKinectCommand(ConfigCommand["RefineKinectConfig", Scene]):
    """Any pipeline of ``kinect/pipeline/``, frame by frame or along sequences."""

    kinds: ClassVar[tuple[type[Scene], ...]] = (RgbdScene,)

    @property
    def options(self) -> tuple[Option, ...]:
        """And a point cloud."""
        ply = Option("ply", bool, "Write a colored point cloud of every frame, too.", default=False)
        return (*super().options, ply)

    def config_model(self) -> type[RefineKinectConfig]:
        """A pipeline and the scale of the depth files."""
        from depthcli.methods.kinect.config import RefineKinectConfig

        return RefineKinectConfig

    def run(self, values: Values, reporter: Reporter) -> int:
        """As every batch; ``--ply`` is a key of the config."""
        settings = [*(values["set"] or ()), *(["ply=true"] if values["ply"] else ())]
        return super().run({**values, "set": settings}, reporter)

    def run_on(self, config: RefineKinectConfig, scenes: Sequence[Scene], values: Values, reporter: Reporter) -> int:
        """As every batch; a method that carries state takes a sequence as one scene."""
        from depthcli.methods.kinect.pipeline import SequencePipeline

        if isinstance(config.pipeline, SequencePipeline):
            scenes = sequences(scenes)
        return super().run_on(config, scenes, values, reporter)

    def settings(self, config: RefineKinectConfig, scene: Scene) -> dict[str, str]:
        """What the layout says about the files."""
        frames = scene.frames if isinstance(scene, SequenceScene) else (scene,)
        first = frames[0]
        if not isinstance(first, RgbdScene):
            return {}
        scale = config.depth_scale or first.depth_scale
        return {"depth_scale": str(scale), "camera": f"{first.intrinsics} {first.fb} {first.rotated} {first.raw}"}

    def memory_of(self, config: RefineKinectConfig, scene: Scene) -> int | None:
        """By the size of the color image, of a sequence of the first one."""
        from depthcli.data.formats.headers import image_size

        frame = scene.frames[0] if isinstance(scene, SequenceScene) else scene
        return config.pipeline.peak_bytes(image_size(frame.color)[:2]) if isinstance(frame, RgbdScene) else None

    def columns(self) -> tuple[Column, ...]:
        """Size, and the shares of pixels that were kept, filled and corrected."""
        from depthcli.batch.console import SIZE, Column, percent

        shares = ("known", "kept", "filled", "corrected")
        return (SIZE, *(Column(name, percent(name)) for name in shares))

    def palette(self) -> Palette:
        """Of a depth map's status."""
        from depthcli.data.formats.pictures import DEPTH_STATUS_PALETTE

        return DEPTH_STATUS_PALETTE

    def compute(self, config: RefineKinectConfig, scene: Scene, folder: Path, memory: int) -> Outcome:
        """Refine a frame, or a sequence from its first frame on.

        Raises
        ------
        InputError
            The files cannot be used, or ``memory`` bytes do not suffice.
        """
        if isinstance(scene, SequenceScene):
            return self._sequence(config, scene, folder, memory)
        assert isinstance(scene, RgbdScene)
        return self._frame(config, scene, folder, memory, lambda frame: config.pipeline(frame))

    def _sequence(self, config: RefineKinectConfig, scene: SequenceScene, folder: Path, memory: int) -> Outcome:
        from depthcli.batch.task import Outcome
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
                outcomes.append(self._frame(config, frame, target, memory, step))
            except DepthcliError as error:  # the others are written; what is carried goes over the gap
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

    def _frame(
        self,
        config: RefineKinectConfig,
        scene: RgbdScene,
        folder: Path,
        memory: int,
        refine: Callable[[RgbdFrame], RefinedDepth],
    ) -> Outcome:
        import numpy as np

        from depthcli.batch.task import Outcome
        from depthcli.commands._save import save_depth
        from depthcli.core.maps import DepthStatus
        from depthcli.core.result import Clock

        clock = Clock()
        if config.depth_scale is not None and not scene.raw:
            scene = replace(scene, depth_scale=config.depth_scale)
        frame = scene.load()
        if config.ply and frame.intrinsics is None:
            raise InputError(f"{scene.folder}: a point cloud wants the camera's intrinsics; say them in meta.json")
        _check_memory(config, frame, memory)
        clock.stop("load")
        result = refine(frame)
        clock.stop("other")
        clock.seconds["other"] = max(clock.seconds["other"] - sum(result.seconds.values()), 0.0)
        status = result.depth.status

        def share(bits: int) -> float:
            return round(float(np.mean((status & bits) != 0)), 6)

        replaced = DepthStatus.GAP_FILLED | DepthStatus.FALLBACK | DepthStatus.CARRIED
        others = replaced | DepthStatus.CORRECTED | DepthStatus.EMPTY
        facts = {
            "width": frame.shape[1],
            "height": frame.shape[0],
            "known": round(float(np.mean(np.isfinite(frame.depth))), 6),
            "kept": round(float(np.mean((status & others) == 0)), 6),
            "filled": share(replaced),
            "corrected": share(DepthStatus.CORRECTED),
            **{bit.name.lower(): share(bit) for bit in DepthStatus if bit and bit.name and bit != DepthStatus.SAMPLED},
            "density": round(result.depth.density, 6),
            **{name: float(value) for name, value in result.figures.items()},
        }
        cloud = (frame.intrinsics, frame.color) if config.ply and frame.intrinsics is not None else None
        save_depth(result, folder, scene.depth_scale, 3 if scene.rotated else 0, cloud)
        clock.stop("save")
        seconds = {"load": clock.seconds["load"], **result.seconds} | clock.seconds
        return Outcome(facts, seconds, [] if scene.raw else _doubts(scene, frame))


def _check_memory(config: RefineKinectConfig, frame: RgbdFrame, memory: int) -> None:
    from depthcli.core.memory import show_bytes

    need = config.pipeline.peak_bytes(frame.shape)
    if need > memory:
        raise InputError(
            f"needs about {show_bytes(need)} of memory ({frame.shape[1]} x {frame.shape[0]} pixels), "
            f"{show_bytes(memory)} may be used; see --max-memory, --jobs"
        )


def _doubts(scene: RgbdScene, frame: RgbdFrame) -> list[str]:
    """Where the depth is no room's: the scale that would fit."""
    import numpy as np

    from depthcli.data.formats.depth import read_codes

    middle = float(np.nanmedian(frame.depth))
    low, high = _PLAUSIBLE
    if low <= middle <= high and (scene.rotated or scene.depth.suffix in (".pfm", ".npy")):
        return []
    codes = None if scene.depth.suffix in (".pfm", ".npy") else read_codes(scene.depth)
    if codes is not None and not scene.rotated and np.mean((codes[codes > 0] & 7) == 0) > 0.5:
        return [f"{scene.depth}: most codes are multiples of 8, as in SUN RGB-D; if it is: --layout sun-rgbd"]
    if low <= middle <= high:
        return []
    fitting = [s for s in _USUAL_SCALES if low <= middle * scene.depth_scale / s <= high and s != scene.depth_scale]
    hint = f"; --depth-scale {fitting[0]:g} would fit" if fitting else ""
    return [f"{scene.depth}: the median depth is {middle:.3g} m at {scene.depth_scale:g} codes a meter{hint}"]


COMMAND = RefineKinectCommand()

"""Depth of transparent objects: a sensor that sees through them, and stereo with infrared or other sparse depth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from depthcli.commands._batch import ConfigCommand
from depthcli.core.errors import InputError
from depthcli.data.scenes import Scene
from depthcli.data.scenes.rgbd import RgbdScene

if TYPE_CHECKING:
    from depthcli.batch.console import Column
    from depthcli.batch.task import Outcome
    from depthcli.core.frames import SparseFrame
    from depthcli.core.result import Result
    from depthcli.data.formats.pictures import Palette
    from depthcli.methods.transparent.config import TransparentConfig


class TransparentCommand(ConfigCommand["TransparentConfig", RgbdScene]):
    """Any pipeline of ``transparent/pipeline/``."""

    kinds: ClassVar[tuple[type[Scene], ...]] = (RgbdScene,)

    def config_model(self) -> type[TransparentConfig]:
        """A pipeline and the scale of the depth files."""
        from depthcli.methods.transparent.config import TransparentConfig

        return TransparentConfig

    def files(self, config: TransparentConfig, scene: RgbdScene) -> dict[str, Path]:
        """The frame's files and the sparse depth's."""
        if config.stereo is not None:
            return super().files(config, scene)
        sparse = {"sparse": scene.sparse, "sparse_confidence": scene.sparse_confidence}
        return super().files(config, scene) | {role: file for role, file in sparse.items() if file is not None}

    def settings(self, config: TransparentConfig, scene: RgbdScene) -> dict[str, str]:
        """What the layout says about the files."""
        said = {"depth_scale": str(config.depth_scale or scene.depth_scale)}
        return said | {"max_disparity": str(getattr(scene, "max_disparity", None))}

    def memory_of(self, config: TransparentConfig, scene: RgbdScene) -> int:
        """By the size of the color image; of what follows the search for sparse depth."""
        from depthcli.data.formats.headers import image_size

        need: int = config.pipeline.peak_bytes(image_size(scene.color)[:2])
        return need

    def columns(self) -> tuple[Column, ...]:
        """Size, and the shares of pixels that were kept, filled, replaced, and have a sample that says the same."""
        from depthcli.batch.console import SIZE, Column, percent

        names = ("known", "sparse", "kept", "filled", "replaced", "from_stereo")
        return (SIZE, *(Column(name, percent(name)) for name in names))

    def palette(self) -> Palette:
        """Colors of the bits of a depth map's status."""
        from depthcli.data.formats.pictures import DEPTH_STATUS_PALETTE

        return DEPTH_STATUS_PALETTE

    def legend_values(self) -> tuple[int, ...]:
        """The sensor's, filled and replaced, without and with a sample of the pixel that says the same, and empty."""
        from depthcli.core.maps import DepthStatus

        filled, replaced, sampled = DepthStatus.GAP_FILLED, DepthStatus.CORRECTED, DepthStatus.SAMPLED
        return (0, filled, replaced, filled | sampled, replaced | sampled, DepthStatus.EMPTY)

    def compute(self, config: TransparentConfig, scene: RgbdScene, folder: Path, memory: int) -> Outcome:
        """Dense depth of one frame.

        Raises
        ------
        InputError
            The files cannot be used, there is no sparse depth, or ``memory`` bytes do not suffice.
        """
        import numpy as np

        from depthcli.batch.task import Outcome
        from depthcli.commands._save import save_depth
        from depthcli.core.maps import DepthStatus
        from depthcli.core.result import Clock

        clock = Clock()
        if config.depth_scale is not None:
            scene = replace(scene, depth_scale=config.depth_scale)
        frame, stereo = self._sparse(config, scene, memory)
        clock.stop("load")
        result = config.pipeline(frame)
        result.seconds = stereo.seconds | result.seconds
        result.figures |= stereo.figures
        result.pictures |= stereo.pictures
        result.confidence |= stereo.confidence
        clock.stop("other")
        clock.seconds["load"] = max(clock.seconds["load"] - sum(stereo.seconds.values()), 0.0)
        clock.seconds["other"] = max(clock.seconds["other"] - sum(result.seconds.values()), 0.0)
        status = result.depth.status

        def share(bits: int) -> float:
            return round(float(np.mean((status & bits) != 0)), 6)

        facts = {
            "width": frame.shape[1],
            "height": frame.shape[0],
            "known": round(float(np.mean(np.isfinite(frame.depth))), 6),
            "sparse": round(float(np.mean(np.isfinite(frame.sparse))), 6),
            "kept": round(float(np.mean(status == DepthStatus.KEPT)), 6),
            "filled": share(DepthStatus.GAP_FILLED),
            "replaced": share(DepthStatus.CORRECTED),
            "from_stereo": share(DepthStatus.SAMPLED),
            "density": round(result.depth.density, 6),
            **{name: float(value) for name, value in result.figures.items()},
        }
        save_depth(result, folder, scene.depth_scale, 3 if scene.rotated else 0)
        clock.stop("save")
        seconds = {"load": clock.seconds["load"], **result.seconds} | clock.seconds
        return Outcome(facts, seconds)

    def _sparse(self, config: TransparentConfig, scene: RgbdScene, memory: int) -> tuple[SparseFrame, Result]:
        """The frame with sparse depth, and what stereo has to say where it comes from there."""
        import numpy as np

        from depthcli.core.result import Clock, Result
        from depthcli.data.scenes.rgb_ir import RgbIrScene

        if config.stereo is None:
            frame = scene.load_sparse()
            _check_memory(config, frame.shape, memory)
            return frame, Result()
        if not isinstance(scene, RgbIrScene):
            raise InputError(f"{scene.folder}: {scene.name} has no infrared image (ir.*), which this config wants")
        pair = scene.load_pair()
        stereo = config.stereo
        if stereo.max_disparity is None and scene.max_disparity is not None:
            stereo = stereo.model_copy(update={"max_disparity": scene.max_disparity})
        height, width = pair.depth.shape
        _check_memory(config, (height, width), memory, stereo.peak_bytes((height, width)))
        clock = Clock()
        frame, figures = stereo(pair, clock)
        with np.errstate(invalid="ignore"):
            codes = np.nan_to_num(np.rint(frame.sparse * scene.depth_scale), nan=0.0)
        pictures = {"stereo": np.where(codes <= 65535, codes, 0).astype(np.uint16)}
        confidence = {} if frame.sparse_confidence is None else {"stereo": frame.sparse_confidence}
        return frame, Result(seconds=clock.seconds, confidence=confidence, pictures=pictures, figures=figures)


def _check_memory(config: TransparentConfig, shape: tuple[int, int], memory: int, least: int = 0) -> None:
    from depthcli.core.memory import show_bytes

    need = max(config.pipeline.peak_bytes(shape), least)
    if need > memory:
        raise InputError(
            f"needs about {show_bytes(need)} of memory ({shape[1]} x {shape[0]} pixels), "
            f"{show_bytes(memory)} may be used; see --max-memory, --jobs"
        )


COMMAND = TransparentCommand()

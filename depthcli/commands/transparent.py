"""Complete the depth of transparent objects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from depthcli.commands._old_batch import DEPTH_RESULTS, ConfigCommand
from depthcli.core.errors import InputError
from depthcli.io.scenes import Scene
from depthcli.io.scenes.rgbd import RgbdScene
from depthcli.run.batch import Outcome
from depthcli.run.console import SIZE, Column, percent

if TYPE_CHECKING:
    from depthcli.core.frames import SparseFrame
    from depthcli.core.result import Clock, Result
    from depthcli.io.formats.pictures import Palette
    from depthcli.methods.transparent.config import TransparentConfig


class TransparentCommand(ConfigCommand["TransparentConfig", RgbdScene]):
    """Completes the depth of transparent objects from sparse depth, given or matched between color and infrared."""

    kinds: ClassVar[tuple[type[Scene], ...]] = (RgbdScene,)
    page = "how_to/glass"
    examples = (
        "depthcli transparent kinect --input frames --output runs/kinect",
        "depthcli transparent sparse --input frames --output runs/sparse --evaluate",
    )
    results: ClassVar[tuple[str, ...]] = DEPTH_RESULTS
    shown_as: ClassVar[str] = "depth"

    def config_model(self) -> type[TransparentConfig]:
        from depthcli.methods.transparent.config import TransparentConfig

        return TransparentConfig

    def files(self, config: TransparentConfig, scene: RgbdScene) -> dict[str, Path]:
        if config.stereo is not None:
            return super().files(config, scene)
        sparse = {"sparse": scene.sparse, "sparse_confidence": scene.sparse_confidence}
        return super().files(config, scene) | {role: file for role, file in sparse.items() if file is not None}

    def settings(self, config: TransparentConfig, scene: RgbdScene) -> dict[str, str]:
        scale, max_disparity = config.depth_scale or scene.depth_scale, getattr(scene, "max_disparity", None)
        return {"depth_scale": str(scale), "max_disparity": str(max_disparity)}

    def memory_of(self, config: TransparentConfig, scene: RgbdScene) -> int:
        """Return an estimate of the peak memory after the sparse depth is known, bytes."""
        return config.pipeline.peak_bytes(scene.frame_size())

    def columns(self) -> tuple[Column, ...]:

        names = ("known", "sparse", "kept", "filled", "replaced", "from_stereo")
        return (SIZE, *(Column(name, percent(name)) for name in names))

    def palette(self) -> Palette:
        from depthcli.io.formats.pictures import DEPTH_STATUS_PALETTE

        return DEPTH_STATUS_PALETTE

    def legend_values(self) -> tuple[int, ...]:
        """Return kept, filled and replaced, the latter two also where the sparse depth has a value, and empty."""
        from depthcli.core.maps import DepthStatus

        filled, replaced, sampled = DepthStatus.GAP_FILLED, DepthStatus.CORRECTED, DepthStatus.SAMPLED
        return (0, filled, replaced, filled | sampled, replaced | sampled, DepthStatus.EMPTY)

    def compute(self, config: TransparentConfig, scene: RgbdScene, folder: Path, memory: int) -> Outcome:
        """Compute the dense depth of one frame.

        Raises
        ------
        InputError
            The files cannot be used, there is no sparse depth, or ``memory`` bytes do not suffice.
        """
        import numpy as np

        from depthcli.api._save import share
        from depthcli.api.depth import completed_frame
        from depthcli.core.maps import DepthStatus
        from depthcli.core.result import Clock
        from depthcli.io.formats.depth import beyond_png

        clock = Clock()
        clock.start("load")
        if config.depth_scale is not None:
            scene = replace(scene, depth_scale=config.depth_scale)
        frame, stereo = _load_frame(config, scene, memory, clock)
        found = completed_frame(config, frame, stereo, clock, scene.depth_scale, 3 if scene.rotated else 0)
        clock.start("save")
        found.save(folder)
        facts = {
            "width": frame.shape[1],
            "height": frame.shape[0],
            "known": share(np.isfinite(frame.depth)),
            "sparse": share(np.isfinite(frame.sparse)),
            "kept": share(found.kept),
            "filled": share((found.status & DepthStatus.GAP_FILLED) != 0),
            "replaced": share(found.corrected),
            "from_stereo": share((found.status & DepthStatus.SAMPLED) != 0),
            "density": round(found.density, 6),
            **{name: float(value) for name, value in found.details.figures.items()},
        }
        _, beyond = beyond_png(found.values, scene.depth_scale)
        return Outcome(facts, clock.seconds, [f"{beyond}; see --depth-scale"] if beyond else [])


def _load_frame(config: TransparentConfig, scene: RgbdScene, memory: int, clock: Clock) -> tuple[SparseFrame, Result]:
    """Return the frame with its sparse depth, and what is written of the matching that this comes from, if any."""
    from depthcli.api.depth import sparse_by_stereo
    from depthcli.core.result import Result
    from depthcli.io.scenes.rgb_ir import RgbIrScene
    from depthcli.run.resources import check_memory

    if config.stereo is None:
        frame = scene.load_sparse()
        height, width = frame.shape
        check_memory(config.pipeline.peak_bytes(frame.shape), memory, f"{width} x {height} pixels")
        return frame, Result()
    if not isinstance(scene, RgbIrScene):
        raise InputError(f"{scene.folder}: {scene.name} has no infrared image (ir.*), which this config needs")
    pair = scene.load_pair()
    stereo = config.stereo
    if stereo.max_disparity is None and scene.max_disparity is not None:
        stereo = stereo.model_copy(update={"max_disparity": scene.max_disparity})
    height, width = pair.depth.shape
    need = max(config.pipeline.peak_bytes((height, width)), stereo.peak_bytes((height, width)))
    check_memory(need, memory, f"{width} x {height} pixels")
    return sparse_by_stereo(stereo, pair, scene.depth_scale, clock)


COMMAND = TransparentCommand()

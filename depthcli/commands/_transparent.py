"""What ``transparent`` computes of a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from depthcli.api.depth import check_completion_memory, completed_frame, sparse_by_stereo
from depthcli.api.results import share
from depthcli.commands._batch import config_of, run_batch
from depthcli.commands._options import RunOptions, SceneOptions
from depthcli.commands._scenes import find_scenes
from depthcli.core.errors import InputError
from depthcli.core.frames import SparseFrame
from depthcli.core.maps import DepthStatus
from depthcli.core.method import used_files
from depthcli.core.result import Clock, Result
from depthcli.io.formats.depth import beyond_png
from depthcli.io.formats.pictures import DEPTH_STATUS_PALETTE
from depthcli.io.scenes.rgbd import RgbdScene, RgbIrScene
from depthcli.methods.transparent.config import TransparentConfig
from depthcli.run.batch import Batch, Outcome
from depthcli.run.console import SIZE, Column, percent

__all__ = ["prepare", "run_batch"]

_COLUMNS = ("known", "sparse", "kept", "filled", "replaced", "from_stereo")
# Kept, filled and replaced, the latter two also where the sparse depth has a value, and empty.
_LEGEND = (
    0,
    DepthStatus.GAP_FILLED,
    DepthStatus.CORRECTED,
    DepthStatus.GAP_FILLED | DepthStatus.SAMPLED,
    DepthStatus.CORRECTED | DepthStatus.SAMPLED,
    DepthStatus.EMPTY,
)


def prepare(
    config: str,
    frames: SceneOptions,
    run: RunOptions,
    settings: Sequence[str | tuple[str, str]] | None,
    **options: Any,
) -> tuple[Batch[RgbdScene], list[RgbdScene]]:
    """Return the batch of ``transparent`` with this config, and the frames that the command line names."""
    found = config_of("transparent", TransparentConfig, config, settings, **options)
    complete = _Complete(found)
    batch = Batch(
        command="transparent",
        config=found,
        compute=complete,
        columns=(SIZE, *(Column(name, percent(name)) for name in _COLUMNS)),
        files=complete.files,
        settings=complete.settings,
        memory=complete.memory,
        palette=DEPTH_STATUS_PALETTE,
        legend=_LEGEND,
        shown_as="depth",
    )
    return batch, find_scenes((RgbdScene,), frames, run)


@dataclass(frozen=True)
class _Complete:
    """Computes the dense depth of one frame."""

    config: TransparentConfig

    def files(self, scene: RgbdScene) -> dict[str, Path]:
        """Return the files of the frame with those of its sparse depth, unless stereo gives that."""
        files = scene.input_files | used_files(self.config)
        if self.config.stereo is None:
            sparse = {"sparse": scene.sparse, "sparse_confidence": scene.sparse_confidence}
            files |= {role: file for role, file in sparse.items() if file is not None}
        return files

    def settings(self, scene: RgbdScene) -> dict[str, str]:
        scale, max_disparity = self.config.depth_scale or scene.depth_scale, getattr(scene, "max_disparity", None)
        return {"depth_scale": str(scale), "max_disparity": str(max_disparity)}

    def memory(self, scene: RgbdScene) -> int:
        """Return an estimate of the peak memory once the sparse depth is known, bytes."""
        return self.config.pipeline.peak_bytes(scene.frame_size())

    def __call__(self, scene: RgbdScene, folder: Path, memory: int) -> Outcome:
        config, clock = self.config, Clock()
        clock.start("load")
        if config.depth_scale is not None:
            scene = replace(scene, depth_scale=config.depth_scale)
        frame, stereo = self._load(scene, memory, clock)
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

    def _load(self, scene: RgbdScene, memory: int, clock: Clock) -> tuple[SparseFrame, Result]:
        """Return the frame with its sparse depth, and what is written of the stereo matching that gives it, if any."""
        stereo = self.config.stereo
        if stereo is None:
            frame = scene.load_sparse()
            check_completion_memory(self.config, None, frame.shape, memory)
            return frame, Result()
        if not isinstance(scene, RgbIrScene):
            raise InputError(f"{scene.folder}: {scene.name} has no infrared image (ir.*), which this config needs")
        pair = scene.load_pair()
        if stereo.max_disparity is None and scene.max_disparity is not None:
            stereo = stereo.model_copy(update={"max_disparity": scene.max_disparity})
        check_completion_memory(self.config, stereo, (pair.depth.shape[0], pair.depth.shape[1]), memory)
        return sparse_by_stereo(stereo, pair, scene.depth_scale, clock)

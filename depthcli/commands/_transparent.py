"""What ``transparent`` computes of a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from depthcli.api.depth import completed_frame
from depthcli.api.saving import check_limits, empty_cloud, parse_mask
from depthcli.commands._batch import config_of
from depthcli.commands._options import DepthOptions, RunOptions, SceneOptions
from depthcli.commands._scenes import depth_settings, find_scenes, say_typical_cameras
from depthcli.core.color_and_infrared import RgbIrFrame
from depthcli.core.context import Context
from depthcli.core.errors import InputError
from depthcli.core.frames import SparseFrame
from depthcli.core.maps import DepthStatus
from depthcli.io.formats.pictures import DEPTH_STATUS_PALETTE
from depthcli.io.rgbd_frames import TRANSPARENT, frame_size, load_infrared_frame, load_masked_frame, load_sparse_frame
from depthcli.io.scenes import RgbdScene, RgbIrScene
from depthcli.io.scenes.frames import FRAMES
from depthcli.methods.transparent.config import TransparentConfig
from depthcli.problems.problem import SceneJob, Shown
from depthcli.run.console import SIZE, number, percent
from depthcli.run.job import Outcome
from depthcli.run.json_csv import Row, median, share


def prepare(
    config: str,
    frames: SceneOptions,
    run: RunOptions,
    settings: Sequence[str | tuple[str, str]] | None,
    depths: DepthOptions,
) -> tuple[Transparent, list[RgbdScene]]:
    """Return the batch of ``transparent`` with this config, and the frames that the command line names."""
    found = config_of(TransparentConfig, config, settings, **depth_settings(depths))
    check_limits(found.near, found.far)
    parse_mask(found.mask)  # a wrong share is an error before any frame is opened
    scenes = find_scenes(FRAMES, frames, run)
    if found.ply and found.intrinsics is None:
        say_typical_cameras(scenes, run.reporter)
    return Transparent(found), scenes


@dataclass(frozen=True)
class Transparent(SceneJob[RgbdScene]):
    """Computes the dense depth of frames."""

    command = "transparent"
    shown = Shown(
        (
            SIZE,
            *map(percent, ("known", "sparse", "kept", "filled", "replaced", "from_stereo")),
            number("median_bound", "{:.3g} m"),
        ),
        palette=DEPTH_STATUS_PALETTE,
        legend=(
            0,
            DepthStatus.GAP_FILLED,
            DepthStatus.CORRECTED,
            DepthStatus.GAP_FILLED | DepthStatus.SAMPLED,
            DepthStatus.CORRECTED | DepthStatus.SAMPLED,
            DepthStatus.EMPTY,
        ),
        protocol="depth",
    )

    config: TransparentConfig

    def files(self, scene: RgbdScene) -> dict[str, Path]:
        """Return the files of the frame, and of its sparse depth unless that comes from stereo."""
        sparse = {"sparse": scene.sparse, "sparse_confidence": scene.sparse_confidence}
        if self._by_mask:
            sparse = {"objects": scene.masks.get(TRANSPARENT)}
        given = {role: file for role, file in sparse.items() if file is not None and self.config.stereo is None}
        return scene.input_files | given

    @property
    def _by_mask(self) -> bool:
        return self.config.stereo is None and self.config.pipeline.needs == "objects"

    def truth_scenes(self, scenes: Sequence[RgbdScene]) -> Sequence[RgbdScene]:
        """Return the frames, without the source of a sparse depth that is not read."""
        read = self.config.stereo is None and not self._by_mask
        return scenes if read else [replace(scene, sparse_source="") for scene in scenes]

    def settings(self, scene: RgbdScene) -> dict[str, str]:
        """Return the scale of the depth, and the largest disparity of color and infrared image."""
        scale, max_disparity = self.config.depth_scale or scene.depth_scale, getattr(scene, "max_disparity", None)
        found = {"depth_scale": str(scale), "max_disparity": str(max_disparity)}
        return found | ({"camera": str(scene.intrinsics)} if self.config.ply else {})

    def memory(self, scene: RgbdScene) -> int:
        """Return an estimate of the peak memory once the sparse depth is known, bytes."""
        return self.config.pipeline.peak_bytes(frame_size(scene))

    def memory_bound(self, scene: RgbdScene) -> int | None:
        """Return the estimate, or None if the color and infrared images are matched first."""
        return self.memory(scene) if self.config.stereo is None else None

    def compute(self, scene: RgbdScene, folder: Path, context: Context) -> Outcome:
        """Load a frame with its sparse depth, or match color and infrared image for it; complete it; save."""
        config, clock = self.config, context.clock
        given: SparseFrame | RgbIrFrame
        clock.start("load")
        scale, intrinsics = config.depth_scale or scene.depth_scale, config.intrinsics or scene.intrinsics
        scene = replace(scene, depth_scale=scale, intrinsics=intrinsics)
        config = config.model_copy(update={"intrinsics": intrinsics})
        if self._by_mask:
            given = load_masked_frame(scene)
        elif (stereo := config.stereo) is None:
            given = load_sparse_frame(scene)
        elif not isinstance(scene, RgbIrScene):
            raise InputError(f"{scene.folder}: {scene.name} has no infrared image (ir.*), which this config needs")
        else:
            given = load_infrared_frame(scene)
            if stereo.max_disparity is None and scene.max_disparity is not None:
                stereo = stereo.model_copy(update={"max_disparity": scene.max_disparity})
                config = config.model_copy(update={"stereo": stereo})
        rotate = 3 if scene.rotated else 0
        frame, found = completed_frame(config, given, clock, scene.depth_scale, context.memory, rotate)
        clock.start("save")
        found.save(folder)
        facts: Row = {
            "width": frame.shape[1],
            "height": frame.shape[0],
            "known": share(np.isfinite(frame.depth)),
            "sparse": share(np.isfinite(frame.sparse)),
            "kept": share(found.kept),
            "filled": share((found.status & DepthStatus.GAP_FILLED) != 0),
            "replaced": share(found.corrected),
            "from_stereo": share((found.status & DepthStatus.SAMPLED) != 0),
            "density": share(found.valid),
            "median_bound": median(found.bound),
            **{name: float(value) for name, value in found.details.figures.items()},
        }
        warnings = list(found.warnings)
        if found.cloud is not None:
            facts["intrinsics"] = "of the camera" if scene.intrinsics else "typical"
            warnings += empty_cloud(found.values, found.cloud)
        return Outcome(facts, clock.seconds, warnings)

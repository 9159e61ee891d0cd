"""``depthcli fuse``: like ``stereo``, with a cost volume fused from several measures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field

from depthcli.batch.record import file_digests
from depthcli.core.frames import StereoPair
from depthcli.fusion import Fusion
from depthcli.io.cost_volume import read_cost_volume
from depthcli.io.scenes import Scene
from depthcli.jobs.stereo import PairWork
from depthcli.stereo.volume import StereoResult


class FuseConfig(Fusion):
    """Root of a ``fuse`` config: the fields of fusion and the search range, side by side."""

    max_disparity: int | None = Field(
        None, ge=1, le=16383, description="largest disparity searched, pixels; null: what the scene says"
    )
    run: dict[str, Any] | None = Field(default=None, exclude=True, description="How a run was made; ignored.")


@dataclass(frozen=True)
class FuseWork(PairWork):
    """Matches one scene; picklable, for worker processes."""

    config: FuseConfig

    def settings(self, scene: Scene) -> dict[str, str]:
        """The search range, and the content of the volumes made elsewhere."""
        return super().settings(scene) | file_digests(self._volume_files(scene).values())

    def _volume_files(self, scene: Scene) -> dict[str, Path]:
        names = {measure.volume for measure in self.config.measures if measure.volume is not None}
        last = scene.name.rpartition("/")[2]
        return {name: scene.left.parent / name.replace("{scene}", last) for name in sorted(names)}

    def _match(self, scene: Scene, pair: StereoPair, top: int) -> StereoResult:
        return self.config(pair, top, {n: read_cost_volume(file) for n, file in self._volume_files(scene).items()})

    def _peak_bytes(self, shape: tuple[int, int], top: int) -> int:
        return self.config.peak_bytes(shape, top)

    def _wanted_range(self) -> int | None:
        return self.config.max_disparity

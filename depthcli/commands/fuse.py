"""Match image pairs by several measures, each trusted where the pixels around agree with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.commands._pairs import PairCommand, asked_range
from depthcli.core.errors import InputError
from depthcli.data.scenes.stereo import StereoScene

if TYPE_CHECKING:
    from pydantic import BaseModel

    from depthcli.core.frames import StereoPair
    from depthcli.methods.stereo.large import Matcher
    from depthcli.methods.stereo.volume import StereoResult


class FuseCommand(PairCommand):
    """Fusion of measures computed here and of volumes made elsewhere."""

    def config_model(self) -> type[BaseModel]:
        """Fusion and the search range."""
        from depthcli.methods.fusion.config import FuseConfig

        return FuseConfig

    def files(self, config: Any, scene: StereoScene) -> dict[str, Path]:
        """The pair, and the volumes made elsewhere."""
        return super().files(config, scene) | self._volumes(config, scene)

    def match(self, config: Any, scene: StereoScene, pair: StereoPair, top: int) -> StereoResult:
        """Fuse, then finish as ``stereo`` does."""
        from depthcli.data.formats.cost_volume import read_cost_volume

        if self._volumes(config, scene) and asked_range(config, scene)[0] != 0:
            raise InputError(f"{scene.folder}: volumes made elsewhere begin at disparity 0; leave --min-disparity out")
        volumes = {name: read_cost_volume(file) for name, file in self._volumes(config, scene).items()}
        result: StereoResult = config(pair, top, volumes)
        return result

    def in_tiles(self, config: Any) -> Matcher | None:
        """Fusion can, but there are no volumes made elsewhere of tiles and smaller sizes."""
        matcher: Matcher | None = config if all(measure.volume is None for measure in config.measures) else None
        return matcher

    def peak_bytes(self, config: Any, shape: tuple[int, int], top: int) -> int:
        """As fusion says."""
        need: int = config.peak_bytes(shape, top)
        return need

    def _volumes(self, config: Any, scene: StereoScene) -> dict[str, Path]:
        names = {measure.volume for measure in config.measures if measure.volume is not None}
        last = scene.name.rpartition("/")[2]
        return {name: scene.left.parent / name.replace("{scene}", last) for name in sorted(names)}


COMMAND = FuseCommand()

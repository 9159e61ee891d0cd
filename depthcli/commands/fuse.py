"""Match image pairs by several measures, each trusted where the pixels around agree with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.commands._pairs import PairCommand, given_range
from depthcli.core.errors import InputError
from depthcli.data.scenes.stereo import StereoScene

if TYPE_CHECKING:
    from depthcli.methods.fusion.config import FuseConfig
    from depthcli.methods.stereo.matching import Matcher


class FuseCommand(PairCommand["FuseConfig"]):
    """Fusion of measures computed here and of volumes made elsewhere."""

    def config_model(self) -> type[FuseConfig]:
        """Return the model of fusion and the search range."""
        from depthcli.methods.fusion.config import FuseConfig

        return FuseConfig

    def files(self, config: FuseConfig, scene: StereoScene) -> dict[str, Path]:
        """Return the files of the pair, and the volumes made elsewhere."""
        return super().files(config, scene) | self._volumes(config, scene)

    def matcher(self, config: FuseConfig, scene: StereoScene) -> Matcher:
        """Return fusion; volumes made elsewhere are read when the pair is matched."""
        from depthcli.data.formats.cost_volume import read_cost_volume
        from depthcli.methods.fusion.config import FusionWithVolumes

        files = self._volumes(config, scene)
        if files and given_range(config, scene)[0] != 0:
            raise InputError(f"{scene.folder}: volumes made elsewhere begin at disparity 0; leave --min-disparity out")
        if not files:
            return config
        return FusionWithVolumes(config, lambda: {name: read_cost_volume(file) for name, file in files.items()})

    def _volumes(self, config: FuseConfig, scene: StereoScene) -> dict[str, Path]:
        names = {measure.volume for measure in config.measures if measure.volume is not None}
        last = scene.name.rpartition("/")[2]
        return {name: scene.left.parent / name.replace("{scene}", last) for name in sorted(names)}


COMMAND = FuseCommand()

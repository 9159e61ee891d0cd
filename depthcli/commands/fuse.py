"""Match image pairs by several cost measures, fused."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.commands._pairs import PairCommand, given_range
from depthcli.core.errors import InputError
from depthcli.io.scenes.stereo import StereoScene
from depthcli.run.command import Values

if TYPE_CHECKING:
    from depthcli.methods.fusion.config import FuseConfig
    from depthcli.methods.stereo.stages import PairMatcher


class FuseCommand(PairCommand["FuseConfig"]):
    """Fusion of measures computed here and of volumes made elsewhere."""

    page = "how_it_works/fusion"
    examples = (
        "depthcli fuse accurate --input scenes --output runs/fused --evaluate",
        "depthcli fuse cross-modal --input color-infrared --output runs/infrared",
    )

    def config_model(self) -> type[FuseConfig]:
        from depthcli.methods.fusion.config import FuseConfig

        return FuseConfig

    def config(self, values: Values) -> FuseConfig:
        """Return the config, with the network that it names."""
        from depthcli.api.stereo import with_network

        return with_network(super().config(values))

    def files(self, config: FuseConfig, scene: StereoScene) -> dict[str, Path]:
        """Return the files of the pair, the volumes made elsewhere, and the network that chooses among maps."""
        from depthcli.io.formats.networks import network_path

        name = config.network_name
        network = {} if name is None else {"network": network_path(name)}
        return super().files(config, scene) | self._volumes(config, scene) | network

    def matcher(self, config: FuseConfig, scene: StereoScene) -> PairMatcher:
        """Return fusion; volumes made elsewhere are read when the pair is matched."""
        from depthcli.io.formats.disparity import map_npy
        from depthcli.methods.fusion.config import FusionWithVolumes

        files = self._volumes(config, scene)
        if files and given_range(config, scene)[0] != 0:
            raise InputError(f"{scene.folder}: volumes made elsewhere begin at disparity 0; leave --min-disparity out")
        if not files:
            return config
        return FusionWithVolumes(config, lambda: {name: map_npy(file, 3) for name, file in files.items()})

    def _volumes(self, config: FuseConfig, scene: StereoScene) -> dict[str, Path]:
        names = {measure.volume for measure in config.measures if measure.volume is not None}
        last = scene.name.rpartition("/")[2]
        return {name: scene.left.parent / name.replace("{scene}", last) for name in sorted(names)}


COMMAND = FuseCommand()

"""Match image pairs by several measures, each trusted where the pixels around agree with it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.commands._pairs import PairCommand, asked_range
from depthcli.core.errors import ConfigError, InputError
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

    def config(self, values: Mapping[str, Any]) -> BaseModel:
        """The config, with the network that it names."""
        config: BaseModel = with_network(super().config(values))
        return config

    def files(self, config: Any, scene: StereoScene) -> dict[str, Path]:
        """The pair, the volumes made elsewhere, and the network that chooses among maps."""
        from depthcli.data.formats.networks import network_path

        name = config.network_name
        network = {} if name is None else {"network": network_path(name)}
        return super().files(config, scene) | self._volumes(config, scene) | network

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


def with_network(config: Any) -> Any:
    """Return the config with the arrays of the network that it names, if it names one.

    Raises
    ------
    ConfigError
        The network cannot be read, or was trained for other maps.
    """
    from depthcli.data.formats.networks import network_path, read_network

    if config.network_name is None:
        return config
    try:
        return config.with_network(read_network(network_path(config.network_name)))
    except InputError as error:
        raise ConfigError(f"maps.choice.weights: {error}") from None


COMMAND = FuseCommand()

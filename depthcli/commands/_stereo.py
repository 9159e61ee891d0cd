"""What ``stereo`` matches a pair by: the pipeline of its config, here or on a device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from depthcli.api.matching import device_of, with_address
from depthcli.commands._options import RunOptions, SceneOptions
from depthcli.commands._pairs import MatchPairs, pair_config
from depthcli.commands._scenes import find_scenes
from depthcli.device import Device
from depthcli.io.scenes import StereoScene
from depthcli.io.scenes.pairs import PAIRS
from depthcli.methods.stereo.config import StereoConfig
from depthcli.methods.stereo.on_device import device_implementation_of
from depthcli.methods.stereo.stages import PairMatcher
from depthcli.run.json_csv import Row


def prepare(
    config: str,
    pairs: SceneOptions,
    run: RunOptions,
    settings: Sequence[str | tuple[str, str]] | None,
    device: str | None = None,
    bound: Mapping[str, float] | None = None,
) -> tuple[Stereo, list[StereoScene]]:
    """Return the batch of ``stereo`` with this config, and the pairs that the command line names."""
    found = with_address(pair_config(StereoConfig, config, pairs, settings, device=device, bound=bound))
    return Stereo(found), find_scenes(PAIRS, pairs, run)


@dataclass(frozen=True)
class Stereo(MatchPairs):
    """Matches pairs by a pipeline."""

    command = "stereo"

    config: StereoConfig

    def matcher(self, scene: StereoScene) -> PairMatcher:
        """Return the pipeline."""
        return self.config.pipeline

    def device(self) -> Device | None:
        """Return the device that the config names."""
        return device_of(self.config)

    def device_column(self) -> Row:
        """Return the device, where the config names one."""
        config, device = self.config, self.device()
        if config.device == "cpu":
            return {}
        if device is None:
            return {"device": config.device}
        where = f"{device.info.address}, {device.info.name}"
        if device_implementation_of(config.pipeline) is None:
            where = f"cpu: {config.pipeline.method_name()} has no kernels for {where}"
        return {"device": where}

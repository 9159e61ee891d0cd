"""What ``fuse`` matches a pair by: measures computed here and volumes made elsewhere, fused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from depthcli.api.stereo import with_network
from depthcli.commands._options import RunOptions, SceneOptions
from depthcli.commands._pairs import MatchPairs, pair_config
from depthcli.commands._scenes import find_scenes
from depthcli.core.errors import InputError
from depthcli.io.formats.disparity import map_npy
from depthcli.io.formats.networks import network_path
from depthcli.io.scenes import StereoScene
from depthcli.io.scenes.pairs import PAIRS
from depthcli.methods.fusion.config import FuseConfig
from depthcli.methods.stereo.stages import PairMatcher


def prepare(
    config: str,
    pairs: SceneOptions,
    run: RunOptions,
    settings: Sequence[str | tuple[str, str]] | None,
    bound: Mapping[str, float] | None = None,
) -> tuple[Fuse, list[StereoScene]]:
    """Return the batch of ``fuse`` with this config, and the pairs that the command line names."""
    found = with_network(pair_config(FuseConfig, config, pairs, settings, bound=bound))
    return Fuse(found), find_scenes(PAIRS, pairs, run)


@dataclass(frozen=True)
class Fuse(MatchPairs):
    """Matches pairs by fusion; volumes made elsewhere are read when a pair is matched."""

    command = "fuse"

    config: FuseConfig

    def matcher(self, scene: StereoScene) -> PairMatcher:
        """Return the fusion, with the volumes of the scene."""
        files = self._volumes(scene)
        if files and self.given_range(scene)[0] != 0:
            raise InputError(f"{scene.folder}: volumes made elsewhere begin at disparity 0; leave --min-disparity out")
        return self.config.with_volumes(lambda: {name: map_npy(file, 3) for name, file in files.items()})

    def files(self, scene: StereoScene) -> dict[str, Path]:
        """Return the files of the pair, the volumes made elsewhere, and the network that chooses among maps."""
        name = self.config.network_name
        network = {} if name is None else {"network": network_path(name)}
        return super().files(scene) | self._volumes(scene) | network

    def _volumes(self, scene: StereoScene) -> dict[str, Path]:
        last = scene.name.rpartition("/")[2]
        return {name: scene.left.parent / name.replace("{scene}", last) for name in sorted(self.config.volumes)}

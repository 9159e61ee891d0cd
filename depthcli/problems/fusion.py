"""Match pairs with several fused measures: ``fuse``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from depthcli.core.errors import ConfigError, InputError
from depthcli.io.formats.disparity import map_npy
from depthcli.io.formats.networks import network_path, read_network
from depthcli.io.scenes import StereoScene
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.stereo.matching import Limits
from depthcli.methods.stereo.stages import PairMatcher
from depthcli.problems.inputs import Overrides
from depthcli.problems.results import Disparity
from depthcli.problems.stereo import (
    End,
    Matcher,
    PairConfig,
    Pairs,
    Stereo,
    StereoConfig,
)


class FuseConfig(PairConfig, Fusion):
    """The fields of ``Fusion`` and the common fields for matching pairs."""

    command: ClassVar[str] = "fuse"
    flattened: ClassVar[str] = ""


@dataclass(frozen=True)
class Fuse(Pairs[FuseConfig]):
    """Match pairs with fusion; external cost volumes are read when a pair is matched."""

    command = "fuse"
    model = FuseConfig

    volumes: Mapping[str, NDArray[Any]] = field(default_factory=dict)  # for pairs of arrays: name -> (H, W, D) costs

    @classmethod
    def ready(cls, config: FuseConfig) -> Self:
        """Return the problem with open networks. Raise ConfigError if one is unusable or for other maps."""
        config = super().ready(config).config
        if config.network_name is None:
            return cls(config)
        try:
            return cls(config.with_network(read_network(network_path(config.network_name))))
        except InputError as error:
            raise ConfigError(f"maps.choice.weights: {error}") from None

    def matcher(self, scene: StereoScene | None = None) -> PairMatcher:
        """Return the fusion with the scene's volumes, or with the volumes given as arrays."""
        if scene is None:
            if self.config.volumes - set(self.volumes):
                raise ConfigError(f"volumes: the config needs {', '.join(sorted(self.config.volumes))}")
            return self.config.with_volumes(lambda: self.volumes) if self.volumes else self.config
        files = self._volumes(scene)
        if not files:
            return self.config
        if self.ends(scene)[0] != 0:
            raise InputError(f"{scene.folder}: volumes made elsewhere begin at disparity 0; leave --min-disparity out")
        return self.config.with_volumes(lambda: {name: map_npy(file) for name, file in files.items()})

    def limits(self, memory: int) -> Limits:
        """Return the limits; the fusion has no implementation for devices."""
        return Limits(memory, self.config.tiles, self.config.tile_memory << 20)

    def files(self, scene: StereoScene) -> dict[str, Path]:
        """Return role -> file for the pair, external volumes, and the network that chooses among maps."""
        name = self.config.network_name
        network = {} if name is None else {"network": network_path(name)}
        return super().files(scene) | self._volumes(scene) | network

    def _volumes(self, scene: StereoScene) -> dict[str, Path]:
        last = scene.name.rpartition("/")[2]
        return {name: scene.left.parent / name.replace("{scene}", last) for name in sorted(self.config.volumes)}


def fuse(
    left: ArrayLike,
    right: ArrayLike,
    max_disparity: End = None,
    preset: str | Path | FuseConfig = "accurate",
    overrides: Overrides | None = None,
    *,
    volumes: Mapping[str, ArrayLike] | None = None,
    **fields: object,
) -> Disparity:
    """Return the disparity map of a rectified pair from several measures.

    A measure is trusted at a pixel if neighboring pixels agree with it. Raise ConfigError and InputError as
    :func:`stereo`.

    Parameters
    ----------
    left, right, max_disparity, overrides, **fields : as for :func:`stereo`
    preset : name of a preset of ``depthcli fuse``, path of a YAML file, or a config
    volumes : external costs: the ``volume`` of a measure in the config -> (H, W, D)

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> left = np.random.default_rng(0).integers(0, 256, (48, 96), np.uint8)
    >>> right = np.roll(left, -8, axis=1)
    >>> disparity = depthcli.fuse(left, right, max_disparity=16)
    >>> round(float(np.median(disparity.values)))
    8
    """
    arrays = {name: np.asarray(volume) for name, volume in (volumes or {}).items()}
    return Matcher(replace(Fuse.of(preset, max_disparity, overrides, fields), volumes=arrays))(left, right)


def matcher(
    preset: str | Path | StereoConfig | FuseConfig = "accurate",
    max_disparity: End = None,
    overrides: Overrides | None = None,
    **fields: object,
) -> Matcher:
    """Return a callable that matches many pairs; the config is checked and kernels are compiled only once, here.

    Raise ConfigError as :func:`stereo`.

    Parameters
    ----------
    preset : as for :func:`stereo`; or a ``FuseConfig``
    max_disparity, overrides, **fields : as for :func:`stereo`. "auto" estimates the range of every pair

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> match = depthcli.matcher("fast", max_disparity=16)
    >>> left = np.random.default_rng(0).integers(0, 256, (48, 96), np.uint8)
    >>> [float(np.median(match(left, np.roll(left, -k, axis=1)).values)) for k in (2, 4, 6)]
    [2.0, 4.0, 6.0]
    """
    problem: type[Stereo | Fuse] = Fuse if isinstance(preset, FuseConfig) else Stereo
    match = Matcher(problem.of(preset, max_disparity, overrides, fields))
    match.load_kernels()
    return match

"""Rectified pairs to disparity maps: ``stereo``, ``fuse``, and ``matcher`` for many pairs."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from depthcli.api.bounds import with_bound
from depthcli.api.inputs import Overrides, as_image, load_config, paired
from depthcli.api.matching import device_of, limits_of, match_pair, with_address, with_opened_networks
from depthcli.api.results import Disparity
from depthcli.api.rigs import rectified_rig
from depthcli.core.context import Context, Latest
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import StereoPair
from depthcli.io.formats.networks import network_path, read_network
from depthcli.kernels.jit import one_at_a_time
from depthcli.methods.fusion.config import FuseConfig
from depthcli.methods.stereo.config import StereoConfig
from depthcli.methods.stereo.pipeline.command import Program
from depthcli.methods.stereo.stages import PairMatcher
from depthcli.run.resources import available_memory

End = int | Literal["auto"] | None
"""An end of the search range: pixels, "auto": as the pair itself says, or None: what the config says."""


def stereo(
    left: ArrayLike,
    right: ArrayLike,
    max_disparity: End = None,
    preset: str | Path | StereoConfig = "accurate",
    overrides: Overrides | None = None,
    **fields: object,
) -> Disparity:
    """Return the map of a pair, rectified or, with ``calibration="stereo.yml"``, as the cameras took it.

    ConfigError for an unknown preset, or keys and values that do not fit; InputError for images that cannot be matched,
    too few matches where they say the range, or too little memory. ``warnings`` says what looks wrong with the map.

    Parameters
    ----------
    left, right : (H, W) grey or (H, W, 3) RGB (OpenCV reads BGR: ``image[..., ::-1]``); uint8, uint16, or floats from
        0 to 1. Where one is grey and the other in color, both become grey
    max_disparity : largest disparity searched, pixels; "auto": as the pair itself says; None: what the config
        says, else "auto", with a warning
    preset : name of a preset of ``depthcli stereo``, path of a YAML file, or a config
    overrides : config keys -> values, as ``--set`` has them, such as ``{"cost.window": 9}``
    **fields : the same for keys that are Python names, such as ``min_disparity=-8``; ``bound=True``: the map then has a
        ``bound`` of its errors and a ``probability``; or ``calibration``: a file, a list of files, or a mapping as in a
        config; the map is then that of the rectified left image

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> left = np.random.default_rng(0).integers(0, 256, (48, 96), np.uint8)
    >>> right = np.roll(left, -8, axis=1)  # all is seen at a disparity of 8 pixels
    >>> disparity = depthcli.stereo(left, right, max_disparity=16, preset="fast")
    >>> float(np.median(disparity.values[disparity.measured]))
    8.0
    """
    config = load_config(StereoConfig, preset, overrides, **_with_range(fields, max_disparity))
    return Matcher(with_address(config))(left, right)


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
    """Return the map of a rectified pair by several measures, each trusted where the pixels around agree with it.

    ConfigError and InputError as for :func:`stereo`.

    Parameters
    ----------
    left, right, max_disparity, overrides, **fields : as for :func:`stereo`
    preset : name of a preset of ``depthcli fuse``, path of a YAML file, or a config
    volumes : costs made elsewhere: name, as the ``volume`` of a measure in the config has it -> (H, W, D)

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> left = np.random.default_rng(0).integers(0, 256, (48, 96), np.uint8)
    >>> right = np.roll(left, -8, axis=1)
    >>> disparity = depthcli.fuse(left, right, max_disparity=16)
    >>> round(float(np.median(disparity.values)))
    8
    """
    config = load_config(FuseConfig, preset, overrides, **_with_range(fields, max_disparity))
    return Matcher(with_network(config), volumes)(left, right)


class Matcher:
    """Matches many pairs by one config: what :func:`matcher` returns. It may be called from several threads."""

    def __init__(self, config: StereoConfig | FuseConfig, volumes: Mapping[str, ArrayLike] | None = None) -> None:
        self.config, self._latest = config, Latest()
        self._method: PairMatcher = config.pipeline if isinstance(config, StereoConfig) else config
        if isinstance(config, FuseConfig) and config.volumes:
            given = {name: np.asarray(volume) for name, volume in (volumes or {}).items()}
            if config.volumes - set(given):
                raise ConfigError(f"volumes: the config needs {', '.join(sorted(config.volumes))}")
            self._method = config.with_volumes(lambda: given)
        self._device = device_of(config) if isinstance(config, StereoConfig) else None
        # A device has one queue of work.
        self._turn = contextlib.nullcontext() if self._device is None else threading.Lock()

    def __call__(self, left: ArrayLike, right: ArrayLike) -> Disparity:
        """Return the map of a pair, which is given as for :func:`stereo`, with the same result and errors."""
        views, geometry = (as_image(left, "left"), as_image(right, "right")), None
        if self.config.calibration is not None:
            rig = rectified_rig(self.config.calibration, *views, self._latest)
            views, geometry = rig.images(*views)[:2], rig.geometry
        pair, top = paired(*views, left), self.config.max_disparity
        ends = self.config.min_disparity or 0, "auto" if top is None else top
        found = replace(self._match(pair, ends), geometry=geometry)
        if top is not None:
            return found
        text = f'max_disparity is not given: "auto" was taken, which gives {found.search.max_disparity} px'
        return replace(found, warnings=(*found.warnings, text))

    def _match(self, pair: StereoPair, ends: tuple[int | str, int | str]) -> Disparity:
        with self._turn, one_at_a_time():
            limits = limits_of(self.config, available_memory(), self._device)
            context = Context(limits.memory)
            found = match_pair(self._method, pair, ends, limits, context)
            bound = self.config.bound
            return found if bound is None else with_bound(found, pair, bound, context)

    def load_kernels(self) -> None:
        """Match small pairs, grey and in color, so that the first pair of the user takes no longer than the next."""
        if isinstance(self._method, Program) or (isinstance(self.config, FuseConfig) and self.config.volumes):
            return
        top = self.config.max_disparity
        top = min(top, 32) if isinstance(top, int) and top > 0 else 32
        noise = np.random.default_rng(0).integers(0, 256, (32, 96, 3), np.uint8)
        for image in (noise[..., 0].copy(), noise):
            self._match(StereoPair(image, np.roll(image, -2, axis=1), 8), (0, top))


def matcher(
    preset: str | Path | StereoConfig | FuseConfig = "accurate",
    max_disparity: End = None,
    overrides: Overrides | None = None,
    **fields: object,
) -> Matcher:
    """Return what matches many pairs: the config is checked, and kernels are loaded or compiled, once and before.

    ConfigError as for :func:`stereo`.

    Parameters
    ----------
    preset : as for :func:`stereo`; or a ``FuseConfig``
    max_disparity, overrides, **fields : as for :func:`stereo`. "auto" finds the range of every pair anew

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> match = depthcli.matcher("fast", max_disparity=16)
    >>> left = np.random.default_rng(0).integers(0, 256, (48, 96), np.uint8)
    >>> [float(np.median(match(left, np.roll(left, -k, axis=1)).values)) for k in (2, 4, 6)]
    [2.0, 4.0, 6.0]
    """
    fields = _with_range(fields, max_disparity)
    if isinstance(preset, FuseConfig):
        made = Matcher(with_network(load_config(FuseConfig, preset, overrides, **fields)))
    else:
        made = Matcher(with_address(load_config(StereoConfig, preset, overrides, **fields)))
    made.load_kernels()
    return made


def with_network(config: FuseConfig) -> FuseConfig:
    """Return the config with the networks that it names; ConfigError where one cannot be used, or is for other maps."""
    config = with_opened_networks(config, "cpu")
    if config.network_name is None:
        return config
    try:
        return config.with_network(read_network(network_path(config.network_name)))
    except InputError as error:
        raise ConfigError(f"maps.choice.weights: {error}") from None


def _with_range(fields: dict[str, object], max_disparity: End) -> dict[str, object]:
    return fields if max_disparity is None else {**fields, "max_disparity": max_disparity}

"""Pairs to disparity maps: what the functions for Python share with the commands that match pairs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from depthcli import device
from depthcli.api.results import Disparity
from depthcli.core.context import Context
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import StereoPair
from depthcli.core.text import show_bytes
from depthcli.device import Device, DeviceError
from depthcli.methods.stereo.config import PairConfig, StereoConfig
from depthcli.methods.stereo.matching import Limits, match
from depthcli.methods.stereo.networks import network_device, networks_in
from depthcli.methods.stereo.search_range import MatchedRange, SearchRange, complete_range, matched_beyond
from depthcli.methods.stereo.stages import PairMatcher
from depthcli.methods.stereo.volume import StereoResult

PairConfigT = TypeVar("PairConfigT", bound=PairConfig)

_MIN_MEASURED_SHARE = 0.5  # of the pixels; with fewer a map has a warning
# Shares of the measured pixels at an end of the search range. Above the first, a map has a warning. Of ranges that end
# at three quarters of the largest disparity a third has fewer: above the second, the pair is asked for its own range.
_MAX_SHARE_AT_END, _MIN_SHARE_AT_END = 0.05, 0.01


def match_pair(
    matcher: PairMatcher,
    pair: StereoPair,
    ends: tuple[int | str, int | str | None],
    limits: Limits,
    context: Context,
    known: MatchedRange | None = None,
) -> Disparity:
    """Return the map of a pair; InputError where the range is empty, too few pixels match, or memory is short.

    Parameters
    ----------
    ends : of the search range, pixels or "auto"; the upper one None: as the pair itself suggests
    context : its clock books ``range``, where the range is found, the stages of the method, and ``other``
    known : the range of the pair's sequence; None: that of the pair itself, where it is wanted
    """
    clock = context.clock
    if known is None and (ends[1] is None or "auto" in ends):
        clock.start("range")
    search, key_points = complete_range(*ends, pair, known)
    clock.start("other")
    widest, given = max(pair.shape[1] - 1, search.min_disparity + 1), search.max_disparity
    search = SearchRange(search.min_disparity, min(given, widest))
    matched = match(matcher, search.shift(pair), search.shifted_max_disparity, limits, context)
    result = search.restore(matched, pair.shape[1])
    clock.include(result.seconds)
    found, seconds = result.disparity, dict(clock.seconds)
    warnings = _warnings(pair, search, key_points, result, limits)
    if given > widest:
        text = f"no pixel of images {pair.shape[1]} wide has a disparity above {widest}: not searched up to {given}"
        warnings = (text, *warnings)
    return Disparity(found.values, found.status, pair.left, search, result, seconds, warnings, key_points)


def _warnings(
    pair: StereoPair, search: SearchRange, key_points: Mapping[str, int], result: StereoResult, limits: Limits
) -> tuple[str, ...]:
    """Return a line for each thing that looks wrong with a map."""
    found, warnings = result.disparity, []
    if partly_used(pair):
        warnings.append(f"samples of {pair.bits} bits in {pair.left.dtype} files; scaled accordingly")
    if flat := [name for name, image in (("left", pair.left), ("right", pair.right)) if image.min() == image.max()]:
        warnings.append(f"the {' and the '.join(flat)} image has one level alone: nothing can be matched")
    elif np.array_equal(pair.left, pair.right):
        warnings.append("both images are the same: the disparity is 0 or chance; was one file given twice?")
    measured = np.count_nonzero(found.measured) / found.values.size
    if measured < _MIN_MEASURED_SHARE:
        warnings.append(
            f"only {100 * measured:.0f} % of the map was measured, the rest is filled in or empty: views swapped, "
            "not rectified, search range too small, or no texture?"
        )
    bounds = ((search.min_disparity, "min_disparity"), (search.max_disparity, "max_disparity"))
    shares = search.share_at_ends(found)
    for share, (end, option) in zip(shares, bounds, strict=True):
        if share > _MAX_SHARE_AT_END:
            warnings.append(
                f"{100 * share:.0f} % of the measured pixels lie at the end of the search range, {end}; see {option}"
            )
    if _MIN_SHARE_AT_END < shares[1] <= _MAX_SHARE_AT_END and (top := matched_beyond(pair, search)) is not None:
        warnings.append(
            f"the images match at disparities up to {top}, searched up to {bounds[1][0]}; see max_disparity"
        )
    if key_points and search.min_disparity > key_points["range_low"] and key_points["range_low"] < 0:
        warnings.append(f"the images match at disparities down to {key_points['range_low']}; see min_disparity")
    if search.min_disparity < 0:
        warnings.append("disp_left.png cannot hold negative disparities: no value there; disp_left.pfm has them")
    if result.figures.get("exact") == 0 and limits.memory < limits.tile_memory:
        warnings.append(
            f"matched in {result.figures['tiles']:.0f} tiles at {result.figures['levels']:.0f} sizes, since only "
            f"{show_bytes(limits.memory)} of memory may be used: with more the map is another one"
        )
    return tuple(warnings)


def limits_of(config: PairConfig, memory: int, device: Device | None) -> Limits:
    """Return where a config lets a pair be matched, with at most ``memory`` bytes."""
    return Limits(memory, config.tiles, config.tile_memory << 20, device)


def with_address(config: StereoConfig) -> StereoConfig:
    """Return the config with the address of its device, and its networks opened there; ConfigError where one fails."""
    try:
        if config.pipeline.uses_devices:
            info = device.find_device(config.device)
            address = "cpu" if info is None else info.address
        else:
            address = network_device(config.device)
    except (DeviceError, InputError) as error:
        raise ConfigError(str(error)) from error
    return with_opened_networks(config.model_copy(update={"device": address}), address)


def device_of(config: StereoConfig) -> Device | None:
    """Open the device that a config names; None for the processor, and where the pipeline opens it itself."""
    return device.open_device(config.device) if config.pipeline.uses_devices else None


def with_opened_networks(config: PairConfigT, address: str) -> PairConfigT:
    """Return the config with its networks opened and checked; ConfigError where one cannot be used.

    On a device other than CUDA's they run on the processor.
    """
    if not any(networks_in(config)):
        return config
    config = config.model_copy(deep=True)
    for network in networks_in(config):
        try:
            network.prepare(address if address.startswith("cuda") else "cpu")
        except InputError as error:
            raise ConfigError(str(error)) from error
    return config


def partly_used(pair: StereoPair) -> bool:
    """Return whether the samples have fewer bits than their type."""
    return pair.bits is not None and pair.bits < 8 * pair.left.dtype.itemsize

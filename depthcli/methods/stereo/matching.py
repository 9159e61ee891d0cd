"""The way a pair is matched: whole, in tiles, coarse to fine, or on a device.

A pair is matched tile by tile if its costs do not fit into the allowed memory. If costs depend only on nearby pixels
(no optimizer), tiles search the whole range with the margin that the method needs, and the result has the same bytes
as for the whole pair. Otherwise the pair is matched coarse to fine (:mod:`.tiling`): smaller sizes decide which
disparities a tile searches.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from depthcli.core.context import Context
from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.core.memory import BASE_BYTES
from depthcli.core.text import show_bytes
from depthcli.device import Device
from depthcli.methods.stereo.on_device import DevicePair, Table
from depthcli.methods.stereo.stages import PairMatcher
from depthcli.methods.stereo.tiling import match_in_tiles
from depthcli.methods.stereo.volume import StereoResult

TileMode = Literal["auto", "always", "never"]
"""Whether a pair is matched in tiles; auto: if the whole pair would need more memory than tiles may take."""

# Upper bound of the host's memory while a GPU does the work: the images, the maps and the library.
_HOST_BYTES_PER_PIXEL, _HOST_BYTES = 200, 64 << 20


@dataclass(frozen=True)
class Limits:
    """The device and the memory for matching a pair.

    ``tile_memory`` determines the tiles, not the free memory, so that the map does not depend on the number of workers.
    """

    memory: int  # bytes that the process may take
    tiles: TileMode = "auto"
    tile_memory: int = 3072 << 20  # bytes that it may take if the pair is matched in tiles
    device: Device | None = None  # used if the matcher has an implementation for it; None: the CPU

    def device_for(self, matcher: PairMatcher) -> Device | None:
        """Return the device, if there is one and the matcher has an implementation for it."""
        return self.device if self.device is not None and type(matcher) in device_table() else None


def device_table() -> Table:
    """Return the device implementations, which are imported only if there is a device."""
    from depthcli.methods.stereo._device_table import TABLE

    return TABLE


def match(
    matcher: PairMatcher, pair: StereoPair, max_disparity: int, limits: Limits, context: Context | None = None
) -> StereoResult:
    """Match ``pair`` over disparities 0 .. ``max_disparity`` inclusive, within ``limits``.

    A device is used if one is given and the matcher has an implementation for it. Otherwise the pair is matched in
    tiles if it needs more memory than ``limits`` allow, or if ``limits.tiles`` is "always", and whole if not.
    Raise InputError if memory does not suffice.
    """
    device = limits.device_for(matcher)
    need, has_tiles = _needs(matcher, pair.shape, max_disparity, limits)
    total = BASE_BYTES + need
    if has_tiles and (need > limits.tile_memory or total > limits.memory or limits.tiles == "always"):
        return match_in_tiles(matcher, pair, max_disparity, min(limits.memory, limits.tile_memory), context)
    if total > limits.memory:
        raise InputError(
            f"needs about {show_bytes(total)} of memory ({pair.shape[1]} x {pair.shape[0]} pixels, {max_disparity + 1} "
            f"disparities), {show_bytes(limits.memory)} may be used; see max_disparity"
        )
    if device is None:
        return matcher(pair, max_disparity, context)
    there = DevicePair(device, pair, device_table())
    result: StereoResult = there.run(matcher, there, max_disparity, context)
    return result


def host_bytes(matcher: PairMatcher, shape: tuple[int, int], max_disparity: int, limits: Limits) -> int:
    """Estimate the host's memory that :func:`match` takes for a pair of (H, W) ``shape``, bytes.

    ``BASE_BYTES``, the memory that the process takes before, is not included.
    """
    need, has_tiles = _needs(matcher, shape, max_disparity, limits)
    return limits.tile_memory - BASE_BYTES if has_tiles and need > limits.tile_memory else need


def _needs(matcher: PairMatcher, shape: tuple[int, int], max_disparity: int, limits: Limits) -> tuple[int, bool]:
    """Return the host's memory for the whole pair, bytes, and whether it may be matched in tiles instead."""
    device = limits.device_for(matcher)
    if device is not None and device.info.is_gpu:
        return _HOST_BYTES_PER_PIXEL * shape[0] * shape[1] + _HOST_BYTES, False
    has_tiles = device is None and limits.tiles != "never" and matcher.tile_halo() is not None
    return matcher.peak_bytes(shape, max_disparity), has_tiles

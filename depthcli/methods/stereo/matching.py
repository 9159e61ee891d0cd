"""How a pair is matched, decided in one place: whole, in tiles, coarse to fine, or on a device.

Pairs whose costs do not fit into the memory that is allowed are matched tile by tile. Where costs depend on the pixels
around alone (no optimizer), tiles search the whole range with the margin that the method needs: the result has the
same bytes as that of the whole pair. Otherwise the pair is matched coarse to fine (:mod:`.coarse_to_fine`): the smaller
sizes say which disparities a tile searches.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel

from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.core.memory import show_bytes
from depthcli.core.method import device_implementation_of
from depthcli.core.result import Clock
from depthcli.device import Device
from depthcli.methods.stereo.adjustment import Adjust, adjusted
from depthcli.methods.stereo.coarse_to_fine import coarse_prior
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.refinement.background_fill import BackgroundFill
from depthcli.methods.stereo.refinement.left_right_check import LeftRightCheck
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.stages import CostStages
from depthcli.methods.stereo.tiles import Candidates, Memory
from depthcli.methods.stereo.tiling import match_by_costs, match_by_patches
from depthcli.methods.stereo.volume import StereoResult

TileMode = Literal["auto", "always", "never"]
"""When a pair is matched in tiles; auto: where the whole pair would need more memory than tiles may take."""

# What matches the smaller sizes for methods without cost stages: fast, and it keeps only what both views agree on.
_FINDER = CostStages(
    cost=Census(window=(7, 7)),
    optimization=Scanline(p1=25, p2=120, edge_threshold=15, edge_divisor=6),
    refinement=(LeftRightCheck(), SpeckleFilter(size=50), BackgroundFill()),
)


# Upper bound of the memory of this machine while a card does the work: the images, the maps and the library.
_HOST_BYTES_A_PIXEL, _HOST_BYTES = 200, 64 << 20


class Matcher(ABC):
    """Anything that matches a pair, and declares what has to be known to decide how it is run."""

    @abstractmethod
    def __call__(self, pair: StereoPair, max_disparity: int, /) -> StereoResult:
        """Match the whole pair over disparities 0 .. ``max_disparity`` inclusive."""

    @abstractmethod
    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate the peak working memory of matching a whole pair of (H, W) ``shape``, bytes."""

    @property
    def has_tiles(self) -> bool:
        """Tell whether parts of a pair can be matched by themselves."""
        return True

    def cost_stages(self) -> CostStages | None:
        """Return the stages whose costs can be computed tile by tile; None: tiles are matched as pairs of their own."""
        return None

    def prepared(self, pair: StereoPair, max_disparity: int, clock: Clock) -> tuple[StereoPair, Matcher]:
        """Return the pair after what is done to its images first, and the matcher that does the rest."""
        return pair, self

    def device_implementation(self) -> Any | None:
        """Return the module with ``run`` and ``peak_bytes`` for devices; None where there is none."""
        return device_implementation_of(self)


class AdjustingMatcher(Matcher, BaseModel):
    """A matcher that may adjust the right image to the left one first."""

    adjust: Adjust = ()

    def prepared(self, pair: StereoPair, max_disparity: int, clock: Clock) -> tuple[StereoPair, Matcher]:
        """Return the pair with an adjusted right image, and the matcher without that step."""
        return adjusted(pair, max_disparity, self.adjust, clock), self.model_copy(update={"adjust": ()})


@dataclass(frozen=True)
class Limits:
    """Where a pair may be matched, and in how much memory.

    Attributes
    ----------
    memory : bytes that the process may take
    tiles : when the pair is matched in tiles
    tile_memory : bytes that the process may take where it is matched in tiles; by this rather than by what is free
        the tiles are chosen, so that the map does not depend on the number of workers
    device : where to match; None: on the processor
    """

    memory: int
    tiles: TileMode = "auto"
    tile_memory: int = 3072 << 20
    device: Device | None = None


def host_bytes(matcher: Matcher, shape: tuple[int, int], max_disparity: int, limits: Limits) -> int:
    """Estimate the memory of this machine that :func:`match` takes for a pair of (H, W) ``shape``, bytes."""
    whole = _whole_bytes(matcher, shape, max_disparity, limits.device)
    return min(whole, limits.tile_memory) if _allows_tiles(matcher, limits) else whole


def match(matcher: Matcher, pair: StereoPair, max_disparity: int, limits: Limits) -> StereoResult:
    """Match ``pair`` over disparities 0 .. ``max_disparity`` inclusive, in the way that ``limits`` ask for.

    On the device, where one is given and the matcher has an implementation for it; in tiles, where the whole pair needs
    more memory than tiles may take, or always; else whole.

    Raises
    ------
    InputError
        The memory that may be used, here or on the device, does not suffice.
    """
    tile_memory = min(limits.memory, limits.tile_memory)
    need = _whole_bytes(matcher, pair.shape, max_disparity, limits.device)
    in_tiles = _allows_tiles(matcher, limits) and (need > tile_memory or limits.tiles == "always")
    if need > limits.memory and not in_tiles:
        raise InputError(
            f"needs about {show_bytes(need)} of memory ({pair.shape[1]} x {pair.shape[0]} pixels, {max_disparity + 1} "
            f"disparities), {show_bytes(limits.memory)} may be used; see --max-memory, --jobs, --max-disparity"
        )
    clock = Clock()
    prepared, rest = matcher.prepared(pair, max_disparity, clock)
    if in_tiles:
        held = 0 if prepared is pair else pair.right.nbytes + pair.shape[0] * pair.shape[1]
        result = match_in_tiles(rest, prepared, max_disparity, Memory.of_process(tile_memory, held))
    elif limits.device is not None and matcher.device_implementation() is not None:
        result = match_on_device(rest, prepared, max_disparity, limits.device)
    else:
        result = rest(prepared, max_disparity)
    result.seconds = clock.seconds | result.seconds
    return result


def match_in_tiles(matcher: Matcher, pair: StereoPair, max_disparity: int, available: Memory) -> StereoResult:
    """Match a prepared pair over disparities 0 .. ``max_disparity`` inclusive with little memory.

    Methods with cost stages compute costs tile by tile; the right view's map, and every step that looks at maps alone,
    is that of the whole image. Any other method matches every tile for itself, over one range from its smallest to its
    largest candidate; pictures and tables that it would write are left out.

    Returns
    -------
    StereoResult
        ``figures`` has ``tiles``, their number, ``levels``, the number of sizes that were matched, and ``exact``:
        1 where the map is that of the whole pair, else 0.

    Raises
    ------
    InputError
        Not even the smallest tiles fit.
    """
    clock = Clock()
    stages = matcher.cost_stages()
    halo = None if stages is None else stages.halo()
    prior = None
    if halo is None:
        prior = coarse_prior(stages or _FINDER, pair, max_disparity, available, clock)
    candidates = Candidates.everywhere(pair.shape, max_disparity) if prior is None else prior.candidates
    if stages is None:
        result = match_by_patches(matcher, matcher.peak_bytes, pair, candidates, available, clock)
    else:
        result, _ = match_by_costs(stages, pair, candidates, prior, halo, available, clock)
    result.figures |= {"levels": 1.0 if prior is None else float(prior.levels), "exact": float(halo is not None)}
    return result


def match_on_device(matcher: Matcher, pair: StereoPair, max_disparity: int, device: Device) -> StereoResult:
    """Match a prepared pair by the matcher's device implementation; InputError where it does not fit on the device."""
    implementation = matcher.device_implementation()
    assert implementation is not None
    need, available = implementation.peak_bytes(matcher, pair.shape, max_disparity, device), device.info.memory
    if need > available:
        raise InputError(
            f"needs about {show_bytes(need)} on {device.info.address} ({device.info.name}), which has "
            f"{show_bytes(available)}; see --device, --max-disparity"
        )
    result: StereoResult = implementation.run(matcher, pair, max_disparity, device)
    return result


def _whole_bytes(matcher: Matcher, shape: tuple[int, int], max_disparity: int, device: Device | None) -> int:
    if device is not None and device.info.is_gpu and matcher.device_implementation() is not None:
        return _HOST_BYTES_A_PIXEL * shape[0] * shape[1] + _HOST_BYTES
    return matcher.peak_bytes(shape, max_disparity)


def _allows_tiles(matcher: Matcher, limits: Limits) -> bool:
    if limits.device is not None and matcher.device_implementation() is not None:
        return False
    return limits.tiles != "never" and matcher.has_tiles

"""A map as it is shown: values, bounds, statuses and kinds of pixels, with their meanings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import DepthStatus, Status

Picture: TypeAlias = NDArray[np.uint8]
"""(H, W, 3) RGB, or (H, W) grey levels."""

Range: TypeAlias = tuple[float, float]

Palette: TypeAlias = Mapping[int, tuple[str, tuple[int, int, int]]]
"""Bit -> (word, RGB color); 0 is a pixel without any. The first of several bits gives the color, others tint it."""

# Colors that the common kinds of color blindness tell apart (Okabe and Ito, 2008). White as a tint makes pale.
_LIGHT, _BLACK, _WHITE = (225, 225, 225), (0, 0, 0), (255, 255, 255)
_BLUE, _SKY, _YELLOW = (0, 114, 178), (86, 180, 233), (240, 228, 66)
_ORANGE, _VERMILION, _PURPLE, _GREEN = (230, 159, 0), (213, 94, 0), (204, 121, 167), (0, 158, 115)

NO_VALUE = _BLACK
"""RGB of a pixel without a value, in all pictures of maps, errors and statuses; no color of a map's scale."""

STATUS_PALETTE: Palette = {
    Status.MEASURED: ("measured", _LIGHT),
    Status.OCCLUDED: ("occluded", _VERMILION),
    Status.MISMATCH: ("mismatch", _BLUE),
    Status.OUT_OF_RANGE: ("out of range", _ORANGE),
    Status.NO_DATA: ("no data", NO_VALUE),
    Status.FILLED: ("filled", _WHITE),
}
DEPTH_STATUS_PALETTE: Palette = {
    DepthStatus.KEPT: ("kept", _LIGHT),
    DepthStatus.GAP_FILLED: ("gap filled", _SKY),
    DepthStatus.CORRECTED: ("corrected", _VERMILION),
    DepthStatus.FALLBACK: ("filled from around", _YELLOW),
    DepthStatus.CARRIED: ("carried over", _PURPLE),
    DepthStatus.EMPTY: ("no value", NO_VALUE),
    DepthStatus.SAMPLED: ("from stereo", _GREEN),
}

MEASURED_CODE = (
    'Measured pixels: cv2.imread("SCENE/status.png", -1) == 0, or depthcli.read_status("SCENE/status.png").measured'
)
"""How a user's program selects them."""

UNKNOWN, RIGHT, WRONG, HIDDEN_RIGHT, HIDDEN_WRONG, EMPTY = range(6)
"""Kinds of pixel; ``HIDDEN``: occluded in the other view, ``EMPTY``: without a value."""

_TINT = 0.4  # share of every further bit's color
_PERCENTILES = (1, 99)  # of values that span colors


class SliceAxis(NamedTuple):
    """An axis of a volume that is shown."""

    plane: str  # name of the slices across it
    ends: str  # letters of the sides where its first and its last voxel is
    first: float  # where the first voxel is, mm; positive towards the first side
    step: float  # how much further the next one is, mm


@dataclass(frozen=True, eq=False)
class View:
    """A map as it is shown; all arrays have its shape."""

    values: NDArray[np.floating[Any]]  # (H, W), or (Z, Y, X) of a volume; NaN = none
    unit: str = ""
    scale: Range = (0.0, 1.0)  # lowest and highest value of the colors
    status: NDArray[np.uint8] | None = None
    palette: Palette = field(default_factory=dict)  # colors and words of the status
    confidence: Mapping[str, NDArray[Any]] = field(default_factory=dict)  # name -> map, higher is surer
    bound: NDArray[np.floating[Any]] | None = None  # of the error, NaN = none
    image: Picture | None = None  # (H, W, 3) RGB, or (Z, Y, X) grey levels, beneath the map
    opacity: float = 1.0  # of the map's colors over the image
    axes: tuple[SliceAxis, ...] = ()  # of a volume; empty: it is an image
    kinds: NDArray[np.uint8] | None = None  # of pixel, ``UNKNOWN`` to ``EMPTY``
    error: NDArray[np.floating[Any]] | None = None  # by which kinds are shaded; None: they are not

    @classmethod
    def of_depth(cls, depth: NDArray[np.float32], bound: NDArray[np.float32] | None = None) -> Self:
        """Return the view of depths in meters, even in inverse depth: the highest color is the nearest."""
        with np.errstate(divide="ignore", over="ignore"):
            inverse = np.where(depth > 0, 1 / depth, np.float32(np.nan)).astype(np.float32)
        return cls(inverse, "m", spread(inverse), bound=bound)

    def part(self, index: Any, step: int = 1) -> Self:
        """Return the view of ``array[index]``, and of that every ``step``-th pixel."""

        def cut(value: Any) -> Any:
            if isinstance(value, np.ndarray):
                return value[index][::step, ::step].copy()  # so that the whole is not kept
            return {name: cut(plane) for name, plane in value.items()} if isinstance(value, dict) else value

        return replace(self, **{each.name: cut(getattr(self, each.name)) for each in fields(self)})


def spread(values: NDArray[np.floating[Any]]) -> Range:
    """Return the 1st and the 99th percentile of the finite values; (0, 0) without any."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 0.0
    low, high = np.percentile(finite, _PERCENTILES).tolist()
    return low, high


def bound_range(bound: NDArray[np.floating[Any]]) -> Range:
    """Return the ends of the colors of bounds, above 0 and never the same: the 1st and the 99th percentile."""
    low, high = (float(f"{end:.2g}") for end in spread(bound[bound > 0]))
    return (low, max(high, 2 * low)) if low else (0.1, 1.0)


def status_colors(palette: Palette) -> Picture:
    """Return (256, 3) RGB of all statuses; black where no bit is in the palette."""
    values, colors, mixed = np.arange(256), np.zeros((256, 3)), np.zeros(256, np.bool_)
    for bit, (_, color) in palette.items():
        has = values & int(bit) > 0 if bit else values == 0
        tint = np.where(mixed, _TINT, 1.0)[:, None]
        colors = np.where(has[:, None], colors + tint * (color - colors), colors)
        mixed |= has
    return np.rint(colors).astype(np.uint8)


def status_words(value: int, palette: Palette) -> str:
    """Return words for the bits ``value``, such as ``occluded, filled``."""
    words = [word for bit, (word, _) in palette.items() if (value & bit if value else bit == 0)]
    return ", ".join(words) or str(value)


def pixel_kinds(
    known: NDArray[np.bool_], hidden: NDArray[np.bool_], wrong: NDArray[np.bool_], missing: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Return the kind of every pixel, ``UNKNOWN`` to ``EMPTY``, as uint8.

    ``known`` are those whose truth is known and counts, ``hidden`` those occluded in the other view.
    """
    kinds = np.uint8(RIGHT) + wrong + np.uint8(HIDDEN_RIGHT - RIGHT) * hidden  # no more memory for whole volumes
    return np.where(known, np.where(missing, np.uint8(EMPTY), kinds), np.uint8(UNKNOWN))

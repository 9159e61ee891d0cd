"""The view of a map: values, bounds, statuses and kinds of pixels, with their meanings; and drawing of views."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Any, NamedTuple, Self, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import DepthStatus, Status

Picture: TypeAlias = NDArray[np.uint8]
"""(H, W, 3) RGB, or (H, W) grey levels."""

Range: TypeAlias = tuple[float, float]

Palette: TypeAlias = Mapping[int, tuple[str, tuple[int, int, int]]]
"""Bit -> (word, RGB color); 0: no bit is set. If several bits are set, the first gives the color, others tint it."""

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

# Name of the color of every kind of pixel, and the colors of a small and of a large error; the darker, the worse. Blue
# and orange stay apart for every kind of color blindness, purple is apart from both by lightness, too.
KIND_COLORS = (
    ("white", "#ffffff", "#ffffff"), ("blue", "#c6dff2", "#2f7ab8"), ("orange", "#f5b13d", "#8a3000"),
    ("grey", "#dcdcdc", "#9b9b9b"), ("purple", "#dba2cf", "#5c1f57"), ("black", "#000000", "#000000"),
)  # fmt: skip
_N_SHADES = 64
_SHADE = 16  # shade of a kind of pixel regardless of its error
_MARGIN, _LINE = 8, 20  # pixels: between two pictures, and height of a line of text
_FONT = cv2.FONT_HERSHEY_SIMPLEX, 0.5  # of lines of text: capitals are 11 pixels high
_INK = (0, 0, 0)


class SliceAxis(NamedTuple):
    """An axis of a shown volume."""

    plane: str  # name of the slices across it
    ends: str  # letters of the sides where its first and its last voxel is
    first: float  # where the first voxel is, mm; positive towards the first side
    step: float  # how much further the next one is, mm


@dataclass(frozen=True, eq=False)
class View:
    """The view of a map; all arrays have its shape."""

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
        """Return the view of every ``step``-th pixel of ``array[index]``."""

        def cut(value: Any) -> Any:
            if isinstance(value, np.ndarray):
                return value[index][::step, ::step].copy()  # so that the whole is not kept
            return {name: cut(plane) for name, plane in value.items()} if isinstance(value, dict) else value

        return replace(self, **{attribute.name: cut(getattr(self, attribute.name)) for attribute in fields(self)})


def spread(values: NDArray[np.floating[Any]]) -> Range:
    """Return the 1st and the 99th percentile of the finite values, or (0, 0) if there are none."""
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

    ``known`` pixels have a ground truth that counts; ``hidden`` pixels are occluded in the other view.
    """
    kinds = np.uint8(RIGHT) + wrong + np.uint8(HIDDEN_RIGHT - RIGHT) * hidden  # no more memory for whole volumes
    return np.where(known, np.where(missing, np.uint8(EMPTY), kinds), np.uint8(UNKNOWN))


def draw(view: View, what: str, scale: Range | None = None) -> Picture:
    """Return a picture of a view, (H, W, 3) RGB or grey levels; pixels without a value are black.

    Parameters
    ----------
    view : view of an image, or of a slice of a volume
    what : quantity to draw:

        - ``preview``: values from blue (lowest) to red (highest), next to any bound;
        - ``values``: values from violet to yellow, over the image;
        - ``bound``: the bound from violet to yellow, on a logarithmic scale;
        - ``error``: kinds of pixel, shaded by any error, over the image;
        - ``status``: colors of the palette;
        - ``confidence:NAME``, or ``confidence`` if the values are one: grey levels, 1st to 99th percentile
    scale : ends of the colors; None: the ends of the view or of the bound. For errors, 0 and the largest
    """
    if what == "preview":
        picture = _turbo(view.values, *view.scale)
        return picture if view.bound is None and not _is_depth(view) else _with_scales(picture, view)
    if what == "values":
        return _over_image(view, _viridis(view.values, *(scale or view.scale)), np.isnan(view.values))
    if what == "status" and view.status is not None:
        return status_colors(view.palette)[view.status]
    if what == "bound" and view.bound is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            return _viridis(np.log(view.bound), *map(math.log, scale or bound_range(view.bound)))
    if what == "error" and view.kinds is not None:
        if view.error is None:
            return kind_colors()[view.kinds]
        shade = step_of(view.error, *(scale or view.scale), _N_SHADES)
        return _over_image(view, error_scales()[view.kinds, shade], view.kinds == UNKNOWN)
    if not what.startswith("confidence"):
        raise ValueError(f"the view has nothing called {what!r}")
    name = what.removeprefix("confidence").removeprefix(":")
    return _grey(view.confidence[name] if name else view.values)


def _turbo(values: NDArray[np.floating[Any]], low: float, high: float) -> Picture:
    """Return values from blue, ``low``, to red, ``high``."""
    known = ~np.isnan(values)
    with np.errstate(over="ignore", invalid="ignore"):
        grey = np.clip(np.rint((values - np.float32(low)) * (255.0 / max(high - low, 1e-6))), 0, 255)
    grey = np.where(known, grey, 0).astype(np.uint8)
    picture: NDArray[Any] = cv2.cvtColor(cv2.applyColorMap(grey, cv2.COLORMAP_TURBO), cv2.COLOR_BGR2RGB)
    picture[~known] = NO_VALUE
    return picture


def _viridis(values: NDArray[np.floating[Any]], low: float, high: float) -> Picture:
    """Return values from violet, ``low``, to yellow, ``high``."""
    picture = map_colors()[step_of(values, low, high, 256)]
    picture[np.isnan(values)] = NO_VALUE
    return picture


def _grey(confidence: NDArray[np.floating[Any]]) -> Picture:
    """Return a confidence from black to white, which are its 1st and 99th percentile."""
    known = ~np.isnan(confidence)
    picture = np.zeros(confidence.shape, np.uint8)
    low, high = spread(confidence[known])
    share = (np.clip(confidence[known], low, high) - low) / (high - low) if high > low else np.ones(known.sum())
    picture[known] = np.rint(share * 255).astype(np.uint8)
    return picture


def _over_image(view: View, picture: Picture, nothing: NDArray[np.bool_]) -> Picture:
    """Return the picture over the image of the view; pixels of ``nothing`` show the image alone."""
    if view.image is None or view.opacity >= 1:
        return picture
    mixed = np.rint(view.opacity * picture + (1 - view.opacity) * view.image).astype(np.uint8)
    return np.where(nothing[..., None], view.image, mixed)


def _is_depth(view: View) -> bool:
    """Return whether the values are inverse depths of a known range, as ``View.of_depth`` makes them."""
    return view.unit == "m" and 0 < view.scale[0] <= view.scale[1]


def _with_scales(picture: Picture, view: View) -> Picture:
    """Return the picture of a map above a scale of its depths, if it has any, beside its bounds above their scale."""
    bound, (height, width) = view.bound, picture.shape[:2]
    total = width if bound is None else 2 * width + _MARGIN
    sheet = np.full((height + 3 * _LINE, total, 3), 255, np.uint8)
    sheet[:height, :width] = picture
    if _is_depth(view):
        ramp = np.linspace(*view.scale, width, dtype=np.float32)[None]
        ends = [1 / (view.scale[0] + share * (view.scale[1] - view.scale[0])) for share in (0.0, 0.5, 1.0)]
        _draw_scale(sheet, (0, height, width), _turbo(ramp, *view.scale), "depth, m", ends, view.unit)
    if bound is not None:
        low, high = bound_range(bound)
        sheet[:height, width + _MARGIN :] = draw(view, "bound", (low, high))
        bar = np.geomspace(low, high, width)[None]
        ends = [low ** (1 - share) * high**share for share in (0.0, 0.5, 1.0)]
        colors, place = draw(View(bar, bound=bar), "bound", (low, high)), (width + _MARGIN, height, width)
        _draw_scale(sheet, place, colors, f"bound, {view.unit}", ends, view.unit)
    return sheet


def _draw_scale(
    sheet: Picture, place: tuple[int, int, int], colors: Picture, title: str, ends: Sequence[float], unit: str
) -> None:
    """Draw a title, a bar of colors, and numbers at its left end, middle and right end; ``place`` is x, y, width."""
    x, y, width = place
    sheet[y + _LINE + 2 : y + 2 * _LINE - 6, x : x + width] = colors
    draw_text(sheet, title, (x, y + _LINE // 2), _INK, max_width=width)
    for share in (0.0, 0.5, 1.0) if width > 5 * _LINE else (1.0,):
        number = f"{ends[round(2 * share)]:.2g}" + f" {unit}" * (share == 1)
        free = width - cv2.getTextSize(number, *_FONT, 1)[0][0]
        draw_text(sheet, number, (round(x + share * free), y + 2 * _LINE + 6), _INK)


def draw_legend(entries: Iterable[tuple[str, Sequence[int]]]) -> Picture:
    """Return a picture with a swatch of each color next to its words."""
    rows = [*entries]
    width = max((cv2.getTextSize(words, *_FONT, 1)[0][0] for words, _ in rows), default=0)
    sheet = np.full((_LINE * len(rows) + 2 * _MARGIN, width + 3 * _MARGIN + _LINE, 3), 255, np.uint8)
    for k, (words, color) in enumerate(rows):
        top = _MARGIN + k * _LINE
        draw_swatch(sheet, words, (_MARGIN, top), color)
    return sheet


def draw_swatch(sheet: Picture, words: str, place: tuple[int, int], color: Sequence[int]) -> None:
    """Draw a line of a legend, a swatch and its words, with the upper left corner at x, y."""
    x, y = place
    cv2.rectangle(sheet, (x, y + 4), (x + 18, y + _LINE - 4), [*color], -1)
    cv2.rectangle(sheet, (x, y + 4), (x + 18, y + _LINE - 4), _INK)
    draw_text(sheet, words, (x + 26, y + _LINE // 2), _INK)


@cache
def map_colors() -> NDArray[np.uint8]:
    """Return (256, 3) RGB of viridis, for maps of the page and for bounds; readable without color vision."""
    grey = np.arange(256, dtype=np.uint8)[:, None]
    table: NDArray[Any] = cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    return np.ascontiguousarray(table, np.uint8)


@cache
def error_scales() -> NDArray[np.uint8]:
    """Return (6, 64, 3) RGB by kind of pixel and size of the error, as the page's script indexes them, too."""
    share = np.linspace(0, 1, _N_SHADES)[:, None]
    ends = [[np.array([int(end[k : k + 2], 16) for k in (1, 3, 5)]) for end in ends] for _, *ends in KIND_COLORS]
    return np.stack([np.rint(first + share * (last - first)) for first, last in ends]).astype(np.uint8)


def kind_colors() -> NDArray[np.uint8]:
    """Return (6, 3) RGB of the kinds of pixel in pictures that do not show how large an error is."""
    return error_scales()[:, _SHADE]


def step_of(values: NDArray[np.floating[Any]], low: float, high: float, steps: int) -> NDArray[np.intp]:
    """Return the index of numbers, NaN the lowest, among equal steps over [low, high]."""
    known = np.clip(np.nan_to_num(values.astype(np.float64), nan=low), low, max(high, low))
    index: NDArray[np.intp] = np.clip(((known - low) / max(high - low, 1e-9) * steps).astype(np.intp), 0, steps - 1)
    return index


def draw_text(
    picture: Picture,
    text: str,
    place: tuple[int, int],
    ink: tuple[int, int, int],
    centered: bool = False,
    max_width: int | None = None,
) -> None:
    """Draw a line of text into an (H, W, 3) picture; characters beyond ASCII become question marks.

    ``place`` is x of its left end, or of its middle if ``centered``, and y of its middle line. A text of more than
    ``max_width`` pixels is cut and ends with three dots.
    """
    shown = text.encode("ascii", "replace").decode()
    (width, height), _ = cv2.getTextSize(shown, *_FONT, 1)
    while max_width is not None and len(shown) > 4 and width > max_width:
        shown = shown[:-4] + "..."
        (width, height), _ = cv2.getTextSize(shown, *_FONT, 1)
    x = place[0] - width // 2 if centered else place[0]
    cv2.putText(picture, shown, (x, place[1] + height // 2), *_FONT, ink, 1, cv2.LINE_AA)

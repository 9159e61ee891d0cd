"""The picture of two volumes and of maps on their grid: three slices in radiological orientation, with a scale."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.text import side_and_distance
from depthcli.core.volumes import ENDS, PLANES, Grid
from depthcli.show.view import Picture, View, draw, draw_text

_MAX_SHOWN_ERROR = 10.0  # mm; this and more is dark red
_SIDE, _MARGIN, _LINE = 300, 24, 22  # pixels: longest side of a slice, space around it for letters, line of text
_SCALE_WIDTH = 90  # pixels, of the scale with its numbers
Values = Callable[[Sequence[int], Sequence[int]], NDArray[np.float32]]
"""Function of a shape and a corner, in voxels, that returns the values of a map there, mm."""
_Style = tuple[int, tuple[int, int, int]]  # grey level of the paper, color of letters
_DARK: _Style = (24, (225, 225, 225))
_LIGHT: _Style = (255, (30, 30, 30))


def draw_volumes(
    volumes: Mapping[str, NDArray[Any]],
    grid: Grid,
    blocks: Sequence[int],
    maps: Mapping[str, Values],
    inside: NDArray[np.bool_] | Callable[[Picture], NDArray[np.bool_]],
    neurological: bool,
    light: bool = False,
    at: Sequence[int] | None = None,
) -> Picture:
    """Return (H, W, 3) RGB, at least 900 wide: a row for one slice across each axis of the body.

    The columns are the volumes, and the maps over the first one. Lengths are to scale. Anterior and superior are up;
    the patient's right is on the left or, in neurological pictures, on the right.

    Parameters
    ----------
    volumes : title -> (Z, Y, X) as stored; all have the grey levels of the first
    grid : the fixed volume's grid
    blocks : number of voxels (z, y, x) of the grid whose mean is a voxel of the volumes
    maps : title -> its values
    inside : voxels where maps are shown, or a function that selects them in the grey levels of a slice
    light : whether the background is white, for print
    at : voxel (z, y, x) of the volumes where the slices meet; None: the middle
    """
    style = paper, _ = _LIGHT if light else _DARK
    fixed = next(iter(volumes.values()))
    low, high = (float(v) for v in np.percentile(fixed[:: max(1, len(fixed) // 16)], [1, 99]))
    order, flipped = grid.anatomical_axes()
    shape = [fixed.shape[axis] for axis in order]
    lengths = [shape[k] * grid.spacing[2 - axis] * blocks[axis] for k, axis in enumerate(order)]  # mm
    rows = []
    for axis, plane in enumerate(PLANES):
        across = [k for k in range(3) if k != axis]
        if min(shape[k] for k in across) == 1:
            continue  # of a single slice
        stored, turned = _slice_number(shape[axis], axis in flipped, None if at is None else at[order[axis]])
        pictures = _slice_pictures(volumes, grid, maps, inside, (low, high), axis, stored)
        longest = max(lengths[k] for k in across)
        height, width = (max(1, round(_SIDE * lengths[k] / longest)) for k in across)
        pictures = [np.asarray(cv2.resize(picture, (width, height)), np.uint8) for picture in pictures]
        ends = "".join(ENDS[k] for k in across)  # top, bottom, left, right
        if neurological and axis < 2:
            pictures = [picture[:, ::-1] for picture in pictures]
            ends = ends[:2] + ends[:1:-1]
        first, step = grid.slice_positions(axis)
        place = side_and_distance(ENDS[axis], first + step * ((turned + 0.5) * blocks[order[axis]] - 0.5))
        titles = (f"{plane}, {place}", *[""] * (len(pictures) - 1))
        framed = [_framed(picture, ends, title, style) for picture, title in zip(pictures, titles, strict=True)]
        rows.append(np.concatenate(framed, axis=1))
    sheet = np.concatenate([_heading((*volumes, *maps), style), *rows])
    short = _LINE + 6 + 2 * _MARGIN + _SIDE - len(sheet)  # of wide slices, beside the scale
    sheet = np.pad(sheet, ((0, max(short, 0)), (0, 0), (0, 0)), constant_values=paper)
    return np.concatenate([sheet, _scale(len(sheet), style)], axis=1)


def _slice_number(count: int, is_flipped: bool, at: int | None) -> tuple[int, int]:
    """Return the number of one of ``count`` slices as stored, and in the turned volume; ``at`` None: the middle one."""
    if at is None:
        turned = count // 2
        return count - 1 - turned if is_flipped else turned, turned
    stored = min(max(int(at), 0), count - 1)
    return stored, count - 1 - stored if is_flipped else stored


def _slice_pictures(
    volumes: Mapping[str, NDArray[Any]],
    grid: Grid,
    maps: Mapping[str, Values],
    inside: NDArray[np.bool_] | Callable[[Picture], NDArray[np.bool_]],
    levels: tuple[float, float],
    axis: int,
    stored: int,
) -> list[Picture]:
    """Return the pictures of a slice across an axis of the body: the volumes, and the maps over the first one.

    ``levels`` are black and white; ``stored`` is the number of the slice as stored.
    """
    stored_axis, (low, high) = grid.anatomical_axes()[0][axis], levels
    scaling = 255 / max(high - low, 1e-6)
    cuts = [grid.turned(np.take(volume, [stored], stored_axis)).squeeze(axis) for volume in volumes.values()]
    greys = [((np.clip(cut, low, high) - low) * scaling).astype(np.uint8) for cut in cuts]
    if callable(inside):
        seen = inside(greys[0])
    else:
        seen = grid.turned(np.take(inside, [stored], stored_axis)).squeeze(axis)
    pictures = [np.repeat(grey[..., None], 3, axis=2) for grey in greys]
    corner, size = [0, 0, 0], list(next(iter(volumes.values())).shape)
    corner[stored_axis], size[stored_axis] = stored, 1
    beneath = pictures[0]
    for values in maps.values():
        view = View(grid.turned(values(size, corner)).squeeze(axis), "mm", (0.0, _MAX_SHOWN_ERROR))
        colored = (0.5 * beneath + 0.5 * draw(view, "preview")).astype(np.uint8)
        pictures.append(np.where(seen[..., None], colored, beneath))
    return pictures


def _heading(titles: Sequence[str], style: _Style) -> Picture:
    """Return the line above the slices, with the titles of the columns."""
    paper, ink = style
    side = _SIDE + 2 * _MARGIN
    heading = np.full((_LINE + 6, len(titles) * side, 3), paper, np.uint8)
    for k, title in enumerate(titles):
        draw_text(heading, title, (k * side + side // 2, _LINE // 2 + 4), ink, centered=True)
    return heading


def _framed(picture: Picture, ends: str, title: str, style: _Style) -> Picture:
    """Return the picture with the letters of its sides around it and a title below, all of one width."""
    paper, ink = style
    height, width = picture.shape[:2]
    frame = np.full((height + 2 * _MARGIN + _LINE, _SIDE + 2 * _MARGIN, 3), paper, np.uint8)
    left, middle = (frame.shape[1] - width) // 2, frame.shape[1] // 2
    frame[_MARGIN : _MARGIN + height, left : left + width] = picture
    half = _MARGIN // 2
    level = _MARGIN + height // 2
    places = ((middle, half), (middle, _MARGIN + height + half), (left - half, level), (left + width + half, level))
    for letter, place in zip(ends, places, strict=True):
        draw_text(frame, letter, place, ink, centered=True)
    draw_text(frame, title, (_MARGIN, len(frame) - _LINE // 2), ink)
    return frame


def _scale(height: int, style: _Style) -> Picture:
    """Return the colors of the maps with their numbers."""
    paper, ink = style
    scale = np.full((height, _SCALE_WIDTH, 3), paper, np.uint8)
    top, length = _LINE + 6 + _MARGIN, _SIDE
    ramp = np.linspace(255, 0, length).astype(np.uint8)[:, None]
    scale[top : top + length, 8:24] = draw(View(ramp.astype(np.float32), scale=(0.0, 255.0)), "preview")
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        number = f"{share * _MAX_SHOWN_ERROR:g}" + ("+ mm" if share == 1 else "")
        draw_text(scale, number, (30, top + round((1 - share) * length)), ink)
    return scale

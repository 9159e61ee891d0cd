"""The picture of a registration's confidence: three slices as radiologists hang them, with a scale in millimeters."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.body import body
from depthcli.core.text import side_and_distance
from depthcli.core.volumes import ENDS, PLANES
from depthcli.io.formats.pictures import draw_text, preview
from depthcli.io.volume_pairs import LoadedPair
from depthcli.methods.registration.pipeline import RegistrationResult, at_voxels

_MAX_SHOWN_ERROR = 10.0  # mm; this and more is dark red
_SIDE, _MARGIN, _LINE = 300, 24, 22  # pixels: longest side of a slice, space around it for letters, line of text
_SCALE_WIDTH = 90  # pixels, of the scale with its numbers
_PAPER, _INK = 24, (225, 225, 225)


def registration_preview(
    result: RegistrationResult, loaded: LoadedPair, neurological: bool, bound: NDArray[np.float32] | None = None
) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB, at least 900 wide: a row for the middle slice across each axis of the body.

    Columns: the fixed volume, the registered one, and the expected error and any ``bound``, on the grid of the result,
    over the fixed one where there is tissue and the mask is set. Sides are true in mm; anterior and superior are up;
    the patient's right is on the left, or, in neurological pictures, on the right.
    """
    grid, pair = loaded.grid, loaded.pair
    low, high = (float(v) for v in np.percentile(pair.fixed[:: max(1, pair.shape[0] // 16)], [1, 99]))
    scaling = 255 / max(high - low, 1e-6)
    order, flipped = grid.anatomical_axes()
    blocks = [loaded.blocks[axis] for axis in order]
    shape = [pair.shape[axis] for axis in order]
    lengths = [shape[k] * grid.spacing[2 - axis] * blocks[k] for k, axis in enumerate(order)]  # mm
    maps = {"expected error": result.expected_error, **({} if bound is None else {"bound of the error": bound})}
    rows = []
    for axis, plane in enumerate(PLANES):
        across = [k for k in range(3) if k != axis]
        if min(shape[k] for k in across) == 1:
            continue  # of a single slice
        middle = shape[axis] // 2
        stored = shape[axis] - 1 - middle if axis in flipped else middle
        cuts = [np.take(volume, [stored], order[axis]) for volume in (pair.fixed, pair.warped)]
        fixed, warped = (
            ((np.clip(grid.turned(cut).squeeze(axis), low, high) - low) * scaling).astype(np.uint8) for cut in cuts
        )
        corner, size = [0, 0, 0], list(pair.shape)
        corner[order[axis]], size[order[axis]] = stored, 1
        if pair.mask is None:
            seen = body(fixed)
        else:
            seen = grid.turned(np.take(pair.mask, [stored], order[axis])).squeeze(axis)
        plain = [np.repeat(cut[..., None], 3, axis=2) for cut in (fixed, warped)]
        over = []
        for values in maps.values():
            error = grid.turned(at_voxels(values, result.start, result.step, size, corner)).squeeze(axis)
            colored = (0.5 * plain[0] + 0.5 * preview(error, _MAX_SHOWN_ERROR)).astype(np.uint8)
            over.append(np.where(seen[..., None], colored, plain[0]))
        longest = max(lengths[k] for k in across)
        height, width = (max(1, round(_SIDE * lengths[k] / longest)) for k in across)
        pictures = [np.asarray(cv2.resize(p, (width, height)), np.uint8) for p in (*plain, *over)]
        ends = "".join(ENDS[k] for k in across)  # top, bottom, left, right
        if neurological and axis < 2:
            pictures = [picture[:, ::-1] for picture in pictures]
            ends = ends[:2] + ends[:1:-1]
        first, step = grid.slice_positions(axis)
        place = side_and_distance(ENDS[axis], first + step * ((middle + 0.5) * blocks[axis] - 0.5))
        titles = (f"{plane}, {place}", *[""] * (len(pictures) - 1))
        framed = [_framed(picture, ends, title) for picture, title in zip(pictures, titles, strict=True)]
        rows.append(np.concatenate(framed, axis=1))
    side = _SIDE + 2 * _MARGIN
    heading = np.full((_LINE + 6, (2 + len(maps)) * side, 3), _PAPER, np.uint8)
    for k, title in enumerate(("fixed", "moving, registered", *maps)):
        draw_text(heading, title, (k * side + side // 2, _LINE // 2 + 4), _INK, centered=True)
    sheet = np.concatenate([heading, *rows])
    return np.concatenate([sheet, _scale(len(sheet))], axis=1)


def _framed(picture: NDArray[np.uint8], ends: str, title: str) -> NDArray[np.uint8]:
    """Return the picture with the letters of its sides around it and a title below, all of one width."""
    height, width = picture.shape[:2]
    frame = np.full((height + 2 * _MARGIN + _LINE, _SIDE + 2 * _MARGIN, 3), _PAPER, np.uint8)
    left, middle = (frame.shape[1] - width) // 2, frame.shape[1] // 2
    frame[_MARGIN : _MARGIN + height, left : left + width] = picture
    half = _MARGIN // 2
    beside = _MARGIN + height // 2
    places = ((middle, half), (middle, _MARGIN + height + half), (left - half, beside), (left + width + half, beside))
    for letter, place in zip(ends, places, strict=True):
        draw_text(frame, letter, place, _INK, centered=True)
    draw_text(frame, title, (_MARGIN, len(frame) - _LINE // 2), _INK)
    return frame


def _scale(height: int) -> NDArray[np.uint8]:
    """Return the colors of errors and bounds with their numbers."""
    scale = np.full((height, _SCALE_WIDTH, 3), _PAPER, np.uint8)
    top, length = _LINE + 6 + _MARGIN, _SIDE
    ramp = np.linspace(255, 0, length).astype(np.uint8)[:, None]
    scale[top : top + length, 8:24] = cv2.applyColorMap(ramp, cv2.COLORMAP_TURBO)[..., ::-1]
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        number = f"{share * _MAX_SHOWN_ERROR:g}" + ("+ mm" if share == 1 else "")
        draw_text(scale, number, (30, top + round((1 - share) * length)), _INK)
    return scale

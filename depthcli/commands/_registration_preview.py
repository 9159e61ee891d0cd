"""The picture of a registration's confidence: three slices as radiologists hang them, with a scale in millimeters."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.resampling import resample
from depthcli.core.volumes import ENDS, PLANES
from depthcli.data.scenes.volume_pair import LoadedPair
from depthcli.methods.registration.pipeline import RegistrationResult

_TITLES = ("fixed", "moving, registered", "expected error")
_MAX_SHOWN_ERROR = 10.0  # mm; this and more is dark red
_AIR_LEVEL = 0.1  # of the range of intensities: darker voxels around the body are not colored
_SIDE, _MARGIN, _LINE = 300, 24, 22  # pixels: longest side of a slice, space around it for letters, line of text
_SCALE_WIDTH = 90  # pixels, of the scale with its numbers
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
_PAPER, _INK = 24, (225, 225, 225)


def registration_preview(result: RegistrationResult, loaded: LoadedPair, neurological: bool) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB, at least 900 wide: a row for the middle slice across each axis of the body.

    Columns: the fixed volume, the registered one, and the expected error over the fixed one where there is tissue and
    the mask is set. Sides are true in mm; anterior and superior are up.

    Parameters
    ----------
    neurological : the patient's right is on the right, else on the left
    """
    grid, pair = loaded.grid, loaded.pair
    back = [1 / step for step in result.step]
    first = [-start / step for start, step in zip(result.start, result.step, strict=True)]
    error = grid.turned(resample(result.expected_error, pair.shape, back, first))
    low, high = (float(v) for v in np.percentile(pair.fixed[:: max(1, pair.shape[0] // 16)], [1, 99]))
    grey = [
        ((np.clip(grid.turned(v), low, high) - low) * (255 / max(high - low, 1e-6))).astype(np.uint8)
        for v in (pair.fixed, pair.warped)
    ]
    inside = None if pair.mask is None else grid.turned(pair.mask)
    spacing = [s * n for s, n in zip(grid.turned_spacing(), _turned(loaded.blocks, loaded), strict=True)]
    rows = []
    for axis, plane in enumerate(PLANES):
        across = [k for k in range(3) if k != axis]
        if min(error.shape[k] for k in across) == 1:
            continue  # of a single slice
        middle = error.shape[axis] // 2
        cut = tuple(middle if k == axis else slice(None) for k in range(3))
        millimeters = [error.shape[k] * spacing[k] for k in across]
        height, width = (max(1, round(_SIDE * side / max(millimeters))) for side in millimeters)
        seen = _body(grey[0][cut]) if inside is None else inside[cut]
        color = cv2.applyColorMap(_codes(error[cut]), cv2.COLORMAP_TURBO)[..., ::-1]
        plain = [np.repeat(volume[cut][..., None], 3, axis=2) for volume in grey]
        over = np.where(seen[..., None], 0.5 * plain[0] + 0.5 * color, plain[0]).astype(np.uint8)
        pictures = [np.asarray(cv2.resize(p, (width, height)), np.uint8) for p in (*plain, over)]
        ends = "".join(ENDS[k] for k in across)  # top, bottom, left, right
        if neurological and axis < 2:
            pictures = [picture[:, ::-1] for picture in pictures]
            ends = ends[:2] + ends[:1:-1]
        place = (middle + 0.5) * _turned(loaded.blocks, loaded)[axis] - 0.5
        origin, step = grid.slice_positions(axis)
        title = f"{plane}, {side_and_distance(axis, origin + step * place)}"
        rows.append(np.concatenate([_framed(p, ends, title if not k else "") for k, p in enumerate(pictures)], axis=1))
    sheet = np.concatenate([_heading(), *rows])
    return np.concatenate([sheet, _scale(len(sheet))], axis=1)


def side_and_distance(axis: int, millimeters: float) -> str:
    """Return a place along an axis of a turned volume as the side of the origin and the distance from it."""
    return f"{ENDS[axis][millimeters < 0]} {abs(millimeters):.0f} mm"


def _turned(blocks: tuple[int, int, int], loaded: LoadedPair) -> list[int]:
    return [blocks[axis] for axis in loaded.grid.anatomical_axes()[0]]


def _codes(error: NDArray[np.float32]) -> NDArray[np.uint8]:
    codes: NDArray[np.uint8] = np.clip(error / _MAX_SHOWN_ERROR * 255, 0, 255).astype(np.uint8)
    return codes


def _body(grey: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return where a slice shows tissue, or air that tissue encloses."""
    tissue: NDArray[Any] = (grey > _AIR_LEVEL * 255).astype(np.uint8)
    tissue = cv2.morphologyEx(cv2.morphologyEx(tissue, cv2.MORPH_OPEN, _CROSS), cv2.MORPH_CLOSE, _CROSS, iterations=2)
    outlines, _ = cv2.findContours(np.asarray(tissue, np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = cv2.drawContours(np.zeros(grey.shape, np.uint8), outlines, -1, 1, cv2.FILLED)
    return np.asarray(filled > 0, np.bool_)


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
        _write(frame, letter, place, centered=True)
    _write(frame, title, (_MARGIN, len(frame) - _LINE // 2))
    return frame


def _heading() -> NDArray[np.uint8]:
    side = _SIDE + 2 * _MARGIN
    heading = np.full((_LINE + 6, 3 * side, 3), _PAPER, np.uint8)
    for k, title in enumerate(_TITLES):
        _write(heading, title, (k * side + side // 2, _LINE // 2 + 4), centered=True)
    return heading


def _scale(height: int) -> NDArray[np.uint8]:
    """Return the colors of expected errors with their numbers."""
    scale = np.full((height, _SCALE_WIDTH, 3), _PAPER, np.uint8)
    top, length = _LINE + 6 + _MARGIN, _SIDE
    ramp = np.linspace(255, 0, length).astype(np.uint8)[:, None]
    scale[top : top + length, 8:24] = cv2.applyColorMap(ramp, cv2.COLORMAP_TURBO)[..., ::-1]
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        number = f"{share * _MAX_SHOWN_ERROR:g}" + ("+ mm" if share == 1 else "")
        _write(scale, number, (30, top + round((1 - share) * length)))
    return scale


def _write(picture: NDArray[np.uint8], text: str, place: tuple[int, int], centered: bool = False) -> None:
    """Draw a text whose middle line is at ``place`` = x, y."""
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)
    x = place[0] - width // 2 if centered else place[0]
    cv2.putText(picture, text, (x, place[1] + height // 2), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _INK, 1, cv2.LINE_AA)

"""Registration confidence as files, on the fixed volume's grid."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.resampling import resample, trilinear
from depthcli.batch.json_csv import Row, to_csv
from depthcli.data.formats.files import write_text
from depthcli.data.formats.images import write_png
from depthcli.data.formats.volumes import write_volume
from depthcli.data.scenes.volume_pair import LoadedPair
from depthcli.methods.registration.pipeline import RegistrationResult

_MAX_SHOWN_ERROR = 10.0  # mm; this and more is dark red in the preview
_SLICE_SIDE = 240  # pixels of the longest side of a slice, about
_POINTS = {"x": 4, "y": 4, "z": 4, "confidence": 5, "expected_error": 4, "shift_x": 4, "shift_y": 4, "shift_z": 4}
"""Columns of the table of landmarks, and their decimals."""


def save_registration(
    result: RegistrationResult, loaded: LoadedPair, points: NDArray[np.float64] | None, folder: Path, suffix: str
) -> None:
    """Write confidence, expected error and shift as volumes, the landmarks as a table, and a preview.

    Parameters
    ----------
    points : (N, 3) landmarks of the fixed volume, x, y, z in mm, or None
    suffix : file suffix of the volumes
    """
    grid = loaded.grid
    starts, steps = loaded.on_grid(result.start, result.step)
    back = [1 / step for step in steps]
    first_place = [-start / step for start, step in zip(starts, steps, strict=True)]

    def slab(values: NDArray[np.float32], first: int, last: int) -> NDArray[np.float32]:
        start = (first_place[0] + first * back[0], first_place[1], first_place[2])
        return resample(values, (last - first, grid.shape[1], grid.shape[2]), back, start)

    def vectors(first: int, last: int) -> NDArray[np.float32]:
        along_axes = np.stack([slab(result.shift[axis], first, last) for axis in (2, 1, 0)], axis=-1)
        return np.asarray(along_axes @ grid.axes.T, np.float32)

    write_volume(folder / f"confidence{suffix}", grid, lambda a, b: slab(result.certainty, a, b))
    write_volume(folder / f"expected_error{suffix}", grid, lambda a, b: slab(result.expected_error, a, b))
    write_volume(folder / f"shift{suffix}", grid, vectors, vector=True)
    write_png(folder / "preview.png", _preview(result, loaded))
    if points is not None:
        write_text(folder / "points.csv", to_csv(_rows(result, loaded, points)))


def _rows(result: RegistrationResult, loaded: LoadedPair, points: NDArray[np.float64]) -> list[Row]:
    starts, steps = loaded.on_grid(result.start, result.step)
    places = (loaded.grid.to_index(points) - np.array(starts)) / np.array(steps)
    shift = np.stack([trilinear(result.shift[axis], places) for axis in (2, 1, 0)], axis=-1) @ loaded.grid.axes.T
    measured = (trilinear(values, places) for values in (result.certainty, result.expected_error))
    table = np.column_stack([points, *measured, shift])
    return [{name: round(float(v), n) for (name, n), v in zip(_POINTS.items(), row, strict=True)} for row in table]


def _preview(result: RegistrationResult, loaded: LoadedPair) -> NDArray[np.uint8]:
    # Three orthogonal slices through the middle, one a row: fixed, warped, expected error over fixed.
    shape = result.expected_error.shape
    finer = max(1, round(_SLICE_SIDE / max(shape)))
    low, high = (float(v) for v in np.percentile(loaded.pair.fixed[:: max(1, shape[0] // 16)], [1, 99]))
    rows = []
    for axis in range(3):
        if axis == 0 or shape[0] > 1:
            middle = shape[axis] // 2
            at = round(result.start[axis] + result.step[axis] * middle)
            volumes = (loaded.pair.fixed, loaded.pair.warped)
            cuts = [_enlarged(v, axis, at, result.step, result.start, shape, finer) for v in volumes]
            grey = [np.clip((c - low) / max(high - low, 1e-6) * 255, 0, 255).astype(np.uint8) for c in cuts]
            plain = [np.repeat(g[..., None], 3, axis=2) for g in grey]
            error = _enlarged(result.expected_error, axis, middle, (1, 1, 1), (0, 0, 0), shape, finer)
            code = np.clip(error / _MAX_SHOWN_ERROR * 255, 0, 255).astype(np.uint8)
            color = cv2.applyColorMap(code, cv2.COLORMAP_TURBO)[..., ::-1].reshape(plain[0].shape)
            over = (0.5 * plain[0] + 0.5 * color).astype(np.uint8)
            rows.append(np.concatenate([*plain, over], axis=1))
    width = max(row.shape[1] for row in rows)
    return np.concatenate([np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0))) for row in rows], axis=0)


def _enlarged(
    volume: NDArray[np.float32], axis: int, at: int, step: Sequence[float], start: Sequence[float],
    shape: tuple[int, ...], finer: int,
) -> NDArray[np.float32]:  # fmt: skip
    # Slice ``at`` of a volume at the places ``start + step * i`` along the other axes, ``finer`` times as many.
    cut = np.take(volume, [min(at, volume.shape[axis] - 1)], axis=axis)
    others = [a != axis for a in range(3)]
    sizes = [finer * n if other else 1 for n, other in zip(shape, others, strict=True)]
    steps = [s / finer for s in step]
    starts = [a - s * (finer - 1) / (2 * finer) for a, s in zip(start, step, strict=True)]
    whole = (sizes[0], sizes[1], sizes[2])
    return resample(cut, whole, steps, starts).reshape([n for n, other in zip(sizes, others, strict=True) if other])

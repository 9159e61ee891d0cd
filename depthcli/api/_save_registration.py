"""Registration confidence as files, on the fixed volume's grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.resampling import resample, trilinear
from depthcli.api._registration_preview import registration_preview
from depthcli.batch.json_csv import Row, to_csv
from depthcli.data.formats.files import write_text
from depthcli.data.formats.images import write_png
from depthcli.data.formats.volumes import write_volume
from depthcli.data.scenes.volume_pair import LoadedPair
from depthcli.methods.registration.pipeline import RegistrationResult

_POINTS = {"x": 4, "y": 4, "z": 4, "confidence": 5, "expected_error": 4, "shift_x": 4, "shift_y": 4, "shift_z": 4}
"""Columns of the table of landmarks, and their decimals."""


def save_registration(
    result: RegistrationResult,
    loaded: LoadedPair,
    points: NDArray[np.float64] | None,
    folder: Path,
    suffix: str,
    neurological: bool = False,
) -> None:
    """Write confidence, expected error and shift as volumes, the landmarks as a table, and a preview.

    Parameters
    ----------
    points : (N, 3) landmarks of the fixed volume, x, y, z in mm, or None
    suffix : file suffix of the volumes
    neurological : the preview has the patient's right on the right
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
    write_png(folder / "preview.png", registration_preview(result, loaded, neurological))
    if points is not None:
        write_text(folder / "points.csv", to_csv(_rows(result, loaded, points)))


def _rows(result: RegistrationResult, loaded: LoadedPair, points: NDArray[np.float64]) -> list[Row]:
    starts, steps = loaded.on_grid(result.start, result.step)
    places = (loaded.grid.to_index(points) - np.array(starts)) / np.array(steps)
    shift = np.stack([trilinear(result.shift[axis], places) for axis in (2, 1, 0)], axis=-1) @ loaded.grid.axes.T
    measured = (trilinear(values, places) for values in (result.certainty, result.expected_error))
    table = np.column_stack([points, *measured, shift])
    return [{name: round(float(v), n) for (name, n), v in zip(_POINTS.items(), row, strict=True)} for row in table]

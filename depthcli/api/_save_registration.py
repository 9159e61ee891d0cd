"""Registration confidence as files, on the fixed volume's grid."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.resampling import resample, trilinear
from depthcli.api._registration_preview import registration_preview
from depthcli.core.errors import InputError
from depthcli.io.formats.files import write_text
from depthcli.io.formats.images import write_png
from depthcli.io.formats.volumes import Slab, write_volume
from depthcli.io.registered_volumes import LoadedPair
from depthcli.methods.registration.pipeline import RegistrationResult
from depthcli.run.json_csv import Row, to_csv

_POINTS = {"x": 4, "y": 4, "z": 4, "confidence": 5, "expected_error": 4}
"""Columns of the table of landmarks, and their decimals."""
_SHIFT_POINTS = {"shift_x": 4, "shift_y": 4, "shift_z": 4}
"""Those behind them of pipelines that look for matches."""


def save_registration(
    result: RegistrationResult,
    loaded: LoadedPair,
    points: NDArray[np.float64] | None,
    folder: Path,
    suffix: str,
    neurological: bool = False,
) -> None:
    """Write confidence, expected error and, if known, shift as volumes, the landmarks as a table, and a preview.

    Parameters
    ----------
    points : (N, 3) landmarks of the fixed volume, x, y, z in mm, or None
    suffix : file suffix of the volumes
    neurological : the preview has the patient's right on the right
    """
    grid = loaded.grid

    def slabs(values: NDArray[np.float32]) -> Slab:
        return lambda first, last: on_fixed_grid(result, loaded, values, first, last)

    write_volume(folder / f"confidence{suffix}", grid, slabs(result.certainty))
    write_volume(folder / f"expected_error{suffix}", grid, slabs(result.expected_error))
    if result.shift is not None:
        write_volume(folder / f"shift{suffix}", grid, partial(shift_on_fixed_grid, result, loaded), vector=True)
    write_png(folder / "preview.png", registration_preview(result, loaded, neurological))
    if points is not None:
        write_text(folder / "points.csv", to_csv(rows_at(result, loaded, points)))


def on_fixed_grid(
    result: RegistrationResult,
    loaded: LoadedPair,
    values: NDArray[np.float32],
    first: int = 0,
    last: int | None = None,
) -> NDArray[np.float32]:
    """Return slices ``first`` .. ``last`` of a (z, y, x) map of the result on the fixed volume's grid; None: all."""
    shape = loaded.grid.shape
    starts, steps = loaded.on_grid(result.start, result.step)
    back = [1 / step for step in steps]
    place = [-start / step for start, step in zip(starts, steps, strict=True)]
    wanted = ((shape[0] if last is None else last) - first, shape[1], shape[2])
    return resample(values, wanted, back, (place[0] + first * back[0], place[1], place[2]))


def shift_on_fixed_grid(
    result: RegistrationResult, loaded: LoadedPair, first: int = 0, last: int | None = None
) -> NDArray[np.float32]:
    """Return slices of the shift on the fixed volume's grid, (Z, Y, X, 3) x, y, z, mm; InputError without one."""
    if result.shift is None:
        raise InputError("shift: this pipeline searches for no matches, so there is none")
    parts = [on_fixed_grid(result, loaded, result.shift[axis], first, last) for axis in (2, 1, 0)]
    return np.asarray(np.stack(parts, axis=-1) @ loaded.grid.axes.T, np.float32)


def rows_at(result: RegistrationResult, loaded: LoadedPair, points: NDArray[np.float64]) -> list[Row]:
    """Return position, confidence, expected error and, if known, shift at points (N, 3) x, y, z, mm."""
    starts, steps = loaded.on_grid(result.start, result.step)
    places = (loaded.grid.to_index(points) - np.array(starts)) / np.array(steps)
    columns: list[NDArray[np.floating[Any]]] = [
        points,
        *(trilinear(values, places) for values in (result.certainty, result.expected_error)),
    ]
    if result.shift is not None:
        own = np.stack([trilinear(result.shift[axis], places) for axis in (2, 1, 0)], axis=-1)
        columns.append(own @ loaded.grid.axes.T)
    decimals = _POINTS if result.shift is None else _POINTS | _SHIFT_POINTS
    table = np.column_stack(columns)
    return [{name: round(float(v), n) for (name, n), v in zip(decimals.items(), row, strict=True)} for row in table]

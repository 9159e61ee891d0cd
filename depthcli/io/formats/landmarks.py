"""Lists of points: CSV, the point files of elastix and transformix, DIR-Lab's text."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid
from depthcli.io.formats.files import naming, read_bytes
from depthcli.io.formats.volumes import suffix_of

_COLUMNS = re.compile(r"(?:^|_)([xyz])(?:_|$)")


def read_landmarks(path: Path, grid: Grid, raw: bool = False) -> NDArray[np.float64]:
    """Return (N, 3) positions x, y, z in mm, LPS, of a list of points.

    Parameters
    ----------
    grid : of the volume that the points lie in, for files of indices
    raw : the volume is a DIR-Lab raw file: a text of whole numbers counts voxels from 1

    Raises
    ------
    InputError
        No such file, no points, or a line that is none.
    """
    with naming(path):
        lines = [line.strip() for line in read_bytes(path, 1 << 26).decode("latin-1").splitlines() if line.strip()]
        if lines and lines[0].lower() in ("point", "index"):
            points = _numbers(lines[2:], [0, 1, 2], 3)
            return grid.to_point(points[:, ::-1]) if lines[0].lower() == "index" else points
        columns, first = [0, 1, 2], 0
        if lines and not _is_row(lines[0]):
            columns, first = _header(lines[0]), 1
        points = _numbers(lines[first:], columns, first + 1)
        if raw and suffix_of(path) == ".txt":
            return grid.to_point(points[:, ::-1] - 1)
        return points


def _split(line: str) -> list[str]:
    return [part.strip() for part in (line.split(",") if "," in line else line.split())]


def _is_row(line: str) -> bool:
    try:
        [float(part) for part in _split(line)]
    except ValueError:
        return False
    return True


def _header(line: str) -> list[int]:
    """Columns of x, y and z by their names; the first three where none says so."""
    names = [_COLUMNS.search(name.lower()) for name in _split(line)]
    columns = {match[1]: k for k, match in enumerate(names) if match}
    return [columns[axis] for axis in "xyz"] if len(columns) == 3 else [0, 1, 2]


def _numbers(lines: list[str], columns: list[int], first: int) -> NDArray[np.float64]:
    points = []
    for number, line in enumerate(lines, first):
        parts = _split(line)
        try:
            points.append([float(parts[k]) for k in columns])
        except (ValueError, IndexError):
            raise InputError(f"point {number}: want x, y, z (got {line[:60]!r})") from None
    if not points:
        raise InputError("no points")
    array = np.array(points)
    if not np.isfinite(array).all():
        raise InputError("a point that is not finite")
    return array

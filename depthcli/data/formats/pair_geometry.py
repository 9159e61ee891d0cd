"""Geometry of rectified pairs, as data sets store it: Middlebury's calib.txt, KITTI's projections."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import InputError
from depthcli.data.formats.files import naming, read_bytes, write_text

_MILLIMETERS = 1000.0
_MAX_SIDE = 1 << 20  # pixels; no image is as wide
_MAX_BYTES = 1 << 24  # a calibration has a few kilobytes


def read_geometry(path: Path, cameras: tuple[int, int] = (2, 3)) -> PairGeometry:
    """Return how the disparities of a rectified pair become depth.

    Parameters
    ----------
    path : ``calib.txt`` of Middlebury v3 or ETH3D (``cam0``, ``cam1``, ``doffs``, ``baseline`` in mm); or
        KITTI's projections, ``P0:`` to ``P3:`` or ``P_rect_00:`` to ``P_rect_03:``
    cameras : numbers of the left and the right one among those of KITTI; 0, 1 grey, 2, 3 color

    Raises
    ------
    InputError
        Not readable, of no known kind, or a number is missing or wrong; one line that names the file.
    """
    with naming(path):
        fields = _fields(read_bytes(path, _MAX_BYTES).decode("utf-8", "replace"))
        if "cam0" in fields:
            return _middlebury(fields)
        if any(re.fullmatch(r"P(_rect_0)?\d", key) for key in fields):
            return _kitti(fields, cameras)
        raise InputError("no calibration of a rectified pair that is known (Middlebury's cam0=, KITTI's P2:)")


def write_geometry(path: Path, geometry: PairGeometry, max_disparity: int | None = None) -> None:
    """Write ``calib.txt`` as Middlebury v3 has it (baseline in mm, ``ndisp`` the search range).

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    left = geometry.left
    camera = "[{:.12g} 0 {:.12g}; 0 {:.12g} {:.12g}; 0 0 1]"
    lines = {
        "cam0": camera.format(left.fx, left.cx, left.fy, left.cy),
        "cam1": camera.format(left.fx, left.cx + geometry.offset, left.fy, left.cy),
        "doffs": f"{geometry.offset:.12g}",
        "baseline": f"{geometry.baseline * _MILLIMETERS:.12g}",
    }
    if geometry.size is not None:
        lines |= {"width": str(geometry.size[0]), "height": str(geometry.size[1])}
    if max_disparity is not None:
        lines["ndisp"] = str(max_disparity)
    write_text(path, "".join(f"{key}={value}\n" for key, value in lines.items()))


def _fields(text: str) -> dict[str, str]:
    return dict(re.findall(r"^\s*(\w+)\s*[=:]\s*(.*?)\s*$", text, re.MULTILINE))


def _middlebury(fields: dict[str, str]) -> PairGeometry:
    left = _matrix(fields, "cam0", (3, 3))
    if "doffs" in fields:
        offset = _number(fields, "doffs")
    else:
        offset = float(_matrix(fields, "cam1", (3, 3))[0, 2] - left[0, 2])
    baseline = _number(fields, "baseline") / _MILLIMETERS
    size = None
    if "width" in fields and "height" in fields:
        size = _size(_number(fields, "width"), _number(fields, "height"), "width, height")
    return PairGeometry(Intrinsics.of_matrix(left), baseline, offset, size)


def _kitti(fields: dict[str, str], cameras: tuple[int, int]) -> PairGeometry:
    start = "P_rect_0" if any(key.startswith("P_rect_0") for key in fields) else "P"
    left, right = (_matrix(fields, f"{start}{number}", (3, 4)) for number in cameras)
    if abs(left[0, 0]) < 1e-9 or abs(right[0, 0]) < 1e-9:
        raise InputError("a camera without focal length")
    baseline = float(left[0, 3] / left[0, 0] - right[0, 3] / right[0, 0])
    size = None
    if rectified := fields.get(f"S_rect_0{cameras[0]}"):
        width, height = _numbers(rectified, f"S_rect_0{cameras[0]}", 2)
        size = _size(width, height, f"S_rect_0{cameras[0]}")
    return PairGeometry(Intrinsics.of_matrix(left), baseline, float(right[0, 2] - left[0, 2]), size)


def _size(width: float, height: float, key: str) -> tuple[int, int]:
    if not 1 <= min(width, height) <= max(width, height) <= _MAX_SIDE:
        raise InputError(f"{key}: want a size (got {width:g} x {height:g})")
    return int(width), int(height)


def _matrix(fields: dict[str, str], key: str, shape: tuple[int, int]) -> NDArray[np.float64]:
    text = re.sub(r"[\[\];,]", " ", fields.get(key, ""))
    return np.array(_numbers(text, key, shape[0] * shape[1])).reshape(shape)


def _number(fields: dict[str, str], key: str) -> float:
    return _numbers(fields.get(key, ""), key, 1)[0]


def _numbers(text: str, key: str, count: int) -> list[float]:
    words = text.split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(f"{key}: want {count} number{'s' if count > 1 else ''} (got {text[:60]!r})")
    return values

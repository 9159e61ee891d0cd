"""Geometry of rectified pairs, as data sets store it: Middlebury's calib.txt, KITTI's projections."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import InputError
from depthcli.io.formats.files import naming, read_bytes, write_text
from depthcli.io.formats.plain_text import image_sides, key_values, numbers
from depthcli.io.formats.rigs import storage_fields

_MILLIMETERS = 1000.0
_UNKNOWN = "no calibration of a rectified pair that is known (Middlebury's cam0=, KITTI's P2:)"
_MAX_BYTES = 1 << 24  # a calibration has a few kilobytes


def read_geometry(path: Path, cameras: tuple[int, int] = (2, 3)) -> PairGeometry:
    """Return how the disparities of a rectified pair become depth.

    Parameters
    ----------
    path : ``calib.txt`` of Middlebury v3 or ETH3D (``cam0``, ``cam1``, ``doffs``, ``baseline`` in mm); Booster's XML
        (``proj_matL``, ``baselineLR``); or KITTI's projections, ``P0:`` to ``P3:`` or ``P_rect_00:`` to ``P_rect_03:``
        (DrivingStereo: ``P_rect_101:``)
    cameras : numbers of the left and the right one among those of KITTI: 0, 1 grey, 2, 3 color (DrivingStereo: 101,
        103)

    Raises
    ------
    InputError
        Not readable, of no known kind, or a number is missing or wrong; one line that names the file.
    """
    with naming(path):
        text = read_bytes(path, _MAX_BYTES).decode("utf-8", "replace")
        if text.lstrip().startswith("<"):
            return _booster(storage_fields(text))
        fields = key_values(text)
        if "cam0" in fields:
            return _middlebury(fields)
        if any(re.fullmatch(r"P(\d|_rect_\d{2,3})", key) for key in fields):
            return _kitti(fields, cameras)
        raise InputError(_UNKNOWN)


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


def _middlebury(fields: dict[str, str]) -> PairGeometry:
    left = numbers(fields.get("cam0", ""), "cam0", (3, 3))
    if "doffs" in fields:
        offset = float(numbers(fields["doffs"], "doffs", (1,))[0])
    else:
        offset = float(numbers(fields.get("cam1", ""), "cam1", (3, 3))[0, 2] - left[0, 2])
    baseline = float(numbers(fields.get("baseline", ""), "baseline", (1,))[0]) / _MILLIMETERS
    size = None
    if "width" in fields and "height" in fields:
        size = image_sides(f"{fields['width']} {fields['height']}", "width, height")
    return PairGeometry(Intrinsics.of_matrix(left), baseline, offset, size)


def _booster(fields: dict[str, Any]) -> PairGeometry:
    left, right = (_projection(fields, name) for name in ("proj_matL", "proj_matR"))
    baseline = float(numbers(fields.get("baselineLR"), "baselineLR", (1,))[0]) / _MILLIMETERS
    return PairGeometry(Intrinsics.of_matrix(left), baseline, float(right[0, 2] - left[0, 2]))


def _projection(fields: dict[str, Any], name: str) -> NDArray[np.float64]:
    """(3, 3), (3, 4) or (4, 4) projection of a rectified camera."""
    stored = fields.get(name)
    values = numbers(stored.get("data") if isinstance(stored, dict) else None, name)
    if values.size not in (9, 12, 16):
        raise InputError(f"{name}: want a projection of 3 x 4 numbers (got {values.size})")
    return values.reshape(-1, 3 if values.size == 9 else 4)


def _kitti(fields: dict[str, str], cameras: tuple[int, int]) -> PairGeometry:
    names = [f"P_rect_{n:02}" if any(key.startswith("P_rect_") for key in fields) else f"P{n}" for n in cameras]
    left, right = (numbers(fields.get(name, ""), name, (3, 4)) for name in names)
    if abs(left[0, 0]) < 1e-9 or abs(right[0, 0]) < 1e-9:
        raise InputError("a camera without focal length")
    baseline = float(left[0, 3] / left[0, 0] - right[0, 3] / right[0, 0])
    rectified = f"S_rect_{cameras[0]:02}"
    size = image_sides(fields[rectified], rectified) if fields.get(rectified) else None
    return PairGeometry(Intrinsics.of_matrix(left), baseline, float(right[0, 2] - left[0, 2]), size)

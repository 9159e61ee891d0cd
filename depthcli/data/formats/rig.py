"""Calibrations of a color and an infrared camera: JSON of ours, or OpenCV's YAML."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.geometry import Camera
from depthcli.core.cameras.rig import Rig
from depthcli.core.errors import InputError
from depthcli.data.formats.files import read_bytes

Size = tuple[int, int]
_LENSES = (4, 5, 8, 12, 14)  # coefficients that OpenCV's model of a lens may have


def read_rig(path: Path, color_size: Size, infrared_size: Size) -> Rig | float:
    """Read a calibration.

    JSON holds ``color`` and ``infrared``, each with ``K`` (3, 3), and where known ``distortion`` and ``size``, and
    ``R`` (3, 3), ``t`` (3,) in meters, from the color camera's frame to the infrared camera's; or ``rectified: true``
    with ``fb``. YAML is OpenCV's, with ``M1 D1 M2 D2 R T``, camera 1 the color one.

    Parameters
    ----------
    color_size, infrared_size : (width, height) of the images

    Returns
    -------
    The rig, or focal length x baseline (pixel meters) of images that are rectified already

    Raises
    ------
    InputError
        A damaged file, a missing or wrong field, a singular calibration, or one for images of other sizes.
    """
    fields = _yaml(path) if path.suffix.lower() in (".yml", ".yaml") else _json(path)
    if fields.get("rectified") is True:
        fb = fields.get("fb")
        if isinstance(fb, bool) or not isinstance(fb, int | float) or not 0 < fb < 1e9:
            raise InputError(f"{path}: fb: want focal length x baseline, pixel meters (got {fb!r})")
        return float(fb)
    cameras = []
    for name, size in (("color", color_size), ("infrared", infrared_size)):
        camera = fields.get(name)
        if not isinstance(camera, dict):
            raise InputError(f"{path}: {name}: want K, distortion, size (got {str(camera)[:40]!r})")
        said = camera.get("size")
        if said is not None and tuple(said) != size:
            raise InputError(f"{path}: calibrated for a {name} image of {said}, but it is {size[0]} x {size[1]}")
        lens = _numbers(path, camera, "distortion", (-1,)) if camera.get("distortion") is not None else np.zeros(5)
        if lens.size not in _LENSES:
            raise InputError(f"{path}: distortion: want {', '.join(map(str, _LENSES))} coefficients, got {lens.size}")
        cameras.append(Camera(_numbers(path, camera, "K", (3, 3)), tuple(lens.tolist())))
    turn, shift = _numbers(path, fields, "R", (3, 3)), _numbers(path, fields, "t", (3,))
    try:
        return Rig(cameras[0], cameras[1], color_size, infrared_size, turn, shift)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _json(path: Path) -> dict[str, Any]:
    try:
        fields = json.loads(read_bytes(path).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({error})") from error
    if not isinstance(fields, dict):
        raise InputError(f"{path}: want a JSON object, got {type(fields).__name__}")
    return fields


def _yaml(path: Path) -> dict[str, Any]:
    text = read_bytes(path).decode("utf-8", "replace")
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        found = {name: storage.getNode(name).mat() for name in ("M1", "D1", "M2", "D2", "R", "T")}
    except (cv2.error, SystemError) as error:
        raise InputError(f"{path}: not a YAML file of OpenCV") from error
    missing = [name for name, value in found.items() if value is None]
    if missing:
        raise InputError(f"{path}: no {', '.join(missing)}; want M1 D1 M2 D2 R T")
    return {
        "color": {"K": found["M1"], "distortion": found["D1"]},
        "infrared": {"K": found["M2"], "distortion": found["D2"]},
        "R": found["R"],
        "t": found["T"],
    }


def _numbers(path: Path, fields: dict[str, Any], key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    try:
        values = np.asarray(fields[key], np.float64).reshape(shape)
    except (KeyError, ValueError, TypeError):
        raise InputError(f"{path}: {key}: want {shape} numbers (got {str(fields.get(key))[:40]!r})") from None
    if not np.isfinite(values).all():
        raise InputError(f"{path}: {key}: want finite numbers")
    return values

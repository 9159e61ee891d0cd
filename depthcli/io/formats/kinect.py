"""Raw codes of a first-generation Kinect, and the calibration that makes them depth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Camera
from depthcli.core.cameras.kinect import UNKNOWN_CODE, KinectCalibration
from depthcli.core.errors import InputError
from depthcli.io.formats.depth import read_codes
from depthcli.io.formats.disparity import read_plane
from depthcli.io.formats.files import naming, read_bytes
from depthcli.io.formats.plain_text import json_object, numbers

_SHAPES: dict[str, tuple[int, ...]] = {
    "depth_K": (3, 3), "color_K": (3, 3), "depth_kc": (5,), "color_kc": (5,), "depth_to_color_R": (3, 3),
    "depth_to_color_t": (3,), "dc": (2,), "dc_alpha": (2,),
}  # fmt: skip


def read_kinect_raw(path: Path | str) -> NDArray[np.uint16]:
    """Return (H, W) uint16 raw codes 0..2047 of a first-generation Kinect, in either order of bytes."""
    raw = read_codes(path)
    if raw.max() > UNKNOWN_CODE:  # the bytes are the wrong way round
        raw = raw.byteswap()
    if raw.max() > UNKNOWN_CODE:
        raise InputError(f"{path}: codes up to {int(raw.max())}, a Kinect's go to {UNKNOWN_CODE}")
    return raw


def read_kinect_calibration(path: Path) -> KinectCalibration:
    """Return the calibration of Herrera et al.'s toolbox as JSON, with its distortion map ``dc_beta.npy`` beside it.

    Raises
    ------
    InputError
        A file is damaged, or a field is missing or of the wrong shape.
    """
    with naming(path):
        fields = json_object(read_bytes(path))
        arrays = {key: numbers(fields.get(key), key, shape) for key, shape in _SHAPES.items()}
        if arrays["dc"][1] == 0 or min(arrays[k][i, i] for k in ("depth_K", "color_K") for i in (0, 1)) <= 0:
            raise InputError("singular: focal lengths and dc[1] must not be zero")
        depth, color = (Camera(arrays[f"{k}_K"], tuple(arrays[f"{k}_kc"].tolist())) for k in ("depth", "color"))
    beta = next(iter(files_read_with(path)), None)
    slope = arrays["dc"][1]
    return KinectCalibration(
        depth=depth,
        color=color,
        rotation=arrays["depth_to_color_R"],
        translation=arrays["depth_to_color_t"],
        offset=float(-arrays["dc"][0] / slope),
        factor=float(-1.0 / slope),
        beta=None if beta is None else read_plane(beta).astype(np.float64),
        alpha=(float(arrays["dc_alpha"][0]), float(arrays["dc_alpha"][1])),
    )


def files_read_with(path: Path) -> tuple[Path, ...]:
    """Return the files that are read beside a Kinect calibration: ``dc_beta.npy``, where it is there."""
    beta = path.with_name("dc_beta.npy")
    return (beta,) if beta.is_file() else ()

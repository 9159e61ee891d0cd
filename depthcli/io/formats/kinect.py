"""Files of a first-generation Kinect: raw codes of its depth sensor, and the calibration of its two cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Camera
from depthcli.core.cameras.kinect import UNKNOWN_CODE, KinectCalibration
from depthcli.core.errors import InputError
from depthcli.io.formats.depth import codes_of
from depthcli.io.formats.disparity import read_plane
from depthcli.io.formats.files import naming, read_bytes, shown
from depthcli.io.formats.files_behind import kinect_files
from depthcli.io.formats.plain_text import json_object, numbers

_FIELDS: dict[str, tuple[int, ...]] = dict.fromkeys(("depth_K", "color_K", "depth_to_color_R"), (3, 3))
_FIELDS |= {"depth_kc": (5,), "color_kc": (5,), "depth_to_color_t": (3,), "dc": (2,), "dc_alpha": (2,)}


def read_kinect_raw(path: Path | str) -> NDArray[np.uint16]:
    """Return (H, W) uint16 raw codes 0..2047, in either order of bytes."""
    raw = codes_of(read_plane(path), path)
    if raw.max() > UNKNOWN_CODE:  # the bytes are the wrong way round
        raw = raw.byteswap()
    if raw.max() > UNKNOWN_CODE:
        raise InputError(f"{shown(path)}: codes up to {int(raw.max())}, a Kinect's go to {UNKNOWN_CODE}")
    return raw


def read_kinect_calibration(path: Path) -> KinectCalibration:
    """Return the calibration of Herrera et al.'s toolbox as JSON, with its distortion map ``dc_beta.npy`` beside it."""
    with naming(path):
        fields = json_object(read_bytes(path))
        arrays = {key: numbers(fields.get(key), key, shape) for key, shape in _FIELDS.items()}
        if arrays["dc"][1] == 0 or min(arrays[k][i, i] for k in ("depth_K", "color_K") for i in (0, 1)) <= 0:
            raise InputError("singular: focal lengths and dc[1] must not be zero")
        depth, color = (Camera(arrays[f"{n}_K"], tuple(arrays[f"{n}_kc"].tolist())) for n in ("depth", "color"))
    beta = kinect_files(path)
    start, slope = arrays["dc"].tolist()
    one, other = arrays["dc_alpha"].tolist()
    return KinectCalibration(
        depth, color, arrays["depth_to_color_R"], arrays["depth_to_color_t"], offset=-start / slope,
        factor=-1.0 / slope, beta=read_plane(beta[0]).astype(np.float64) if beta else None, alpha=(one, other),
    )  # fmt: skip

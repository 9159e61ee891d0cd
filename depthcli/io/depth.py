"""Depth maps as files: integer codes, meters, raw codes of a Kinect and their calibration."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.geometry import Camera, KinectCalibration
from depthcli.io.atomic import write_bytes
from depthcli.io.disparity import read_disparity, read_pfm
from depthcli.io.images import read_bytes, read_grey, read_image, write_png

_RAW_MOST = 2047


def read_color(path: Path | str) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB of any image; grey is repeated, 16 bits are scaled down."""
    image: NDArray[Any] = read_image(path)
    if image.dtype == np.uint16:
        image = ((image.astype(np.uint32) + 128) // 257).astype(np.uint8)
    return np.repeat(image[:, :, None], 3, axis=2) if image.ndim == 2 else image


def read_depth(path: Path | str, scale: float, rotated: bool = False) -> NDArray[np.float32]:
    """Read a depth map in meters.

    Parameters
    ----------
    path : 16-bit PNG, PGM or TIFF codes (0 = unknown), or PFM or npy of meters (not finite or not positive = unknown)
    scale : codes a meter of integer files
    rotated : the codes' bits are rotated left by 3, as in SUN RGB-D

    Returns
    -------
    (H, W) float32, meters, NaN = unknown

    Raises
    ------
    InputError
        Not readable, 8-bit codes, or not one channel.
    """
    path = Path(path)
    values: NDArray[Any]
    if path.suffix.lower() in (".pfm", ".npy"):
        values = read_pfm(path) if path.suffix.lower() == ".pfm" else read_disparity(path)
    else:
        values = read_grey(path)
    if values.dtype.kind in "iu":
        if values.dtype.itemsize == 1:
            raise InputError(f"{path}: 8-bit codes hold no usable depth, want 16 bit")
        if rotated:
            codes = values.astype(np.uint16)
            values = (codes >> np.uint16(3)) | (codes << np.uint16(13))
        values = values / np.float64(scale)
    with np.errstate(over="ignore"):
        depth = values.astype(np.float32)
    depth[~(np.isfinite(depth) & (depth > 0))] = np.nan
    return depth


def write_depth_png(path: Path | str, depth: NDArray[np.float32], scale: float) -> None:
    """Write (H, W) meters as 16-bit codes, 0 = unknown; what lies beyond the last code becomes unknown."""
    codes = np.rint(np.nan_to_num(depth.astype(np.float64) * scale, nan=0.0, posinf=0.0, neginf=0.0))
    codes[(codes > 65535) | (codes < 0)] = 0
    write_png(path, codes.astype(np.uint16))


def read_kinect_raw(path: Path | str) -> NDArray[np.uint16]:
    """(H, W) raw codes 0..2047 of a first-generation Kinect; codes out of range tell bytes in the wrong order."""
    raw: NDArray[Any] = read_grey(path)
    if raw.dtype != np.uint16:
        raise InputError(f"{path}: {raw.dtype} samples, want the Kinect's 11-bit codes in 16 bits")
    if raw.max() > _RAW_MOST:
        raw = raw.byteswap()
    if raw.max() > _RAW_MOST:
        raise InputError(f"{path}: codes up to {int(raw.max())}, a Kinect's go to {_RAW_MOST}")
    return raw


def read_kinect_calibration(path: Path) -> KinectCalibration:
    """The calibration of Herrera et al.'s toolbox as JSON, with its distortion map ``dc_beta.npy`` beside it.

    Raises
    ------
    InputError
        A file is damaged, or a field is missing or of the wrong shape.
    """
    try:
        fields = json.loads(read_bytes(path).decode("utf-8"))
        arrays = {
            key: np.array(fields[key], np.float64)
            for key in ("depth_K", "color_K", "depth_kc", "color_kc", "depth_to_color_R", "depth_to_color_t", "dc",
                        "dc_alpha")
        }  # fmt: skip
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{path}: not a Kinect calibration ({type(error).__name__}: {error})") from None
    shapes = {"depth_K": (3, 3), "color_K": (3, 3), "depth_kc": (5,), "color_kc": (5,), "depth_to_color_R": (3, 3),
              "depth_to_color_t": (3,), "dc": (2,), "dc_alpha": (2,)}  # fmt: skip
    for key, shape in shapes.items():
        if arrays[key].shape != shape or not np.isfinite(arrays[key]).all():
            raise InputError(f"{path}: {key}: want {shape} finite numbers, got {arrays[key].shape}")
    if arrays["dc"][1] == 0 or min(arrays[k][i, i] for k in ("depth_K", "color_K") for i in (0, 1)) <= 0:
        raise InputError(f"{path}: singular: focal lengths and dc[1] must not be zero")
    beta = path.with_name("dc_beta.npy")
    slope = arrays["dc"][1]
    return KinectCalibration(
        depth=Camera(arrays["depth_K"], tuple(arrays["depth_kc"].tolist())),
        color=Camera(arrays["color_K"], tuple(arrays["color_kc"].tolist())),
        rotation=arrays["depth_to_color_R"],
        translation=arrays["depth_to_color_t"],
        offset=float(-arrays["dc"][0] / slope),
        factor=float(-1.0 / slope),
        beta=np.load(beta).astype(np.float64) if beta.is_file() else None,
        alpha=(float(arrays["dc_alpha"][0]), float(arrays["dc_alpha"][1])),
    )


def write_ply(path: Path | str, points: NDArray[np.float32], colors: NDArray[np.uint8]) -> None:
    """Write a colored point cloud as binary little-endian PLY, atomically.

    Parameters
    ----------
    points : (N, 3) float32, meters
    colors : (N, 3) uint8 RGB
    """
    kind = np.dtype([("position", "<f4", 3), ("color", "u1", 3)])
    data = np.empty(len(points), kind)
    data["position"], data["color"] = points, colors
    names = ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property {name}" for name in names] + ["end_header", ""]
    write_bytes(path, "\n".join(header).encode() + data.tobytes())

"""Calibration in recordings of ROS: ``sensor_msgs/CameraInfo`` as the files that commands read."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics, is_rotation
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import InputError
from depthcli.io.formats.files import write_text
from depthcli.io.formats.rigs import read_rig

_MAX_FOCAL_DIFFERENCE = 1e-3  # relative, of the focal lengths of a rectified pair
_MAX_ROW_DIFFERENCE = 0.5  # of the principal points' rows of a rectified pair, pixels
_MAX_BASELINE = 20.0  # meters, as for files of calibrations
_MAX_NUMBER = 1e9  # of a calibration, pixels or coefficients
_CLOSE = 1e-6  # relative difference of numbers that are the same but for rounding


@dataclass(frozen=True)
class CameraInfo:
    """What a ``CameraInfo`` says of one camera.

    Attributes
    ----------
    size : (width, height) of the images
    matrix, rotation, projection : K (3, 3), R (3, 3), P (3, 4), of whole images; P is 0 where it is not known
    model, distortion : name of the lens model, and its coefficients D
    frame : name of the camera's coordinates, for transforms
    """

    size: tuple[int, int]
    matrix: NDArray[np.float64]
    rotation: NDArray[np.float64]
    projection: NDArray[np.float64]
    model: str
    distortion: tuple[float, ...]
    frame: str = ""

    @property
    def is_calibrated(self) -> bool:
        """False for the placeholder that drivers publish without a calibration: K is 0."""
        return bool(self.matrix[0, 0] > 0 and self.matrix[1, 1] > 0)

    @property
    def is_undistorted(self) -> bool:
        """True where the images need no rectification: no distortion, no rotation, and P has the camera matrix K."""
        same = not self.projection.any() or np.allclose(self.projection[:, :3], self.matrix, rtol=_CLOSE)
        return not any(self.distortion) and bool(np.allclose(self.rotation, np.eye(3), atol=1e-9)) and same

    def intrinsics(self, rectified: bool) -> Intrinsics:
        """Return focal lengths and principal point: of P for ``rectified`` images where it is known, else of K."""
        return Intrinsics.of_matrix(self.projection if rectified and self.projection[0, 0] > 0 else self.matrix)

    def same_camera(self, other: CameraInfo) -> bool:
        """Return whether both say the same of images, but for the frame."""
        return (self.size, self.model, self.distortion) == (other.size, other.model, other.distortion) and all(
            np.array_equal(one, two)
            for one, two in (
                (self.matrix, other.matrix),
                (self.rotation, other.rotation),
                (self.projection, other.projection),
            )
        )


def camera_info(message: Any) -> CameraInfo:
    """Return the camera of a ``sensor_msgs/CameraInfo`` of ROS 1 or 2.

    Raises
    ------
    InputError
        Numbers that are not finite, a rotation that is none, or images that are binned or cut out of larger ones.
    """
    parts = {}
    for name, shape in (("K", (3, 3)), ("R", (3, 3)), ("P", (3, 4)), ("D", (-1,))):
        values = np.asarray(getattr(message, name, None) if hasattr(message, name) else getattr(message, name.lower()))
        parts[name] = values.astype(np.float64).reshape(shape)
        if not np.all(np.abs(parts[name]) < _MAX_NUMBER):
            raise InputError(f"{name} of camera_info holds numbers that are not finite, or too large")
    size = (int(message.width), int(message.height))
    if max(int(message.binning_x), int(message.binning_y)) > 1:
        raise InputError("camera_info of binned images; record them at full size")
    region = message.roi
    if (region.x_offset or region.y_offset) or (region.width, region.height) not in ((0, 0), size):
        raise InputError("camera_info of a region of interest; record whole images")
    rotation = parts["R"] if parts["R"].any() else np.eye(3)
    if not is_rotation(rotation):
        raise InputError("R of camera_info is no rotation")
    return CameraInfo(size, parts["K"], rotation, parts["P"], str(message.distortion_model),
                      tuple(parts["D"].tolist()), str(message.header.frame_id))  # fmt: skip


def rectified_geometry(left: CameraInfo, right: CameraInfo, baseline: float | None = None) -> PairGeometry:
    """Return the geometry of a pair whose images are rectified.

    Parameters
    ----------
    baseline : meters, where another message says it; None: it is in P, as ROS has it

    Raises
    ------
    InputError
        There is no baseline, or both cameras contradict each other.
    """
    cameras = [info.intrinsics(rectified=True) for info in (left, right)]
    if left.size != right.size:
        raise InputError(f"camera_info of images of {left.size} and {right.size} pixels")
    for name in ("fx", "fy"):
        one, two = (getattr(camera, name) for camera in cameras)
        if abs(one - two) > _MAX_FOCAL_DIFFERENCE * one:
            raise InputError(f"{name} is {one:g} and {two:g} in camera_info: these are no rectified images")
    if abs(cameras[0].cy - cameras[1].cy) > _MAX_ROW_DIFFERENCE:
        raise InputError(f"cy is {cameras[0].cy:g} and {cameras[1].cy:g} in camera_info: the rows do not correspond")
    if baseline is None:
        baseline = sum(
            sign * float(info.projection[0, 3]) / camera.fx
            for sign, info, camera in ((1, left, cameras[0]), (-1, right, cameras[1]))
        )
    if baseline == 0:
        raise InputError("P of camera_info holds no baseline")
    if baseline < 0:
        raise InputError(f"a baseline of {baseline:g} m in camera_info: are left and right exchanged?")
    if baseline > _MAX_BASELINE:
        raise InputError(f"a baseline of {baseline:g} m in camera_info; want meters")
    return PairGeometry(cameras[0], baseline, cameras[1].cx - cameras[0].cx, left.size)


def write_raw_pair(folder: Path, left: CameraInfo, right: CameraInfo) -> tuple[str, str]:
    """Write ``calib_left.yaml`` and ``calib_right.yaml``, which ``rectify --calibration`` reads; return their names.

    Raises
    ------
    InputError
        They hold no calibration of a pair that can be used; nothing is left in ``folder`` then.
    """
    names = ("calib_left.yaml", "calib_right.yaml")
    files = [folder / name for name in names]
    for file, info in zip(files, (left, right), strict=True):
        write_text(file, _yaml(info, file.stem))
    try:
        rig = read_rig(files)
        if rig.rotation.T @ rig.translation @ (1, 0, 0) > 0:
            raise InputError(f"{files[1]}: the right camera is left of the left one: are left and right exchanged?")
    except InputError as error:
        for file in files:
            file.unlink()
        raise InputError(str(error).replace(f"{folder}/", "")) from error
    return names


def _yaml(info: CameraInfo, name: str) -> str:
    """The file that the calibration program of ROS writes."""

    def matrix(key: str, values: NDArray[np.float64]) -> list[str]:
        rows, columns = values.shape
        return [f"{key}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: {json.dumps(values.ravel().tolist())}"]

    distortion = np.array([info.distortion or (0.0,) * (4 if info.model in ("equidistant", "fisheye") else 5)])
    lines = [
        f"image_width: {info.size[0]}",
        f"image_height: {info.size[1]}",
        f"camera_name: {name}",
        *matrix("camera_matrix", info.matrix),
        f"distortion_model: {json.dumps(info.model or 'plumb_bob')}",
        *matrix("distortion_coefficients", distortion),
        *matrix("rectification_matrix", info.rotation),
        *matrix("projection_matrix", info.projection),
    ]
    return "\n".join(lines) + "\n"

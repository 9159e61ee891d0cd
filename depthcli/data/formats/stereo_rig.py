"""Calibrations of two cameras, as the calibration programs store them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from depthcli.core.cameras.stereo_rig import Lens, StereoRig
from depthcli.core.errors import InputError
from depthcli.data.formats.files import naming, read_bytes, shown

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Meters of the units that a translation may be stored in."""

_MOST_BYTES = 1 << 22
_MOST_METERS = 20.0  # a longer baseline is one in another unit
# What the parts are called in files of OpenCV.
_NAMES = {
    "K1": ("K1", "M1", "cameraMatrix1", "camera_matrix_1", "left_camera_matrix", "K_left"),
    "D1": ("D1", "distCoeffs1", "dist_coeffs_1", "left_distortion_coefficients", "D_left"),
    "K2": ("K2", "M2", "cameraMatrix2", "camera_matrix_2", "right_camera_matrix", "K_right"),
    "D2": ("D2", "distCoeffs2", "dist_coeffs_2", "right_distortion_coefficients", "D_right"),
    "R": ("R", "rotation", "rotation_matrix"),
    "T": ("T", "t", "translation", "translation_vector"),
}
_KALIBR = {"radtan": False, "equidistant": True, "equi": True, "none": False}
_ROS = {"plumb_bob": False, "rational_polynomial": False, "equidistant": True, "fisheye": True}


def read_stereo_rig(
    paths: Sequence[Path], unit: str = "m", fisheye: bool = False, cameras: tuple[int, int] = (2, 3)
) -> StereoRig:
    """Read the calibration of two cameras; the kind is told by the content.

    Parameters
    ----------
    paths : one file, or two that belong together: OpenCV's ``FileStorage`` as YAML, XML or JSON (K1 D1 K2 D2 R T in
        either), ROS's ``camera_info`` of the left and the right camera, Kalibr's camchain, KITTI's ``calib_cam_to_cam``
    unit : of OpenCV's translation, a key of ``UNITS``; the others have meters
    fisheye : the lenses of OpenCV's file follow its fisheye model; the others say it themselves
    cameras : numbers of the left and the right one, in KITTI's file

    Raises
    ------
    InputError
        Not readable, of no known kind, or a part is missing or wrong; one line that names the file.
    """
    texts = [read_bytes(path, _MOST_BYTES).decode("utf-8", "replace") for path in paths]
    with naming(paths[0]):
        if any(text.lstrip().startswith(("%YAML", "<?xml", "<opencv_storage", "{")) for text in texts):
            rig = _opencv(texts, UNITS[unit], fisheye)
        elif re.search(r"^K_0\d:", texts[0], re.MULTILINE):
            rig = _kitti(texts[0], cameras)
        else:
            rig = _of_yaml([_mapping(path, text) for path, text in zip(paths, texts, strict=True)])
        long = float(np.linalg.norm(rig.translation))
        if long > _MOST_METERS:
            raise InputError(f"a baseline of {long:g} m; is the translation in millimeters? then say --unit mm")
        return rig


def _opencv(texts: Sequence[str], meters: float, fisheye: bool) -> StereoRig:
    found: dict[str, NDArray[np.float64]] = {}
    size = None
    for text in texts:
        try:
            storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
            for part, names in _NAMES.items():
                for name in names:
                    value = storage.getNode(name).mat()
                    if value is not None:
                        found.setdefault(part, np.asarray(value, np.float64))
            size = size or _opencv_size(storage)
            model = storage.getNode("model").string() + storage.getNode("distortion_model").string()
        except (cv2.error, SystemError) as error:
            raise InputError("not a file of OpenCV's FileStorage") from error
        fisheye = fisheye or any(word in model.lower() for word in ("fisheye", "equidistant"))
    missing = [part for part in _NAMES if part not in found]
    if missing:
        raise InputError(f"no {', '.join(missing)}; want K1 D1 K2 D2 R T (or M1 ..., cameraMatrix1 ...)")
    left, right = (
        Lens(_shaped(found[f"K{n}"], f"K{n}", (3, 3)), tuple(found[f"D{n}"].ravel().tolist()), size, fisheye)
        for n in (1, 2)
    )
    turn = found["R"] if found["R"].size == 9 else cv2.Rodrigues(_shaped(found["R"], "R", (3,)))[0]
    shift = _shaped(found["T"], "T", (3,)) * meters
    return StereoRig(left, right, np.asarray(turn, np.float64).reshape(3, 3), shift)


def _opencv_size(storage: Any) -> tuple[int, int] | None:
    pair = [int(storage.getNode(name).real()) for name in ("image_width", "image_height")]
    node = storage.getNode("imageSize")
    if min(pair) <= 0 and node.isSeq() and node.size() == 2:
        pair = [int(node.at(k).real()) for k in (0, 1)]
    return (pair[0], pair[1]) if min(pair) > 0 else None


def _kitti(text: str, cameras: tuple[int, int]) -> StereoRig:
    fields = dict(re.findall(r"^(\w+):\s*(.*?)\s*$", text, re.MULTILINE))

    def numbers(key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
        try:
            values = np.array([float(word) for word in fields.get(key, "").split()])
        except ValueError:
            values = np.zeros(0)
        return _shaped(values, key, shape)

    lenses, turns, shifts = [], [], []
    for number in cameras:
        width, height = numbers(f"S_0{number}", (2,)).astype(int)
        lens = tuple(numbers(f"D_0{number}", (5,)).tolist())
        lenses.append(Lens(numbers(f"K_0{number}", (3, 3)), lens, (int(width), int(height))))
        turns.append(numbers(f"R_0{number}", (3, 3)))
        shifts.append(numbers(f"T_0{number}", (3,)))
    turn = turns[1] @ turns[0].T
    return StereoRig(lenses[0], lenses[1], turn, shifts[1] - turn @ shifts[0])


def _mapping(path: Path, text: str) -> dict[str, Any]:
    try:
        data = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise InputError(f"no calibration of a kind that is known ({type(error).__name__})") from None
    if not isinstance(data, dict):
        raise InputError(f"{shown(path.name)}: no calibration of a kind that is known (OpenCV, ROS, Kalibr, KITTI)")
    return data


def _of_yaml(files: Sequence[dict[str, Any]]) -> StereoRig:
    if "cam0" in files[0]:
        return _kalibr(files[0])
    if "camera_matrix" in files[0]:
        if len(files) != 2:
            raise InputError("one camera_info; give the left and the right one: --calibration L --calibration R")
        return _ros(files[0], files[1])
    raise InputError("no calibration of a kind that is known (OpenCV's K1 ..., ROS's camera_matrix, Kalibr's cam0)")


def _kalibr(file: dict[str, Any]) -> StereoRig:
    lenses = []
    for name in ("cam0", "cam1"):
        camera = file.get(name)
        if not isinstance(camera, dict):
            raise InputError(f"no {name}; want a camchain of two cameras")
        model, lens = str(camera.get("camera_model")), str(camera.get("distortion_model"))
        if model != "pinhole" or lens not in _KALIBR:
            raise InputError(f"{name}: {model}, {lens}: want pinhole with {', '.join(_KALIBR)}")
        fx, fy, cx, cy = _listed(camera, "intrinsics", (4,), name)
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        distortion = np.zeros(4) if lens == "none" else _listed(camera, "distortion_coeffs", (4,), name)
        size = _listed(camera, "resolution", (2,), name).astype(int)
        lenses.append(Lens(matrix, tuple(distortion.tolist()), (int(size[0]), int(size[1])), _KALIBR[lens]))
    place = _listed(file["cam1"], "T_cn_cnm1", (4, 4), "cam1")
    return StereoRig(lenses[0], lenses[1], place[:3, :3], place[:3, 3])


def _ros(left: dict[str, Any], right: dict[str, Any]) -> StereoRig:
    lenses, turns = [], []
    for name, camera in (("left", left), ("right", right)):
        model = str(camera.get("distortion_model", "plumb_bob"))
        if model not in _ROS:
            raise InputError(f"{name}: distortion_model {model}: want {', '.join(_ROS)}")
        size = (int(_one(camera, "image_width", name)), int(_one(camera, "image_height", name)))
        distortion = _data(camera, "distortion_coefficients", (-1,), name)
        lens = Lens(_data(camera, "camera_matrix", (3, 3), name), tuple(distortion.tolist()), size, _ROS[model])
        lenses.append(lens)
        turns.append(_data(camera, "rectification_matrix", (3, 3), name))
    projection = _data(right, "projection_matrix", (3, 4), "right")
    if projection[0, 0] <= 0 or projection[0, 3] == 0:
        raise InputError("right: projection_matrix holds no baseline; is it the camera_info of a stereo calibration?")
    shift = np.array([projection[0, 3] / projection[0, 0], projection[1, 3] / projection[1, 1], 0.0])
    # Both frames meet in the rectified one: R' x' = R x + shift.
    return StereoRig(lenses[0], lenses[1], turns[1].T @ turns[0], turns[1].T @ shift)


def _data(camera: dict[str, Any], key: str, shape: tuple[int, ...], name: str) -> NDArray[np.float64]:
    part = camera.get(key)
    return _listed(part if isinstance(part, dict) else {"data": part}, "data", shape, f"{name}: {key}")


def _one(camera: dict[str, Any], key: str, name: str) -> float:
    return float(_listed(camera, key, (1,), name)[0])


def _listed(mapping: dict[str, Any], key: str, shape: tuple[int, ...], name: str) -> NDArray[np.float64]:
    try:
        values = np.asarray(mapping.get(key), np.float64).ravel()
    except (TypeError, ValueError):
        values = np.zeros(0)
    return _shaped(values, f"{name}: {key}", shape)


def _shaped(values: NDArray[np.float64], name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    fits = values.size > 0 and (shape == (-1,) or values.size == int(np.prod(shape)))
    if not fits or not np.isfinite(values).all():
        wanted = " x ".join(map(str, shape)) if shape != (-1,) else "some"
        raise InputError(f"{name}: want {wanted} finite numbers, got {values.size}")
    return values.reshape(shape)

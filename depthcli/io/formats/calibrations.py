"""Calibrations as programs and data sets store them.

They describe two unrectified cameras (OpenCV, ROS, Kalibr, KITTI, ZED), a rectified pair (Middlebury's ``calib.txt``,
KITTI's projections, Booster's XML, FoundationStereo's ``K.txt``), or a color and an infrared camera.
"""

from __future__ import annotations

import configparser
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar
from xml.etree import ElementTree

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Camera, Intrinsics
from depthcli.core.cameras.rig import Rig
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import InputError
from depthcli.io.formats.files import naming, read_bytes, shown, warn, warnings_naming, write_text
from depthcli.io.formats.plain_text import image_sides, is_number, json_object, key_values, numbers, text_of

ValueT = TypeVar("ValueT")

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Unit of a length -> meters."""

_MILLIMETER = 0.001  # meters
_LENGTH = re.compile(r"\s*([0-9]*\.?[0-9]+)?\s*(mm|cm|m)\s*")
_UNKNOWN = "no calibration of a kind that is known"
# Files with nested fields: XML, JSON, YAML of OpenCV, ROS and Kalibr. Other files have a key and numbers per line.
_STORAGE = re.compile(
    r"\A\s*[<{%]|!!opencv|^cam0:\s*(\{|$)|^(camera_matrix|[KM]1|cameraMatrix1|distortion_model):", re.MULTILINE
)
_MAX_BYTES = 1 << 24  # a calibration has a few kilobytes
_MAX_LISTS = 1000  # in YAML; a calibration has a few dozen
_MAX_PARTS = 10_000  # messages in a ROS file
# Meters. A baseline outside _BASELINES means that the translation has another unit, which the user must give. Few rigs
# have a baseline above _LONG_BASELINE.
_BASELINES, _LONG_BASELINE = (0.005, 5.0), 1.0
# Part -> its names in OpenCV's files.
_NAMES = {
    "K1": ("K1", "M1", "cameraMatrix1", "camera_matrix_1", "left_camera_matrix", "K_left"),
    "D1": ("D1", "distCoeffs1", "dist_coeffs_1", "left_distortion_coefficients", "D_left"),
    "K2": ("K2", "M2", "cameraMatrix2", "camera_matrix_2", "right_camera_matrix", "K_right"),
    "D2": ("D2", "distCoeffs2", "dist_coeffs_2", "right_distortion_coefficients", "D_right"),
    "R": ("R", "rotation", "rotation_matrix"),
    "T": ("T", "t", "translation", "translation_vector"),
}
# Name of a distortion model -> whether it is OpenCV's fisheye model.
_KALIBR = {"radtan": False, "equidistant": True, "equi": True, "none": False}
_ROS = {"plumb_bob": False, "rational_polynomial": False, "equidistant": True, "fisheye": True, "": False}
_ZED = re.compile(r"^\s*\[(LEFT|RIGHT)_CAM_\w+\]", re.MULTILINE | re.IGNORECASE)
_ZED_LENS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_K_NUMBERS = 10  # numbers in FoundationStereo's file: K, row by row, and the baseline


# ZED's names of image sizes.
_ZED_SIZES = {
    "2K": (2208, 1242), "FHD1200": (1920, 1200), "FHD": (1920, 1080), "HD": (1280, 720), "VGA": (672, 376),
    "SVGA": (960, 600), "QHDPLUS": (3200, 1800), "4K": (3840, 2160),
}  # fmt: skip
_ROS_NAMES = {  # field of a message, as ``ros2 topic echo`` prints it -> field of ROS's calibration files
    "k": "camera_matrix", "d": "distortion_coefficients", "r": "rectification_matrix", "p": "projection_matrix",
    "width": "image_width", "height": "image_height",
}  # fmt: skip


@dataclass(frozen=True)
class Reading:
    """User options for reading a calibration file."""

    unit: str | None = None  # unit of lengths; None: the format's unit, mostly meters
    fisheye: bool = False  # OpenCV's file has its fisheye model; other formats name the model
    cameras: tuple[int, int] = (2, 3)  # numbers of the left and the right camera in KITTI's files
    alpha: float = 0.0  # extent of the rectified images, see :meth:`Rig.rectified`
    asks: bool = True  # whether an implausible baseline without a unit is an error

    def meters(self, default: float = 1.0) -> float:
        """Return the length of the file's unit in meters, or ``default`` if the user gave no unit."""
        return default if self.unit is None else meters_of(self.unit)

    def check(self, baseline: float) -> None:
        """Raise InputError if a baseline, in meters, is implausible and the user gave no unit; warn if it is long."""
        low, high = _BASELINES
        if self.unit is not None or not self.asks:
            return
        if baseline > 0 and not low <= baseline <= high:
            raise InputError(
                f"a baseline of {baseline:g} m; which unit has the translation? Give the unit, as --unit mm, --unit m, "
                "or that of squares of a board, --unit 24mm"
            )
        if baseline > _LONG_BASELINE:
            warn(f"a baseline of {baseline:g} m: if the translation has another unit, give the unit, as --unit mm")


def meters_of(length: str) -> float:
    """Return a unit (``mm``) or a length with its unit (``24mm``) in meters. Raise InputError for other texts."""
    match = _LENGTH.fullmatch(length)
    meters = float(match[1] or 1) * UNITS[match[2]] if match else 0.0
    if not meters > 0:
        raise InputError(f"expected {', '.join(UNITS)}, or a length such as 25mm (got {length[:40]!r})")
    return meters


def read_rig(paths: Sequence[Path], reading: Reading | None = None, size: tuple[int, int] | None = None) -> Rig:
    """Return the two cameras of a calibration, whose format is recognized by its content.

    Parameters
    ----------
    paths : one file, or two that belong together: OpenCV's ``FileStorage`` as YAML, XML or JSON (K1 D1 K2 D2 R T in
        either file), ROS's ``camera_info`` of the left and the right camera, Kalibr's camchain, KITTI's
        ``calib_cam_to_cam``, ZED's ``SN12345.conf``
    size : (width, height) of the images, which selects the cameras in ZED's file; None: the first size in the file
    """
    content, _ = _read(paths, reading or Reading(), size, only_rigs=True)
    assert isinstance(content, Rig)
    return content


def _read(
    paths: Sequence[Path], reading: Reading, size: tuple[int, int] | None, only_rigs: bool = False
) -> tuple[Rig | PairGeometry, list[dict[str, Any]]]:
    """Return the cameras of a calibration, rectified or not, and the nested fields of its files, if they have any."""
    texts, meters, files = [text_of(read_bytes(path, _MAX_BYTES)) for path in paths], reading.meters(), []
    content: Rig | PairGeometry | None = None
    with naming(paths[0]), warnings_naming(paths[0]):
        if re.search(r"^K_0\d:", texts[0], re.MULTILINE):
            content = _kitti_rig(key_values(_only(texts)), reading.cameras)
        elif _ZED.search(texts[0]):
            content, meters = _zed_rig(_only(texts), size), reading.meters(_MILLIMETER)
        elif not _STORAGE.search(texts[0]):
            content = _rectified_geometry(texts, reading)
        if content is None:
            files = [_storage_fields(text) for text in texts]
            if "proj_matL" in files[0]:
                content = _booster_geometry(_only(files), reading.meters(_MILLIMETER))
            elif "cam0" in files[0]:
                content = _kalibr_rig(_only(files))
            elif "camera_matrix" in files[0]:
                content = _ros_rig(files)
            else:
                content = _opencv_rig(files, reading.fisheye)
        if isinstance(content, Rig):
            content = replace(content, translation=content.translation * meters)
        elif only_rigs:
            raise InputError("describes a rectified pair, which is matched as it is; depth takes this file, too")
        reading.check(content.baseline)
        return content, files


def _only(files: Sequence[ValueT]) -> ValueT:
    """Return the only file of a calibration. Raise InputError if there are several."""
    if len(files) > 1:
        raise InputError("such a file is a whole calibration; give one of them")
    return files[0]


def write_calibration(path: Path, cameras: Sequence[Camera], rig: Rig | None = None) -> None:
    """Write one camera (K1 D1), or two with R and T in meters (K1 D1 K2 D2 R T), as OpenCV's YAML.

    :func:`read_rig` reads files of two cameras.
    """
    lines = ["%YAML:1.0", "---"]
    if len({camera.size for camera in cameras}) == 1 and cameras[0].size is not None:
        lines += [f"image_width: {cameras[0].size[0]}", f"image_height: {cameras[0].size[1]}"]
    lines.append(f"distortion_model: {'fisheye' if cameras[0].fisheye else 'plumb_bob'}")
    parts: dict[str, NDArray[np.float64]] = {}
    for number, camera in enumerate(cameras, 1):
        parts |= {f"K{number}": camera.matrix, f"D{number}": camera.coefficients[None]}
    if rig is not None:
        parts |= {"R": rig.rotation, "T": rig.translation[:, None]}
    for name, part in parts.items():
        values = ", ".join(repr(float(value)) for value in part.ravel())
        rows, columns = part.shape
        lines += [f"{name}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}", "   dt: d"]
        lines.append(f"   data: [ {values} ]")
    write_text(path, "\n".join(lines) + "\n")


def read_geometry(
    paths: Path | Sequence[Path],
    reading: Reading | None = None,
    size: tuple[int, int] | None = None,
    rectified: Path | None = None,
) -> PairGeometry:
    """Return the geometry that converts disparities of a rectified pair to depth.

    Files are ``calib.txt`` of Middlebury v3 or ETH3D (``cam0``, ``cam1``, ``doffs``, ``baseline`` in mm); Booster's XML
    (``proj_matL``, ``baselineLR`` in mm); KITTI's projections, ``P0:`` to ``P3:`` or ``P_rect_00:`` to ``P_rect_03:``
    (cameras 0 and 1 are grey, 2 and 3 color; DrivingStereo has ``P_rect_101:`` and cameras 101, 103);
    FoundationStereo's ``K.txt`` (9 numbers of K, then the baseline in meters); or any file that :func:`read_rig` reads.

    Parameters
    ----------
    paths : a file, or two that belong together
    size : (width, height) of the map, for unrectified cameras
    rectified : ``calib.txt`` written when the images of unrectified cameras were rectified. It replaces the files' own
        projections (``P1``, ``P2``, ROS's ``projection_matrix``) and the rectification of ``depthcli rectify``
    """
    files, reading = [paths] if isinstance(paths, Path) else list(paths), reading or Reading()
    rig, fields = _read(files, reading, size)
    if isinstance(rig, PairGeometry):
        return rig
    if rectified is not None:
        return read_geometry(rectified, Reading(asks=False))
    with naming(files[0]), warnings_naming(files[0]):
        if (geometry := _projected(fields, rig.left.size, reading.meters())) is not None:
            reading.check(geometry.baseline)
            warn("the map is taken to be of a pair that was rectified by its projections")
            return geometry
        warn(f"the map is taken to be of a pair that depthcli rectify has rectified, with alpha {reading.alpha:g}")
        center = rig.left.matrix[:2, 2]
        known = rig.left.size or size or (round(2 * center[0]) + 1, round(2 * center[1]) + 1)
        return rig.rectified(known, rig.right.size or known, reading.alpha).geometry


def _rectified_geometry(texts: Sequence[str], reading: Reading) -> PairGeometry | None:
    """Return the geometry in a rectified pair's file of key-value lines or plain numbers, or None for other files."""
    fields = key_values(texts[0])
    if "cam0" in fields:
        return _middlebury_geometry(key_values(_only(texts)), reading.meters(_MILLIMETER))
    if any(re.fullmatch(r"P(\d|_rect_\d{2,3})", key) for key in fields):
        return _kitti_geometry(key_values(_only(texts)), reading)
    words = texts[0].split()
    if len(words) == _K_NUMBERS and all(map(is_number, words)):
        values = numbers(_only(texts), "K and baseline", (_K_NUMBERS,))
        matrix = values[:9].reshape(3, 3)
        if matrix[[1, 2, 2], [0, 0, 1]].any() or matrix[2, 2] != 1:
            raise InputError("expected the 9 numbers of K, row by row, and the baseline")
        return PairGeometry(Intrinsics.of_matrix(matrix), float(values[9]) * reading.meters())
    return None


def write_geometry(path: Path, geometry: PairGeometry, max_disparity: int | None = None) -> None:
    """Write Middlebury v3's ``calib.txt`` (baseline in mm, ``ndisp`` is the search range)."""
    left, offset = geometry.left, geometry.offset
    lines = [
        f"cam{k}=[{left.fx:.12g} 0 {cx:.12g}; 0 {left.fy:.12g} {left.cy:.12g}; 0 0 1]"
        for k, cx in enumerate((left.cx, left.cx + offset))
    ]
    lines += [f"doffs={offset:.12g}", f"baseline={geometry.baseline / _MILLIMETER:.12g}"]
    if geometry.size is not None:
        lines += [f"width={geometry.size[0]}", f"height={geometry.size[1]}"]
    lines += [] if max_disparity is None else [f"ndisp={max_disparity}"]
    write_text(path, "\n".join(lines) + "\n")


def read_color_infrared_rig(path: Path, color_size: tuple[int, int], infrared_size: tuple[int, int]) -> Rig | float:
    """Return the calibration of a color (``left``) and an infrared camera (``right``) for images of these sizes.

    Sizes are (width, height). For a rectified pair, return focal length x baseline in pixel meters.

    JSON has ``color`` and ``infrared``, each with ``K`` (3, 3) and optional ``distortion`` and ``size``, and ``R``
    (3, 3), ``t`` (3,) in meters, from the color camera's frame to the infrared camera's. A rectified pair has
    ``rectified: true`` and ``fb`` instead. Files of :func:`read_rig` are read, too; their first camera is the color
    camera.
    """
    text = text_of(read_bytes(path, _MAX_BYTES))
    with naming(path):
        if not text.lstrip().startswith("{") or "opencv-matrix" in text:
            rig = read_rig([path], Reading("m"))
        else:
            fields = json_object(text)
            if fields.get("rectified") is True:
                fb = _number(fields, "fb")
                if not 0 < fb < 1e9:
                    raise InputError(f"fb: expected focal length x baseline, pixel meters (got {fb:g})")
                return fb
            cameras = []
            for name, image_size in (("color", color_size), ("infrared", infrared_size)):
                camera = fields.get(name)
                if not isinstance(camera, dict):
                    raise InputError(f"{name}: expected K, distortion, size (got {str(camera)[:40]!r})")
                if (size := camera.get("size")) not in (None, list(image_size)):
                    raise InputError(f"calibrated for a {name} image of {str(size)[:40]}, got one of {image_size}")
                with naming(name):
                    known = {key: value for key, value in camera.items() if value is not None}
                    cameras.append(_camera({"distortion": [0.0] * 5, **known}, "K", "distortion"))
            rig = Rig(cameras[0], cameras[1], _field(fields, "R", (3, 3)), _field(fields, "t", (3,)))
        for line in rig.doubts(color_size, infrared_size):
            warn(f"{shown(path)}: {line}".replace(": left camera", ": color").replace(": right camera", ": infrared"))
        low, high = _BASELINES
        if not low <= rig.baseline <= high:
            raise InputError(f"a baseline of {rig.baseline:.3g} m; the translation must be in meters")
        if color_size == infrared_size or rig.left.size != rig.right.size:  # OpenCV's files have only one size
            for name, camera, image in (("color", rig.left, color_size), ("infrared", rig.right, infrared_size)):
                if camera.size not in (None, image):
                    raise InputError(f"calibrated for a {name} image of {camera.size}, got one of {image}")
        return replace(rig, left=replace(rig.left, size=color_size), right=replace(rig.right, size=infrared_size))


def _field(fields: Mapping[str, Any], key: str, shape: tuple[int, ...] = (-1,)) -> NDArray[np.float64]:
    """Return the numbers of a field, or of its ``data`` if it is a matrix."""
    value = fields.get(key)
    return numbers(value.get("data") if isinstance(value, dict) else value, key, shape)


def _number(fields: Mapping[str, Any], key: str) -> float:
    return float(_field(fields, key, (1,))[0])


def _camera(
    fields: Mapping[str, Any], matrix: str, lens: str, size: tuple[int, int] | None = None, fisheye: bool = False
) -> Camera:
    """Return the camera in the fields called ``matrix`` and ``lens``."""
    return Camera(_field(fields, matrix, (3, 3)), tuple(_field(fields, lens).tolist()), size, fisheye)


def _storage_fields(text: str) -> dict[str, Any]:
    """Return the content of a JSON, XML or YAML file, e.g. OpenCV's ``FileStorage``. Raise InputError on failure.

    OpenCV's reader is not used: some damaged files make it hang or end the process.
    """
    text = text.lstrip()
    fields: Any = None
    try:
        if text.startswith("{"):
            fields = json.loads(text)
        elif text.startswith("<"):
            parts = ElementTree.fromstring(text)
            fields = {part.tag: {each.tag: each.text or "" for each in part} or part.text or "" for part in parts}
        else:
            text = _first_part(re.sub(r"\A%YAML.*|!!opencv-[\w-]+", "", text))
            # Thousands of nested lists take hours, and a few aliases may expand to billions of numbers.
            if text.count("[") > _MAX_LISTS or any(isinstance(each, yaml.AliasToken) for each in yaml.scan(text)):
                raise InputError(f"{_UNKNOWN} (YAML with aliases, or too many lists)")
            fields = yaml.safe_load(text)
    except (ValueError, RecursionError, ElementTree.ParseError, yaml.YAMLError) as error:
        raise InputError(f"{_UNKNOWN} ({' '.join(str(error).split())[:200]})") from error
    if not isinstance(fields, dict):
        raise InputError(f"{_UNKNOWN} (OpenCV, ROS, Kalibr, KITTI, ZED)")
    return _ros_fields(fields)


def _first_part(text: str) -> str:
    """Return the first YAML document, e.g. a ROS message; warn if others differ in more than their times."""
    parts = [part for part in re.split(r"^---[ \t]*$", text, maxsplit=_MAX_PARTS, flags=re.MULTILINE) if part.strip()]
    alike = {re.sub(r"^\s*(n?secs?|nanosec|seq|stamp):.*$", "", part, flags=re.MULTILINE).strip() for part in parts}
    if len(alike) > 1:
        warn(f"{len(parts)} parts that differ; the first one is used")
    return parts[0] if parts else ""


def _ros_fields(fields: dict[str, Any]) -> dict[str, Any]:
    """Return a ROS message with the field names of ROS's files; other fields are returned unchanged."""
    small = {str(key).lower(): value for key, value in fields.items()}
    if not {"k", "d", "r", "p", "width", "height"} <= small.keys():
        return fields
    if any(isinstance(small.get(key), int) and small[key] > 1 for key in ("binning_x", "binning_y")):
        raise InputError("binning_x, binning_y: the camera_info of whole images is needed, without binning")
    roi = small.get("roi")
    if isinstance(roi, dict) and any(roi.get(key) for key in ("x_offset", "y_offset")):
        raise InputError("roi: the camera_info of whole images is needed, not of a part of them")
    renamed = {_ROS_NAMES.get(key, key): value for key, value in small.items()}
    return renamed | {"distortion_coefficients": small["d"] or [0.0] * 5}


def _opencv_rig(files: Sequence[dict[str, Any]], fisheye: bool) -> Rig:
    """Return the rig of OpenCV's fields, which may be in two files: matrices, distortions, rotation, translation."""
    fields: dict[str, Any] = {}
    for file in files:
        model = f"{file.get('model')} {file.get('distortion_model')}".lower()
        fisheye = fisheye or "fisheye" in model or "equidistant" in model
        if twice := [name for names in _NAMES.values() for name in names if name in fields and name in file]:
            raise InputError(f"two files of one calibration, but both have {twice[0]}; give one whole calibration")
        fields = file | fields
    names = {part: next((name for name in known if name in fields), "") for part, known in _NAMES.items()}
    if missing := [part for part, name in names.items() if not name]:
        unknown = f"{_UNKNOWN}: " if len(missing) == len(names) else ""
        raise InputError(
            f"{unknown}no {', '.join(missing)}; expected K1 D1 K2 D2 R T (or M1 ..., cameraMatrix1 ...) as OpenCV, "
            "camera_matrix or k, d, r, p as ROS, cam0 as Kalibr, K_02 as KITTI, or [LEFT_CAM_HD] as ZED"
        )
    size = None
    if {"image_width", "image_height"} <= set(fields):
        size = image_sides([fields["image_width"], fields["image_height"]], "image_width, image_height")
    elif "imageSize" in fields:
        size = image_sides(_field(fields, "imageSize").tolist(), "imageSize")
    left, right = (_camera(fields, names[f"K{n}"], names[f"D{n}"], size, fisheye) for n in (1, 2))
    turn = _field(fields, names["R"])
    if turn.size != 9:  # a rotation vector
        turn = np.asarray(cv2.Rodrigues(numbers(turn.tolist(), names["R"], (3,)))[0], np.float64)
    return Rig(left, right, turn.reshape(3, 3), _field(fields, names["T"], (3,)))


def _kitti_rig(fields: dict[str, str], cameras: tuple[int, int]) -> Rig:
    """Return the rig of two of KITTI's cameras, each of which has its place relative to camera 0."""
    sizes = [image_sides(fields.get(f"S_0{n}"), f"S_0{n}") for n in cameras]
    left, right = (_camera(fields, f"K_0{n}", f"D_0{n}", size) for n, size in zip(cameras, sizes, strict=True))
    turns = [_field(fields, f"R_0{n}", (3, 3)) for n in cameras]
    shifts = [_field(fields, f"T_0{n}", (3,)) for n in cameras]
    rotation = turns[1] @ turns[0].T
    return Rig(left, right, rotation, shifts[1] - rotation @ shifts[0])


def _kalibr_rig(file: dict[str, Any]) -> Rig:
    """Return the rig of Kalibr's camchain of two pinhole cameras."""
    cameras = []
    for name in ("cam0", "cam1"):
        fields = file.get(name)
        if not isinstance(fields, dict):
            raise InputError(f"no {name}; expected a camchain of two cameras")
        with naming(name):
            model, lens = str(fields.get("camera_model")), str(fields.get("distortion_model"))
            if model != "pinhole" or lens not in _KALIBR:
                raise InputError(f"{model}, {lens}: expected pinhole with {', '.join(_KALIBR)}")
            matrix = Intrinsics(*_field(fields, "intrinsics", (4,))).matrix
            distortion = np.zeros(4) if lens == "none" else _field(fields, "distortion_coeffs", (4,))
            size = image_sides(fields.get("resolution"), "resolution")
            cameras.append(Camera(matrix, tuple(distortion.tolist()), size, _KALIBR[lens]))
    with naming("cam1"):
        place = _field(file["cam1"], "T_cn_cnm1", (4, 4))
    return Rig(cameras[0], cameras[1], place[:3, :3], place[:3, 3])


def _ros_rig(files: Sequence[dict[str, Any]]) -> Rig:
    """Return the rig of the left and the right camera_info of ROS, from what they say about the rectified pair."""
    if len(files) != 2:
        raise InputError("one camera_info; give the left and the right one: --calibration L --calibration R")
    cameras, rotations = [], []
    for name, fields in zip(("left", "right"), files, strict=True):
        with naming(name):
            model = str(fields.get("distortion_model", "plumb_bob"))
            if model not in _ROS:
                raise InputError(f"distortion_model {model}: expected {', '.join(_ROS)}")
            size = image_sides([fields.get("image_width"), fields.get("image_height")], "image_width, image_height")
            cameras.append(_camera(fields, "camera_matrix", "distortion_coefficients", size, _ROS[model]))
            rotations.append(_field(fields, "rectification_matrix", (3, 3)))
    with naming("right"):
        projection = _field(files[1], "projection_matrix", (3, 4))
        if projection[0, 0] <= 0 or projection[0, 3] == 0:
            raise InputError(
                "projection_matrix holds no baseline; is it the camera_info of a stereo pair, the left one first?"
            )
    shift = np.array([projection[0, 3] / projection[0, 0], projection[1, 3] / projection[1, 1], 0.0])
    # Both frames map to the rectified frame: R' x' = R x + shift.
    return Rig(cameras[0], cameras[1], rotations[1].T @ rotations[0], rotations[1].T @ shift)


def _zed_rig(text: str, size: tuple[int, int] | None) -> Rig:
    """Return the cameras for images of ``size`` (None: the file's first size) from a Stereolabs ini file.

    ``Baseline`` is the distance to the right camera, ``TY`` and ``TZ`` are as in OpenCV, and ``RX``, ``CV``, ``RZ`` are
    the rotation vector.
    """
    parser = configparser.ConfigParser(strict=False, interpolation=None, comment_prefixes=("#", ";"))
    try:
        parser.read_string(text)
    except configparser.Error as error:
        raise InputError(f"{_UNKNOWN} ({' '.join(str(error).split())[:200]})") from error
    sections = {name.upper(): dict(parser[name]) for name in parser.sections()}
    there = [name.removeprefix("LEFT_CAM_") for name in sections if name.startswith("LEFT_CAM_")]
    known = [name for name in there if name in _ZED_SIZES and f"RIGHT_CAM_{name}" in sections]
    if not known or "STEREO" not in sections:
        raise InputError("expected the sections LEFT_CAM_HD, RIGHT_CAM_HD (or of another size) and STEREO of a ZED")
    mode = next((name for name in known if _ZED_SIZES[name] == size), known[0] if size is None else "")
    if not mode:
        sizes = ", ".join(f"{_ZED_SIZES[name][0]} x {_ZED_SIZES[name][1]}" for name in known)
        raise InputError(f"has cameras for images of {sizes}, got {size[0] if size else 0} x {size[1] if size else 0}")
    stereo, cameras = sections["STEREO"], []
    for side in ("LEFT", "RIGHT"):
        fields = sections.get(f"{side}_DISTO", {}) | sections[f"{side}_CAM_{mode}"]
        with naming(f"{side}_CAM_{mode}"):
            matrix = Intrinsics(*(_number(fields, key) for key in ("fx", "fy", "cx", "cy"))).matrix
            lens = [float(_field({"0": "0"} | fields, key if key in fields else "0")[0]) for key in _ZED_LENS]
            fisheye = "k4" in fields and "p1" not in fields
            kept = [lens[k] for k in (0, 1, 4, 5)] if fisheye else lens[: 8 if any(lens[5:]) else 5]
            cameras.append(Camera(matrix, tuple(kept), _ZED_SIZES[mode], fisheye))
    with naming("STEREO"):

        def value(key: str) -> float:
            name = next((each for each in (f"{key}_{mode}".lower(), key.lower()) if each in stereo), "")
            return _number(stereo, name) if name else 0.0

        shift = np.array([-_number(stereo, "baseline"), value("TY"), value("TZ")])
        turn = np.asarray(cv2.Rodrigues(np.array([value(key) for key in ("RX", "CV", "RZ")]))[0], np.float64)
    return Rig(cameras[0], cameras[1], turn, shift)


def _middlebury_geometry(fields: dict[str, str], meters: float) -> PairGeometry:
    left = _field(fields, "cam0", (3, 3))
    offset = _number(fields, "doffs") if "doffs" in fields else float(_field(fields, "cam1", (3, 3))[0, 2] - left[0, 2])
    size = None
    if "width" in fields and "height" in fields:
        size = image_sides(f"{fields['width']} {fields['height']}", "width, height")
    return PairGeometry(Intrinsics.of_matrix(left), _number(fields, "baseline") * meters, offset, size)


def _booster_geometry(fields: dict[str, Any], meters: float) -> PairGeometry:
    projections = []
    for name in ("proj_matL", "proj_matR"):  # (3, 3), (3, 4) or (4, 4)
        values = _field(fields, name)
        if values.size not in (9, 12, 16):
            raise InputError(f"{name}: expected a projection of 3 x 4 numbers (got {values.size})")
        projections.append(values.reshape(-1, 3 if values.size == 9 else 4))
    left, right = projections
    baseline = _number(fields, "baselineLR") * meters
    return PairGeometry(Intrinsics.of_matrix(left), baseline, float(right[0, 2] - left[0, 2]))


def _kitti_geometry(fields: dict[str, str], reading: Reading) -> PairGeometry:
    cameras = reading.cameras
    is_raw = any(key.startswith("P_rect_") for key in fields)
    left, right = (_field(fields, f"P_rect_{n:02}" if is_raw else f"P{n}", (3, 4)) for n in cameras)
    rectified = f"S_rect_{cameras[0]:02}"
    size = image_sides(fields[rectified], rectified) if fields.get(rectified) else None
    return _of_projections(left, right, size, reading.meters())


def _projected(files: Sequence[dict[str, Any]], size: tuple[int, int] | None, meters: float) -> PairGeometry | None:
    """Return the geometry from the rectified cameras' projections in ROS's or OpenCV's files, or None."""
    if files and "camera_matrix" in files[0]:
        left, right = (_field(fields, "projection_matrix", (3, 4)) for fields in files)
        return _of_projections(left, right, size, meters)
    fields = {key: value for file in files for key, value in file.items()}
    if not {"P1", "P2"} <= fields.keys():
        return None
    left, right = (_field(fields, name, (3, 4)) for name in ("P1", "P2"))
    return _of_projections(left, right, size, meters)


def _of_projections(
    left: NDArray[np.float64], right: NDArray[np.float64], size: tuple[int, int] | None, meters: float = 1.0
) -> PairGeometry:
    if abs(left[0, 0]) < 1e-9 or abs(right[0, 0]) < 1e-9:
        raise InputError("a camera without focal length")
    baseline = float(left[0, 3] / left[0, 0] - right[0, 3] / right[0, 0]) * meters
    return PairGeometry(Intrinsics.of_matrix(left), baseline, float(right[0, 2] - left[0, 2]), size)

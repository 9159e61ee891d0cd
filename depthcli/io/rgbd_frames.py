"""Load RGB-D frames and their ground truth from the files of a scene."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Camera, Intrinsics, off_center, sensor_fb
from depthcli.core.cameras.color_and_depth import ColorAndDepth, registered
from depthcli.core.color_and_infrared import RgbIrFrame
from depthcli.core.errors import InputError
from depthcli.core.frames import RgbdFrame, SparseFrame, infrared_image
from depthcli.io.formats.calibrations import read_color_infrared_rig
from depthcli.io.formats.depth import check_fb, codes_of, read_depth
from depthcli.io.formats.disparity import read_filled_mask, read_plane
from depthcli.io.formats.files import naming, read_bytes, shown, warn
from depthcli.io.formats.images import image_size, read_color8, read_image
from depthcli.io.formats.plain_text import json_object, numbers
from depthcli.io.scenes import RgbdScene, RgbIrScene, check_same_size
from depthcli.io.scenes.kinds import distortion_map, read_masks

TRANSPARENT = "transparent"
"""Name of the mask of transparent objects."""

UNKNOWN_CODE = 2047
"""Raw code of a pixel without depth, the largest of 11 bits."""

_FIELDS: dict[str, tuple[int, ...]] = dict.fromkeys(("depth_K", "color_K", "depth_to_color_R"), (3, 3))
_FIELDS |= {"depth_kc": (5,), "color_kc": (5,), "depth_to_color_t": (3,), "dc": (2,), "dc_alpha": (2,)}


@dataclass(frozen=True)
class RgbdTruth:
    """Ground truth of a frame."""

    depth: NDArray[np.float32]  # (H, W) float32, meters, NaN = unknown
    masks: dict[str, NDArray[np.bool_]] = field(default_factory=dict)  # name -> (H, W) bool, True = evaluate
    fb: float | None = None  # focal length x baseline, pixel meters; None: errors in pixels have no meaning


def frame_size(scene: RgbdScene) -> tuple[int, int]:
    """Return (height, width) of the frame from an image's header. Raise InputError if it cannot be read."""
    return image_size(scene.image)


def check_center(where: object, camera: Intrinsics | None, shape: tuple[int, ...]) -> None:
    """Warn if a camera's center suggests images of another size than ``shape``."""
    if camera is not None and (doubt := off_center(camera, (shape[1], shape[0]))):
        warn(f"{where}: {doubt}")


def load_frame(scene: RgbdScene) -> RgbdFrame:
    """Return color with depth in meters, registered to the color and of its size, or only depth without color."""
    scene.check()
    color_camera, depth_camera = (
        None if each is None else Intrinsics(*each) for each in (scene.intrinsics, scene.depth_intrinsics)
    )
    if scene.color is None:
        known = color_camera or depth_camera
        frame = RgbdFrame.without_color(_visible_depth(scene), scene.fb or sensor_fb(known), known)
        check_center(f"{scene.depth}: intrinsics", known, frame.shape)
    elif scene.raw:
        frame = _registered_raw(scene, read_color8(scene.color))
    else:
        color, depth = read_color8(scene.color), _visible_depth(scene)
        check_center(f"{scene.color}: intrinsics", color_camera, color.shape)
        check_center(f"{scene.depth}: depth_intrinsics", depth_camera, depth.shape)
        with naming(scene.depth):
            found = registered(depth, color.shape[:2], color_camera, depth_camera, scene.depth_to_color)
        if found.note:
            warn(f"{scene.depth}: {found.note}")
        fb = scene.fb or sensor_fb(color_camera)
        frame = RgbdFrame(color, found.depth, fb, color_camera, found.interpolated, _pose(scene))
    if not np.isfinite(frame.depth).any():
        raise InputError(f"{scene.depth}: no pixel has a depth")
    if scene.fb:
        check_fb(scene.folder / "meta.json", scene.fb, frame.depth)
    return frame


def load_masked_frame(scene: RgbdScene) -> SparseFrame:
    """Return the frame with the mask of its transparent objects and an empty sparse depth map."""
    frame = _color_frame(scene)
    if (file := scene.masks.get(TRANSPARENT)) is None:
        raise InputError(
            f"{scene.folder}: {scene.name} has no mask of the objects (mask_{TRANSPARENT}.*, 255 inside), which this "
            "config needs"
        )
    objects = read_filled_mask(file)
    check_same_size(file, objects.shape, scene.image, frame.shape)
    if not (np.isfinite(frame.depth) & ~objects).any():
        raise InputError(f"{scene.depth}: no pixel outside of {file.name} has a depth")
    return _sparse_frame(frame, sparse=np.full(frame.shape, np.nan, np.float32), objects=objects)


def _color_frame(scene: RgbdScene) -> RgbdFrame:
    frame = load_frame(scene)
    if scene.color is None:
        raise InputError(f"{scene.depth}: no color image beside it, which transparent objects need")
    return frame


def _sparse_frame(frame: RgbdFrame, **maps: NDArray[Any] | None) -> SparseFrame:
    return SparseFrame(frame.color, frame.depth, frame.fb, frame.intrinsics, frame.interpolated, **maps)  # type: ignore[arg-type]


def load_sparse_frame(scene: RgbdScene) -> SparseFrame:
    """Return the frame with its second, sparse depth."""
    frame = _color_frame(scene)
    if scene.sparse is None:
        raise InputError(
            f"{scene.folder}: {scene.name} has no sparse depth (sparse.*); with a mask of the objects "
            f"(mask_{TRANSPARENT}.*) preset sensor does without"
        )
    sparse, confidence = _read_depth(scene, scene.sparse), None
    check_same_size(scene.sparse, sparse.shape, scene.image, frame.shape)
    if scene.sparse_confidence is not None:
        plane = read_plane(scene.sparse_confidence)
        check_same_size(scene.sparse_confidence, plane.shape, scene.image, frame.shape)
        confidence = (plane / (np.iinfo(plane.dtype).max if plane.dtype.kind in "iu" else 1)).astype(np.float32)
    if not np.isfinite(sparse).any():
        raise InputError(f"{scene.sparse}: no pixel has a depth")
    return _sparse_frame(frame, sparse=sparse, sparse_confidence=confidence)


def load_infrared_frame(scene: RgbIrScene) -> RgbIrFrame:
    """Return the frame with its infrared image and calibration."""
    frame = load_frame(scene)
    if scene.calibration is None:
        raise InputError(f"{scene.folder}: no calibration of the color and the infrared camera (calib.json)")
    file = scene.infrared_plain or scene.infrared
    infrared = infrared_image(read_image(file))
    height, width = infrared.shape
    rig = read_color_infrared_rig(scene.calibration, (frame.shape[1], frame.shape[0]), (width, height))
    if not isinstance(rig, float):
        return RgbIrFrame(frame.color, infrared, frame.depth, rig)
    check_same_size(file, infrared.shape, scene.image, frame.shape, "; a rectified pair has one size")
    check_fb(scene.calibration, rig, frame.depth)
    return RgbIrFrame(frame.color, infrared, frame.depth, None, rig)


def true_depth(scene: RgbdScene) -> RgbdTruth:
    """Return ground truth depth and masks. Raise InputError if there is none or sizes differ."""
    scene.check()
    if scene.depth_true is None:
        raise InputError(f"{scene.folder}: {scene.name} has no true depth")
    depth = _read_depth(scene, scene.depth_true, scene.invalid)
    masks = read_masks(scene.masks, scene.depth_true, depth.shape)
    if scene.fb:
        check_fb(scene.folder / "meta.json", scene.fb, depth)
    return RgbdTruth(depth, masks, scene.fb)


def _read_depth(scene: RgbdScene, path: Path, invalid: float | None = None) -> NDArray[np.float32]:
    # If the sensor's map has integer codes, the scale is theirs, and a floating-point map is in meters.
    floats = scene.scale_floats and (path == scene.depth or read_plane(scene.depth).dtype.kind == "f")
    rotate = 3 if scene.rotated else 0
    return read_depth(path, scene.depth_scale, rotate=rotate, invalid=invalid, scale_floats=floats)


def _visible_depth(scene: RgbdScene) -> NDArray[np.float32]:
    """Return the depth without the pixels of ``scene.hidden``."""
    depth = _read_depth(scene, scene.depth)
    if scene.hidden is None:
        return depth
    mask = read_filled_mask(scene.hidden)
    check_same_size(scene.hidden, mask.shape, scene.depth, depth.shape)
    return np.where(mask, np.float32(np.nan), depth)


def _pose(scene: RgbdScene) -> NDArray[np.float64] | None:
    return None if scene.pose is None else np.array(scene.pose).reshape(4, 4)


def _registered_raw(scene: RgbdScene, color: NDArray[np.uint8]) -> RgbdFrame:
    """Return color, reduced to about the depth camera's resolution, with raw depth registered to it."""
    raw = read_kinect_raw(scene.depth)
    calibration = kinect_v1() if scene.calibration is None else read_kinect_calibration(scene.calibration)
    if calibration.beta is not None and calibration.beta.shape != raw.shape:
        raise InputError(f"{scene.calibration}: its distortion map is not of the depth image's size")
    for name, one, image in (("color", calibration.color, color), ("depth", calibration.depth, raw)):
        check_center(f"{scene.calibration or 'calibration'}: {name}", one.intrinsics, image.shape)
    # Most pixels of a color image with a higher resolution would get no depth.
    ratio = calibration.color.matrix[0, 0] / calibration.depth.matrix[0, 0]
    factor = 1.0 if ratio < 1.5 else 1.0 / round(ratio)
    if factor != 1:
        color = cv2.resize(color, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
    camera = calibration.color.scaled(factor)
    scaled = replace(calibration, color=camera)
    depth = scaled.register(scaled.depth_of_raw(raw), (color.shape[0], color.shape[1]))
    return RgbdFrame(color, depth, scene.fb or sensor_fb(camera.intrinsics), camera.intrinsics, False, _pose(scene))


@dataclass(frozen=True)
class KinectCalibration(ColorAndDepth):
    """Both cameras of a first-generation Kinect and how its raw codes become depth.

    The plain model is triangulation, ``Z = Zr / (1 + Zr / (f b) d)`` (thesis, equation 1.1), with the shift ``d``
    counted in raw codes: ``1 / Z = (offset - raw) / factor``. The calibrated one (Herrera et al., TPAMI 2012) corrects
    the codes first: ``raw + beta(x, y) exp(alpha_0 - alpha_1 raw)``.
    """

    offset: float = 1092.5  # raw code of infinite depth
    factor: float = 351.3  # codes x meters
    beta: NDArray[np.float64] | None = None  # (H, W) spatial distortion of the codes, or None for the plain model
    alpha: tuple[float, float] = (0.0, 0.0)  # by which the distortion decays with the code

    def depth_of_raw(self, raw: NDArray[np.uint16]) -> NDArray[np.float32]:
        """Return the depth of raw codes (0 to 2046; 2047 = unknown), (H, W) float32, meters, NaN = unknown."""
        codes = raw.astype(np.float64)
        if self.beta is not None:
            codes += self.beta * np.exp(self.alpha[0] - self.alpha[1] * codes)
        with np.errstate(divide="ignore"):
            depth = self.factor / (self.offset - codes)
        depth[(raw >= UNKNOWN_CODE) | ~(depth > 0) | ~np.isfinite(depth)] = np.nan
        return depth.astype(np.float32)


def kinect_v1() -> KinectCalibration:
    """Return a typical calibration, from the NYU Depth v2 recordings (Silberman et al., ECCV 2012)."""
    depth = Camera(
        np.array([[582.62448167737955, 0, 313.04475870804731], [0, 582.69103270988637, 238.44389626620386], [0, 0, 1]]),
        (-0.09989723655308448, 0.39065324602765344, 0.0019290592870229277, -0.0019422022475975055, -0.5103172505340058),
    )
    color = Camera(
        np.array([[518.85790117450188, 0, 325.58244941119034], [0, 519.46961112127485, 253.73616633400465], [0, 0, 1]]),
        (0.20796615318809061, -0.58613825163911781, 0.00072231363135888329, 0.0010479627195765181, 0.49856986684705107),
    )
    rows = (
        (0.99997798940829263, 0.0050518419386157446, 0.0043011152014118693),
        (-0.0050359919480810989, 0.99998051861143999, -0.0036879781309514218),
        (-0.0043196624923060242, 0.0036662365748484798, 0.99998394948385538),
    )
    rotation = np.array(rows)
    translation = np.array([-0.025031875059141302, 0.00029342312935846411, -0.00066238747008330102])
    return KinectCalibration(depth, color, rotation.T, translation)


def read_kinect_raw(path: Path | str) -> NDArray[np.uint16]:
    """Return (H, W) uint16 raw codes 0 to 2047, from files of either byte order."""
    raw = codes_of(read_plane(path), path)
    if raw.max() > UNKNOWN_CODE:  # wrong byte order
        raw = raw.byteswap()
    if raw.max() > UNKNOWN_CODE:
        raise InputError(f"{shown(path)}: codes up to {int(raw.max())}, a Kinect's go to {UNKNOWN_CODE}")
    return raw


def read_kinect_calibration(path: Path) -> KinectCalibration:
    """Return a calibration of Herrera et al.'s toolbox from JSON, with the distortion map ``dc_beta.npy`` if any."""
    with naming(path):
        fields = json_object(read_bytes(path))
        arrays = {key: numbers(fields.get(key), key, shape) for key, shape in _FIELDS.items()}
        if arrays["dc"][1] == 0 or min(arrays[k][i, i] for k in ("depth_K", "color_K") for i in (0, 1)) <= 0:
            raise InputError("singular: focal lengths and dc[1] must not be zero")
        depth, color = (Camera(arrays[f"{n}_K"], tuple(arrays[f"{n}_kc"].tolist())) for n in ("depth", "color"))
    beta = distortion_map(path)
    start, slope = arrays["dc"].tolist()
    one, other = arrays["dc_alpha"].tolist()
    return KinectCalibration(
        depth, color, arrays["depth_to_color_R"], arrays["depth_to_color_t"], offset=-start / slope,
        factor=-1.0 / slope, beta=None if beta is None else read_plane(beta).astype(np.float64), alpha=(one, other),
    )  # fmt: skip

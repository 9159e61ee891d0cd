"""Cameras and rigs from the corners of a board in many photos (Zhang's method, by OpenCV), without outliers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.calibration.boards import MIN_CORNERS, Board, Corners
from depthcli.algorithms.filters import single_thread
from depthcli.core.cameras.camera import Camera
from depthcli.core.cameras.rig import Rig
from depthcli.core.errors import InputError

MIN_PHOTOS = 3
"""Fewest photos that a camera is found from."""

MIN_TILT = 15.0
"""Degrees between the board in two photos below which the focal length is not determined."""

OUTLIER_PX = 0.3
"""Errors up to this, pixels, are those of good photos, however small those of the others are."""

_OUTLIER_DEVIATIONS = 3.0
_DEVIATION = 1.4826  # median absolute deviations to standard deviations
_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-9)
_cv2: Any = cv2  # its stubs know the lists neither of cv2 nor of cv2.fisheye
_FISHEYE_FLAGS: Any = cv2 if hasattr(cv2, "CALIB_RECOMPUTE_EXTRINSIC") else cv2.fisheye  # OpenCV 5 and 4
_FISHEYE = _FISHEYE_FLAGS.CALIB_RECOMPUTE_EXTRINSIC | _FISHEYE_FLAGS.CALIB_FIX_SKEW
_NOT_FOUND = "the photos do not determine the camera; take some with the board tilted"


ResultT = TypeVar("ResultT", bound="CameraFit | RigFit")
Size = tuple[int, int]


@dataclass(frozen=True)
class CameraFit:
    """A camera, and how well the photos agree with it.

    Attributes
    ----------
    camera : what was found
    focal_deviations : standard deviations of fx and fy, pixels; None for fisheye lenses, and where the tilt is below
        ``MIN_TILT``: then the equations are nearly singular, and what they say of their errors is too little
    errors : name of a photo -> root mean square of its reprojection errors, pixels; outliers are not among them
    residuals : name -> (N, 2), pixels
    tilt : largest angle between the board in two photos, degrees
    outliers : name -> error, of the photos that were left out
    """

    camera: Camera
    focal_deviations: tuple[float, float] | None
    errors: dict[str, float]
    residuals: dict[str, NDArray[np.float64]]
    tilt: float
    outliers: dict[str, float]

    @property
    def error(self) -> float:
        """Root mean square of all reprojection errors, pixels."""
        return _rms(np.concatenate(list(self.residuals.values())))


@dataclass(frozen=True)
class RigFit:
    """Two cameras, and how well the pairs agree with them.

    Attributes
    ----------
    rig : what was found
    errors : name of a pair -> the larger reprojection error of its views with one place of the board for both, pixels
    outliers : name -> error, of the pairs that were left out
    """

    rig: Rig
    errors: dict[str, float]
    outliers: dict[str, float]


def fit_camera(board: Board, photos: dict[str, Corners], size: Size, fisheye: bool) -> CameraFit:
    """Return the camera that took the photos, without those whose error is an outlier.

    A photo is one if its error is above 0.3 pixels, and above the median of all by 3 standard deviations, which are
    estimated from the median of absolute deviations. The worst one is left out and the camera found anew, until there
    is none or half of the photos are left.

    Parameters
    ----------
    photos : name -> corners
    size : (width, height) of the photos

    Raises
    ------
    InputError
        Fewer than three photos, or they do not determine the camera.
    """
    with single_thread():  # OpenCV's solvers sum over threads as those come
        return _without_outliers(photos, lambda used: _fit_camera(board, used, size, fisheye))


def fit_rig(board: Board, pairs: dict[str, tuple[Corners, Corners]], cameras: tuple[Camera, Camera]) -> RigFit:
    """Return the rig of two cameras, whose lenses are refined by the pairs, without those that are outliers.

    Outliers are found with the lenses as given, by the rule of :func:`fit_camera`: pairs of photos that do not belong
    together, or between which the board was moved.

    Raises
    ------
    InputError
        Fewer than three pairs, or they do not determine the rig.
    """
    common = {name: _common(left, right) for name, (left, right) in pairs.items()}
    usable = {name: pair for name, pair in common.items() if len(pair[0]) >= MIN_CORNERS}
    with single_thread():
        rough = _without_outliers(usable, lambda used: _fit_rig(board, used, cameras, False))
        fine = _fit_rig(board, {name: usable[name] for name in rough.errors}, cameras, True)
    return RigFit(fine.rig, fine.errors, rough.outliers)


def _without_outliers(photos: dict[str, Any], fit: Callable[[dict[str, Any]], ResultT]) -> ResultT:
    used, outliers = dict(photos), dict[str, float]()
    min_used = max(MIN_PHOTOS, (len(photos) + 1) // 2)
    if len(used) < MIN_PHOTOS:
        raise InputError(f"{len(used)} usable; at least {MIN_PHOTOS} are needed, better 15 or more")
    while True:
        found = fit(used)
        errors = np.array(list(found.errors.values()))
        middle = float(np.median(errors))
        spread = _DEVIATION * float(np.median(np.abs(errors - middle)))
        worst = max(found.errors, key=lambda name: found.errors[name])
        if found.errors[worst] <= max(middle + _OUTLIER_DEVIATIONS * spread, OUTLIER_PX) or len(used) <= min_used:
            found.outliers.update(outliers)
            return found
        outliers[worst] = found.errors[worst]
        del used[worst]


def _fit_camera(board: Board, photos: dict[str, Corners], size: Size, fisheye: bool) -> CameraFit:
    objects, pixels = _arrays(board, photos.values())
    deviations = None
    try:
        if fisheye:
            _, matrix, lens, turns, shifts = _cv2.fisheye.calibrate(
                [each[None].astype(np.float64) for each in objects],
                [each[None].astype(np.float64) for each in pixels],
                size,
                np.zeros((3, 3)),
                np.zeros((4, 1)),
                flags=_FISHEYE,
                criteria=_CRITERIA,
            )
        else:
            _, matrix, lens, turns, shifts, spread, _, _ = _cv2.calibrateCameraExtended(
                objects, pixels, size, np.eye(3), np.zeros(5), criteria=_CRITERIA
            )
            deviations = float(spread[0, 0]), float(spread[1, 0])
        camera = Camera(np.asarray(matrix, np.float64), tuple(np.ravel(lens).tolist()), size, fisheye)
    except (cv2.error, InputError) as error:
        raise InputError(_NOT_FOUND) from error
    residuals = {
        name: _projected(camera, points, np.asarray(turn), np.asarray(shift)) - seen
        for (name, points, seen, turn, shift) in zip(photos, objects, pixels, turns, shifts, strict=True)
    }
    normals = np.stack([cv2.Rodrigues(np.asarray(turn))[0][:, 2] for turn in turns])
    tilt = float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1)).max()))
    errors = {name: _rms(each) for name, each in residuals.items()}
    if tilt < MIN_TILT:
        deviations = None
    return CameraFit(camera, deviations, errors, residuals, tilt, {})


def _fit_rig(
    board: Board, pairs: dict[str, tuple[Corners, Corners]], cameras: tuple[Camera, Camera], refine: bool
) -> RigFit:
    objects, left = _arrays(board, (pair[0] for pair in pairs.values()))
    _, right = _arrays(board, (pair[1] for pair in pairs.values()))
    lenses = [each for camera in cameras for each in (camera.matrix.copy(), camera.coefficients.copy())]
    size = cameras[0].size
    assert size is not None
    try:
        if cameras[0].fisheye:
            flags = (
                _FISHEYE_FLAGS.CALIB_USE_INTRINSIC_GUESS if refine else _FISHEYE_FLAGS.CALIB_FIX_INTRINSIC
            ) | _FISHEYE
            parts = _cv2.fisheye.stereoCalibrate(
                *([each[None].astype(np.float64) for each in views] for views in (objects, left, right)),
                *lenses,
                size,
                flags=flags,
                criteria=_CRITERIA,
            )
        else:
            flags = cv2.CALIB_USE_INTRINSIC_GUESS if refine else cv2.CALIB_FIX_INTRINSIC
            parts = _cv2.stereoCalibrate(objects, left, right, *lenses, size, flags=flags, criteria=_CRITERIA)
        found = [
            Camera(np.asarray(matrix, np.float64), tuple(np.ravel(lens).tolist()), camera.size, camera.fisheye)
            for matrix, lens, camera in ((*parts[1:3], cameras[0]), (*parts[3:5], cameras[1]))
        ]
        rig = Rig(found[0], found[1], np.asarray(parts[5], np.float64), np.asarray(parts[6], np.float64).ravel())
    except (cv2.error, InputError) as error:
        raise InputError("the pairs do not determine where the cameras stand") from error
    errors = {name: max(_pair_errors(rig, *views)) for name, *views in zip(pairs, objects, left, right, strict=True)}
    return RigFit(rig, errors, {})


def _pair_errors(
    rig: Rig, points: NDArray[np.float32], left: NDArray[np.float32], right: NDArray[np.float32]
) -> tuple[float, float]:
    """Return the errors of both views when the board lies where the left view shows it, in pixels."""
    rays = rig.left.rays(left)
    _, turn, shift = cv2.solvePnP(points.astype(np.float64), rays[:, None], np.eye(3), np.zeros(5))
    placed = points.astype(np.float64) @ cv2.Rodrigues(turn)[0].T + shift.ravel()
    in_right = placed @ rig.rotation.T + rig.translation
    zero = np.zeros(3)
    return (
        _rms(_projected(rig.left, placed, zero, zero) - left),
        _rms(_projected(rig.right, in_right, zero, zero) - right),
    )


def _common(left: Corners, right: Corners) -> tuple[Corners, Corners]:
    """Return the corners that both views show."""
    ids = np.intersect1d(left.ids, right.ids)
    one, other = (Corners(ids, each.pixels[np.isin(each.ids, ids)]) for each in (left, right))
    return one, other


def _arrays(board: Board, views: Any) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]]:
    listed: Sequence[Corners] = list(views)
    return [board.points[each.ids] for each in listed], [each.pixels.astype(np.float32) for each in listed]


def _projected(
    camera: Camera, points: NDArray[Any], turn: NDArray[np.float64], shift: NDArray[np.float64]
) -> NDArray[np.float64]:
    project = cv2.fisheye.projectPoints if camera.fisheye else cv2.projectPoints
    pixels, _ = project(points.astype(np.float64)[:, None], turn, shift, camera.matrix, camera.coefficients)
    return np.asarray(pixels, np.float64).reshape(-1, 2)


def _rms(residuals: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))

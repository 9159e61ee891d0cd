"""Calibration of cameras and rigs from photos of a board, without outliers (Zhang's method, by OpenCV)."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.filters import single_thread
from depthcli.core.cameras.camera import Camera
from depthcli.core.cameras.rig import Rig
from depthcli.core.errors import InputError
from depthcli.core.maps import Doubles, Floats, Image8, Mask

MIN_CORNERS = 6  # smallest number of corners in a photo; four fit any camera
MIN_PHOTOS = 3  # smallest number of photos of a camera
MIN_TILT = 15.0  # degrees; with a smaller tilt between any two photos, the focal length is not determined
OUTLIER_PX = 0.3  # a photo with an error up to this is no outlier, however small the other errors are
MAX_ERROR_RATIO = 3.0  # error of the rig / error of its cameras alone (or 0.3 px); above, the rig does not fit
SIMILAR_ERROR_RATIO = 2.0  # error of the rig / error of its cameras alone; above, its lengths must hardly change

_WINDOW = 0.25  # half the window in which a corner's edges are fitted, share of the spacing of corners
_BLUR = (0.4, 0.2)  # standard deviation, pixels: constant, and per pixel of half the window; smooths stairs along edges
_AGREEMENT = 0.15  # largest difference between the corners of two windows, pixels
_MIN_WINDOW, _MAX_WINDOW = 3, 25  # half of windows, pixels; smaller windows have too few pixels
_REFINEMENT = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
_OUTLIER_DEVIATIONS = 3.0
_MAX_CHANGE = 1.05  # largest factor between focal lengths and baselines with refined and with the cameras' own lenses
_MAX_UNCERTAINTY = 0.05  # largest relative standard deviation of the focal length of a determined camera
_MIN_NOISE = 0.05  # floor of the corners' noise, pixels: fits to few photos have smaller residuals
_MIN_MOVE = 0.005  # share of the image's width; views whose corners differ by less are the same view
_MIN_CONDITION = 1e-10  # smallest condition of solvable equations
_DEVIATION = 1.4826  # standard deviation / median absolute deviation
_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-9)
_cv2: Any = cv2  # its stubs lack the lists of cv2 and cv2.fisheye
_FISHEYE_FLAGS: Any = cv2 if hasattr(cv2, "CALIB_RECOMPUTE_EXTRINSIC") else cv2.fisheye  # OpenCV 5 and 4
_FISHEYE = _FISHEYE_FLAGS.CALIB_RECOMPUTE_EXTRINSIC | _FISHEYE_FLAGS.CALIB_FIX_SKEW
_NOT_FOUND = "the photos do not determine the camera; take some with the board tilted"


@dataclass(frozen=True)
class Corners:
    """The corners of a board in an image."""

    ids: NDArray[np.int64]  # (N,) int, indices of the corners on the board, row by row, ascending
    pixels: Doubles  # (N, 2) float64, x and y

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True)
class Board(ABC):
    """A plane with ``columns`` x ``rows`` corners where squares meet, ``square`` meters apart."""

    columns: int
    rows: int
    square: float

    @cached_property
    def points(self) -> Floats:
        """The corners (N, 3), row by row, meters, z = 0."""
        y, x = np.mgrid[: self.rows, : self.columns]
        return np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3).astype(np.float32) * np.float32(self.square)

    @property
    @abstractmethod
    def words(self) -> str:
        """Name of the board, for a message."""

    @abstractmethod
    def find(self, grey: Image8) -> Corners | None:
        """Return the corners in an (H, W) image; None if the board is not found."""

    def alike(self, left: Corners, right: Corners) -> Corners:
        """Return the right view's corners, numbered like the left view's corners."""
        return right

    def _refined(self, grey: Image8, corners: Corners, share: float) -> tuple[Doubles, Mask]:
        # Return the corners refined in a window, and whether a smaller window agrees. Half the window is ``share`` of
        # the smallest spacing of corners.
        places = np.full((self.rows * self.columns, 2), np.nan)
        places[corners.ids] = corners.pixels
        grid = places.reshape(self.rows, self.columns, 2)
        steps = np.concatenate([np.linalg.norm(np.diff(grid, axis=k), axis=-1).ravel() for k in (0, 1)])
        steps = steps[~np.isnan(steps)]
        half = int(share * steps.min()) if len(steps) else 0
        half = min(max(half, _MIN_WINDOW), _MAX_WINDOW)
        smooth = cv2.GaussianBlur(grey, (0, 0), _BLUR[0] + _BLUR[1] * half)
        start = np.ascontiguousarray(corners.pixels, np.float32).reshape(-1, 1, 2)
        wide, narrow = (
            cv2.cornerSubPix(smooth, start.copy(), (size, size), (-1, -1), _REFINEMENT).reshape(-1, 2)
            for size in (half, half - 1)
        )
        return np.asarray(wide, np.float64), np.asarray(np.abs(wide - narrow).max(axis=1) < _AGREEMENT, np.bool_)


class Chessboard(Board):
    """A plain chessboard, which is found as a whole or not at all.

    If one of the numbers of rows and columns is even and the other odd, the dark square at the first corner determines
    the orientation. Other boards look the same upside down: their first corner is the corner at the upper left of the
    image. In a second view, the first corner is chosen so that the board's rotation against the first view is smallest.
    """

    @property
    def words(self) -> str:
        return (
            f"a chessboard of {self.columns} x {self.rows} inner corners ({self.columns + 1} x {self.rows + 1} squares)"
        )

    def find(self, grey: Image8) -> Corners | None:
        found, pixels = cv2.findChessboardCornersSB(grey, (self.columns, self.rows), flags=_FLAGS)
        if not found or len(pixels) != self.columns * self.rows:
            return None
        ids = np.arange(self.columns * self.rows)
        refined, _ = self._refined(grey, Corners(ids, np.asarray(pixels, np.float64).reshape(-1, 2)), _WINDOW)
        grid = refined.reshape(self.rows, self.columns, 2)
        (ax, ay), (bx, by) = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
        if ax * by - ay * bx < 0:  # mirrored order; boards are printed on one side
            grid = grid[::-1]
        if (self.columns + self.rows) % 2:  # the square between the first four corners is dark
            centers = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
            x, y = (centers[..., k].astype(np.float32) for k in (0, 1))
            levels = cv2.remap(cv2.blur(grey, (3, 3)), x, y, cv2.INTER_LINEAR).astype(np.float64)
            first = np.indices(levels.shape).sum(axis=0) % 2 == 0
            grid = grid if levels[first].mean() < levels[~first].mean() else grid[::-1, ::-1]
        else:
            grid = self._turned(grid, np.array([1, 0.5]))
        return Corners(ids, grid.reshape(-1, 2))

    def alike(self, left: Corners, right: Corners) -> Corners:
        """Return the right view's corners in the order with the smallest rotation from the left view."""
        if (self.columns + self.rows) % 2:
            return right
        wanted, grid = (each.pixels.reshape(self.rows, self.columns, 2) for each in (left, right))
        return Corners(right.ids, self._turned(grid, _direction(wanted)).reshape(-1, 2))

    def _turned(self, grid: Doubles, axis: Doubles) -> Doubles:
        # Return the grid of corners, turned so that its rows are closest to the direction ``axis``.
        turns = range(0, 4, 1 if self.columns == self.rows else 2)
        return max((np.rot90(grid, k) for k in turns), key=lambda each: float(_direction(each) @ axis))


def _direction(grid: Doubles) -> Doubles:
    vector = grid[:, -1].mean(axis=0) - grid[:, 0].mean(axis=0)
    return np.asarray(vector / np.linalg.norm(vector), np.float64)


@dataclass(frozen=True)
class CharucoBoard(Board):
    """A chessboard with a marker in every light square; any part of it may be visible."""

    marker: float  # edge of a marker, meters
    dictionary: str  # name of OpenCV's dictionary of markers, without ``DICT_``

    @property
    def words(self) -> str:
        return f"a ChArUco board of {self.columns + 1} x {self.rows + 1} squares with markers of {self.dictionary}"

    def find(self, grey: Image8) -> Corners | None:
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))
        board = cv2.aruco.CharucoBoard((self.columns + 1, self.rows + 1), self.square, self.marker, markers)
        pixels, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
        if ids is None or len(ids) < MIN_CORNERS:
            return None
        numbers = np.asarray(ids, np.int64).ravel()
        order = np.argsort(numbers, kind="stable")
        found = Corners(numbers[order], np.asarray(pixels, np.float64).reshape(-1, 2)[order])
        # The window extends up to the nearest markers' edges; their corners are farther away.
        refined, sure = self._refined(grey, found, (self.square - self.marker) / 2 / self.square)
        numbers = found.ids[sure]  # a doubtful window contains a part of a marker
        n_lines = min(len(np.unique(numbers // self.columns)), len(np.unique(numbers % self.columns)))
        if len(numbers) < MIN_CORNERS or n_lines < 2:  # one line does not determine the plane
            return None
        return Corners(numbers, refined[sure])


def dictionaries() -> dict[str, int]:
    """Return the names of OpenCV's dictionaries of markers, without ``DICT_``, and the number of markers in each."""
    names = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_") and name.upper() == name)
    return {name[5:]: len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)).bytesList) for name in names}


ResultT = TypeVar("ResultT", bound="CameraFit | RigFit")
Size = tuple[int, int]


@dataclass(frozen=True)
class CameraFit:
    """A camera, and the errors of the photos."""

    camera: Camera  # the result
    # standard deviations of fx and fy, pixels; None for fisheye lenses, and if the tilt is below ``MIN_TILT``: then the
    # equations are nearly singular, and the deviations from them are too small
    focal_deviations: tuple[float, float] | None
    # name of a photo -> root mean square of its reprojection errors, pixels; without outliers
    errors: dict[str, float]
    residuals: dict[str, Doubles]  # name -> (N, 2), pixels
    tilt: float  # largest angle between the board in two photos, degrees
    outliers: dict[str, float]  # name of a photo that was left out -> error
    # relative standard deviation of the focal length, from the condition of all equations; infinite: undetermined
    focal_uncertainty: float = 0.0

    @property
    def error(self) -> float:
        """Root mean square of all reprojection errors, pixels."""
        return _rms(np.concatenate(list(self.residuals.values())))


@dataclass(frozen=True)
class RigFit:
    """Two cameras, and the errors of the pairs."""

    rig: Rig  # the result
    # name of a pair -> the larger reprojection error of its views, with one pose of the board for both, pixels
    errors: dict[str, float]
    outliers: dict[str, float]  # name of a pair that was left out -> error

    @property
    def error(self) -> float:
        """Root mean square of the errors of the pairs, pixels."""
        return float(np.sqrt(np.mean(np.square(list(self.errors.values())))))


def fit_camera(board: Board, photos: dict[str, Corners], size: Size, fisheye: bool) -> CameraFit:
    """Return the camera that took the photos of ``size`` (width, height), fitted without outliers.

    A photo is an outlier if its error exceeds 0.3 pixels and the median error by 3 standard deviations, estimated from
    the median absolute deviation. The worst outlier is left out and the camera fitted again, until there is no outlier
    or half of the photos are left. InputError: fewer than three distinct photos, or they do not determine the camera.
    """
    _check_distinct(photos.values(), size, "photos")
    with single_thread():  # OpenCV's solvers sum over threads in varying order
        fit = _without_outliers(photos, lambda used: _fit_camera(board, used, size, fisheye))
    _check_determined(fit, "photos")
    return fit


def _check_distinct(views: Iterable[Corners], size: Size, what: str) -> None:
    """Raise InputError if the views show the board in fewer than three poses, e.g. in copies of one photo."""
    views, distinct = list(views), list[Corners]()
    for view in views:
        if all(_is_another(view, other, size[0]) for other in distinct):
            distinct.append(view)
    if len(views) >= MIN_PHOTOS > len(distinct):
        raise InputError(
            f"{len(views)} {what} show the board at {len(distinct)} different places; at least {MIN_PHOTOS} are "
            "needed, better 15 or more, with the board tilted to all sides"
        )


def _check_determined(fit: CameraFit, what: str) -> None:
    if not fit.focal_uncertainty < _MAX_UNCERTAINTY:
        raise InputError(
            f"the {what} do not determine the camera: the focal length is {fit.camera.matrix[0, 0]:.4g} px with a "
            f"standard deviation of {100 * fit.focal_uncertainty:.2g} %; add {what} with the board tilted by 30 "
            "degrees or more, to all sides"
        )


def _is_another(one: Corners, other: Corners, width: int) -> bool:
    """Return whether two views show the board in different poses, judged by their common corners."""
    ids = np.intersect1d(one.ids, other.ids)
    if len(ids) < MIN_CORNERS:
        return True
    here, there = (each.pixels[np.isin(each.ids, ids)] for each in (one, other))
    return float(np.median(np.linalg.norm(here - there, axis=1))) > _MIN_MOVE * width


def fit_rig(board: Board, pairs: dict[str, tuple[Corners, Corners]], alone: tuple[CameraFit, CameraFit]) -> RigFit:
    """Return the rig of two cameras, with lenses refined by the pairs, fitted without outliers.

    ``alone`` are the cameras fitted to their own photos. With their lenses, outliers are removed by the rule of
    :func:`fit_camera`: pairs of photos that do not belong together, or between which the board was moved. InputError:
    there are fewer than three distinct pairs, they do not determine the rig, or the refined rig does not fit them. It
    does not fit if its error exceeds 3 times the error of the cameras alone (or 0.9 pixels, if larger). It also does
    not fit if its error exceeds twice the error of the cameras alone, and refinement changed a focal length or the
    baseline by more than 5 %.
    """
    usable = {}
    for name, pair in pairs.items():
        ids = np.intersect1d(pair[0].ids, pair[1].ids)
        if len(ids) >= MIN_CORNERS:
            left, right = (Corners(ids, view.pixels[np.isin(view.ids, ids)]) for view in pair)
            usable[name] = left, right
    cameras = alone[0].camera, alone[1].camera
    size = cameras[0].size
    assert size is not None
    _check_distinct((left for left, _ in usable.values()), size, "pairs")
    with single_thread():
        rough = _without_outliers(usable, lambda used: _fit_rig(board, used, cameras, False))
        for k, each in enumerate(alone):
            if each.errors.keys() - rough.errors.keys():  # there are fewer pairs than photos
                views = {name: usable[name][k] for name in rough.errors}
                _check_determined(_fit_camera(board, views, size, cameras[k].fisheye), "pairs")
        fine = _fit_rig(board, {name: usable[name] for name in rough.errors}, cameras, True)
    error = max(each.error for each in alone)
    if not fine.error <= MAX_ERROR_RATIO * max(error, OUTLIER_PX):
        raise InputError(
            f"the pairs do not fit two cameras at fixed places: they are off by {fine.error:.3g} px, each camera alone "
            f"by {error:.2f} px at most; were the photos of a pair taken at one moment, and is the board flat?"
        )
    change = float(np.exp(np.abs(np.log(_lengths(fine.rig) / _lengths(rough.rig))).max()))
    if fine.error > SIMILAR_ERROR_RATIO * error and change > _MAX_CHANGE:
        raise InputError(
            "the photos do not determine the cameras: focal lengths or baseline by pairs and by single photos differ "
            f"by a factor of {change:.3g}; add photos with the board tilted by 30 degrees or more"
        )
    return RigFit(fine.rig, fine.errors, rough.outliers)


def _lengths(rig: Rig) -> Doubles:
    """Return the focal lengths of both cameras, pixels, and the baseline, meters."""
    return np.array([*np.diag(rig.left.matrix)[:2], *np.diag(rig.right.matrix)[:2], rig.baseline])


def _without_outliers(photos: dict[str, Any], fit: Callable[[dict[str, Any]], ResultT]) -> ResultT:
    """Return the fit to the photos without outliers, which are removed one by one; at least half of them stay."""
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
    """Return the camera fitted to all photos. Raise InputError if they do not determine it."""
    objects, pixels = _arrays(board, photos.values())
    deviations = None
    try:
        if fisheye:
            start = np.zeros((3, 3)), np.zeros((4, 1))
            views = ([each[None].astype(np.float64) for each in points] for points in (objects, pixels))
            _, matrix, lens, turns, shifts = _cv2.fisheye.calibrate(
                *views, size, *start, flags=_FISHEYE, criteria=_CRITERIA
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
    noise = max(_rms(np.concatenate(list(residuals.values()))), _MIN_NOISE)
    uncertainty = noise * _focal_sensitivity(camera, objects, list(zip(turns, shifts, strict=True)))
    return CameraFit(camera, deviations, errors, residuals, tilt, {}, uncertainty)


def _focal_sensitivity(camera: Camera, objects: Sequence[Floats], poses: Sequence[tuple[Any, Any]]) -> float:
    """Return the relative standard deviation of the focal length if corners have a standard deviation of one pixel.

    It comes from the normal equations of all parameters after elimination of the board's poses.
    """
    project, of_pose = (cv2.fisheye.projectPoints, slice(8, 14)) if camera.fisheye else (cv2.projectPoints, slice(6))
    of_lens = slice(8) if camera.fisheye else slice(6, 10 + len(camera.distortion))
    rows = []
    for points, (turn, shift) in zip(objects, poses, strict=True):
        _, slopes = project(points.astype(np.float64)[:, None], turn, shift, camera.matrix, camera.coefficients)
        scale = np.linalg.norm(slopes[:, of_pose], axis=0)
        basis = np.linalg.qr(slopes[:, of_pose] / np.where(scale > 0, scale, 1))[0]
        rows.append(slopes[:, of_lens] - basis @ (basis.T @ slopes[:, of_lens]))
    stacked = np.concatenate(rows)
    scale = np.linalg.norm(stacked, axis=0)
    if not (np.isfinite(stacked).all() and (scale > 0).all()):
        return math.inf
    _, spread, turned = np.linalg.svd(stacked / scale, full_matrices=False)
    if spread[-1] < spread[0] * _MIN_CONDITION:
        return math.inf
    variances = np.sum((turned / spread[:, None]) ** 2, axis=0)[:2]
    return float(np.sqrt(np.max(variances / (scale[:2] * np.diag(camera.matrix)[:2]) ** 2)))


def _fit_rig(
    board: Board, pairs: dict[str, tuple[Corners, Corners]], cameras: tuple[Camera, Camera], refine: bool
) -> RigFit:
    """Return the rig fitted to all pairs, with the lenses of ``cameras``, refined if ``refine``.

    Raise InputError if the pairs do not determine it.
    """
    objects, left = _arrays(board, (pair[0] for pair in pairs.values()))
    _, right = _arrays(board, (pair[1] for pair in pairs.values()))
    lenses = [each for camera in cameras for each in (camera.matrix.copy(), camera.coefficients.copy())]
    size = cameras[0].size
    assert size is not None
    try:
        if cameras[0].fisheye:
            flags = _FISHEYE_FLAGS.CALIB_USE_INTRINSIC_GUESS if refine else _FISHEYE_FLAGS.CALIB_FIX_INTRINSIC
            views = ([each[None].astype(np.float64) for each in points] for points in (objects, left, right))
            parts = _cv2.fisheye.stereoCalibrate(*views, *lenses, size, flags=flags | _FISHEYE, criteria=_CRITERIA)
        else:
            flags = cv2.CALIB_USE_INTRINSIC_GUESS if refine else cv2.CALIB_FIX_INTRINSIC
            parts = _cv2.stereoCalibrate(objects, left, right, *lenses, size, flags=flags, criteria=_CRITERIA)
        found = [
            Camera(np.asarray(matrix, np.float64), tuple(np.ravel(lens).tolist()), camera.size, camera.fisheye)
            for matrix, lens, camera in ((*parts[1:3], cameras[0]), (*parts[3:5], cameras[1]))
        ]
        rig = Rig(found[0], found[1], np.asarray(parts[5], np.float64), np.asarray(parts[6], np.float64).ravel())
    except (cv2.error, InputError) as error:
        raise InputError("the pairs do not determine the positions of the cameras") from error
    errors, zero = {}, np.zeros(3)
    for name, points, in_left, in_right in zip(pairs, objects, left, right, strict=True):
        # The pose of the board comes from the left view.
        points64 = points.astype(np.float64)
        _, turn, shift = cv2.solvePnP(points64, rig.left.rays(in_left)[:, None], np.eye(3), np.zeros(5))
        placed = points64 @ cv2.Rodrigues(turn)[0].T + shift.ravel()
        moved = placed @ rig.rotation.T + rig.translation
        seen_by = (rig.left, placed, in_left), (rig.right, moved, in_right)
        errors[name] = max(_rms(_projected(camera, at, zero, zero) - seen) for camera, at, seen in seen_by)
    return RigFit(rig, errors, {})


def _arrays(board: Board, views: Iterable[Corners]) -> tuple[list[Floats], list[Floats]]:
    """Return for every view the points of its corners on the board, meters, and in the image, pixels."""
    listed: list[Corners] = list(views)
    return [board.points[each.ids] for each in listed], [each.pixels.astype(np.float32) for each in listed]


def _projected(camera: Camera, points: NDArray[Any], turn: Doubles, shift: Doubles) -> Doubles:
    """Return the pixels (N, 2) of points on a board in the pose ``turn`` (a rotation vector) and ``shift``."""
    project = cv2.fisheye.projectPoints if camera.fisheye else cv2.projectPoints
    pixels, _ = project(points.astype(np.float64)[:, None], turn, shift, camera.matrix, camera.coefficients)
    return np.asarray(pixels, np.float64).reshape(-1, 2)


def _rms(residuals: Doubles) -> float:
    """Return the root of the mean squared length of (N, 2) residuals."""
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))

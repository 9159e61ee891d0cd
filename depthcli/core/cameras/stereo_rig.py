"""Two cameras that see one scene: how they are rectified, and how the disparity of the pair becomes depth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.geometry import depth_of_disparity
from depthcli.core.errors import InputError
from depthcli.core.frames import Intrinsics

_STEEP = 0.5  # vertical over horizontal baseline beyond which rows of a rectified pair would have to be columns
_LENSES = {False: (4, 5, 8, 12, 14), True: (4,)}  # coefficients of OpenCV's models, pinhole and fisheye
_ALIKE = 0.01  # relative difference of two factors of size that rounding to whole pixels explains


@dataclass(frozen=True)
class PairGeometry:
    """The left camera of a rectified pair, and where the right one stands.

    Attributes
    ----------
    left : the left camera
    baseline : distance of the cameras, meters
    offset : x of the right principal point minus that of the left one (``doffs`` of Middlebury v3), pixels
    size : (width, height) of the images that this holds for, or None where it is not said
    """

    left: Intrinsics
    baseline: float
    offset: float = 0.0
    size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        numbers = (self.left.fx, self.left.fy, self.left.cx, self.left.cy, self.baseline, self.offset)
        if not np.isfinite(numbers).all():
            raise InputError("calibration: want finite numbers")
        if self.left.fx <= 0 or self.left.fy <= 0:
            raise InputError(f"calibration: a focal length of {min(self.left.fx, self.left.fy):g} pixels")
        if self.baseline <= 0:
            raise InputError(f"calibration: a baseline of {self.baseline:g} m; are left and right exchanged?")

    @property
    def fb(self) -> float:
        """Focal length x baseline, pixel meters."""
        return self.left.fx * self.baseline

    def depth(self, disparity: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """``Z = f b / (d + doffs)``; float32, meters, NaN where the point is unknown or not before the cameras."""
        return depth_of_disparity(disparity, self.fb, self.offset)

    def for_size(self, width: int, height: int) -> PairGeometry:
        """The same cameras with images of that size.

        Raises
        ------
        InputError
            The calibration is for images of another shape.
        """
        if self.size is None or self.size == (width, height):
            return replace(self, size=(width, height))
        across, down = width / self.size[0], height / self.size[1]
        if abs(across - down) > _ALIKE * max(across, down) + 1 / min(*self.size, width, height):
            raise InputError(f"calibrated for {self.size[0]} x {self.size[1]} pixels, the map has {width} x {height}")
        left = self.left
        # The center of the first pixel is (0, 0): its corner is what stays when the size changes.
        center = ((left.cx + 0.5) * across - 0.5, (left.cy + 0.5) * down - 0.5)
        scaled = Intrinsics(left.fx * across, left.fy * down, *center)
        return PairGeometry(scaled, self.baseline, self.offset * across, (width, height))


@dataclass(frozen=True)
class Lens:
    """A camera as it is.

    Attributes
    ----------
    matrix : (3, 3) float64, pixels
    distortion : coefficients of OpenCV's pinhole model (k1, k2, p1, p2, k3 ...) or of its fisheye model (k1 to k4)
    size : (width, height) of its images, or None where it is not known
    fisheye : which model
    """

    matrix: NDArray[np.float64]
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    size: tuple[int, int] | None = None
    fisheye: bool = False

    def __post_init__(self) -> None:
        if self.matrix.shape != (3, 3) or not np.isfinite(self.matrix).all() or min(np.diag(self.matrix)) <= 0:
            raise InputError("calibration: want a 3 x 3 camera matrix with positive focal lengths")
        wanted = _LENSES[self.fisheye]
        if len(self.distortion) not in wanted or not np.isfinite(self.distortion).all():
            model = "fisheye" if self.fisheye else "pinhole"
            counts = ", ".join(map(str, wanted))
            raise InputError(f"calibration: a {model} lens has {counts} coefficients (got {len(self.distortion)})")

    @property
    def coefficients(self) -> NDArray[np.float64]:
        """The distortion as OpenCV takes it."""
        return np.asarray(self.distortion, np.float64)

    def straightened(
        self, points: NDArray[np.floating[Any]], turn: NDArray[np.float64], projection: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(N, 2) pixels of this camera in one that is turned by ``turn``, has no distortion, and ``projection``."""
        if len(points) == 0:
            return np.zeros((0, 2))
        undistort = cv2.fisheye.undistortPoints if self.fisheye else cv2.undistortPoints
        found = undistort(
            np.asarray(points, np.float64)[:, None], self.matrix, self.coefficients, R=turn, P=projection[:, :3]
        )
        return np.asarray(found, np.float64)[:, 0]

    def maps(
        self, turn: NDArray[np.float64], projection: NDArray[np.float64], size: tuple[int, int]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """x and y in this camera's image of every pixel of the turned one."""
        build = cv2.fisheye.initUndistortRectifyMap if self.fisheye else cv2.initUndistortRectifyMap
        x, y = build(self.matrix, self.coefficients, turn, projection[:, :3], size, cv2.CV_32FC1)
        return np.asarray(x, np.float32), np.asarray(y, np.float32)


@dataclass(frozen=True)
class StereoRig:
    """Two cameras at fixed places.

    Attributes
    ----------
    left, right : the cameras
    rotation, translation : from the left camera's frame to the right one's; (3, 3), (3,) meters
    """

    left: Lens
    right: Lens
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.rotation.shape != (3, 3) or self.translation.shape != (3,):
            raise InputError("calibration: want R (3, 3) and T (3,)")
        if not np.allclose(self.rotation @ self.rotation.T, np.eye(3), atol=1e-3) or np.linalg.det(self.rotation) < 0:
            raise InputError("calibration: R is not a rotation")
        if not np.isfinite(self.translation).all() or not np.linalg.norm(self.translation) > 0:
            raise InputError("calibration: the cameras stand at one place")
        if self.left.fisheye != self.right.fisheye:
            raise InputError("calibration: one fisheye lens and one that is none cannot be rectified together")

    def rectified(self, size: tuple[int, int], right_size: tuple[int, int], alpha: float = 0.0) -> RectifiedRig:
        """Images of ``size`` whose rows correspond (Bouguet's method, as OpenCV has it).

        Parameters
        ----------
        size, right_size : (width, height) of the two cameras' images
        alpha : 0 shows only what both images hold, 1 all that either holds

        Raises
        ------
        InputError
            Calibrated for images of another size, cameras one above the other, or exchanged.
        """
        for name, lens, here in (("left", self.left, size), ("right", self.right, right_size)):
            if lens.size is not None and lens.size != here:
                raise InputError(
                    f"calibrated for a {name} image of {lens.size[0]} x {lens.size[1]}, it has {here[0]} x {here[1]}"
                )
        known = (self.left.matrix, self.left.coefficients, self.right.matrix, self.right.coefficients, size)
        where = (self.rotation, self.translation[:, None])
        if self.left.fisheye:
            parts = cv2.fisheye.stereoRectify(*known, *where, flags=cv2.CALIB_ZERO_DISPARITY, balance=alpha)[:4]
        else:
            parts = cv2.stereoRectify(*known, *where, flags=cv2.CALIB_ZERO_DISPARITY, alpha=alpha)[:4]
        turn, turn_right, projection, projection_right = (np.asarray(part, np.float64) for part in parts)
        along, across = projection_right[0, 3], projection_right[1, 3]
        if abs(across) > _STEEP * abs(along):
            raise InputError("the cameras lie one above the other; turn the images by 90 degrees and calibrate them so")
        if along > 0:
            raise InputError("the right camera stands to the left of the left one; exchange the images and cameras")
        return RectifiedRig(self, size, turn, turn_right, projection, projection_right)


@dataclass(frozen=True)
class RectifiedRig:
    """How both cameras of a rig are turned and projected; both images have ``size``."""

    rig: StereoRig
    size: tuple[int, int]
    turn: NDArray[np.float64]
    turn_right: NDArray[np.float64]
    projection: NDArray[np.float64]
    projection_right: NDArray[np.float64]

    @property
    def geometry(self) -> PairGeometry:
        """Of the rectified pair."""
        p, right = self.projection, self.projection_right
        camera = Intrinsics(float(p[0, 0]), float(p[1, 1]), float(p[0, 2]), float(p[1, 2]))
        return PairGeometry(camera, float(-right[0, 3] / right[0, 0]), float(right[0, 2] - p[0, 2]), self.size)

    def images(self, left: NDArray[Any], right: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.bool_]]:
        """Both rectified images, and (H, W) bool of the left pixels that both cameras' images reach at infinity."""
        views, seen = [], np.ones(self.size[::-1], bool)
        for lens, turn, projection, image in (
            (self.rig.left, self.turn, self.projection, left),
            (self.rig.right, self.turn_right, self.projection_right, right),
        ):
            x, y = lens.maps(turn, projection, self.size)
            views.append(cv2.remap(image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT))
            height, width = image.shape[:2]
            seen &= (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
        return views[0], views[1], seen

    def points(
        self, left: NDArray[np.floating[Any]], right: NDArray[np.floating[Any]]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(N, 2) pixels of the two cameras in the rectified images."""
        return (
            self.rig.left.straightened(left, self.turn, self.projection),
            self.rig.right.straightened(right, self.turn_right, self.projection_right),
        )

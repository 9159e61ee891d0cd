"""One camera and its projection, with or without the distortion of its lens."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError

# Fisheye model or not -> allowed numbers of OpenCV's distortion coefficients.
_COEFFICIENT_COUNTS = {False: (4, 5, 8, 12, 14), True: (4,)}

_MAX_TRANSLATION = 1.0  # meters between the cameras of one sensor; a longer one is in another unit
# Share of the width or height; a third of the way from the center to the border. Images of 2/3 the size of those that a
# camera is calibrated for have it at 1/4, images of 3/2 the size at 1/6.
_MAX_OFF_CENTER = 0.15

KINECT_BASELINE = 0.075
"""Distance of projector and depth camera in the first Kinect and in sensors of the same design, meters."""

KINECT_FOCAL_LENGTH = 580.0
"""Of the first Kinect's depth camera, pixels of its 640 x 480 images."""


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without distortion: focal lengths and principal point, pixels."""

    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def of_matrix(cls, matrix: NDArray[np.float64]) -> Intrinsics:
        """Return the intrinsics in a camera matrix (3, 3) or projection (3, 4)."""
        return cls(float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2]))

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The camera matrix, (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], np.float64)

    def points(self, depth: NDArray[np.float32], chosen: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Return the points (N, 3) float32 of the ``chosen`` pixels of a depth map, row by row.

        They are in the camera's frame and in the unit of ``depth``: x right, y down, z forward.
        """
        rows, columns = np.nonzero(chosen)
        z = depth[chosen].astype(np.float64)
        x, y = (columns - self.cx) / self.fx * z, (rows - self.cy) / self.fy * z
        return np.stack([x, y, z], axis=-1).astype(np.float32)


def off_center(camera: Intrinsics, size: tuple[int, int]) -> str:
    """Return why a calibration probably belongs to images of another (width, height); "" if it fits.

    It does not fit if its principal point is far from the image center.
    """
    center = ((size[0] - 1) / 2, (size[1] - 1) / 2)
    # Conventions of a pixel's center differ by half a pixel.
    apart = max((abs(camera.cx - center[0]) - 0.5) / size[0], (abs(camera.cy - center[1]) - 0.5) / size[1])
    if not apart > _MAX_OFF_CENTER:
        return ""
    return (
        f"the principal point ({camera.cx:.1f}, {camera.cy:.1f}) is far from the center of images of {size[0]} x "
        f"{size[1]}: are these numbers for images of another size, about {2 * camera.cx:.0f} x {2 * camera.cy:.0f}?"
    )


def typical_intrinsics(width: int, height: int) -> Intrinsics:
    """Return the defaults of drivers of Kinect v1 and similar: 525 pixels at a width of 640, the image center."""
    focal = 525.0 * width / 640
    return Intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2)


def sensor_fb(camera: Intrinsics | None) -> float:
    """Return focal length x baseline of a Kinect whose depth is registered to ``camera``, or stays in its own one."""
    return (camera.fx if camera else KINECT_FOCAL_LENGTH) * KINECT_BASELINE


Place = tuple[tuple[float, ...], tuple[float, ...]]
"""Rotation (3 x 3, row by row) and translation (meters) from one camera's frame to another one's."""


def is_rotation(matrix: NDArray[np.float64]) -> bool:
    """Return whether a (3, 3) matrix is a rotation, within 1e-3."""
    return bool(np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-3) and np.linalg.det(matrix) > 0)


def check_place(rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> None:
    """Raise InputError if (3, 3) is no rotation, or (3,) is too long between two cameras of one sensor, meters."""
    if not is_rotation(rotation):
        raise InputError("depth_to_color: the rotation is not a rotation matrix")
    if not np.linalg.norm(translation) <= _MAX_TRANSLATION:
        raise InputError(f"depth_to_color: the translation is longer than {_MAX_TRANSLATION:g} m; expected meters")


@dataclass(frozen=True)
class Camera:
    """A camera with lens distortion. Raise InputError for an invalid matrix or number of coefficients."""

    matrix: NDArray[np.float64]  # (3, 3), pixels
    # Of OpenCV's pinhole model (k1, k2, p1, p2, k3 ...) or, with ``fisheye``, of its fisheye model (k1 to k4).
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    size: tuple[int, int] | None = None  # (width, height) of its images; None: unknown
    fisheye: bool = False

    def __post_init__(self) -> None:
        if self.matrix.shape != (3, 3) or not np.isfinite(self.matrix).all() or min(np.diag(self.matrix)) <= 0:
            raise InputError("calibration: expected a finite 3 x 3 camera matrix with positive focal lengths")
        if abs(np.linalg.det(self.matrix)) < 1e-9:
            raise InputError("calibration: the camera matrix is singular")
        counts = _COEFFICIENT_COUNTS[self.fisheye]
        if len(self.distortion) not in counts or not np.isfinite(self.distortion).all():
            model = "fisheye" if self.fisheye else "pinhole"
            raise InputError(
                f"calibration: a {model} lens has {', '.join(map(str, counts))} coefficients of distortion "
                f"(got {len(self.distortion)})"
            )

    @property
    def coefficients(self) -> NDArray[np.float64]:
        """The distortion coefficients for OpenCV."""
        return np.asarray(self.distortion, np.float64)

    @property
    def intrinsics(self) -> Intrinsics:
        """The camera without its distortion."""
        return Intrinsics.of_matrix(self.matrix)

    def scaled(self, factor: float | tuple[float, float]) -> Camera:
        """Return the same camera with an image of ``factor`` times the size, or times (width, height)."""
        matrix = self.matrix.copy()
        matrix[:2, 2] = (matrix[:2, 2] + 0.5) * factor - 0.5
        matrix[[0, 1], [0, 1]] *= factor
        return Camera(matrix, self.distortion, None, self.fisheye)

    def rays(self, pixels: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return (x / z, y / z), as (N, 2), of the points that this camera projects to (N, 2) ``pixels``."""
        return self.undistorted(pixels, np.eye(3), np.eye(3))

    def undistorted(
        self, pixels: NDArray[np.floating[Any]], rotation: NDArray[np.float64], projection: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return where an undistorted camera, turned by ``rotation``, shows the points at ``pixels``, (N, 2)."""
        if len(pixels) == 0:
            return np.zeros((0, 2))
        undistort = cv2.fisheye.undistortPoints if self.fisheye else cv2.undistortPoints
        points = np.asarray(pixels, np.float64)[:, None]
        found = undistort(points, self.matrix, self.coefficients, R=rotation, P=projection[:, :3])
        return np.asarray(found, np.float64)[:, 0]

    def undistortion_maps(
        self, rotation: NDArray[np.float64], projection: NDArray[np.float64], size: tuple[int, int]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return, for every pixel of an undistorted camera turned by ``rotation``, x and y in this camera's image.

        The other camera's ``projection`` is (3, 3) or (3, 4), ``size`` the (width, height) of its image.
        """
        build = cv2.fisheye.initUndistortRectifyMap if self.fisheye else cv2.initUndistortRectifyMap
        x, y = build(self.matrix, self.coefficients, rotation, projection[:, :3], size, cv2.CV_32FC1)
        return np.asarray(x, np.float32), np.asarray(y, np.float32)

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the pixels (N, 2) of points (N, 3) in the camera's frame, N > 0, by the pinhole model."""
        projected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), self.matrix, self.coefficients)
        return np.asarray(projected[:, 0], np.float64)

    def depth_image(
        self, points: NDArray[np.float64], shape: tuple[int, int], *values: NDArray[np.float32]
    ) -> list[NDArray[np.float32]]:
        """Return the depth map of points (N, 3), in the camera frame, meters, then maps of their ``values``, (N,) each.

        All are float32, NaN at pixels without a point. If a pixel has several points, the nearest one counts.
        """
        images = [np.full(shape, np.nan, np.float32) for _ in range(1 + len(values))]
        ahead = points[:, 2] > 0
        points = points[ahead]
        if len(points) == 0:
            return images
        x, y = np.rint(self.project(points)).astype(np.int64).T
        inside = (x >= 0) & (y >= 0) & (x < shape[1]) & (y < shape[0])
        x, y, depth = x[inside], y[inside], points[inside, 2]
        order = np.lexsort((-depth, y * shape[1] + x))  # of equal pixels the nearest comes last, and stays
        for image, samples in zip(images, (depth, *(each[ahead][inside] for each in values)), strict=True):
            image[y[order], x[order]] = samples[order]
        return images

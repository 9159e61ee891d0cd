"""Two cameras at fixed places, and their images brought to a common plane."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.geometry import Camera
from depthcli.core.errors import InputError

_LEAST_OVERLAP = 0.05
_STEEP = 0.3  # vertical over horizontal baseline beyond which rows of a rectified pair would have to be columns


@dataclass(frozen=True)
class Rig:
    """A color and an infrared camera.

    Attributes
    ----------
    color, infrared : cameras
    color_size, infrared_size : (width, height) of their images
    rotation, translation : from the color camera's frame to the infrared camera's; (3, 3), (3,) meters
    """

    color: Camera
    infrared: Camera
    color_size: tuple[int, int]
    infrared_size: tuple[int, int]
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name, camera in (("color", self.color), ("infrared", self.infrared)):
            if camera.matrix.shape != (3, 3) or not np.isfinite(camera.matrix).all():
                raise InputError(f"calibration: want a finite 3 x 3 matrix of the {name} camera")
            if camera.matrix[0, 0] <= 0 or camera.matrix[1, 1] <= 0 or abs(np.linalg.det(camera.matrix)) < 1e-9:
                raise InputError(f"calibration: the {name} camera's matrix is singular")
        if self.rotation.shape != (3, 3) or self.translation.shape != (3,):
            raise InputError("calibration: want R (3, 3) and t (3,)")
        if not np.allclose(self.rotation @ self.rotation.T, np.eye(3), atol=1e-3) or np.linalg.det(self.rotation) < 0:
            raise InputError("calibration: R is not a rotation")
        if not 1e-4 < np.linalg.norm(self.translation) < 10:
            raise InputError(f"calibration: a baseline of {np.linalg.norm(self.translation):.3g} m; t is in meters")

    def rectified(self) -> Rectified:
        """Images of the color camera's size whose rows correspond; InputError where the baseline is not along them."""
        turns = cv2.stereoRectify(
            self.color.matrix, np.asarray(self.color.distortion), self.infrared.matrix,
            np.asarray(self.infrared.distortion), self.color_size, self.rotation, self.translation[:, None], alpha=-1,
            flags=cv2.CALIB_ZERO_DISPARITY,
        )  # fmt: skip
        first, second, left, right = (np.asarray(part, np.float64) for part in turns[:4])
        shift = right[:2, 3]
        if abs(shift[1]) > _STEEP * abs(shift[0]):
            raise InputError("calibration: the cameras lie one above the other; their baseline must be along the rows")
        rectified = Rectified(self, first, second, left, right)
        if rectified.overlap() < _LEAST_OVERLAP:
            raise InputError("calibration: the two cameras see nothing in common")
        return rectified


@dataclass(frozen=True)
class Rectified:
    """How both cameras of a rig are turned and projected."""

    rig: Rig
    turn: NDArray[np.float64]
    turn_infrared: NDArray[np.float64]
    projection: NDArray[np.float64]
    projection_infrared: NDArray[np.float64]

    @property
    def mirrored(self) -> bool:
        """The infrared camera is on the left: matches lie to the right, unless both images are mirrored."""
        return bool(self.projection_infrared[0, 3] > 0)

    @property
    def fb(self) -> float:
        """Focal length x baseline, pixel meters."""
        return abs(float(self.projection_infrared[0, 3]))

    def overlap(self) -> float:
        """Share of the rectified image that both cameras see, of points at infinity."""
        seen = []
        for camera, turn, projection, (width, height) in (
            (self.rig.color, self.turn, self.projection, self.rig.color_size),
            (self.rig.infrared, self.turn_infrared, self.projection_infrared, self.rig.infrared_size),
        ):
            x, y = cv2.initUndistortRectifyMap(
                camera.matrix, np.asarray(camera.distortion), turn, projection, self.rig.color_size, cv2.CV_32FC1
            )
            ahead = np.tensordot(turn.T[2], self._rays(x.shape[0], x.shape[1]), axes=1) > 0
            seen.append((x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1) & ahead)
        return float(np.mean(seen[0] & seen[1]))

    def images(
        self, color: NDArray[np.uint8], infrared: NDArray[np.uint8]
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Both images, (H, W, ...) of the color image's size."""
        pairs = (
            (self.rig.color, self.turn, self.projection, color),
            (self.rig.infrared, self.turn_infrared, self.projection_infrared, infrared),
        )
        found = []
        for camera, turn, projection, image in pairs:
            maps = cv2.initUndistortRectifyMap(
                camera.matrix, np.asarray(camera.distortion), turn, projection, self.rig.color_size, cv2.CV_32FC1
            )
            seen = cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            found.append(np.asarray(seen, np.uint8))
        return found[0], found[1]

    def depth(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """A depth map of the color camera, in the rectified one's pixels and along its axis."""
        camera = self.rig.color
        maps = cv2.initUndistortRectifyMap(
            camera.matrix, np.asarray(camera.distortion), self.turn, self.projection, self.rig.color_size, cv2.CV_32FC1
        )
        near = cv2.remap(depth, maps[0], maps[1], cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT,
                         borderValue=float("nan"))  # fmt: skip
        # The camera only turns: a pixel's ray stays, its point's depth along the axis changes.
        along = np.tensordot(self.turn.T[2], self._rays(depth.shape[0], depth.shape[1]), axes=1)
        return (near / along).astype(np.float32)

    def _rays(self, height: int, width: int) -> NDArray[np.float64]:
        """(3, H, W): directions of the rectified camera's pixels."""
        x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        x = (x - self.projection[0, 2]) / self.projection[0, 0]
        y = (y - self.projection[1, 2]) / self.projection[1, 1]
        return np.stack([x, y, np.ones_like(x)])

    def back(self, depth: NDArray[np.float32], other: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
        """A sparse depth map of the rectified camera, and a map beside it, in the color camera's pixels.

        Of several points that meet in a pixel the nearest one stays.
        """
        rows, columns = np.nonzero(np.isfinite(depth))
        found = np.full(depth.shape, np.nan, np.float32)
        beside = np.full(depth.shape, np.nan, np.float32)
        if rows.size == 0:
            return found, beside
        z = depth[rows, columns].astype(np.float64)
        x, y = (columns - self.projection[0, 2]) * z, (rows - self.projection[1, 2]) * z
        points = np.stack([x / self.projection[0, 0], y / self.projection[1, 1], z], axis=1) @ self.turn
        camera = self.rig.color
        projected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, np.asarray(camera.distortion))
        u, v = np.rint(projected[:, 0]).astype(np.int64).T
        inside = (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0]) & (points[:, 2] > 0)
        u, v, far, values = u[inside], v[inside], points[inside, 2], other[rows, columns][inside]
        order = np.lexsort((-far, v * depth.shape[1] + u))
        found[v[order], u[order]] = far[order]
        beside[v[order], u[order]] = values[order]
        return found, beside

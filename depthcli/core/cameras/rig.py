"""Two cameras at fixed places, and the rectification of their images, after which rows correspond."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Camera, Intrinsics, is_rotation, off_center
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import InputError

_MAX_SIZE_RATIO = 1.25  # of the widths of the two cameras' images


@dataclass(frozen=True)
class Rig:
    """Two cameras that do not move relative to each other.

    Raise InputError if the matrix is no rotation, the cameras have one position, or only one has a fisheye lens.
    """

    left: Camera  # of a color and an infrared camera, the color camera, even if it is on the right
    right: Camera
    rotation: NDArray[np.float64]  # (3, 3), from the left camera's frame to the right one's
    translation: NDArray[np.float64]  # (3,), meters

    def __post_init__(self) -> None:
        for name in ("rotation", "translation"):  # OpenCV refuses views of larger arrays
            object.__setattr__(self, name, np.array(getattr(self, name), np.float64))
        if self.rotation.shape != (3, 3) or self.translation.shape != (3,):
            raise InputError("calibration: expected R (3, 3) and T (3,)")
        if not is_rotation(self.rotation):
            raise InputError("calibration: R is not a rotation")
        if not np.isfinite(self.translation).all() or not np.linalg.norm(self.translation) > 0:
            raise InputError("calibration: both cameras are at the same place")
        if self.left.fisheye != self.right.fisheye:
            raise InputError("calibration: a fisheye camera cannot be rectified with another one")

    @property
    def baseline(self) -> float:
        """Distance of the cameras, meters."""
        return float(np.linalg.norm(self.translation))

    def doubts(self, size: tuple[int, int], right_size: tuple[int, int]) -> list[str]:
        """Return why a calibration without an image size probably does not fit images of these sizes."""
        cameras = (("left", self.left, size), ("right", self.right, right_size))
        reasons = ((name, off_center(camera.intrinsics, at)) for name, camera, at in cameras if camera.size is None)
        return [f"{name} camera: {reason}" for name, reason in reasons if reason]

    def rectified(
        self,
        size: tuple[int, int],
        right_size: tuple[int, int],
        alpha: float = 0.0,
        *,
        mirrored: bool = False,
        max_tilt: float = 0.5,
        min_overlap: float = 0.0,
    ) -> RectifiedRig:
        """Return the rectification after which matching points lie in the same row (Bouguet's method, by OpenCV).

        Parameters
        ----------
        size, right_size : (width, height) of the two cameras' images, as in the calibration
        alpha : 0 keeps only pixels with image content, 1 keeps all pixels; -1 is OpenCV's default in between
        mirrored : True allows the right camera to be left of the left one; otherwise this is an InputError
        max_tilt : largest ratio of vertical to horizontal baseline; beyond it, InputError
        min_overlap : smallest share of the rectified image that both cameras must see, or InputError
        """
        for name, camera, given in (("left", self.left, size), ("right", self.right, right_size)):
            if camera.size is not None and camera.size != given:
                raise InputError(
                    f"calibrated for a {name} image of {camera.size[0]} x {camera.size[1]}, it has "
                    f"{given[0]} x {given[1]}"
                )
        if max(size[0] / right_size[0], right_size[0] / size[0]) > _MAX_SIZE_RATIO:
            raise InputError(
                f"images of {size[0]} x {size[1]} and {right_size[0]} x {right_size[1]} px; bring both "
                "to one size, and calibrate them so"
            )
        cameras = (self.left.matrix, self.left.coefficients, self.right.matrix, self.right.coefficients, size)
        places = (self.rotation, self.translation[:, None])
        if self.left.fisheye:
            parts = cv2.fisheye.stereoRectify(*cameras, *places, flags=cv2.CALIB_ZERO_DISPARITY, balance=alpha)[:4]
        else:
            parts = cv2.stereoRectify(*cameras, *places, flags=cv2.CALIB_ZERO_DISPARITY, alpha=alpha)[:4]
        rotation, rotation_right, projection, projection_right = (np.asarray(part, np.float64) for part in parts)
        along, across = projection_right[0, 3], projection_right[1, 3]
        if abs(across) > max_tilt * abs(along):
            raise InputError("one camera is above the other; turn the images by 90 degrees and calibrate them so")
        if along > 0 and not mirrored:
            raise InputError("the right camera is to the left of the left one; exchange the images and cameras")
        rectified = RectifiedRig(self, size, right_size, rotation, rotation_right, projection, projection_right)
        if min_overlap and rectified.overlap() < min_overlap:
            raise InputError("the two cameras see nothing in common")
        return rectified


@dataclass(frozen=True)
class RectifiedRig:
    """A rectification: how both cameras of a rig are turned and projected, so that rows correspond."""

    rig: Rig
    size: tuple[int, int]  # (width, height) of the left camera's images, and of both rectified ones
    right_size: tuple[int, int]
    rotation: NDArray[np.float64]  # (3, 3)
    rotation_right: NDArray[np.float64]
    projection: NDArray[np.float64]  # of the rectified cameras, (3, 4)
    projection_right: NDArray[np.float64]

    @property
    def geometry(self) -> PairGeometry:
        """How the disparity of the rectified pair becomes depth."""
        left, right = self.projection, self.projection_right
        baseline = float(-right[0, 3] / right[0, 0])
        return PairGeometry(Intrinsics.of_matrix(left), baseline, float(right[0, 2] - left[0, 2]), self.size)

    @property
    def mirrored(self) -> bool:
        """True if the right camera is left of the left one, so that matches are to the right."""
        return bool(self.projection_right[0, 3] > 0)

    @property
    def fb(self) -> float:
        """Focal length x baseline, pixel meters."""
        return abs(float(self.projection_right[0, 3]))

    def overlap(self) -> float:
        """Return the share of the rectified image's pixels that both cameras see, for points at infinity."""
        common = self._common
        for rotation in (self.rotation, self.rotation_right):
            common = common & (np.tensordot(rotation.T[2], self._rays(), axes=1) > 0)
        return float(np.mean(common))

    def images(
        self,
        left: NDArray[Any],
        right: NDArray[Any],
        interpolation: int = cv2.INTER_CUBIC,
        border: int = cv2.BORDER_CONSTANT,
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.bool_]]:
        """Return both rectified images, and (H, W) bool: both cameras' images contain the pixel's point at infinity.

        ``interpolation`` and ``border`` are OpenCV's flags.
        """
        one, other = (
            cv2.remap(image, x, y, interpolation, borderMode=border)
            for (x, y), image in zip(self._maps, (left, right), strict=True)
        )
        return one, other, self._common.copy()

    def points(
        self, left: NDArray[np.floating[Any]], right: NDArray[np.floating[Any]]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the rectified positions, (N, 2) each, of (N, 2) pixels of the left and of the right camera."""
        return (
            self.rig.left.undistorted(left, self.rotation, self.projection),
            self.rig.right.undistorted(right, self.rotation_right, self.projection_right),
        )

    def rectify_depth(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return a depth map of the left camera in the rectified one's pixels and along its axis, meters."""
        x, y = self._maps[0]
        near = cv2.remap(depth, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))
        # The camera only turns: a pixel's ray stays, its point's depth along the axis changes.
        along = np.tensordot(self.rotation.T[2], self._rays(), axes=1)
        return (near / along).astype(np.float32)

    def unrectify_depth(self, depth: NDArray[np.float32], values: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        """Return a sparse depth map of the rectified left camera, and its ``values``, in the left camera's pixels.

        If several points fall into one pixel, the nearest one stays.
        """
        rows, columns = np.nonzero(np.isfinite(depth))
        z = depth[rows, columns].astype(np.float64)
        x, y = (columns - self.projection[0, 2]) * z, (rows - self.projection[1, 2]) * z
        points = np.stack([x / self.projection[0, 0], y / self.projection[1, 1], z], axis=1) @ self.rotation
        return self.rig.left.depth_image(points, (depth.shape[0], depth.shape[1]), values[rows, columns])

    @cached_property  # one rectification may serve all frames of a video
    def _maps(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """x and y in the left and the right image of every rectified pixel."""
        return [
            self.rig.left.undistortion_maps(self.rotation, self.projection, self.size),
            self.rig.right.undistortion_maps(self.rotation_right, self.projection_right, self.size),
        ]

    @cached_property
    def _common(self) -> NDArray[np.bool_]:
        """(H, W): both cameras' images contain the pixel's point at infinity."""
        common = np.ones(self.size[::-1], bool)
        for (x, y), (width, height) in zip(self._maps, (self.size, self.right_size), strict=True):
            common &= (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
        return common

    def _rays(self) -> NDArray[np.float64]:
        """(3, H, W): directions of the rectified camera's pixels."""
        x, y = np.meshgrid(np.arange(self.size[0], dtype=np.float64), np.arange(self.size[1], dtype=np.float64))
        x = (x - self.projection[0, 2]) / self.projection[0, 0]
        y = (y - self.projection[1, 2]) / self.projection[1, 1]
        return np.stack([x, y, np.ones_like(x)])

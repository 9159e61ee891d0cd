"""Resample a depth camera's map to the pixels of a color camera; the images may have any sizes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Camera, Intrinsics, Place, check_place, typical_intrinsics
from depthcli.core.errors import InputError
from depthcli.kernels.jit import helper, jit

# Default of the largest relative difference between two depths on one surface; set by hand.
_MAX_STEP = 0.03
# Neighboring samples whose relative steps differ by more are on two surfaces: standard deviations of the map's noise,
# with lower and upper limits of that noise; set by hand.
_MAX_BEND, _MIN_LIMIT, _MAX_LIMIT = 6.0, 0.005, 0.1
_MAD_TO_SIGMA = 1.4826
_PATCHES_AT_ONCE = 1 << 15  # limits the memory of their points
_MAX_APPROACH = 0.1  # of a depth: surfaces that would be nearer to the color camera are left out

_ON_EDGE = -1e-9  # share of a triangle: pixels on an edge belong to it in spite of rounding


@dataclass(frozen=True)
class ColorAndDepth:
    """Both cameras of a sensor."""

    depth: Camera
    color: Camera
    rotation: NDArray[np.float64]  # (3, 3), from the depth camera's frame to the color camera's
    translation: NDArray[np.float64]  # (3,), meters

    @property
    def interpolates(self) -> bool:
        """True if the depth camera's pixels are larger than the color camera's."""
        return bool(np.any(np.diag(self.color.matrix) > np.diag(self.depth.matrix) * (1 + 1e-9)))

    def register(self, depth: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
        """Return the depth camera's map in the pixels of the color image of ``shape`` (H', W'), float32, meters.

        If several surfaces fall on one pixel, the nearest one counts. If the depth camera's pixels are larger than the
        color camera's, depth is interpolated between neighboring samples of one surface. Between samples of two
        surfaces, each pixel belongs to the nearer sample and is on the plane through that sample's neighbors. Otherwise
        points are projected. A single empty pixel between two neighbors of similar depth gets their mean. Pixels that
        the depth camera did not see or measure stay unknown.
        """
        if not self.interpolates:
            rows, columns = np.nonzero(np.isfinite(depth))
            points = self._points(np.stack([columns, rows], axis=1), depth[rows, columns].astype(np.float64))
            return _close_gaps(self.color.depth_image(points, shape)[0])
        pixels, inverse = _surface_patches(1 / depth.astype(np.float64))
        image = np.zeros(shape)
        for start in range(0, len(pixels), _PATCHES_AT_ONCE):
            part = slice(start, start + _PATCHES_AT_ONCE)
            corners = self._points(pixels[part].reshape(-1, 2), 1 / inverse[part].ravel()).reshape(-1, 4, 3)
            corners = corners[np.all(corners[..., 2] > _MAX_APPROACH / inverse[part], axis=1)]
            if len(corners):
                x, y = np.ascontiguousarray(self.color.project(corners.reshape(-1, 3)).T).reshape(2, -1, 4)
                draw_quads(x, y, 1 / corners[..., 2], image)
        with np.errstate(divide="ignore"):
            return _close_gaps(np.where(image > 0, 1 / image, np.nan).astype(np.float32))

    def _points(self, pixels: NDArray[np.floating], z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the points (N, 3) in the color camera's frame of (N, 2) pixels of the depth camera."""
        rays = self.depth.rays(pixels)
        points = np.stack([rays[:, 0] * z, rays[:, 1] * z, z], axis=1)
        return np.asarray(points @ self.rotation.T + self.translation)


class Registered(NamedTuple):
    """A depth map in a color image's pixels."""

    depth: NDArray[np.float32]  # (H, W), meters, NaN = unknown
    interpolated: bool = False  # the map was smaller than the image
    note: str = ""  # assumption made without a calibration of the depth camera


def registered(
    depth: NDArray[np.float32],
    shape: tuple[int, int],
    color: Intrinsics | None,
    camera: Intrinsics | None,
    place: Place | None,
) -> Registered:
    """Return a depth map in the pixels of a color image.

    Without ``camera``, a map of the image's size is returned as it is, and a smaller one of the same aspect ratio is
    scaled. ``place`` is the pose of the depth camera; None: the pose of the color camera. Raise InputError if the sizes
    differ and the cameras are unknown, if a camera or its pose is impossible, or if no point is in the color image.
    """
    if camera is None and place is not None:
        raise InputError("depth_to_color wants depth_intrinsics beside it")
    if camera is not None and color is None:
        raise InputError("depth_intrinsics want those of the color camera beside them; give intrinsics, too")
    (height, width), (small_height, small_width) = shape, depth.shape
    same_aspect = abs(small_width * height / width - small_height) <= 1  # within one pixel of the smaller image
    if camera is not None and color is not None:
        rotation, translation = (np.eye(3), np.zeros(3)) if place is None else map(np.array, place)
        cameras = ColorAndDepth(Camera(camera.matrix), Camera(color.matrix), rotation.reshape(3, 3), translation)
        check_place(cameras.rotation, cameras.translation)
    elif depth.shape == shape:
        return Registered(depth)
    elif small_width < width and small_height < height and same_aspect:
        image = Camera((color or typical_intrinsics(width, height)).matrix)
        scaled = image.scaled((small_width / width, small_height / height))
        cameras = ColorAndDepth(scaled, image, np.eye(3), np.zeros(3))
    else:
        raise InputError(
            f"{small_width} x {small_height}, but the color image is {width} x {height}; the depth must be registered "
            "to the color image; else give depth_intrinsics, and intrinsics of the color camera"
        )
    result = cameras.register(depth, shape)
    if np.isfinite(depth).any() and not np.isfinite(result).any():
        raise InputError(
            "no point of the depth map is in the color image; check depth_intrinsics, depth_to_color "
            "(meters) and the intrinsics of the color camera"
        )
    note = (
        f"{small_width} x {small_height}, taken as registered to the color image of {width} x {height} and scaled; "
        "if it is not, give depth_intrinsics"
    )
    return Registered(result, cameras.interpolates, "" if camera else note)


def _close_gaps(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    out = depth.copy()
    for axis in (1, 0):
        before, center, after = (
            out[:, k : out.shape[1] - 2 + k] if axis else out[k : out.shape[0] - 2 + k] for k in (0, 1, 2)
        )
        with np.errstate(invalid="ignore"):
            bridge = np.isnan(center) & (np.abs(before - after) <= _MAX_STEP * np.minimum(before, after))
        center[bridge] = (before[bridge] + after[bridge]) / 2
    return out


def _surface_patches(inverse: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return quadrilaterals that cover all known pixels of a map of inverse depth, each within one surface.

    Four neighboring pixel centers with samples on one surface are the corners of one
    quadrilateral. Otherwise each sample gets a quarter of the square between them, with the slope to its
    neighbors on its surface.
    The result is x, y of the corners, (N, 4, 2), clockwise as the image is seen, and their inverse depth, (N, 4).
    """
    inverse = np.pad(inverse, 1, constant_values=np.nan)
    # The largest difference of the relative steps within a surface, by the noise of the map.
    bends = np.concatenate([np.abs(np.diff(_relative_steps(each), axis=1)).ravel() for each in (inverse, inverse.T)])
    bends = bends[np.isfinite(bends)]
    noise = _MAD_TO_SIGMA * float(np.median(bends)) / 6**0.5 if bends.size else 0.0
    limit = min(max(_MAX_BEND * noise, _MIN_LIMIT), _MAX_LIMIT)
    right, below = _same_surface(inverse, limit), _same_surface(inverse.T, limit).T
    whole = right[:-1] & right[1:] & below[:, :-1] & below[:, 1:]
    corner = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])  # x, y
    rows, columns = np.nonzero(whole)
    at = np.stack([columns, rows], axis=1)[:, None] + corner
    pixels, values = [at.astype(np.float64)], [inverse[at[..., 1], at[..., 0]]]
    for x, y in corner:
        rows, columns = np.nonzero(~whole & np.isfinite(inverse[y : y + whole.shape[0], x : x + whole.shape[1]]))
        rows, columns = rows + y, columns + x
        slope_x = _slopes(inverse, right, 1 - 2 * x)[rows, columns, None]
        slope_y = _slopes(inverse.T, below.T, 1 - 2 * y).T[rows, columns, None]
        # The quarter reaches from the sample's center half a pixel towards the middle of the four.
        offset = 0.5 * corner * (1 - 2 * x, 1 - 2 * y)
        offset = offset if x == y else offset[::-1]  # mirrored once: clockwise again
        own = inverse[rows, columns, None]
        values.append(np.maximum(own + slope_x * offset[:, 0] + slope_y * offset[:, 1], 0.5 * own))
        pixels.append(np.stack([columns, rows], axis=1)[:, None] + offset)
    return np.concatenate(pixels) - 1, np.concatenate(values)


def _relative_steps(inverse: NDArray[np.float64]) -> NDArray[np.float64]:
    """(H, W - 1): from each pixel to the next one in its row."""
    return 2 * np.diff(inverse, axis=1) / (inverse[:, 1:] + inverse[:, :-1])


def _same_surface(inverse: NDArray[np.float64], limit: float) -> NDArray[np.bool_]:
    """(H, W - 1): a pixel and the next one in its row are on one surface.

    Either they are alike, or on one slope with the pixels on both sides; with that on one side if the step is small,
    which is so at the rim of a slanted surface.
    """
    steps = _relative_steps(inverse)
    bends = np.abs(np.diff(np.pad(steps, ((0, 0), (1, 1)), constant_values=np.nan), axis=1))
    one, both = np.fmin(bends[:, 1:], bends[:, :-1]), np.maximum(bends[:, 1:], bends[:, :-1])
    with np.errstate(invalid="ignore"):
        steps = np.abs(steps)
        return (steps <= limit) | (both <= limit) | ((one <= limit) & (steps <= _MAX_STEP))


def _slopes(inverse: NDArray[np.float64], right: NDArray[np.bool_], sign: int) -> NDArray[np.float64]:
    """(H, W): change along x per pixel, to the neighbor at ``sign`` or else the other one; 0 if neither fits."""
    steps = np.pad(np.where(right, np.diff(inverse, axis=1), 0.0), ((0, 0), (1, 1)))
    known = np.pad(right, ((0, 0), (1, 1)))
    after, before = slice(1, None), slice(None, -1)
    first, second = (after, before) if sign > 0 else (before, after)
    return np.where(known[:, first], steps[:, first], steps[:, second])


@jit
def draw_quads(
    x: NDArray[np.float64], y: NDArray[np.float64], inverse: NDArray[np.float64], image: NDArray[np.float64]
) -> None:
    """Draw quadrilaterals as two triangles each; if several cover the center of a pixel, the nearest is kept.

    Inside of a triangle, inverse depth is interpolated linearly, which is exact on planes. A quadrilateral is divided
    along the diagonal with the more similar ends. Triangles that are seen from behind are left out. The corners, (N,
    4) ``x``, ``y`` and inverse depth, are clockwise as the image is seen; ``image``, 0 = nothing, is changed in place.
    """
    for n in range(len(x)):
        other = int(abs(inverse[n, 0] - inverse[n, 2]) > abs(inverse[n, 1] - inverse[n, 3]))
        _draw_triangle(x[n], y[n], inverse[n], 0 + other, 1 + other, 2 + other, image)
        _draw_triangle(x[n], y[n], inverse[n], 2 + other, (3 + other) % 4, 0 + other, image)


@helper
def _draw_triangle(x, y, inverse, a, b, c, image):
    ux, uy, vx, vy = x[b] - x[a], y[b] - y[a], x[c] - x[a], y[c] - y[a]
    area = ux * vy - vx * uy
    if not area > 0:
        return
    height, width = image.shape
    top = max(math.ceil(min(y[a], y[b], y[c]) - 1e-6), 0)
    bottom = min(math.floor(max(y[a], y[b], y[c]) + 1e-6), height - 1)
    left = max(math.ceil(min(x[a], x[b], x[c]) - 1e-6), 0)
    right = min(math.floor(max(x[a], x[b], x[c]) + 1e-6), width - 1)
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            dx, dy = column - x[a], row - y[a]
            share_b = (dx * vy - vx * dy) / area
            share_c = (ux * dy - dx * uy) / area
            if share_b < _ON_EDGE or share_c < _ON_EDGE or share_b + share_c > 1 - _ON_EDGE:
                continue
            value = inverse[a] + share_b * (inverse[b] - inverse[a]) + share_c * (inverse[c] - inverse[a])
            if value > image[row, column]:
                image[row, column] = value

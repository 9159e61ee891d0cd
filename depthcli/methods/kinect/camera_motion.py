"""Motion of the camera between two frames: its estimation, and the projection of a frame into the next view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.maps import Doubles, Floats, Image8, Ints, Mask
from depthcli.kernels.jit import helper, jit, run_bands

# Common values for trackers; nothing in the repository varies them.
_MAX_CORNERS, _CORNER_QUALITY, _CORNER_DISTANCE = 400, 0.01, 8  # count, share of the best corner's score, pixels
_MIN_INLIERS, _MIN_INLIER_SHARE = 30, 0.5  # tracked corners that must agree with a motion
_UNCERTAIN = 3  # width of the uncertain band along steps and unreached pixels, pixels
_REPROJECTION = 1.0  # largest reprojection error of an inlier, pixels


@dataclass(frozen=True)
class MovedView:
    """The previous frame, projected into the view of the next frame."""

    source: Ints  # (H, W), row x width + column in the previous frame; 0 if not reached
    reached: Mask  # (H, W), a pixel of the previous frame is projected there
    disparity: Floats  # (H, W), pixels in the next view, NaN = none
    color: Image8  # (H, W, 3), interpolated; arbitrary if not reached
    certain: Mask  # (H, W), reached, and not near a disparity step or unreached pixels


def view_after(
    motion: Doubles, color: Image8, disparity: Floats, camera: Intrinsics, fb: float, max_step: float
) -> MovedView:
    """Project a frame into the view after a motion; if several pixels fall in one place, the nearest is seen.

    Positions are rounded to whole pixels, so edges are off by up to half a pixel. These errors would add up over
    frames, so pixels near edges are not certain.

    Parameters
    ----------
    motion : (4, 4), from the frame's coordinates to the next view's coordinates, meters
    max_step : largest disparity step within a surface, pixels; gaps of one pixel are closed within surfaces
    """
    shape = disparity.shape
    source, values = np.full(shape, -1, np.int32), np.full(shape, np.nan, np.float32)
    _splat(disparity, *_pixel_motion(motion, camera), np.float64(fb), source, values)
    _close(source, values, np.float32(max_step))
    columns, rows = np.empty(shape, np.float32), np.empty(shape, np.float32)
    run_bands(
        _places, len(values), values, *_pixel_motion(np.linalg.inv(motion), camera), np.float64(fb), columns, rows
    )
    shown = cv2.remap(color, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    steps = cv2.morphologyEx(np.nan_to_num(values), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    size = 2 * _UNCERTAIN - 1  # the gradient reaches one pixel farther
    edges = cv2.dilate(((source < 0) | (steps > max_step)).astype(np.uint8), np.ones((size, size), np.uint8))
    return MovedView(np.maximum(source, 0), source >= 0, values, np.asarray(shown, np.uint8), np.asarray(edges == 0))


def displacement(motion: Doubles, disparity: Floats, camera: Intrinsics, fb: float) -> float:
    """Return how far the image moves, pixels: the 90th percentile over a grid; 0 if no pixel has a disparity."""
    rows, columns = (axis.ravel() for axis in np.mgrid[: disparity.shape[0] : 16, : disparity.shape[1] : 16])
    known = ~np.isnan(disparity[rows, columns])
    rows, columns = rows[known], columns[known]
    if not rows.size:
        return 0.0
    matrix, offset = _pixel_motion(motion, camera)
    pixels = np.stack([columns, rows, np.ones(rows.size)])
    points = (matrix @ pixels).T + offset * (disparity[rows, columns] / fb)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.where(points[:, 2:] > 0, points[:, :2] / points[:, 2:], np.inf)
    return float(np.quantile(np.hypot(moved[:, 0] - columns, moved[:, 1] - rows), 0.9, method="lower"))


def estimated_motion(
    color: Image8, next_color: Image8, disparity: Floats, camera: Intrinsics, fb: float
) -> Doubles | None:
    """Estimate the camera's motion from corners tracked between two frames; None if too few corners agree.

    Corners are tracked by the Lucas-Kanade method. The motion, (4, 4) from the first frame's coordinates to the next
    frame's coordinates, in meters, solves a perspective-n-point problem with RANSAC.
    """
    grey, next_grey = (cv2.cvtColor(each, cv2.COLOR_RGB2GRAY) for each in (color, next_color))
    corners = cv2.goodFeaturesToTrack(grey, _MAX_CORNERS, _CORNER_QUALITY, _CORNER_DISTANCE)
    if corners is None or len(corners) < _MIN_INLIERS:
        return None
    tracked, found, _ = cv2.calcOpticalFlowPyrLK(grey, next_grey, corners, None)  # type: ignore[call-overload]
    at, to = corners.reshape(-1, 2).astype(np.float64), tracked.reshape(-1, 2).astype(np.float64)
    columns, rows = np.rint(at).astype(np.int64).T
    inverse = disparity[rows, columns].astype(np.float64) / fb
    good = (found.ravel() == 1) & (inverse > 0)
    if good.sum() < _MIN_INLIERS:
        return None
    at, to, z = at[good], to[good], 1 / inverse[good]
    points = np.stack([(at[:, 0] - camera.cx) / camera.fx * z, (at[:, 1] - camera.cy) / camera.fy * z, z], axis=1)
    done, turn, shift, inliers = cv2.solvePnPRansac(
        points, to, camera.matrix, np.zeros(4), reprojectionError=_REPROJECTION, confidence=0.999
    )
    if not done or inliers is None or len(inliers) < max(_MIN_INLIERS, _MIN_INLIER_SHARE * len(points)):
        return None
    chosen = inliers.ravel()
    turn, shift = cv2.solvePnPRefineLM(points[chosen], to[chosen], camera.matrix, np.zeros(4), turn, shift)
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    return motion if np.isfinite(motion).all() else None


def _pixel_motion(motion: Any, camera: Intrinsics) -> tuple[Doubles, Doubles]:
    # Return A and b: a pixel p = (x, y, 1) of depth z moves to the pixel q = A p + b / z, with depth z q[2].
    return camera.matrix @ motion[:3, :3] @ np.linalg.inv(camera.matrix), camera.matrix @ motion[:3, 3]


@helper
def _moved(a, b, x, y, inverse):
    # Return the column and row that a pixel of this inverse depth moves to, and the factor of its depth.
    w = a[2, 0] * x + a[2, 1] * y + a[2, 2] + b[2] * inverse
    u = (a[0, 0] * x + a[0, 1] * y + a[0, 2] + b[0] * inverse) / w
    v = (a[1, 0] * x + a[1, 1] * y + a[1, 2] + b[1] * inverse) / w
    return u, v, w


@jit
def _splat(disparity, a, b, fb, source, values):
    height, width = disparity.shape
    for y in range(height):
        for x in range(width):
            d = disparity[y, x]
            if not d > 0:
                continue
            u, v, w = _moved(a, b, x, y, d / fb)
            if not (w > 0 and -0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
                continue
            i, j = int(np.floor(v + 0.5)), int(np.floor(u + 0.5))
            value = np.float32(d / w)
            if not values[i, j] >= value:  # True if unknown
                values[i, j] = value
                source[i, j] = y * width + x


@jit
def _close(source, values, max_step):
    # Close gaps of one pixel, first along rows, then along columns.
    height, width = values.shape
    for dy, dx in ((0, 1), (1, 0)):
        for y in range(dy, height - dy):
            for x in range(dx, width - dx):
                if source[y, x] >= 0:
                    continue
                before, after = values[y - dy, x - dx], values[y + dy, x + dx]
                if abs(before - after) <= max_step:
                    values[y, x] = (before + after) / np.float32(2)
                    source[y, x] = source[y - dy, x - dx]


@jit
def _places(begin, end, values, a, b, fb, columns, rows):
    # Write the positions of the next view's pixels in the previous frame; -1 if not seen.
    width = values.shape[1]
    for y in range(begin, end):
        for x in range(width):
            columns[y, x], rows[y, x] = -1, -1
            u, v, w = _moved(a, b, x, y, values[y, x] / fb)
            if w > 0:  # False if unknown
                columns[y, x], rows[y, x] = u, v

"""Disparity, depth and raw sensor codes: the triangulation formulas, in one place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def depth_of_disparity(disparity: NDArray[np.floating[Any]], fb: float, offset: float = 0.0) -> NDArray[np.float32]:
    """Depth ``fb / (d + offset)`` of a rectified pair.

    Parameters
    ----------
    disparity : pixels, NaN = unknown
    fb : focal length x baseline, pixel meters
    offset : difference of the principal points (``doffs`` of Middlebury v3), pixels

    Returns
    -------
    float32, meters; NaN where the disparity is unknown or the point is not in front of the cameras
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (fb / (disparity.astype(np.float64) + offset)).astype(np.float32)
    depth[~(np.isfinite(depth) & (depth > 0))] = np.nan
    return depth


def disparity_of_depth(depth: NDArray[np.floating[Any]], fb: float, offset: float = 0.0) -> NDArray[np.float32]:
    """The inverse of :func:`depth_of_disparity`; float32, pixels, NaN where the depth is unknown or not positive."""
    with np.errstate(divide="ignore", invalid="ignore"):
        disparity = (fb / depth.astype(np.float64) - offset).astype(np.float32)
    disparity[~(np.isfinite(disparity) & (depth > 0))] = np.nan
    return disparity


@dataclass(frozen=True)
class Camera:
    """A pin-hole camera with lens distortion.

    Attributes
    ----------
    matrix : (3, 3) float64, pixels
    distortion : coefficients k1, k2, p1, p2, k3 of OpenCV's model
    """

    matrix: NDArray[np.float64]
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def scaled(self, factor: float) -> Camera:
        """The same camera with an image of ``factor`` times the size."""
        matrix = self.matrix.copy()
        matrix[0, 2] = (matrix[0, 2] + 0.5) * factor - 0.5
        matrix[1, 2] = (matrix[1, 2] + 0.5) * factor - 0.5
        matrix[[0, 1], [0, 1]] *= factor
        return Camera(matrix, self.distortion)


@dataclass(frozen=True)
class KinectCalibration:
    """Both cameras of a first-generation Kinect and how its raw codes become depth.

    The plain model is the triangulation of the thesis's eq. 1.1, ``Z = Zr / (1 + Zr / (f b) d)``, with the
    shift ``d`` counted in raw codes: ``1 / Z = (offset - raw) / factor``. The calibrated one (Herrera et al., TPAMI
    2012) corrects the codes first: ``raw + beta(x, y) exp(alpha_0 - alpha_1 raw)``.

    Attributes
    ----------
    depth, color : cameras
    rotation, translation : from the depth camera's frame to the color camera's; (3, 3), (3,) meters
    offset, factor : raw code of infinity; code meters
    beta : (H, W) spatial distortion of the codes, or None
    alpha : its decay
    """

    depth: Camera
    color: Camera
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    offset: float = 1092.5
    factor: float = 351.3
    beta: NDArray[np.float64] | None = None
    alpha: tuple[float, float] = (0.0, 0.0)

    def depth_of_raw(self, raw: NDArray[np.uint16]) -> NDArray[np.float32]:
        """Depth of raw codes 0..2046 (2047 = none); (H, W) float32, meters, NaN where unknown."""
        codes = raw.astype(np.float64)
        if self.beta is not None:
            codes += self.beta * np.exp(self.alpha[0] - self.alpha[1] * codes)
        with np.errstate(divide="ignore"):
            depth = self.factor / (self.offset - codes)
        depth[(raw >= _RAW_NONE) | ~(depth > 0) | ~np.isfinite(depth)] = np.nan
        return depth.astype(np.float32)

    def register(self, depth: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
        """The depth camera's map as the color camera, whose image is ``shape``, sees it.

        Points are projected and the nearest one of a pixel wins; single pixels that no point met, between two
        neighbors of like depth, are closed.

        Parameters
        ----------
        depth : (H, W) float32, meters, NaN = unknown
        shape : (H', W') of the color image that ``color`` describes

        Returns
        -------
        (H', W') float32, meters, NaN = unknown
        """
        rows, cols = np.nonzero(np.isfinite(depth))
        registered = np.full(shape, np.nan, np.float32)
        if len(rows) == 0:
            return registered
        pixels = np.stack([cols, rows], axis=1).astype(np.float64)[:, None]
        rays = cv2.undistortPoints(pixels, self.depth.matrix, np.asarray(self.depth.distortion))[:, 0]
        z = depth[rows, cols].astype(np.float64)
        points = np.stack([rays[:, 0] * z, rays[:, 1] * z, z], axis=1) @ self.rotation.T + self.translation
        points = points[points[:, 2] > 0]
        projected, _ = cv2.projectPoints(
            points, np.zeros(3), np.zeros(3), self.color.matrix, np.asarray(self.color.distortion)
        )
        x, y = np.rint(projected[:, 0]).astype(np.int64).T
        inside = (x >= 0) & (y >= 0) & (x < shape[1]) & (y < shape[0])
        x, y, far = x[inside], y[inside], points[inside, 2]
        order = np.lexsort((-far, y * shape[1] + x))  # of equal pixels the nearest comes last, and stays
        registered[y[order], x[order]] = far[order]
        return _closed(registered)


_RAW_NONE = 2047
_ALIKE = 0.03  # relative difference of two depths that may be bridged


def _closed(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Single unknown pixels between two known ones of like depth get their mean."""
    out = depth.copy()
    for axis in (1, 0):
        before, here, after = (
            out[:, k : out.shape[1] - 2 + k] if axis else out[k : out.shape[0] - 2 + k] for k in (0, 1, 2)
        )
        with np.errstate(invalid="ignore"):
            bridge = np.isnan(here) & (np.abs(before - after) <= _ALIKE * np.minimum(before, after))
        here[bridge] = (before[bridge] + after[bridge]) / 2
    return out


def kinect_v1() -> KinectCalibration:
    """A typical first-generation Kinect, that of the NYU Depth v2 recordings (Silberman et al., ECCV 2012)."""
    depth = Camera(
        np.array([[582.62448167737955, 0, 313.04475870804731], [0, 582.69103270988637, 238.44389626620386], [0, 0, 1]]),
        (
            -0.099897236553084481,
            0.39065324602765344,
            0.0019290592870229277,
            -0.0019422022475975055,
            -0.51031725053400578,
        ),
    )
    color = Camera(
        np.array([[518.85790117450188, 0, 325.58244941119034], [0, 519.46961112127485, 253.73616633400465], [0, 0, 1]]),
        (0.20796615318809061, -0.58613825163911781, 0.00072231363135888329, 0.0010479627195765181, 0.49856986684705107),
    )
    rotation = np.array(
        [
            [0.99997798940829263, 0.0050518419386157446, 0.0043011152014118693],
            [-0.0050359919480810989, 0.99998051861143999, -0.0036879781309514218],
            [-0.0043196624923060242, 0.0036662365748484798, 0.99998394948385538],
        ]
    )
    translation = np.array([-0.025031875059141302, 0.00029342312935846411, -0.00066238747008330102])
    return KinectCalibration(depth, color, rotation.T, translation)

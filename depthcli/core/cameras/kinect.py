"""The depth sensor of a first-generation Kinect: its raw codes, and its depth in the color camera's pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Camera, Intrinsics
from depthcli.core.cameras.color_and_depth import ColorAndDepth

KINECT_BASELINE = 0.075
"""Distance of projector and depth camera in the first Kinect and in sensors of the same design, meters."""

KINECT_FOCAL_LENGTH = 580.0
"""Of the first Kinect's depth camera, pixels of its 640 x 480 images."""

UNKNOWN_CODE = 2047
"""Raw code of a pixel without depth, the largest of 11 bits."""


def sensor_fb(camera: Intrinsics | None) -> float:
    """Return focal length x baseline of a Kinect whose depth is registered to ``camera``, or stays in its own one."""
    return (camera.fx if camera else KINECT_FOCAL_LENGTH) * KINECT_BASELINE


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

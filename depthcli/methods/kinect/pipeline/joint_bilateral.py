"""Joint bilateral inpainting, the thesis's competitor, as a peer."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.frames import RgbdFrame
from depthcli.core.method import Odd
from depthcli.core.result import Clock
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.kinect.noise import noise_level
from depthcli.methods.kinect.outcome import measured_disparity, outcome
from depthcli.methods.kinect.pipeline import KinectPipeline
from depthcli.methods.kinect.result import RefinedDepth


class JointBilateral(KinectPipeline):
    """Fill every gap with the mean of what is known around, weighted by distance and likeness of color.

    Repeated from the gap's rim inwards, until nothing is left that a window can reach.
    """

    window: Odd = Field(21, ge=3, le=101, description="side of the window, pixels, odd")
    sigma_space: float = Field(5.0, gt=0, description="standard deviation of the weight by distance, pixels")
    sigma_color: float = Field(15.0, gt=0, description="standard deviation of the weight by color, grey levels")

    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        clock = Clock()
        measured = measured_disparity(frame)
        filled = joint_bilateral_fill(frame.color, measured, self.window, self.sigma_space, self.sigma_color)
        clock.stop("fill")
        noise = noise_level(measured)
        sigma = np.where(np.isnan(measured), np.nan, noise).astype(np.float32)
        return outcome(frame, filled, sigma, noise, clock)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        return 60 * shape[0] * shape[1]


def joint_bilateral_fill(
    color: NDArray[np.uint8],
    values: NDArray[np.float32],
    window: int = 21,
    sigma_space: float = 5.0,
    sigma_color: float = 15.0,
) -> NDArray[np.float32]:
    """Fill unknown values with ``sum w v / sum w`` over the known ones of a window, from the rims inwards.

    ``w = exp(-|p - q|^2 / 2 sigma_space^2 - |I_p - I_q|^2 / 2 sigma_color^2)``. What is filled counts as known in
    the next round; values that no round reaches stay NaN.

    Parameters
    ----------
    color : (H, W, 3) uint8
    values : (H, W) float32, NaN = unknown
    window : side, pixels, odd
    sigma_space, sigma_color : pixels, grey levels
    """
    reach = window // 2
    offsets = np.arange(-reach, reach + 1)
    spatial = np.exp(-(offsets[:, None] ** 2 + offsets**2) / (2 * sigma_space**2)).astype(np.float32)
    likeness = np.exp(-np.arange(3 * 255**2 + 1) / (2 * sigma_color**2)).astype(np.float32)
    filled = values.copy()
    unknown = np.argwhere(np.isnan(filled))
    while unknown.size:
        found = _bilateral_means(color, filled, unknown, spatial, likeness)
        reached = ~np.isnan(found)
        if not reached.any():
            break
        filled[tuple(unknown[reached].T)] = found[reached]
        unknown = unknown[~reached]
    return filled


@parallel_jit
def _bilateral_means(color: Any, values: Any, pixels: Any, spatial: Any, likeness: Any) -> Any:
    height, width = values.shape
    reach = spatial.shape[0] // 2
    means = np.empty(len(pixels), np.float32)
    for n in prange(len(pixels)):
        y, x = pixels[n]
        r, g, b = np.int32(color[y, x, 0]), np.int32(color[y, x, 1]), np.int32(color[y, x, 2])
        total, weights = 0.0, 0.0
        for v in range(max(y - reach, 0), min(y + reach + 1, height)):
            for u in range(max(x - reach, 0), min(x + reach + 1, width)):
                value = values[v, u]
                if np.isnan(value):
                    continue
                dr, dg, db = color[v, u, 0] - r, color[v, u, 1] - g, color[v, u, 2] - b
                weight = spatial[v - y + reach, u - x + reach] * likeness[dr * dr + dg * dg + db * db]
                total += weight * value
                weights += weight
        # Far from every color the weights underflow together: such a pixel waits for a nearer rim.
        means[n] = total / weights if weights > 1e-30 else np.nan
    return means

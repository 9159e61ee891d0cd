"""Smoothing of a map that was fitted to scattered samples, where it is an extrapolation: far from all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from depthcli.algorithms.plane_fitting.samples import Samples
from depthcli.kernels.jit import parallel_jit, prange


class Smoothing(BaseModel):
    """The mean of a window, weighted by similarity of color, at pixels that are far from all samples.

    There a plane is an extrapolation, and those of neighboring pixels rest on other samples: their mean is nearer to
    the surface. Near samples it would only flatten the fit.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    reach: float = Field(
        0.011,
        ge=0,
        description="values are smoothed beyond this distance from the nearest sample, as a share of the image width",
    )
    radius: int = Field(5, ge=0, le=50, description="half the side of the window, pixels")
    color_scale: float = Field(
        12.0, gt=0, description="color difference at which a neighbor's weight falls by exp(-1/2), grey levels"
    )

    def __call__(
        self, values: NDArray[np.float32], samples: Samples, image: NDArray[np.uint8], wanted: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """Smooth a map.

        Parameters
        ----------
        values : (H, W) float32, fitted; NaN = unknown, left out of the means
        samples : those that ``values`` were fitted to
        image : (H, W, 3) uint8
        wanted : (H, W) bool, pixels to smooth; others keep ``values``

        Returns
        -------
        (H, W) float32
        """
        height, width = values.shape
        selected = wanted & np.isfinite(values) & (samples.distance((height, width)) > self.reach * width)
        result = values.copy()
        _smooth(values, image, selected, self.radius, np.float32(1.0 / (2.0 * self.color_scale**2)), result)
        return result


@parallel_jit
def _smooth(values, image, wanted, radius, rate, result):
    height, width = values.shape
    for y in prange(height):
        for x in range(width):
            if not wanted[y, x]:
                continue
            total = weight = np.float32(0.0)
            for v in range(max(0, y - radius), min(height, y + radius + 1)):
                for u in range(max(0, x - radius), min(width, x + radius + 1)):
                    off = values[v, u] - values[y, x]
                    if np.isnan(off):
                        continue
                    color = np.float32(0.0)
                    for c in range(3):
                        step = np.float32(image[v, u, c]) - np.float32(image[y, x, c])
                        color += step * step
                    w = np.exp(-color * rate)
                    weight += w
                    total += w * off
            result[y, x] = values[y, x] + total / weight

"""Neighbors of like color smooth what was fitted to samples."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.transparent.robust_fit import Samples


class Smoothing(BaseModel):
    """The mean of a window, weighted by likeness of color, far from all samples.

    There a plane is an extrapolation, and those of neighbors rest on other samples, or on another choice among them:
    their mean is nearer to the surface. Near samples it would only flatten what they say.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    reach: float = Field(
        0.011, ge=0, description="distance from the nearest sample beyond which it is done, over the image's width"
    )
    radius: int = Field(5, ge=0, le=50, description="half the side of the window, pixels")
    color_scale: float = Field(
        12.0, gt=0, description="color difference at which a neighbor counts exp(-1/2), grey levels"
    )

    def __call__(
        self,
        values: NDArray[np.float32],
        samples: Samples,
        image: NDArray[np.uint8],
        wanted: NDArray[np.bool_],
    ) -> NDArray[np.float32]:
        """Smooth a map.

        Parameters
        ----------
        values : (H, W) float32, what was fitted; NaN = unknown, never a neighbor
        samples : what it was fitted to
        image : (H, W, 3) uint8
        wanted : (H, W) bool, where it is done; elsewhere ``values`` are returned

        Returns
        -------
        (H, W) float32
        """
        blank = np.ones(values.shape, np.uint8)
        blank[samples.rows, samples.columns] = 0
        away = cv2.distanceTransform(blank, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        result = values.copy()
        _smooth(
            values, image, wanted & np.isfinite(values) & (away > self.reach * values.shape[1]), self.radius,
            np.float32(1.0 / (2.0 * self.color_scale**2)), result,
        )  # fmt: skip
        return result


@parallel_jit
def _smooth(values: Any, image: Any, wanted: Any, radius: int, rate: Any, result: Any) -> None:
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

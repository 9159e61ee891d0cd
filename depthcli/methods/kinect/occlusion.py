"""What can lie in a gap of a depth map: the sensor did not see it because something nearer hides it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import parallel_jit, prange


def farthest_fit(disparity: NDArray[np.float32], jump: float, tolerance: float = 2.5) -> NDArray[np.float32]:
    """Largest disparity (H, W) float32 that fits the shadow a gap in a row looks like; inf where it looks like none.

    A gap of n pixels beside a jump is the shadow of its near side on a surface that is farther by about n pixels of
    disparity: on the far side of the jump, if that is as far, or else on something behind it.

    Parameters
    ----------
    disparity : (H, W) float32, pixels, NaN = unknown
    jump : gaps between known pixels that differ by less are taken for reflections, not for shadows
    tolerance : pixels of disparity
    """
    limit = np.full(disparity.shape, np.inf, np.float32)
    _limits(disparity, np.float32(jump), np.float32(tolerance), limit)
    return limit


@parallel_jit
def _limits(disparity, jump, tolerance, limit):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for y in prange(height):
        last = -1
        for x in range(width):
            if np.isnan(disparity[y, x]):
                continue
            gap = x - last - 1
            if gap > 0 and last >= 0:
                near = max(disparity[y, last], disparity[y, x])
                far = min(disparity[y, last], disparity[y, x])
                if near - far > jump:
                    most = near - np.float32(gap)
                    if most >= far - tolerance:
                        most = max(most, far)
                    for u in range(last + 1, x):
                        limit[y, u] = most + tolerance
            last = x

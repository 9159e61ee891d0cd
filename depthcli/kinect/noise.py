"""How noisy a sensor's disparity is: the unit of every threshold on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_MAD = 1.4826  # standard deviation of a normal distribution by its median absolute deviation


def noise_level(disparity: NDArray[np.float32], floor: float = 0.1) -> float:
    """Standard deviation of a disparity map's noise, in its pixels.

    From the median of the second differences along rows and columns, which slopes do not touch and edges hardly
    do. Where most of them are 0 the values are rounded: then that of rounding to their usual step.

    Parameters
    ----------
    disparity : (H, W) float32, pixels, NaN = unknown
    floor : least answer. Triangulating sensors interpolate and smooth to about 1/8 pixel, and of noise that
        neighbors share the differences show little
    """
    bends = [np.abs(np.diff(disparity, 2, axis=axis)).ravel() for axis in (0, 1)]
    steps = [np.abs(np.diff(disparity, axis=axis)).ravel() for axis in (0, 1)]
    bend, step = (a[~np.isnan(a)] for a in (np.concatenate(bends), np.concatenate(steps)))
    step = step[step > 0]
    smooth = _MAD * float(np.median(bend)) / 6**0.5 if bend.size else 0.0
    rounded = float(np.median(step)) / 12**0.5 if step.size and np.median(bend) == 0 else 0.0
    return max(smooth, rounded, floor)

"""How noisy a sensor's disparity is: the unit of every threshold on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_SAMPLES = 60_000  # about so many second differences along either axis are enough
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
    every = max(1, disparity.size // _SAMPLES)
    lines = disparity[::every], disparity[:, ::every].T
    bends, steps = (np.concatenate([np.abs(np.diff(a, n)).ravel() for a in lines]) for n in (2, 1))
    bend, step = bends[~np.isnan(bends)], steps[steps > 0]
    middle = float(np.median(bend)) if bend.size else 0.0
    rounded = float(np.median(step)) / 12**0.5 if step.size and middle == 0 else 0.0
    return max(_MAD * middle / 6**0.5, rounded, floor)

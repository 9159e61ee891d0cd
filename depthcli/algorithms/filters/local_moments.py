"""Mean and variance of the grey levels around every pixel."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def local_moments(image: NDArray[np.float32], side: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean and variance in windows of ``side`` pixels, reflected at the border; (H, W) float32 each."""
    mean = cv2.blur(image, (side, side))
    variance = np.maximum(cv2.blur(image * image, (side, side)) - mean * mean, 0)
    return np.asarray(mean, np.float32), np.asarray(variance, np.float32)

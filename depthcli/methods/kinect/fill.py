"""The simplest fill of a map's gaps."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def nearest_fill(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Unknown values take that of the nearest known one (Euclidean distance as ``cv2.distanceTransform`` has it).

    Parameters
    ----------
    values : (H, W) float32, NaN = unknown; all unknown stays so
    """
    unknown = np.isnan(values)
    if not unknown.any() or unknown.all():
        return values.copy()
    _, label = cv2.distanceTransformWithLabels(
        unknown.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.full(int(label.max()) + 1, np.nan, np.float32)
    table[label[~unknown]] = values[~unknown]
    filled: NDArray[np.float32] = table[label]
    return filled

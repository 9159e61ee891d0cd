"""Matched key points of two views that are not rectified, and the difference of their rows."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
"""(N, 2) x and y, pixels."""

_MAX_PIXELS = 2_000_000  # larger images are reduced to this size for key points: more pixels add little
_MAX_KEY_POINTS = 6000
_RATIO = 0.75  # a match must be nearer than this times the second candidate (Lowe, IJCV 2004, has 0.8)


def match_views(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> tuple[Points, Points]:
    """Return matched key points (SIFT, mutual nearest neighbors, ratio test) of two (H, W) uint8 views, some wrong."""
    found = []
    for image in (left, right):
        height, width = image.shape
        shrink = min(1.0, (_MAX_PIXELS / (height * width)) ** 0.5)
        small = image
        if shrink < 1:
            small = np.asarray(cv2.resize(image, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA), np.uint8)
        points, descriptors = cv2.SIFT.create(nfeatures=_MAX_KEY_POINTS).detectAndCompute(small, None)
        places = np.array([point.pt for point in points], np.float64).reshape(-1, 2)
        scale = np.array([width / small.shape[1], height / small.shape[0]])
        found.append(((places + 0.5) * scale - 0.5, descriptors))
    (one, of_one), (other, of_other) = found
    if len(one) < 2 or len(other) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    matcher = cv2.BFMatcher()
    back = {match.queryIdx: match.trainIdx for match in matcher.match(of_other, of_one)}
    kept = [
        (best.queryIdx, best.trainIdx)
        for best, second in matcher.knnMatch(of_one, of_other, k=2)
        if best.distance < _RATIO * second.distance and back.get(best.trainIdx) == best.queryIdx
    ]
    pairs = np.array(sorted(kept), np.int64).reshape(-1, 2)
    return one[pairs[:, 0]], other[pairs[:, 1]]


def row_error(left: Points, right: Points) -> float:
    """Return the median difference of the rows of matched points, pixels; NaN if there are none."""
    return float(np.median(np.abs(left[:, 1] - right[:, 1]))) if len(left) else float("nan")

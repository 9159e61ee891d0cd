"""Rectification without a calibration: key points of both views are matched and brought to the same rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.maps import Doubles, Image8, Mask

Points = NDArray[np.float64]
"""(N, 2) x and y, pixels."""

_MAX_PIXELS = 2_000_000  # larger images are reduced to this size for key points: more pixels add little
_MAX_KEY_POINTS = 6000
_RATIO = 0.75  # a match must be nearer than this times the second candidate (Lowe, IJCV 2004, has 0.8)
_MIN_MATCHES = 20  # for six unknowns
_MAX_ROW_ERROR = 1.0  # median, pixels, of a pair rectified without calibration; matching tolerates it
_MAX_STEPS = 60  # of Levenberg-Marquardt, which ends earlier when steps are small
_FIRST_FOCALS = (1.0, 1.5, 0.7, 2.5)  # starts of the search, in lengths of the longer side: wide to long lenses
_REGULARIZATION = 0.1  # pixels per radian, and per unit of log f: keeps undetermined parameters at zero
_MIN_DISPARITY_SHARE = 0.02  # smallest disparity of the matches after rectification, share of the width


def match_views(left: Image8, right: Image8) -> tuple[Points, Points]:
    """Return key points (SIFT, mutual nearest neighbors, ratio test) of two (H, W) uint8 views, with outliers."""
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


@dataclass(frozen=True)
class RectifyingHomographies:
    """The (3, 3) homographies that warp both views to ``size``, (width, height)."""

    left: Doubles
    right: Doubles
    size: tuple[int, int]

    def images(self, left: NDArray[Any], right: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], Mask]:
        """Return both warped images, and (H, W) bool of the pixels inside both."""
        views, in_both = [], np.ones(self.size[::-1], bool)
        for image, homography in ((left, self.left), (right, self.right)):
            views.append(cv2.warpPerspective(image, homography, self.size, flags=cv2.INTER_CUBIC))
            full = np.full(image.shape[:2], 255, np.uint8)
            in_both &= cv2.warpPerspective(full, homography, self.size, flags=cv2.INTER_NEAREST) > 0
        return views[0], views[1], in_both

    def points(self, left: Points, right: Points) -> tuple[Points, Points]:
        """Return the (N, 2) warped pixels of both views."""
        return _moved(self.left, left), _moved(self.right, right)


def rectify_uncalibrated(left: Points, right: Points, size: tuple[int, int]) -> RectifyingHomographies:
    """Return homographies that bring matched points of cameras of unknown focal length to the same rows.

    They turn two pin-hole cameras of one focal length, so that the images keep their shape (quasi-Euclidean
    rectification, Fusiello and Irsara, ICPR 2008). Only matches that a fundamental matrix explains count (MAGSAC). Then
    the right view is moved along the rows so that disparities begin a little above 0. ``size`` is the (width, height)
    of both views. Raise InputError if there are too few matches, or if half of them stay more than a pixel apart.
    """
    if len(left) < _MIN_MATCHES:
        raise InputError(f"only {len(left)} key points match, at least {_MIN_MATCHES} are needed to rectify a pair")
    _, inside = cv2.findFundamentalMat(left, right, cv2.USAC_MAGSAC, 1.0, 0.999, 10_000)
    chosen = np.zeros(len(left), bool) if inside is None else inside.ravel() > 0
    if chosen.sum() < _MIN_MATCHES:
        raise InputError(f"no geometry of two views explains the {len(left)} matched key points")
    starts = [_fitted(left[chosen], right[chosen], size, focal * max(size)) for focal in _FIRST_FOCALS]
    found = starts[0]
    error = row_error(*found.points(left, right))
    for other in starts[1:]:
        other_error = row_error(*other.points(left, right))
        if other_error < 0.9 * error:
            error, found = other_error, other
    if not error <= _MAX_ROW_ERROR:
        raise InputError(
            f"the rows of half of the {len(left)} matched key points stay more than {error:.1f} px apart, at most "
            f"{_MAX_ROW_ERROR:g} px may be left; calibrate the cameras"
        )
    return found


def _fitted(left: Points, right: Points, size: tuple[int, int], focal: float) -> RectifyingHomographies:
    """Return the best homographies: Levenberg-Marquardt over 2 + 3 angles and the focal length, Huber's weights."""
    parameters, damping = np.zeros(6), 1e-3
    weigh = np.sqrt(len(left)) * _REGULARIZATION

    def residual(values: Doubles) -> Doubles:
        one, other = (_moved(h, p) for h, p in zip(_turned(values, size, focal), (left, right), strict=True))
        rows = one[:, 1] - other[:, 1]
        rows *= 1 / np.sqrt(np.maximum(np.abs(rows), 1.0))
        return np.concatenate([rows, weigh * values])

    here = residual(parameters)
    for _ in range(_MAX_STEPS):
        columns = [(residual(parameters + step) - residual(parameters - step)) / 2e-6 for step in 1e-6 * np.eye(6)]
        jacobian = np.stack(columns, axis=1)
        normal = jacobian.T @ jacobian
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -jacobian.T @ here)
        trial = residual(parameters + step)
        if trial @ trial < here @ here:
            parameters, here, damping = parameters + step, trial, damping / 10
            if np.abs(step).max() < 1e-9:
                break
        else:
            damping *= 10
            if damping > 1e9:
                break
    one, other = _turned(parameters, size, focal)
    middle = np.array([[(size[0] - 1) / 2, (size[1] - 1) / 2]])
    shift = middle - _moved(one, middle)
    ours, theirs = _moved(one, left), _moved(other, right)
    first = float(np.quantile(ours[:, 0] - theirs[:, 0], 0.01)) - _MIN_DISPARITY_SHARE * size[0]
    to_left, to_right = np.eye(3), np.eye(3)
    to_left[:2, 2] = shift[0]
    to_right[:2, 2] = shift[0] + (first, 0)
    return RectifyingHomographies(to_left @ one, to_right @ other, size)


def _turned(values: Doubles, size: tuple[int, int], focal: float) -> tuple[Doubles, Doubles]:
    f = focal * np.exp(np.clip(values[5], -2, 2))
    camera = np.array([[f, 0, (size[0] - 1) / 2], [0, f, (size[1] - 1) / 2], [0, 0, 1]])
    inverse = np.linalg.inv(camera)
    one = np.asarray(cv2.Rodrigues(np.array([0.0, values[0], values[1]]))[0], np.float64)
    other = np.asarray(cv2.Rodrigues(values[2:5].copy())[0], np.float64)
    return camera @ one @ inverse, camera @ other @ inverse


def _moved(homography: Doubles, points: Points) -> Points:
    return np.asarray(cv2.perspectiveTransform(points[:, None], homography), np.float64)[:, 0]

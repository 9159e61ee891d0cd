"""Shadows of the sensor's projector: which surfaces can lie in a gap, and whether a frame's gaps are shadows at all.

With the projector on the right of the camera, pixels left of a near surface that the camera sees but the projector
does not reach have no depth: of a row, the pixels x with ``x - d(x) >= x' - d(x')`` for a nearer pixel x' on their
right. On one surface that is a strip as wide as the step of disparity.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.kernels.jit import jit, parallel_jit, prange

# Values that the preset refine-kinect accurate was published with; nothing in the repository varies them.
SHADOW_FACTOR, GAP_FACTOR, HOLE_FACTOR = 0.02, 0.06, 0.5
"""Likelihood of a surface that is nearer than a shadow allows: in a shadow, another gap, a hole of one surface."""
SHADOW_BAND = 8
"""Width of the band on the right of a shadow where the near surface may have grown over the far one, pixels."""
WIDTH_TOLERANCE = 4.0
"""Pixels by which a shadow may be wider than its step."""
SLOPE_FADE = 20.0
"""Distance from a surface at which half of its slope is left when it is continued, pixels."""
_MAX_WIDTH_DIFFERENCE = 3.0  # between a gap and its step that still count as equal, pixels
_FULL_SHARE = 0.5  # share of gaps as wide as their step from which on the confidence is 1
_PRIOR_GAPS = 20.0  # gaps added to those of the frame, as if not as wide as their step
_MAX_COLOR_DIFFERENCE = 10  # between a hole and the surface around it, L1 in 8-bit Lab
# Share of the votes that the surface on the left of a shadow gets: least; where the shadow is as wide as its step.
_MIN_EXTRA_SHARE, _MAX_EXTRA_SHARE = 0.1, 0.6
_EXTRA_SHARE_SCALE = 2.0  # pixels between the shadow's width and the step over which the share falls by 1/e


def shadow_confidence(disparity: NDArray[np.float32], jump: float) -> float:
    """Estimate the confidence, 0 .. 1, that the frame's gaps are shadows, from how many are as wide as their step.

    Gaps left of the near side count for it, those on the right of it against it.

    Parameters
    ----------
    disparity : (H, W) float32, pixels, NaN = unknown
    jump : smallest step, pixels
    """
    counts = np.zeros((len(disparity), 4), np.int64)
    _count_gaps(disparity, np.float32(jump), counts)
    rising, falling, fits, mirrored = counts.sum(axis=0)
    return float(np.clip((fits - mirrored) / (rising + falling + _PRIOR_GAPS) / _FULL_SHARE, 0, 1))


def shadow_limits(
    lab: NDArray[np.uint8],
    disparity: NDArray[np.float32],
    planes: WindowPlanes,
    jump: float,
    tolerance: float,
    confidence: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compute the largest disparity that a shadow allows at each pixel, and the likelihood of surfaces above it.

    Parameters
    ----------
    lab : (H, W, 3) uint8, CIE Lab as OpenCV scales it
    disparity : (H, W) float32, pixels, NaN = unknown
    planes : of the measured disparity
    jump, tolerance : pixels
    confidence : of :func:`shadow_confidence`

    Returns
    -------
    limit : (H, W) float32, pixels; inf outside gaps
    limit_factor : (H, W) float32 in (0, 1], factor of the likelihood; 1 outside gaps and for ``confidence`` 0
    """
    limit = np.full(disparity.shape, np.inf, np.float32)
    limit_factor = np.ones(disparity.shape, np.float32)
    factors = (np.float32(f**confidence) for f in (SHADOW_FACTOR, GAP_FACTOR, HOLE_FACTOR))
    in_shadow, in_gap, in_hole = factors
    _limits(
        lab, disparity, planes.value, planes.slope_x, np.float32(jump), np.float32(tolerance), in_shadow, in_gap,
        in_hole, limit, limit_factor,
    )  # fmt: skip
    return limit, limit_factor


def shadow_background(
    disparity: NDArray[np.float32], planes: WindowPlanes, jump: float, confidence: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compute the disparity of the surface behind each shadow and the band on its right, and its share of the votes.

    It is the surface on the left, continued along its slope. A shadow is as wide as the step to the surface that it
    falls on: the nearer its width is to the step to the surface on the left, the larger the share.

    Parameters
    ----------
    disparity, planes, jump, confidence : as in :func:`shadow_limits`

    Returns
    -------
    background : (H, W) float32, pixels, NaN = no shadow
    extra_share : (H, W) float32, share of all votes that the background gets in addition
    """
    background = np.full(disparity.shape, np.nan, np.float32)
    extra_share = np.zeros(disparity.shape, np.float32)
    low, high = np.float32(confidence * _MIN_EXTRA_SHARE), np.float32(confidence * _MAX_EXTRA_SHARE)
    _background(disparity, planes.value, planes.slope_x, np.float32(jump), low, high, background, extra_share)
    return background, extra_share


@jit
def _gaps(d, first):  # type: ignore[no-untyped-def]
    # (n, 2): the known pixels beside every gap of a row. Gaps at its ends are left out, but the first one if ``first``:
    # its left pixel is -1.
    ends = np.empty((d.size, 2), np.int64)
    count, last = 0, -1
    for x in range(d.size):
        if not np.isnan(d[x]):
            if x - last > 1 and (first or last >= 0):
                ends[count, 0], ends[count, 1] = last, x
                count += 1
            last = x
    return ends[:count]


@parallel_jit
def _count_gaps(disparity, jump, counts):  # type: ignore[no-untyped-def]
    for y in prange(disparity.shape[0]):
        d = disparity[y]
        for last, x in _gaps(d, False):
            step = d[x] - d[last]
            if x - last > 2 and abs(step) > jump:
                side = 0 if step > 0 else 1
                counts[y, side] += 1
                if abs(np.float32(x - last - 1) - abs(step)) <= _MAX_WIDTH_DIFFERENCE:
                    counts[y, 2 + side] += 1


@jit
def _rim_contrast(lab, d, y, u, left, right):  # type: ignore[no-untyped-def]
    # Smallest difference of color between pixel u and the first few known ones beyond the rims of its gap.
    smallest = np.int32(1000)
    for k in range(8):
        for v in (left - k, right + k):
            if 0 <= v < d.size and not np.isnan(d[v]):
                contrast = np.int32(0)
                for i in range(3):
                    contrast += abs(np.int32(lab[y, u, i]) - np.int32(lab[y, v, i]))
                smallest = min(smallest, contrast)
    return smallest


@parallel_jit
def _limits(lab, disparity, value, slope_x, jump, tolerance, in_shadow, in_gap, in_hole, limit, limit_factor):  # type: ignore[no-untyped-def]
    for y in prange(disparity.shape[0]):
        d = disparity[y]
        for last, x in _gaps(d, True):
            gap = x - last - 1
            step = d[x] - d[last] if last >= 0 else np.float32(0)
            factor = in_shadow if step > jump and gap <= step + WIDTH_TOLERANCE else in_gap
            one_surface = False
            if last >= 0 and abs(step) < jump + np.float32(0.2) * np.float32(gap):
                far = np.float32(gap + 1)
                off = abs(value[y, last] + slope_x[y, last] * far - d[x])
                off = min(off, abs(value[y, x] - slope_x[y, x] * far - d[last]))
                one_surface = off < tolerance + np.float32(0.05) * far
            for u in range(last + 1, x):
                if one_surface:
                    # a hole in one surface, if the color is that of the rims
                    factor = in_hole if _rim_contrast(lab, d, y, u, last, x) < _MAX_COLOR_DIFFERENCE else in_gap
                limit[y, u] = d[x] - np.float32(x - u) + tolerance
                limit_factor[y, u] = factor


@parallel_jit
def _background(disparity, value, slope_x, jump, low, high, background, extra_share):  # type: ignore[no-untyped-def]
    for y in prange(disparity.shape[0]):
        d = disparity[y]
        for last, x in _gaps(d, False):
            gap, step = x - last - 1, d[x] - d[last]
            if step > jump and gap <= step + WIDTH_TOLERANCE:
                end = min(x + SHADOW_BAND, d.size)
                for u in range(last + 1, end):
                    far = np.float32(u - last)
                    fade = 1 + (far / np.float32(SLOPE_FADE)) ** 2
                    background[y, u] = value[y, last] + slope_x[y, last] * far / fade
                off = (np.float32(gap) - (d[x] - background[y, x])) / np.float32(_EXTRA_SHARE_SCALE)
                extra_share[y, last + 1 : end] = low + (high - low) * np.float32(np.exp(-off * off))


def max_disparity_in_gaps(disparity: NDArray[np.float32], jump: float, tolerance: float = 2.5) -> NDArray[np.float32]:
    """Compute the largest disparity (H, W) float32 that a gap allows if it is a shadow; inf where it is none.

    One value per gap, from its rims only (:func:`shadow_limits` is finer, and weighs). A gap of n pixels beside a step
    is the shadow of its near side on a surface that is farther by about n pixels of disparity: on the far side of the
    step, if that is as far, or else on a surface behind it.

    Parameters
    ----------
    disparity : (H, W) float32, pixels, NaN = unknown
    jump : gaps between known pixels that differ by less are taken for reflections, not for shadows, pixels
    tolerance : pixels of disparity
    """
    limit = np.full(disparity.shape, np.inf, np.float32)
    _max_in_gaps(disparity, np.float32(jump), np.float32(tolerance), limit)
    return limit


@parallel_jit
def _max_in_gaps(disparity, jump, tolerance, limit):  # type: ignore[no-untyped-def]
    for y in prange(disparity.shape[0]):
        d = disparity[y]
        for last, x in _gaps(d, False):
            near, far = max(d[last], d[x]), min(d[last], d[x])
            if near - far > jump:
                largest = near - np.float32(x - last - 1)
                if largest >= far - tolerance:
                    largest = max(largest, far)
                limit[y, last + 1 : x] = largest + tolerance

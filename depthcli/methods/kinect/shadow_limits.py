"""What shadows say of the surfaces in a gap: which are possible, and which one lies behind."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.kinect.shadows import WIDTH_TOLERANCE, Shadows, gaps_of

# Values that the preset refine-kinect accurate was published with; nothing in the repository varies them.
SHADOW_FACTOR, GAP_FACTOR, HOLE_FACTOR = 0.02, 0.06, 0.5
"""Likelihood of a surface that is nearer than a shadow allows: in a shadow, another gap, a hole of one surface."""
SHADOW_BAND = 8
"""Width of the band on the right of a shadow where the near surface may have grown over the far one, pixels."""
SLOPE_FADE = 20.0
"""Distance from a surface at which half of its slope is left when it is continued, pixels."""
_MAX_COLOR_DIFFERENCE = 10  # between a hole and the surface around it, L1 in 8-bit Lab
# Share of the votes that the surface on the left of a shadow gets: least; where the shadow is as wide as its step.
_MIN_EXTRA_SHARE, _MAX_EXTRA_SHARE = 0.1, 0.6
_EXTRA_SHARE_SCALE = 2.0  # pixels between the shadow's width and the step over which the share falls by 1/e


def shadow_limits(
    lab: NDArray[np.uint8],
    disparity: NDArray[np.float32],
    planes: WindowPlanes,
    jump: float,
    tolerance: float,
    shadows: Shadows,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compute the largest disparity that a shadow allows at each pixel, and the likelihood of surfaces above it.

    Parameters
    ----------
    lab : (H, W, 3) uint8, CIE Lab as OpenCV scales it
    disparity : (H, W) float32, pixels, NaN = unknown
    planes : of the measured disparity
    jump, tolerance : pixels
    shadows : of :func:`measure_shadows`

    Returns
    -------
    limit : (H, W) float32, pixels; inf outside gaps
    limit_factor : (H, W) float32 in (0, 1], factor of the likelihood; 1 outside gaps and without shadows
    """
    limit = np.full(disparity.shape, np.inf, np.float32)
    limit_factor = np.ones(disparity.shape, np.float32)
    for shadow, right, holes in shadows.sides():
        colors, values, value, slope = _turned(right, lab, disparity, planes.value, planes.slope_x)
        hidden = shadow.confidence * (1 - shadows.p_hole)
        factors = np.array([SHADOW_FACTOR**shadow.confidence, GAP_FACTOR**hidden, HOLE_FACTOR**hidden], np.float32)
        out, out_factor = _turned_views(right, limit, limit_factor)
        _limits(
            colors, values, value, -slope if right else slope, np.float32(jump), np.float32(tolerance), factors,
            np.float32(shadow.scale), np.float32(shadow.covered), holes, out, out_factor,
        )  # fmt: skip
    return limit, limit_factor


def shadow_background(
    disparity: NDArray[np.float32], planes: WindowPlanes, jump: float, shadows: Shadows
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compute the disparity of the surface behind each shadow and the band beyond it, and its share of the votes.

    It is the surface on the far side, continued along its slope. A shadow is as wide as the step to the surface that it
    falls on: the nearer its width is to the step to the surface on the far side, the larger the share.

    Parameters
    ----------
    disparity, planes, jump, shadows : as in :func:`shadow_limits`

    Returns
    -------
    background : (H, W) float32, pixels, NaN = no shadow
    extra_share : (H, W) float32, share of all votes that the background gets in addition
    """
    background = np.full(disparity.shape, np.nan, np.float32)
    extra_share = np.zeros(disparity.shape, np.float32)
    for shadow, right, _ in shadows.sides():
        values, value, slope = _turned(right, disparity, planes.value, planes.slope_x)
        low, high = (np.float32(shadow.confidence * share) for share in (_MIN_EXTRA_SHARE, _MAX_EXTRA_SHARE))
        out, out_share = _turned_views(right, background, extra_share)
        _background(
            values, value, -slope if right else slope, np.float32(jump), low, high, np.float32(shadow.scale),
            np.float32(shadow.covered), out, out_share,
        )  # fmt: skip
    return background, extra_share


def _turned_views(right: bool, *maps: Any) -> tuple[Any, ...]:
    # Views; mirrored for the right side, whose shadows are those of the left side of the mirrored frame.
    return tuple(m[:, ::-1] for m in maps) if right else maps


def _turned(right: bool, *maps: Any) -> tuple[Any, ...]:
    return tuple(np.ascontiguousarray(m) for m in _turned_views(right, *maps))


@jit
def _rim_contrast(lab, d, y, u, left, right):
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
def _limits(
    lab, disparity, value, slope_x, jump, tolerance, factors, scale, covered, holes, limit, limit_factor
):  # fmt: skip
    for y in prange(disparity.shape[0]):
        d = disparity[y]
        for last, x in gaps_of(d, True):
            gap = np.float32(x - last - 1)
            step = d[x] - d[last] if last >= 0 else np.float32(0)
            if step <= jump and not holes:
                continue
            shadow = step > jump and abs(gap + covered - scale * step) <= np.float32(WIDTH_TOLERANCE)
            factor = factors[0] if shadow else factors[1]
            one_surface = False
            if last >= 0 and abs(step) < jump + np.float32(0.2) * gap:
                far = gap + np.float32(1)
                off = abs(value[y, last] + slope_x[y, last] * far - d[x])
                off = min(off, abs(value[y, x] - slope_x[y, x] * far - d[last]))
                one_surface = off < tolerance + np.float32(0.05) * far
            for u in range(last + 1, x):
                if one_surface:
                    # a hole in one surface, if the color is that of the rims
                    factor = factors[2 if _rim_contrast(lab, d, y, u, last, x) < _MAX_COLOR_DIFFERENCE else 1]
                limit[y, u] = d[x] - (np.float32(x - u) + covered) / scale + tolerance
                limit_factor[y, u] = factor


@parallel_jit
def _background(disparity, value, slope_x, jump, low, high, scale, covered, background, extra_share):
    for y in prange(disparity.shape[0]):
        d = disparity[y]
        for last, x in gaps_of(d, False):
            width, step = (np.float32(x - last - 1) + covered) / scale, d[x] - d[last]
            if step > jump and abs(width - step) <= np.float32(WIDTH_TOLERANCE):
                end = min(x + SHADOW_BAND, d.size)
                for u in range(last + 1, end):
                    far = np.float32(u - last)
                    fade = 1 + (far / np.float32(SLOPE_FADE)) ** 2
                    background[y, u] = value[y, last] + slope_x[y, last] * far / fade
                off = (width - (d[x] - background[y, x])) / np.float32(_EXTRA_SHARE_SCALE)
                extra_share[y, last + 1 : end] = low + (high - low) * np.float32(np.exp(-off * off))


def max_disparity_in_gaps(
    disparity: NDArray[np.float32], jump: float, shadows: Shadows, tolerance: float = 2.5
) -> NDArray[np.float32]:
    """Compute the largest disparity (H, W) float32 that a gap allows if it is a shadow; inf where it is none.

    One value per gap, from its rims only (:func:`shadow_limits` is finer, and weighs). A gap of n pixels beside a step
    is the shadow of its near side on a surface that is farther by about n pixels of disparity: on the far side of the
    step, if that is as far, or else on a surface behind it, unless holes are as probable.

    Parameters
    ----------
    disparity : (H, W) float32, pixels, NaN = unknown
    jump : gaps between known pixels that differ by less are taken for reflections, not for shadows, pixels
    shadows : of :func:`measure_shadows`
    tolerance : pixels of disparity
    """
    limit = np.full(disparity.shape, np.inf, np.float32)
    for shadow, right, _ in shadows.sides():
        (turned,) = _turned(right, disparity)
        _max_in_gaps(
            turned, np.float32(jump), np.float32(tolerance), np.float32(shadow.scale), np.float32(shadow.covered),
            shadows.p_hole < 0.5, _turned_views(right, limit)[0],
        )  # fmt: skip
    return limit


@parallel_jit
def _max_in_gaps(disparity, jump, tolerance, scale, covered, behind, limit):
    for y in prange(disparity.shape[0]):
        d = disparity[y]
        for last, x in gaps_of(d, False):
            near, far = d[x], d[last]
            if near - far <= jump:
                continue
            gap = np.float32(x - last - 1)
            largest = near - (gap + covered) / scale
            if largest >= far - tolerance:
                largest = max(largest, far)
            if behind or abs(gap + covered - scale * (near - far)) <= np.float32(WIDTH_TOLERANCE):
                limit[y, last + 1 : x] = largest + tolerance

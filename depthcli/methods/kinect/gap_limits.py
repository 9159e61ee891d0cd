"""Surfaces that gaps allow: limits from shadows, and the surfaces behind shadows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.core.maps import Floats, Image8
from depthcli.kernels.jit import helper, jit, run_bands
from depthcli.methods.kinect.color import lab_difference
from depthcli.methods.kinect.shadows import WIDTH_TOLERANCE, Shadow, Shadows, gaps_of

# Values of the published preset refine-kinect accurate; nothing in the repository varies them.
SHADOW_FACTOR, GAP_FACTOR, HOLE_FACTOR = 0.02, 0.06, 0.5
"""Likelihood of a surface nearer than a shadow allows: in a shadow, in another gap, in a hole of one surface."""
SHADOW_BAND = 8
"""Width of the band on the right of a shadow where the near surface may have grown over the far one, pixels."""
SLOPE_FADE = 20.0
"""Distance at which a continued surface has half of its slope, pixels."""
_MAX_COLOR_DIFFERENCE = 10  # between a hole and the surface around it, L1 in 8-bit Lab
# Smallest share of the votes for the surface on the left of a shadow, and largest: for a shadow as wide as its step.
_MIN_EXTRA_SHARE, _MAX_EXTRA_SHARE = 0.1, 0.6
_EXTRA_SHARE_SCALE = 2.0  # pixels between the shadow's width and the step over which the share falls by 1/e


class GapLimits(NamedTuple):
    """Limits of disparity in shadows; both arrays are (H, W) float32."""

    value: Floats  # pixels, inf outside gaps
    factor: Floats  # likelihood of surfaces above the limit, in (0, 1]; 1 outside gaps and without shadows


class _Sizes(NamedTuple):
    # The shadows on one side, as float32 for kernels.
    scale: np.float32
    covered: np.float32
    jump: np.float32

    @classmethod
    def of(cls, shadow: Shadow, jump: float) -> _Sizes:
        return cls(np.float32(shadow.scale), np.float32(shadow.covered), np.float32(jump))


@helper
def _is_shadow(gap, step, sizes):
    # Return whether a gap is as wide as the shadow of its step.
    return step > sizes.jump and abs(gap + sizes.covered - sizes.scale * step) <= np.float32(WIDTH_TOLERANCE)


def shadow_limits(
    lab: Image8, disparity: Floats, planes: WindowPlanes, jump: float, tolerance: float, shadows: Shadows
) -> GapLimits:
    """Compute the largest disparity that a shadow allows at each pixel, and the likelihood of surfaces above it."""
    limits = GapLimits(np.full(disparity.shape, np.inf, np.float32), np.ones(disparity.shape, np.float32))
    for shadow, step, holes in shadows.sides():
        turn = np.s_[:, ::step]
        given = [np.ascontiguousarray(m[turn]) for m in (lab, disparity, planes.value, step * planes.slope_x)]
        hidden = shadow.confidence * (1 - shadows.p_hole)
        factors = np.array([SHADOW_FACTOR**shadow.confidence, GAP_FACTOR**hidden, HOLE_FACTOR**hidden], np.float32)
        found = [np.ascontiguousarray(m[turn]) for m in limits]
        run_bands(
            _limits, len(disparity), *found, holes, factors, _Sizes.of(shadow, jump), np.float32(tolerance), *given
        )
        limits.value[turn], limits.factor[turn] = found
    return limits


@helper
def _rim_contrast(lab, d, y, u, left, right):
    # Return the smallest color difference between pixel u and the known ones of the first 8 pixels beyond each rim.
    smallest = np.int32(1000)
    for k in range(8):
        for v in (left - k, right + k):
            if 0 <= v < d.size and not np.isnan(d[v]):
                smallest = min(smallest, lab_difference(lab, y, u, y, v))
    return smallest


@jit
def _limits(begin, end, limit, limit_factor, holes, factors, sizes, tolerance, lab, disparity, value, slope_x):
    for y in range(begin, end):
        d = disparity[y]
        for last, x in gaps_of(d, True):
            gap = np.float32(x - last - 1)
            step = d[x] - d[last] if last >= 0 else np.float32(0)
            if step <= sizes.jump and not holes:
                continue
            factor = factors[0 if _is_shadow(gap, step, sizes) else 1]
            one_surface = False
            if last >= 0 and abs(step) < sizes.jump + np.float32(0.2) * gap:
                far = gap + np.float32(1)
                off = abs(value[y, last] + slope_x[y, last] * far - d[x])
                off = min(off, abs(value[y, x] - slope_x[y, x] * far - d[last]))
                one_surface = off < tolerance + np.float32(0.05) * far
            for u in range(last + 1, x):
                if one_surface:
                    # a hole in one surface, if its color is similar to the rims' colors
                    factor = factors[2 if _rim_contrast(lab, d, y, u, last, x) < _MAX_COLOR_DIFFERENCE else 1]
                limit[y, u] = d[x] - (np.float32(x - u) + sizes.covered) / sizes.scale + tolerance
                limit_factor[y, u] = factor


def max_disparity_in_gaps(disparity: Floats, jump: float, shadows: Shadows, tolerance: float = 2.5) -> Floats:
    """Compute the largest disparity (H, W) float32 that shadows allow in gaps; inf elsewhere.

    Each gap gets one value, from its rims only; :func:`shadow_limits` is finer and weights the limits. A gap of n
    pixels at a step is the shadow of its near side on a surface about n pixels of disparity farther. This is the far
    side of the step if it fits. Otherwise it is a surface behind the far side, unless holes are at least as probable.
    Gaps between known pixels that differ by at most ``jump`` are no shadows.
    """
    limit = np.full(disparity.shape, np.inf, np.float32)
    for shadow, step, _ in shadows.sides():
        turned, behind = np.ascontiguousarray(disparity[:, ::step]), shadows.p_hole < 0.5
        found = np.ascontiguousarray(limit[:, ::step])
        run_bands(_max_in_gaps, len(turned), found, turned, behind, _Sizes.of(shadow, jump), np.float32(tolerance))
        limit[:, ::step] = found
    return limit


@jit
def _max_in_gaps(begin, end, limit, disparity, behind, sizes, tolerance):
    for y in range(begin, end):
        d = disparity[y]
        for last, x in gaps_of(d, False):
            gap, step = np.float32(x - last - 1), d[x] - d[last]
            if step > sizes.jump and (behind or _is_shadow(gap, step, sizes)):
                largest = d[x] - (gap + sizes.covered) / sizes.scale
                if largest >= d[last] - tolerance:
                    largest = max(largest, d[last])
                limit[y, last + 1 : x] = largest + tolerance


def shadow_background(disparity: Floats, planes: WindowPlanes, jump: float, shadows: Shadows) -> tuple[Floats, Floats]:
    """Compute the disparity of the surface behind each shadow and the band beyond it, and its share of the votes.

    This surface is the far side of the step, continued along its slope. A shadow is as wide as the step to the surface
    behind it, so the share is larger if the width is closer to the step. Both results are (H, W) float32: disparity in
    pixels, NaN = no shadow; and the background's additional votes as a share of all votes.
    """
    background, extra_share = np.full(disparity.shape, np.nan, np.float32), np.zeros(disparity.shape, np.float32)
    for shadow, step, _ in shadows.sides():
        turn = np.s_[:, ::step]
        given = [np.ascontiguousarray(m[turn]) for m in (disparity, planes.value, step * planes.slope_x)]
        low, high = (np.float32(shadow.confidence * share) for share in (_MIN_EXTRA_SHARE, _MAX_EXTRA_SHARE))
        found = [np.ascontiguousarray(m[turn]) for m in (background, extra_share)]
        run_bands(_background, len(disparity), *found, _Sizes.of(shadow, jump), low, high, *given)
        background[turn], extra_share[turn] = found
    return background, extra_share


@jit
def _background(begin, end, background, extra_share, sizes, low, high, disparity, value, slope_x):
    for y in range(begin, end):
        d = disparity[y]
        for last, x in gaps_of(d, False):
            width, step = (np.float32(x - last - 1) + sizes.covered) / sizes.scale, d[x] - d[last]
            if step > sizes.jump and abs(width - step) <= np.float32(WIDTH_TOLERANCE):
                stop = min(x + SHADOW_BAND, d.size)
                for u in range(last + 1, stop):
                    far = np.float32(u - last)
                    fade = 1 + (far / np.float32(SLOPE_FADE)) ** 2
                    background[y, u] = value[y, last] + slope_x[y, last] * far / fade
                off = (width - (d[x] - background[y, x])) / np.float32(_EXTRA_SHARE_SCALE)
                extra_share[y, last + 1 : stop] = low + (high - low) * np.float32(np.exp(-off * off))

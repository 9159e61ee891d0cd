"""What can lie in the projector's shadow, and how far a frame's gaps are shadows at all.

With the projector on the right of the camera, what is seen left of a near surface but hidden from the
projector has no depth: of a row, the pixels x with ``x - d(x) >= x' - d(x')`` for a nearer pixel x' on their right.
On one surface that is a strip as wide as the step of disparity.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.kernels.jit import jit, parallel_jit, prange

_CLOSE = 3.0  # pixels by which a gap's width may differ from the step, to count as a shadow
_USUAL = 0.5  # share of the gaps at steps that fit, from which on all are believed to be shadows
_PRIOR_RUNS = 20.0
_SLACK = 4.0  # pixels by which a shadow may be wider than the step
_STRONG, _WEAK, _SAME = 0.02, 0.06, 0.5
_SAME_COLOR = 10  # L1 in 8-bit Lab
_RIM = 0.1, 0.6  # share that the left rim's surface gets: in any shadow; where the shadow's width proves it
_RIM_WIDTH = 2.0  # pixels
_FADE = 20.0  # pixels over which a slope is followed
BAND = 8  # pixels right of a shadow that may show the near surface too wide


def shadow_belief(disparity: NDArray[np.float32], jump: float) -> float:
    """In [0, 1]: how far the frame's gaps behave like shadows, by how many are as wide as the step they lie at.

    Gaps left of the near side count for it, those on the right of it against it.

    Parameters
    ----------
    disparity : (H, W) float32, pixels, NaN = unknown
    jump : least step, pixels
    """
    counts = np.zeros((len(disparity), 4), np.int64)
    _count_runs(disparity, np.float32(jump), counts)
    rising, falling, fits, mirrored = counts.sum(axis=0)
    return float(np.clip((fits - mirrored) / (rising + falling + _PRIOR_RUNS) / _USUAL, 0, 1))


def shadow_limits(
    lab: NDArray[np.uint8],
    disparity: NDArray[np.float32],
    planes: WindowPlanes,
    jump: float,
    tolerance: float,
    belief: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Largest disparity that fits a shadow at each pixel, and the factor for the likelihood of what is nearer.

    Parameters
    ----------
    lab : (H, W, 3) uint8, CIE Lab as OpenCV scales it
    disparity : (H, W) float32, pixels, NaN = unknown
    planes : of the measured disparity
    jump, tolerance : pixels
    belief : of :func:`shadow_belief`

    Returns
    -------
    limit : (H, W) float32, pixels; inf outside gaps
    beyond : (H, W) float32 in (0, 1]; 1 outside gaps and for ``belief`` 0
    """
    limit = np.full(disparity.shape, np.inf, np.float32)
    beyond = np.ones(disparity.shape, np.float32)
    strong, weak, same = (np.float32(f**belief) for f in (_STRONG, _WEAK, _SAME))
    _limits(
        lab, disparity, planes.value, planes.slope_x, np.float32(jump), np.float32(tolerance), strong, weak, same,
        limit, beyond,
    )  # fmt: skip
    return limit, beyond


def left_rims(
    disparity: NDArray[np.float32], planes: WindowPlanes, jump: float, belief: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What the surface left of a shadow continues to, in the shadow and the band on its right; and how sure that is.

    A shadow's width is the step to the surface that it falls on: where the left rim's step agrees with it, it
    is that surface.

    Parameters
    ----------
    disparity, planes, jump, belief : as in :func:`shadow_limits`

    Returns
    -------
    rim : (H, W) float32, pixels, NaN = no shadow
    bonus : (H, W) float32, share of all votes that it gets besides
    """
    rim = np.full(disparity.shape, np.nan, np.float32)
    bonus = np.zeros(disparity.shape, np.float32)
    low, high = (np.float32(belief * b) for b in _RIM)
    _rims(disparity, planes.value, planes.slope_x, np.float32(jump), low, high, rim, bonus)
    return rim, bonus


@parallel_jit
def _count_runs(disparity, jump, counts):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for y in prange(height):
        d = disparity[y]
        last = -1
        for x in range(width):
            if np.isnan(d[x]):
                continue
            gap = x - last - 1
            if last >= 0 and gap > 1 and abs(d[x] - d[last]) > jump:
                step = d[x] - d[last]
                side = 0 if step > 0 else 1
                counts[y, side] += 1
                if abs(np.float32(gap) - abs(step)) <= _CLOSE:
                    counts[y, 2 + side] += 1
            last = x


@jit
def _rim_contrast(lab, d, y, u, left, right):  # type: ignore[no-untyped-def]
    """Least difference of color between pixel u and the first few known ones beyond the rims of its gap."""
    least = np.int32(1000)
    for k in range(8):
        for v in (left - k, right + k):
            if 0 <= v < d.size and not np.isnan(d[v]):
                contrast = np.int32(0)
                for i in range(3):
                    contrast += abs(np.int32(lab[y, u, i]) - np.int32(lab[y, v, i]))
                if contrast < least:
                    least = contrast
    return least


@parallel_jit
def _limits(lab, disparity, value, slope_x, jump, tolerance, strong, weak, same, limit, beyond):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for y in prange(height):
        d = disparity[y]
        last = -1
        for x in range(width):
            if np.isnan(d[x]):
                continue
            gap = x - last - 1
            if gap > 0:
                step = d[x] - d[last] if last >= 0 else np.float32(0)
                factor = strong if step > jump and gap <= step + _SLACK else weak
                one_surface = False
                if last >= 0 and abs(step) < jump + np.float32(0.2) * np.float32(gap):
                    far = np.float32(gap + 1)
                    off = abs(value[y, last] + slope_x[y, last] * far - d[x])
                    off = min(off, abs(value[y, x] - slope_x[y, x] * far - d[last]))
                    one_surface = off < tolerance + np.float32(0.05) * far
                for u in range(last + 1, x):
                    if one_surface:
                        # a hole in one surface, if the color is that of the rims
                        factor = same if _rim_contrast(lab, d, y, u, last, x) < _SAME_COLOR else weak
                    limit[y, u] = d[x] - np.float32(x - u) + tolerance
                    beyond[y, u] = factor
            last = x


@parallel_jit
def _rims(disparity, value, slope_x, jump, low, high, rim, bonus):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for y in prange(height):
        d = disparity[y]
        last = -1
        for x in range(width):
            if np.isnan(d[x]):
                continue
            gap = x - last - 1
            step = d[x] - d[last] if last >= 0 else np.float32(0)
            if gap > 0 and last >= 0 and step > jump and gap <= step + _SLACK:
                for u in range(last + 1, min(x + BAND, width)):
                    far = np.float32(u - last)
                    rim[y, u] = value[y, last] + slope_x[y, last] * far / (1 + (far / np.float32(_FADE)) ** 2)
                off = (np.float32(gap) - (d[x] - rim[y, x])) / np.float32(_RIM_WIDTH)
                share = low + (high - low) * np.float32(np.exp(-off * off))
                for u in range(last + 1, min(x + BAND, width)):
                    bonus[y, u] = share
            last = x


def shadow_rims(disparity: NDArray[np.float32], jump: float) -> NDArray[np.float32]:
    """(H, W) float32: in gaps that look like shadows the value on their left, else NaN.

    Parameters
    ----------
    disparity : (H, W) float32, pixels, NaN = unknown
    jump : least step, pixels
    """
    rim = np.full(disparity.shape, np.nan, np.float32)
    bonus = np.zeros(disparity.shape, np.float32)
    level = np.zeros(disparity.shape, np.float32)
    _rims(disparity, disparity, level, np.float32(jump), np.float32(0), np.float32(0), rim, bonus)
    return rim

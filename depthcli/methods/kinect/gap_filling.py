"""Fill gaps along the cheapest paths: each pixel continues the surface of the known pixel that its path starts from."""

from __future__ import annotations

import cv2
import numpy as np

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes, window_planes
from depthcli.core.maps import Floats, Image8, Ints, Mask
from depthcli.kernels.jit import empty, helper, jit, run_bands
from depthcli.methods.kinect.color import lab_difference
from depthcli.methods.kinect.gap_limits import SLOPE_FADE

UNRELIABLE_COST = 15.0
"""Initial cost of paths that start at unreliable pixels, pixels of path length."""
SHADOW_COST = 1000.0
"""Cost of a surface that a shadow rules out: higher than any color path, so that such a surface is the last resort."""

# Chosen for refine-kinect dsrm on simulated sensors and on blocks cut out of real frames; nothing varies them.
_COLOR_COST = 0.2  # cost per L1 difference in 8-bit Lab along a path; a pixel of length costs 1
_BORDER_COST = 5.0  # cost of crossing the border of a segment
_SWEEPS = 4
# Exchanges after which the fifth of nine numbers is their median (Paeth, Graphics Gems, 1990).
_MEDIAN_OF_NINE = tuple(
    (int(pair[0]), int(pair[1]))
    for pair in "12 45 78 01 34 67 12 45 78 03 58 47 36 14 25 47 42 64 42".split()  # noqa: SIM905
)
_SMOOTHING_STRIDES = (12, 8, 6, 4, 3, 2, 1)  # pixels; the first strides reach across the widest common gaps
_BLOCK = 256  # number of pixels whose medians are computed at once
_MAX_CONTRAST = 35  # largest contrast of pixels that smooth each other, L1 in 8-bit Lab


def fill_gaps(
    values: Floats, lab: Image8, segments: Ints | None, limit: Floats | None, cost: Floats, noise: float | None
) -> tuple[Floats, Mask]:
    """Fill the unknown pixels of a disparity map. NaN remains only if no pixel is known.

    The cost of a path is its length, the color differences along it, and the segment borders that it crosses. A filled
    value continues the plane around the path's start, with a slope that fades with distance. Paths to neighboring
    pixels may start far from each other, so medians over pixels of similar color smooth the result.

    Parameters
    ----------
    values : (H, W) float32, pixels, NaN = unknown
    segments : (n, H, W) int32, layers of segments, or None
    limit : (H, W) float32, largest possible disparity, pixels; inf = no limit; None: no limits
    cost : (H, W) float32 >= 0, initial cost of paths that start at a known pixel; unreliable pixels cost more
    noise : standard deviation of the values, pixels; None: continue values without slope, which is faster

    Returns the disparity and (H, W) bool, unknown pixels joined to a known pixel of the same segment in some layer.
    """
    known = ~np.isnan(values)
    unknown = np.flatnonzero(~known)
    inside, filled = np.zeros(values.shape, bool), values.copy()
    if not unknown.size or unknown.size == values.size:
        return filled, inside
    segments = np.empty((0, *values.shape), np.int32) if segments is None else segments
    limit = np.full_like(values, np.inf) if limit is None else limit
    start = np.where(known, np.arange(values.size, dtype=np.int32).reshape(values.shape), np.int32(-1))
    total = np.where(known, cost, np.float32(np.inf)).astype(np.float32)
    y, x = np.divmod(unknown, values.shape[1])
    pixels = np.stack([y, x], axis=1).astype(np.int32)
    _join(pixels, lab, segments, limit, values.ravel(), start, total)
    from_y, from_x = np.divmod(start.ravel()[unknown], values.shape[1])
    inside[y, x] = (segments[:, y, x] == segments[:, from_y, from_x]).any(axis=0)
    if noise is None:
        filled[y, x] = values[from_y, from_x]
    else:
        rim = cv2.dilate((~known).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        empty = [np.zeros(values.shape, np.float32) for _ in range(3)]
        planes = window_planes(values, known.astype(np.float32), noise, WindowPlanes(values, *empty), rim & known)
        down, right = (y - from_y).astype(np.float32), (x - from_x).astype(np.float32)
        slope = planes.slope_x[from_y, from_x] * right + planes.slope_y[from_y, from_x] * down
        fade = 1 + (right * right + down * down) / np.float32(SLOPE_FADE**2)
        filled[y, x] = planes.value[from_y, from_x] + slope / fade
    # Medians over pixels of similar color. Smoothed values above the limit come from beyond the shadow and are dropped.
    source, smoothed = filled.copy(), filled.copy()
    for stride in _SMOOTHING_STRIDES:
        run_bands(_median, (len(pixels) + _BLOCK - 1) // _BLOCK, source, pixels, lab, stride, smoothed)
        source, smoothed = smoothed, source
    return np.where(source > limit, filled, source), inside


@helper
def _exchange(low, high):
    for i in range(low.size):
        p, q = low[i], high[i]
        low[i] = p if p < q else q
        high[i] = q if p < q else p


@jit
def _median(begin, end, source, pixels, lab, stride, out):
    # A sorting network of nine samples per pixel, cut down to the median. A sample of another color, or outside the
    # map, is replaced by the pixel's own value.
    height, width = source.shape
    for block in range(begin, end):
        samples = empty((9, _BLOCK), np.float32)
        start = block * _BLOCK
        count = min(_BLOCK, len(pixels) - start)
        for i in range(count):
            y, x = pixels[start + i]
            light, a, b = np.int32(lab[y, x, 0]), np.int32(lab[y, x, 1]), np.int32(lab[y, x, 2])
            for k in range(9):
                v, u = y + (k // 3 - 1) * stride, x + (k % 3 - 1) * stride
                sample = source[y, x]
                if 0 <= v < height and 0 <= u < width:
                    contrast = abs(np.int32(lab[v, u, 0]) - light) + abs(np.int32(lab[v, u, 1]) - a)
                    contrast += abs(np.int32(lab[v, u, 2]) - b)
                    if contrast <= _MAX_CONTRAST:
                        sample = source[v, u]
                samples[k, i] = sample
        for p, q in _MEDIAN_OF_NINE:
            _exchange(samples[p, :count], samples[q, :count])
        for i in range(count):
            y, x = pixels[start + i]
            out[y, x] = samples[4, i]


@helper
def passed(y, x, step, k):
    """Return row and column of the k-th of four neighbors already passed by a raster sweep; ``step`` -1: backwards."""
    return (y, x - step) if k == 0 else (y - step, x + k - 2)


@jit
def _join(pixels, lab, segments, limit, values, start, total):
    # Raster sweeps alternate in direction, as for a chamfer distance; they miss paths with more turns than sweeps.
    height, width = limit.shape
    for sweep in range(_SWEEPS):
        step = 1 - 2 * (sweep & 1)
        for y, x in pixels[::step]:
            for k in range(4):
                v, u = passed(y, x, step, k)
                if not (0 <= v < height and 0 <= u < width) or start[v, u] < 0:
                    continue
                path = total[v, u] + np.float32(1 if k == 0 or k == 2 else 1.4)
                path += np.float32(_COLOR_COST) * np.float32(lab_difference(lab, np.int64(y), np.int64(x), v, u))
                for layer in range(len(segments)):
                    if segments[layer, v, u] != segments[layer, y, x]:
                        path += np.float32(_BORDER_COST)
                if values[start[v, u]] > limit[y, x]:
                    path += np.float32(SHADOW_COST)
                if path < total[y, x]:
                    total[y, x] = path
                    start[y, x] = start[v, u]

"""Where the true outline of a near surface lies beside a measured depth edge, learned from the frame itself.

A sensor that matches windows shows near surfaces too wide, by an amount that depends on the sensor, and registration
to the color camera shifts what it shows. Averaged over all depth edges of a frame, though, the contrast of the
color image peaks at the true outline: its profile across the edges is a law of how far off they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit, parallel_jit, prange

FIRST, LAST = -6, 14  # offsets of an outline that are thought of, pixels into the near side
SLOPE = 0.2  # over a gap of n pixels, steps below this many pixels a pixel are slopes
_SPAN = 20  # pixels on both sides of an edge whose contrast is looked at
_CEILING = 20.0  # contrast (L1 in 8-bit Lab) that counts in full
_LOBE = 0.15  # the peak ends where it falls below this share of its height
_PRIOR_EDGES = 100.0  # so many edges of full contrast weigh as much as the law of no particular sensor
_PRIOR_FLOOR = 0.1  # which always has this share
_HIDDEN = 0.5  # belief that a gap without a visible step hides something behind its rims
_OTHER_GAP = 0.6  # belief in an edge whose gap does not look like a shadow
_SHADOW_SLACK = 4.0  # pixels by which a shadow may be wider than the step
_MIXED = 0.75  # share of an outline's pixels that still belong to the near surface
_THIN = 0.6  # each raised run has a pixel that is right with at least this probability


def truth_probability(lab: NDArray[np.uint8], disparity: NDArray[np.float32], jump: float) -> NDArray[np.float32]:
    """Probability that a measured value belongs to the surface that is seen at its pixel.

    Parameters
    ----------
    lab : (H, W, 3) uint8, CIE Lab as OpenCV scales it
    disparity : (H, W) float32, pixels, NaN = unknown
    jump : a larger step between consecutive known pixels of a row or column is a depth edge, pixels

    Returns
    -------
    (H, W) float32 in [0, 1]; 1 far from all edges, and where nothing was measured
    """
    across = _along_rows(lab, disparity, jump, _HIDDEN)
    upright = np.ascontiguousarray(lab.transpose(1, 0, 2)), np.ascontiguousarray(disparity.T)
    # No sensor's shadows run along columns: a gap there says nothing about what its rims hide.
    result: NDArray[np.float32] = across * _along_rows(*upright, jump, 0.0).T
    return result


def _along_rows(
    lab: NDArray[np.uint8], disparity: NDArray[np.float32], jump: float, hidden: float
) -> NDArray[np.float32]:
    laws = outline_offsets(lab, disparity, jump)
    # The pixel that the outline runs through mixes both colors and shows half of the contrast on its inner side: it
    # still belongs to the near surface.
    laws = np.cumsum(laws, axis=1) + _MIXED * np.column_stack([laws[:, 1:], np.zeros(2)])
    laws = laws.astype(np.float32)
    result = np.empty_like(disparity)
    _probability(disparity, np.float32(jump), laws, np.float32(hidden), result)
    return result


def outline_offsets(lab: NDArray[np.uint8], disparity: NDArray[np.float32], jump: float) -> NDArray[np.float64]:
    """Law of the outline's offset from the depth edges of the rows: (2, LAST - FIRST + 1) float64, rows sum to 1.

    The first row is for edges whose near side lies on their right, the second for the others. Element i is the
    probability that the true near surface starts ``FIRST + i`` pixels inside the measured one.

    Parameters
    ----------
    lab, disparity, jump : as in :func:`truth_probability`
    """
    sums = np.zeros((len(disparity), 2, 2 * _SPAN))
    counts = np.zeros((len(disparity), 2), np.int64)
    _contrast_profiles(lab, disparity, np.float32(jump), sums, counts)
    offsets = np.arange(FIRST, LAST + 1)
    broad = np.exp(-np.abs(offsets - 2.5) / 2.5)
    broad /= broad.sum()
    laws = []
    for total, count in zip(sums.sum(axis=0), counts.sum(axis=0), strict=True):
        excess = np.zeros(offsets.size)
        if count:
            profile = total / count
            ground = max(np.median(profile[:10]), np.median(profile[-6:]))
            excess = np.maximum(profile[FIRST + _SPAN : LAST + _SPAN + 1] - ground, 0)
        top = int(excess.argmax())
        outside = np.flatnonzero(excess <= _LOBE * excess[top])
        excess[: outside[outside < top].max(initial=-1) + 1] = 0
        excess[outside[outside > top].min(initial=excess.size) :] = 0
        seen = excess.sum() / _CEILING * count  # edges' worth of full contrast
        share = (1 - _PRIOR_FLOOR) * seen / (seen + _PRIOR_EDGES)
        laws.append(share * excess / max(excess.sum(), 1e-9) + (1 - share) * broad)
    return np.array(laws)


@jit
def _is_edge(d, last, x, jump):  # type: ignore[no-untyped-def]
    return abs(d[x] - d[last]) > max(jump, np.float32(SLOPE) * np.float32(x - last))


@parallel_jit
def _contrast_profiles(lab, disparity, jump, sums, counts):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for y in prange(height):
        d = disparity[y]
        last = -1
        for x in range(width):
            if np.isnan(d[x]):
                continue
            if last >= _SPAN and _SPAN <= x < width - _SPAN and _is_edge(d, last, x, jump):
                side = 0 if d[x] > d[last] else 1
                for k in range(-_SPAN, _SPAN):
                    u = x + k if side == 0 else last - k + 1
                    contrast = 0.0
                    for i in range(3):
                        contrast += abs(np.float64(lab[y, u, i]) - np.float64(lab[y, u - 1, i]))
                    sums[y, side, k + _SPAN] += min(contrast, _CEILING)
                counts[y, side] += 1
            last = x


@parallel_jit
def _probability(disparity, jump, laws, hidden, out):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for y in prange(height):
        d, q = disparity[y], out[y]
        q[:] = np.float32(1)
        last = -1
        for x in range(width):
            if np.isnan(d[x]):
                continue
            gap = x - last - 1
            if last >= 0 and _is_edge(d, last, x, jump):
                step = d[x] - d[last]
                if step > 0:
                    belief = np.float32(1 if gap <= step + _SHADOW_SLACK else _OTHER_GAP)
                    _doubt_near(d, q, x, 1, jump, laws[0], belief)
                    _doubt_far(d, q, last, x, jump, laws[0], belief)
                else:
                    belief = np.float32(1 if gap <= 2 else _OTHER_GAP)
                    _doubt_near(d, q, last, -1, jump, laws[1], belief)
                    _doubt_far(d, q, x, last, jump, laws[1], belief)
            elif gap > 1:
                _doubt_near(d, q, x, 1, jump, laws[0], hidden)
                if last >= 0:
                    _doubt_near(d, q, last, -1, jump, laws[1], hidden)
            last = x
        _believe_raised_runs(d, q, jump)


@jit
def _doubt_near(d, q, x, step, jump, law, belief):  # type: ignore[no-untyped-def]
    """From x, the first pixel of the near side, inwards."""
    last, u = x, x
    for k in range(LAST + 1):
        if u < 0 or u >= d.size:
            break
        if not np.isnan(d[u]):
            if u != last and abs(d[u] - d[last]) > max(jump, np.float32(SLOPE) * np.float32(abs(u - last))):
                break
            last = u
            q[u] *= np.float32(1) - belief * (np.float32(1) - law[k - FIRST])
        u += step


@jit
def _doubt_far(d, q, x, near, jump, law, belief):  # type: ignore[no-untyped-def]
    """From x, the last pixel of the far side, outwards: the outline may lie outside what was measured."""
    step = 1 if x > near else -1
    last, u = x, x
    while 0 <= u < d.size and abs(u - near) <= -FIRST:
        if not np.isnan(d[u]):
            if u != last and abs(d[u] - d[last]) > max(jump, np.float32(SLOPE) * np.float32(abs(u - last))):
                break
            last = u
            q[u] *= np.float32(1) - belief * law[-abs(u - near) - FIRST]
        u += step


@jit
def _believe_raised_runs(d, q, jump):  # type: ignore[no-untyped-def]
    """What is nearer than a neighbor was seen for a reason: somewhere in every such run the value is right."""
    start, last = -1, -1
    raised = False
    for x in range(d.size):
        if np.isnan(d[x]):
            continue
        if last >= 0 and _is_edge(d, last, x, jump):
            if start >= 0 and (raised or d[x] < d[last]):
                most = np.float32(0)
                for u in range(start, last + 1):
                    if not np.isnan(d[u]):
                        most = max(most, q[u])
                if np.float32(0) < most < np.float32(_THIN):
                    for u in range(start, last + 1):
                        q[u] *= np.float32(_THIN) / most
            start = x
            raised = d[x] > d[last]
        last = x

"""Measurements next to depth edges: their distance from the edge, and the probability that they are correct.

A sensor that matches windows shows near surfaces too wide, by an amount that depends on the sensor. Registration to the
color camera also shifts them. Averaged over all depth edges of a frame, the contrast of the color image peaks at the
true outline, so the contrast profile across the edges gives the distribution of the outline's offset.
"""

from __future__ import annotations

import numpy as np

from depthcli.core.maps import Doubles, Floats, Image8, Mask
from depthcli.kernels.jit import helper, jit, run_bands
from depthcli.methods.kinect.color import lab_difference
from depthcli.methods.kinect.shadows import WIDTH_TOLERANCE, Shadows

# Values of the published preset refine-kinect accurate; nothing in the repository varies them.
MIN_OFFSET, MAX_OFFSET = -6, 14
"""Range of an outline's offset from a depth edge, pixels into the near side."""
_MAX_SLOPE = 0.2  # smaller steps over a gap are slopes, pixels of disparity per pixel
_PROFILE_REACH = 20  # length of the contrast profile on each side of an edge, pixels
_MAX_CONTRAST = 20.0  # larger contrast counts as this, L1 in 8-bit Lab
_PEAK_END = 0.15  # the profile's peak ends where it falls below this share of its height
_PRIOR_EDGES = 100.0  # weight of the prior distribution of offsets, edges of full contrast
_MIN_PRIOR_SHARE = 0.1  # smallest share of the prior in the distribution of offsets
_GAP_EDGE_PROBABILITY = 0.5  # probability that a gap without a step hides a surface behind its rims
_WIDE_GAP_PROBABILITY = 0.6  # probability that an edge is at its place if its gap is wider than a shadow
_MIXED_PIXEL_SHARE = 0.75  # share of the pixels on an outline that belong to the near surface
_MIN_RUN_PROBABILITY = 0.6  # floor of the largest probability in a run of pixels nearer than an adjacent run


def correct_probability(lab: Image8, disparity: Floats, jump: float, shadows: Shadows) -> Floats:
    """Compute the probability that a measured value belongs to the surface that the color image shows there.

    Returns (H, W) float32 in [0, 1]; 1 far from all edges, and at unknown pixels.
    """
    across = _along_rows(lab, disparity, jump, _GAP_EDGE_PROBABILITY, shadows)
    upright = np.ascontiguousarray(lab.transpose(1, 0, 2)), np.ascontiguousarray(disparity.T)
    # No sensor has shadows along columns, so a gap there is no evidence of surfaces behind its rims.
    return np.asarray(across * _along_rows(*upright, jump, 0.0, Shadows()).T, np.float32)


def _along_rows(lab: Image8, disparity: Floats, jump: float, gap_probability: float, shadows: Shadows) -> Floats:
    offsets = outline_offsets(lab, disparity, jump)
    # A pixel on the outline mixes both colors and has half of the contrast on its inner side. Most of these pixels
    # still belong to the near surface.
    inside = np.cumsum(offsets, axis=1) + _MIXED_PIXEL_SHARE * np.column_stack([offsets[:, 1:], np.zeros(2)])
    inside, result = inside.astype(np.float32), np.empty_like(disparity)
    # Probability that a measurement is incorrect, by its distance from the edge: on the near side, on the far side.
    near, far = np.float32(1) - inside[:, -MIN_OFFSET:], np.ascontiguousarray(inside[:, -MIN_OFFSET::-1])
    sides = shadows.left, shadows.right
    widths = np.array([(side.scale, side.covered) for side in sides], np.float32)
    shadowed = np.array([side.confidence > 0 for side in sides])
    run_bands(
        _probability, len(disparity), disparity, np.float32(jump), near, far, np.float32(gap_probability), widths,
        shadowed, result,
    )  # fmt: skip
    return result


def outline_offsets(lab: Image8, disparity: Floats, jump: float) -> Doubles:
    """Estimate the distribution of the outline's offset from depth edges in rows, (2, offsets) float64.

    The first row is for edges with the near side on their right, the second for the others; each sums to 1. Element i
    is the probability that the true near surface starts ``MIN_OFFSET + i`` pixels inside the measured one.
    """
    sums = np.zeros((len(disparity), 2, 2 * _PROFILE_REACH))
    counts = np.zeros((len(disparity), 2), np.int64)
    run_bands(_contrast_profiles, len(disparity), lab, disparity, np.float32(jump), sums, counts)
    offsets = np.arange(MIN_OFFSET, MAX_OFFSET + 1)
    prior = np.exp(-np.abs(offsets - 2.5) / 2.5)
    prior /= prior.sum()
    distributions = []
    for total, count in zip(sums.sum(axis=0), counts.sum(axis=0), strict=True):
        excess = np.zeros(offsets.size)
        if count:
            profile = total / count
            ground = max(np.median(profile[:10]), np.median(profile[-6:]))
            excess = np.maximum(profile[MIN_OFFSET + _PROFILE_REACH : MAX_OFFSET + _PROFILE_REACH + 1] - ground, 0)
        top = int(excess.argmax())
        outside = np.flatnonzero(excess <= _PEAK_END * excess[top])
        excess[: outside[outside < top].max(initial=-1) + 1] = 0
        excess[outside[outside > top].min(initial=excess.size) :] = 0
        n_edges = excess.sum() / _MAX_CONTRAST * count  # number of edges of full contrast
        share = (1 - _MIN_PRIOR_SHARE) * n_edges / (n_edges + _PRIOR_EDGES)
        distributions.append(share * excess / max(excess.sum(), 1e-9) + (1 - share) * prior)
    return np.array(distributions)


@helper
def _is_edge(d, last, x, jump):
    return abs(d[x] - d[last]) > max(jump, np.float32(_MAX_SLOPE) * np.float32(abs(x - last)))


@jit
def _contrast_profiles(begin, end, lab, disparity, jump, sums, counts):
    width = disparity.shape[1]
    for y in range(begin, end):
        d = disparity[y]
        last = -1
        for x in range(width):
            if np.isnan(d[x]):
                continue
            if last >= _PROFILE_REACH and _PROFILE_REACH <= x < width - _PROFILE_REACH and _is_edge(d, last, x, jump):
                side = 0 if d[x] > d[last] else 1
                for k in range(-_PROFILE_REACH, _PROFILE_REACH):
                    u = x + k if side == 0 else last - k + 1
                    sums[y, side, k + _PROFILE_REACH] += min(lab_difference(lab, y, u, y, u - 1), _MAX_CONTRAST)
                counts[y, side] += 1
            last = x


@jit
def _probability(begin, end, disparity, jump, near, far, gap_probability, widths, shadowed, out):
    width = disparity.shape[1]
    for y in range(begin, end):
        d, q = disparity[y], out[y]
        q[:] = np.float32(1)
        last = -1
        for x in range(width):
            if np.isnan(d[x]):
                continue
            gap = x - last - 1
            if last >= 0 and _is_edge(d, last, x, jump):
                step = d[x] - d[last]
                side = 0 if step > 0 else 1
                shadow = (np.float32(gap) + widths[side, 1]) / widths[side, 0]
                fits = gap <= 2 or (shadowed[side] and shadow <= abs(step) + np.float32(WIDTH_TOLERANCE))
                probability = np.float32(1 if fits else _WIDE_GAP_PROBABILITY)
                if step > 0:
                    _lower(d, q, x, 1, 0, jump, near[0], probability)
                    _lower(d, q, last, -1, gap + 1, jump, far[0], probability)
                else:
                    _lower(d, q, last, -1, 0, jump, near[1], probability)
                    _lower(d, q, x, 1, gap + 1, jump, far[1], probability)
            elif gap > 1:
                _lower(d, q, x, 1, 0, jump, near[0], gap_probability)
                if last >= 0:
                    _lower(d, q, last, -1, 0, jump, near[1], gap_probability)
            last = x
        _raise_thin_runs(d, q, jump)


@helper
def _lower(d, q, x, step, k, jump, wrong, probability):
    # Lower the probabilities q from x on, at distance k from the edge, to the end of the surface or of ``wrong``, the
    # probability by distance that a measurement is incorrect.
    last = x
    while k < wrong.size and 0 <= x < d.size:
        if not np.isnan(d[x]):
            if x != last and _is_edge(d, last, x, jump):
                break
            last = x
            q[x] *= np.float32(1) - probability * wrong[k]
        x += step
        k += 1


@helper
def _raise_thin_runs(d, q, jump):
    # A run nearer than an adjacent run shows an object, however thin, so one of its values is correct.
    start, last = -1, -1
    raised = False
    for x in range(d.size):
        if np.isnan(d[x]):
            continue
        if last >= 0 and _is_edge(d, last, x, jump):
            if start >= 0 and (raised or d[x] < d[last]):
                best = np.float32(0)
                for u in range(start, last + 1):
                    if not np.isnan(d[u]):
                        best = max(best, q[u])
                if np.float32(0) < best < np.float32(_MIN_RUN_PROBABILITY):
                    for u in range(start, last + 1):
                        q[u] *= np.float32(_MIN_RUN_PROBABILITY) / best
            start = x
            raised = d[x] > d[last]
        last = x


def near_side(disparity: Floats, jump: float, row_band: int, column_band: int, gap_tolerance: float = 2.5) -> Mask:
    """Select the known pixels, (H, W) bool, in bands on the near side of depth edges.

    The bands are ``row_band`` and ``column_band`` pixels wide. A depth edge is a step of more than ``jump`` between
    consecutive known pixels. The shadow of a near surface on a far one is as wide as the step between them. If a gap in
    a row is wider by more than ``gap_tolerance`` pixels, it contains another surface that either side may have grown
    over, so both sides count as near.
    """
    selected = np.zeros(disparity.shape, np.bool_)
    # There are no shadows along columns.
    for values, band, tolerance, out in (
        (disparity, row_band, gap_tolerance, selected), (disparity.T, column_band, np.inf, selected.T),
    ):  # fmt: skip
        distance = np.full(values.shape, 255, np.uint8)  # the largest: no edge within 254 pixels
        limits = np.float32(jump), np.float32(tolerance)
        run_bands(_distance_along_rows, len(values), np.ascontiguousarray(values), *limits, distance)
        out |= distance <= band
    return selected


@jit
def _distance_along_rows(begin, end, disparity, jump, tolerance, nearest):
    width = disparity.shape[1]
    for y in range(begin, end):
        d, out = disparity[y], nearest[y]
        for step in (1, -1):
            start, last = -1, -1  # first pixel of x's near side, previous known pixel; -1: none
            for k in range(width):
                x = k if step == 1 else width - 1 - k
                if np.isnan(d[x]):
                    continue
                if last >= 0:
                    height_of_step = abs(d[x] - d[last])
                    if abs(x - last) - 1 > height_of_step + tolerance:
                        start = x
                    elif height_of_step > jump:
                        start = x if d[x] > d[last] else -1
                last = x
                if start >= 0:
                    out[x] = min(np.int64(out[x]), abs(x - start) + 1)

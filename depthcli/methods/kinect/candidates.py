"""Candidates for the disparity of every unreliable pixel, the modes of the votes around it, and the choice of one."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.algorithms.trws import trws
from depthcli.core.arrays import Floats, Image8, Ints, Mask
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.kinect.shadows import SLOPE_FADE, lab_difference

# Values that the preset refine-kinect accurate was published with; nothing in the repository varies them.
LEVELS = ((1, 5), (4, 36), (12, 108))
"""Stride and reach of the voters: every pixel within 5, every fourth within 36, every twelfth within 108 pixels."""
_BIN = 5 / 3  # width of a bin of the histogram, multiples of the noise
_SPACE_SCALES = 2.0 * 1.1 ** np.arange(32)  # scales of distance that weights are tabulated for, pixels
_MIN_SHARE = 0.01  # smaller modes are no candidates
_MIN_SIMILARITY = 0.002  # of colors, however different
_MIN_LIKELIHOOD_RATIO = 0.3  # of a pixel's color on its own surface to that on surfaces behind it
_MIN_OPENING_DISTANCE = 9  # pixels: nearer ones may lie in the same opening
_OPENING_REACH = 36  # pixels
_OPENING_GRID, _OPENING_SQUARE = 3, 5  # one pixel of a square of 3 x 3 is tested, for all of 5 x 5 around it
_OPENING_SCALE = 20.0  # distance over which weights fall by 1/e, pixels
AGREEMENT = 4.0
"""A candidate agrees with the measurement if it differs by less than this, multiples of the noise."""
_SHARE_FLOOR = 0.08  # added to every share of votes, so that small shares cost about the same
_MAX_PROBABILITY = 0.97  # largest probability that a measurement is correct, and that it is wrong
_EDGE_COLOR = 12.0  # contrast over which smoothness falls by 1/e, L1 in 8-bit Lab
_MIN_WEIGHT = 0.02  # of smoothness, across the strongest color edge
_MAX_EXTRA_COST = 4.0  # candidates that cost more than the cheapest by this are left out
_NEIGHBORS = ((0, 1), (1, -1), (1, 0), (1, 1), (0, -1), (-1, 1), (-1, 0), (-1, -1))  # dy, dx: first those behind it


class Voters(NamedTuple):
    """The planes that vote: those of every n-th pixel of every n-th row, n being the ``stride``."""

    stride: int
    planes: Floats  # (3, h, w): value and slopes, pixels
    lab: Image8  # (3, h, w)
    weight: Floats  # (h, w), 0 = does not vote

    @classmethod
    def of(cls, lab: Image8, planes: WindowPlanes, trust: Floats, stride: int) -> Voters:
        """Return every n-th plane with the weight ``trust`` (H, W) of its pixel, times the n x n pixels of its cell."""
        every = np.s_[::stride, ::stride]
        stack = np.stack([planes.value[every], planes.slope_x[every], planes.slope_y[every]])
        weight = np.where(np.isnan(stack[0]), np.float32(0), trust[every] * np.float32(stride * stride))
        colors = np.ascontiguousarray(lab[every].transpose(2, 0, 1))
        return cls(stride, np.nan_to_num(stack), colors, weight.astype(np.float32))


class ExtraVotes(NamedTuple):
    """What votes beside the planes around: shadows, and surfaces continued into gaps; all (H, W) float32, pixels."""

    limit: Floats  # votes for disparities above it are multiplied by ``limit_factor``
    limit_factor: Floats
    background: Floats  # the surface behind a shadow, NaN = none
    extra_share: Floats  # of all votes, which it gets in addition
    continued: Floats  # (n, H, W) surfaces continued into gaps, NaN = none
    continued_share: Floats  # of all votes, which each of them gets in addition


def color_similarity(sigma: float) -> Floats:
    """Tabulate the similarity of two colors by their L1 distance in 8-bit Lab, (766,) float32."""
    return (np.exp(-np.arange(766) / sigma) + _MIN_SIMILARITY).astype(np.float32)


def cast_votes(
    pixels: Ints,
    lab: Image8,
    voters: list[Voters],
    prior: ExtraVotes,
    noise: float,
    candidates: int,
    sigma_color: float,
    sigma_space: Floats,
) -> tuple[Floats, Floats]:
    """Compute the candidates for the disparity of some pixels: the strongest modes of the votes.

    Each voter votes for its plane, continued to the pixel along slopes that fade with distance, with the
    weight ``exp(-|Lab difference|_1 / sigma_color - |offset|_1 / sigma_space)``.

    Parameters
    ----------
    pixels : (N, 2) int32, row and column
    voters : for each of ``LEVELS``
    noise : of the disparity, pixels
    candidates : K, largest number of modes
    sigma_color, sigma_space : L1 in 8-bit Lab; (H, W) float32, pixels

    Returns
    -------
    values : (N, K) float32, pixels, strongest first, NaN = no more
    shares : (N, K) float32, share of the votes, 0 where there is no candidate
    """
    values = np.full((len(pixels), candidates), np.nan, np.float32)
    shares = np.zeros((len(pixels), candidates), np.float32)
    voting = [v.planes[0][v.weight > 0] for v in voters]
    if len(pixels) == 0 or not voting[0].size:
        return values, shares
    unit = _BIN * noise
    low = float(voting[0].min()) - 8 * unit
    bins = int((float(voting[0].max()) - low) / unit) + 10
    reach = max(r for _, r in LEVELS)
    space = np.exp(-np.arange(reach + 1) / _SPACE_SCALES[:, None]).astype(np.float32)
    scale = np.searchsorted(_SPACE_SCALES[:-1], sigma_space[pixels[:, 0], pixels[:, 1]])
    voting_planes = tuple(v.planes for v in voters), tuple(v.lab for v in voters), tuple(v.weight for v in voters)
    tables = (color_similarity(sigma_color), space, np.float32(low), np.float32(unit), bins)
    _vote(pixels, scale, lab, *voting_planes, *prior, *tables, values, shares)
    return values, shares


@jit
def _gather(
    y, x, light, a, b, planes, colors, weight, stride, inner, reach, limit, limit_factor, similarity, space, low, unit,
    votes, extent,
):  # fmt: skip
    # Adds the votes of one level to the histogram; those within ``inner`` pixels belong to the finer level.
    height, width = weight.shape
    top, bottom = max((y - reach + stride - 1) // stride, 0), min((y + reach) // stride + 1, height)
    left, right = max((x - reach + stride - 1) // stride, 0), min((x + reach) // stride + 1, width)
    per_square = np.float32(1 / (SLOPE_FADE * SLOPE_FADE))
    for v in range(top, bottom):
        dy = y - v * stride
        row, down, square = space[abs(dy)], np.float32(dy), np.float32(dy * dy)
        value, slope_x, slope_y = planes[0, v], planes[1, v], planes[2, v]
        l_row, a_row, b_row, w_row = colors[0, v], colors[1, v], colors[2, v], weight[v]
        inside = abs(dy) <= inner
        for u in range(left, right):
            dx = x - u * stride
            if w_row[u] <= 0 or (inside and abs(dx) <= inner):
                continue
            c = abs(np.int32(l_row[u]) - light) + abs(np.int32(a_row[u]) - a) + abs(np.int32(b_row[u]) - b)
            if c >= similarity.size:
                continue
            across = np.float32(dx)
            w = w_row[u] * similarity[c] * row * space[abs(dx)]
            fade = np.float32(1) / (np.float32(1) + (across * across + square) * per_square)
            d = value[u] + fade * (slope_x[u] * across + slope_y[u] * down)
            if d > limit:
                w *= limit_factor
            _add_vote(votes, extent, np.int32((d - low) * unit), w, d)


@jit
def _add_vote(votes, extent, k, weight, disparity):
    if 1 <= k < len(votes) - 1:
        votes[k, 0] += weight
        votes[k, 1] += weight * disparity
        extent[0] = min(extent[0], k)
        extent[1] = max(extent[1], k)


@parallel_jit
def _vote(
    pixels, scale, lab, planes, colors, weight, limit, limit_factor, background, extra_share, continued,
    continued_share, similarity, space, low, unit, bins, values, shares,
):  # fmt: skip
    for block in prange((len(pixels) + 255) // 256):
        votes = np.zeros((bins, 2), np.float32)  # mass, and mass x value
        extent = np.empty(2, np.int64)
        per_unit = np.float32(1) / unit
        for n in range(block * 256, min(block * 256 + 256, len(pixels))):
            y, x = pixels[n]
            light, a, b = np.int32(lab[y, x, 0]), np.int32(lab[y, x, 1]), np.int32(lab[y, x, 2])
            extent[0], extent[1] = bins, -1
            largest, factor, weights = limit[y, x], limit_factor[y, x], space[scale[n]]
            inner = -1
            for level in range(len(LEVELS)):
                stride, reach = LEVELS[level]
                _gather(
                    y, x, light, a, b, planes[level], colors[level], weight[level], stride, inner, reach, largest,
                    factor, similarity, weights, low, per_unit, votes, extent,
                )  # fmt: skip
                inner = reach
            total = np.float32(0)
            for k in range(extent[0], extent[1] + 1):
                total += votes[k, 0]
            cast = total
            for extra in range(1 + len(continued)):
                d = background[y, x] if extra == 0 else continued[extra - 1, y, x]
                share = extra_share[y, x] if extra == 0 else continued_share[y, x]
                k = 0 if np.isnan(d) else int((d - low) * per_unit)
                if 1 <= k < bins - 1:
                    w = max(share * cast, np.float32(1e-9))
                    total += w
                    _add_vote(votes, extent, k, w, d)
            _modes(votes, extent, total, values[n], shares[n])
            for k in range(extent[0], extent[1] + 1):
                votes[k, 0] = np.float32(0)
                votes[k, 1] = np.float32(0)


@jit
def _modes(votes, extent, total, values, shares):
    # Takes the modes out of a histogram, the strongest first.
    for i in range(values.size):
        best, top = np.float32(0), -1
        for k in range(extent[0], extent[1] + 1):
            m = votes[k, 0] + np.float32(0.5) * (votes[k - 1, 0] + votes[k + 1, 0])
            if m > best:
                best, top = m, k
        if top < 0 or best < np.float32(_MIN_SHARE) * total:
            break
        around, center = np.float32(0), np.float32(0)
        for k in range(top - 1, top + 2):
            around += votes[k, 0]
            center += votes[k, 1]
        values[i] = center / around
        for k in range(max(top - 2, 0), min(top + 3, len(votes))):
            if abs(k - top) == 2:
                around += votes[k, 0]
            votes[k, 0] = np.float32(0)
            votes[k, 1] = np.float32(0)
        shares[i] = around / total


def hidden_openings(
    lab: Image8, planes: WindowPlanes, voters: Voters, trusted: Mask, jump: float, sigma_color: float
) -> Mask:
    """Select the measured pixels, (H, W) bool, whose color is that of a surface behind the measured one.

    A pixel is selected if its color is much less likely on the surface that was measured there than on those farther
    away within 36 pixels. Only the color shows an opening that near surfaces have grown over from both sides.

    ``voters`` have a stride of 4, ``trusted`` pixels are tested, and what is farther by ``jump`` pixels lies behind.
    """
    space = np.exp(-np.arange(_OPENING_REACH + 1) / _OPENING_SCALE).astype(np.float32)
    shape = trusted.shape
    hidden = np.zeros((-(-shape[0] // _OPENING_GRID), -(-shape[1] // _OPENING_GRID)), np.uint8)
    own = (planes.value, planes.slope_x, planes.slope_y, trusted)
    _test_openings(lab, *own, *voters[1:], color_similarity(sigma_color), space, np.float32(jump), hidden)
    spread = np.zeros(shape, np.uint8)
    spread[::_OPENING_GRID, ::_OPENING_GRID] = hidden
    square = np.ones((_OPENING_SQUARE, _OPENING_SQUARE), np.uint8)
    return np.asarray((cv2.dilate(spread, square) > 0) & trusted, np.bool_)


@parallel_jit
def _test_openings(lab, value, slope_x, slope_y, trusted, planes, colors, weight, similarity, space, jump, hidden):
    for j in prange(hidden.shape[0]):
        y = _OPENING_GRID * j
        for i in range(hidden.shape[1]):
            x = _OPENING_GRID * i
            if not trusted[y, x]:
                continue
            own = value[y, x]
            light, a, b = np.int32(lab[y, x, 0]), np.int32(lab[y, x, 1]), np.int32(lab[y, x, 2])
            s_own, n_own = np.float32(0), np.float32(1e-9)
            s_far, n_far = np.float32(0), np.float32(1e-9)
            top, bottom = max((y - _OPENING_REACH + 3) // 4, 0), min((y + _OPENING_REACH) // 4 + 1, weight.shape[0])
            left, right = max((x - _OPENING_REACH + 3) // 4, 0), min((x + _OPENING_REACH) // 4 + 1, weight.shape[1])
            for v in range(top, bottom):
                dy = 4 * v - y
                row = space[abs(dy)]
                for u in range(left, right):
                    dx = 4 * u - x
                    if weight[v, u] <= 0 or (abs(dx) <= _MIN_OPENING_DISTANCE and abs(dy) <= _MIN_OPENING_DISTANCE):
                        continue
                    d = planes[0, v, u]
                    here = own + slope_x[y, x] * np.float32(dx) + slope_y[y, x] * np.float32(dy)
                    z = row * space[abs(dx)]
                    c = abs(np.int32(colors[0, v, u]) - light) + abs(np.int32(colors[1, v, u]) - a)
                    c += abs(np.int32(colors[2, v, u]) - b)
                    if d < min(own, here) - jump:
                        s_far += z * similarity[c]
                        n_far += z
                    elif abs(d - own) < jump or abs(d - here) < jump:
                        s_own += z * similarity[c]
                        n_own += z
            compared = n_far > np.float32(1e-6) and n_own > np.float32(1e-6)
            if compared and s_own * n_far < _MIN_LIKELIHOOD_RATIO * s_far * n_own:
                hidden[j, i] = 1


def choose_candidates(
    pixels: Ints,
    values: Floats,
    shares: Floats,
    planes: WindowPlanes,
    costs: tuple[float, float, float],
    iterations: int,
    lab: Image8,
    disparity: Floats,
    p_correct: Floats,
    unreliable: Mask,
) -> Floats:
    """Choose a value for every unreliable pixel, (H, W) float32; NaN where it has no candidate, and elsewhere.

    The cost of a candidate is ``-ln(share + 0.08)`` and, where something was measured, ``-ln`` of the probability
    that it is correct (for candidates close to it) or wrong; differences of neighbors cost, less across color edges.
    TRW-S minimizes the sum.

    Parameters
    ----------
    pixels : (N, 2) int32, the ``unreliable`` pixels in raster order
    values, shares : (N, K) of :func:`cast_votes`
    planes : known surfaces; at reliable pixels they are the fixed neighbors
    costs : noise; weight of a difference, in units of the noise, between neighbors of one color; largest difference
        that counts, multiples of the noise
    p_correct : (H, W) float32, probability that a measured value is correct
    """
    chosen = np.full(disparity.shape, np.nan, np.float32)
    candidates = np.zeros((len(pixels), values.shape[1] + 1), np.float32)
    unary = np.full(candidates.shape, np.inf, np.float32)
    weights = np.zeros((len(pixels), 4), np.float32)
    surfaces = (planes.value, planes.slope_x, planes.slope_y)
    noise, smoothness, truncation = costs
    scales = (np.float32(noise), np.float32(smoothness), np.float32(truncation))
    given = (pixels, values, shares, lab, disparity, p_correct, unreliable)
    _costs(*given, *surfaces, *scales, candidates, unary, weights)
    has_candidates = np.isfinite(unary[:, 0])
    pixels = pixels[has_candidates]
    if not len(pixels):
        return chosen
    active = np.zeros(disparity.shape, bool)
    active[pixels[:, 0], pixels[:, 1]] = True
    candidates, unary, weights = candidates[has_candidates], unary[has_candidates], weights[has_candidates]
    labels = trws(candidates, unary, active, weights, truncation * noise, iterations)
    chosen[active] = candidates[np.arange(len(pixels)), labels]
    return chosen


@parallel_jit
def _costs(
    pixels, values, shares, lab, disparity, p_correct, unreliable, value, slope_x, slope_y, noise, smoothness,
    truncation, candidates, unary, weights,
):  # fmt: skip
    height, width = disparity.shape
    for n in prange(len(pixels)):
        y, x = pixels[n]
        measured = disparity[y, x]
        known = not np.isnan(measured)
        count = 0
        agreed = False
        for i in range(values.shape[1]):
            if np.isnan(values[n, i]):
                break
            candidates[n, count] = values[n, i]
            unary[n, count] = -np.log(shares[n, i] + np.float32(_SHARE_FLOOR))
            agreed = agreed or (known and abs(values[n, i] - measured) < np.float32(AGREEMENT) * noise)
            count += 1
        if known and not agreed:
            candidates[n, count] = measured
            unary[n, count] = -np.log(np.float32(_SHARE_FLOOR))
            count += 1
        if known:
            p = min(max(p_correct[y, x], np.float32(1 - _MAX_PROBABILITY)), np.float32(_MAX_PROBABILITY))
            for i in range(count):
                close = abs(candidates[n, i] - measured) < np.float32(AGREEMENT) * noise
                unary[n, i] -= np.log(p) if close else np.log(np.float32(1) - p)
        for k in range(8):
            dy, dx = _NEIGHBORS[k]
            v, u = y + dy, x + dx
            if v < 0 or v >= height or u < 0 or u >= width:
                continue
            contrast = lab_difference(lab, y, x, v, u)
            diagonal = np.float32(0.7 if dy != 0 and dx != 0 else 1.0)
            weight = smoothness * np.float32(np.exp(-contrast / _EDGE_COLOR)) * diagonal / noise
            weight += np.float32(_MIN_WEIGHT)
            if k < 4:
                weights[n, k] = weight
            if not unreliable[v, u] and not np.isnan(value[v, u]):
                here = value[v, u] - slope_x[v, u] * np.float32(dx) - slope_y[v, u] * np.float32(dy)
                for i in range(count):
                    unary[n, i] += weight * min(abs(candidates[n, i] - here), truncation * noise)
        _drop_expensive(unary[n], candidates[n], count)


@jit
def _drop_expensive(unary, candidates, count):
    # Moves the cheap candidates to the front, in order; the cost of the others becomes infinite.
    cheapest = np.float32(np.inf)
    for i in range(count):
        cheapest = min(cheapest, unary[i])
    kept = 0
    for i in range(count):
        cost, candidate = unary[i], candidates[i]
        unary[i] = np.inf
        if cost <= cheapest + np.float32(_MAX_EXTRA_COST):
            unary[kept] = cost
            candidates[kept] = candidate
            kept += 1

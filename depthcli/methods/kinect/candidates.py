"""Candidates for the disparity of every unreliable pixel (the modes of the votes around it), and the choice of one."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.algorithms.trws import trws
from depthcli.core.maps import Floats, Image8, Ints, Mask
from depthcli.kernels.jit import empty, helper, jit, run_bands, zeros
from depthcli.methods.kinect.color import lab_difference
from depthcli.methods.kinect.gap_limits import SLOPE_FADE, GapLimits

# Values of the published preset refine-kinect accurate; nothing in the repository varies them.
LEVELS = ((1, 5), (4, 36), (12, 108))
"""Stride and reach of the voters: every pixel within 5, every fourth within 36, every twelfth within 108 pixels."""
_BIN = 5 / 3  # width of a bin of the histogram, multiples of the noise
_SPACE_SCALES = 2.0 * 1.1 ** np.arange(32)  # distance scales for which weights are tabulated, pixels
_MIN_SHARE = 0.01  # smaller modes are no candidates
_MIN_SIMILARITY = 0.002  # floor of the color similarity
_MIN_LIKELIHOOD_RATIO = 0.3  # likelihood of a pixel's color on its own surface / on surfaces behind it
_MIN_OPENING_DISTANCE = 9  # pixels: nearer pixels may belong to the same opening
_OPENING_REACH = 36  # pixels
OPENING_LEVEL = 1
"""Index in ``LEVELS`` of the voters for the detection of openings."""
_OPENING_GRID, _OPENING_SQUARE = 3, 5  # each tested pixel, one per 3 x 3, decides for the 5 x 5 around it
_OPENING_SCALE = 20.0  # distance over which weights fall by 1/e, pixels
AGREEMENT = 4.0
"""A candidate agrees with the measurement if it differs by less than this, multiples of the noise."""
_SHARE_FLOOR = 0.08  # added to every share of votes, so that small shares cost about the same
_MAX_PROBABILITY = 0.97  # largest probability that a measurement is correct, and that it is incorrect
_EDGE_COLOR = 12.0  # contrast over which smoothness falls by 1/e, L1 in 8-bit Lab
_MIN_WEIGHT = 0.02  # smoothness weight across the strongest color edge
_MAX_EXTRA_COST = 4.0  # largest extra cost over the cheapest candidate; costlier candidates are dropped
_NEIGHBORS = ((0, 1), (1, -1), (1, 0), (1, 1), (0, -1), (-1, 1), (-1, 0), (-1, -1))  # dy, dx: later pixels first


class Voters(NamedTuple):
    """The planes that vote: one at every n-th pixel of every n-th row."""

    planes: Floats  # (4, h, w): value and slopes, pixels; weight, 0 = does not vote
    colors: Image8  # (3, h, w), Lab

    @classmethod
    def of(cls, lab: Image8, planes: WindowPlanes, trust: Floats, stride: int) -> Voters:
        """Return every n-th plane, n = ``stride``, with its pixel's ``trust`` (H, W) times n x n as weight."""
        *plane, weight, colors = (each[::stride, ::stride] for each in (*planes[:3], trust, lab))
        weight = np.where(np.isnan(plane[0]), np.float32(0), weight * np.float32(stride * stride))
        return cls(np.nan_to_num(np.stack([*plane, weight])), np.ascontiguousarray(colors.transpose(2, 0, 1)))


class ExtraVotes(NamedTuple):
    """Surfaces that get votes in addition to the planes around; both (n, H, W) float32."""

    values: Floats  # pixels, NaN = none
    shares: Floats  # additional votes for each surface, as a share of the planes' votes


class VotedModes(NamedTuple):
    """The strongest modes of the votes for N pixels, at most K per pixel; both (N, K) float32."""

    values: Floats  # pixels, strongest first, NaN = no more
    shares: Floats  # share of the votes, 0 if there is no candidate


class Observed(NamedTuple):
    """Observations that decide between candidates, (H, W)."""

    lab: Image8  # (H, W, 3)
    disparity: Floats  # measured, pixels, NaN = unknown
    p_correct: Floats  # probability that a measured value is correct
    unreliable: Mask

    def every(self, stride: int) -> Observed:
        """Return every n-th pixel of every n-th row, n = ``stride``."""
        lab, disparity, p_correct, unreliable = self
        part = np.s_[::stride, ::stride]
        values = np.ascontiguousarray(disparity[part]), np.ascontiguousarray(p_correct[part])
        return Observed(np.ascontiguousarray(lab[part]), *values, np.ascontiguousarray(unreliable[part]))


class Costs(NamedTuple):
    """Costs of disparity differences between neighbors."""

    noise: float  # standard deviation, pixels; unit of the other fields
    smoothness: float  # weight of a difference between neighbors of equal color
    truncation: float  # larger differences cost no more


class _Histogram(NamedTuple):
    # Votes for one pixel, (bins, 2) float32: mass, and mass x value; first and last bin with votes; lower end; scale.
    votes: Floats
    extent: Ints
    low: np.float32
    per_pixel: np.float32


class _Fading(NamedTuple):
    # How votes fade: with the difference of colors, (766,), and the distance, (scales, reach + 1); each pixel's scale.
    similarity: Floats
    space: Floats
    scale: NDArray[np.signedinteger[Any]]


def color_similarity(sigma: float) -> Floats:
    """Tabulate the similarity of two colors by their L1 distance in 8-bit Lab, (766,) float32."""
    return (np.exp(-np.arange(766) / sigma) + _MIN_SIMILARITY).astype(np.float32)


def cast_votes(
    pixels: Ints,
    lab: Image8,
    voters: list[Voters],
    limits: GapLimits,
    extra: ExtraVotes,
    noise: float,
    count: int,
    sigma_color: float,
    sigma_space: Floats,
) -> VotedModes:
    """Compute disparity candidates for some pixels: the strongest modes of the votes, at most ``count`` per pixel.

    Each voter votes for its plane, continued to the pixel with a slope that fades with distance. The weight of a vote
    is ``exp(-|Lab difference|_1 / sigma_color - |offset|_1 / sigma_space)``, times the pixel's factor in ``limits`` if
    the disparity exceeds the limit.

    Parameters
    ----------
    pixels : (N, 2) int32, row and column
    voters : one for each of ``LEVELS``
    noise : standard deviation of the disparity, pixels
    sigma_color, sigma_space : L1 in 8-bit Lab; (H, W) float32, pixels
    """
    shape = len(pixels), count
    found = VotedModes(np.full(shape, np.nan, np.float32), np.zeros(shape, np.float32))
    value, _, _, weight = voters[0].planes
    voting = value[weight > 0]
    if len(pixels) == 0 or not voting.size:
        return found
    unit = _BIN * noise
    low = float(voting.min()) - 8 * unit
    bins = np.float32(low), np.float32(1) / np.float32(unit), int((float(voting.max()) - low) / unit) + 10
    reach = max(r for _, r in LEVELS)
    space = np.exp(-np.arange(reach + 1) / _SPACE_SCALES[:, None]).astype(np.float32)
    scale = np.searchsorted(_SPACE_SCALES[:-1], sigma_space[pixels[:, 0], pixels[:, 1]])
    fading = _Fading(color_similarity(sigma_color), space, scale)
    run_bands(_vote, (len(pixels) + 255) // 256, pixels, lab, tuple(voters), limits, extra, fading, bins, found)
    return found


@jit
def _vote(begin, end, pixels, lab, voters, limits, extra, fading, bins, found):
    low, per_pixel, n_bins = bins
    for block in range(begin, end):
        histogram = _Histogram(zeros((n_bins, 2), np.float32), empty(2, np.int64), low, per_pixel)
        votes, extent = histogram.votes, histogram.extent
        for n in range(block * 256, min(block * 256 + 256, len(pixels))):
            y, x = pixels[n]
            extent[0], extent[1] = n_bins, -1
            limit = limits.value[y, x], limits.factor[y, x]
            weights = fading.similarity, fading.space[fading.scale[n]]
            inner = -1
            for level in range(len(LEVELS)):
                _gather(y, x, lab[y, x], voters[level], LEVELS[level], inner, limit, weights, histogram)
                inner = LEVELS[level][1]
            cast = np.float32(0)
            for k in range(extent[0], extent[1] + 1):
                cast += votes[k, 0]
            total = cast
            for k in range(len(extra.values)):
                d = extra.values[k, y, x]
                if not np.isnan(d):
                    total += _add_vote(histogram, max(extra.shares[k, y, x] * cast, np.float32(1e-9)), d)
            _modes(histogram, total, found.values[n], found.shares[n])
            votes[extent[0] : extent[1] + 1] = np.float32(0)


@helper
def _gather(y, x, color, voters, level, inner, limit, weights, histogram):
    # Add the votes of one level to the histogram, except within ``inner`` pixels, which belong to the finer level.
    (planes, colors), (stride, reach), (similarity, space) = voters, level, weights
    largest, factor = limit
    light, a, b = np.int32(color[0]), np.int32(color[1]), np.int32(color[2])
    top, bottom = _nth_within(np.int64(y), reach, stride, planes.shape[1])
    left, right = _nth_within(np.int64(x), reach, stride, planes.shape[2])
    per_square = np.float32(1 / (SLOPE_FADE * SLOPE_FADE))
    for v in range(top, bottom):
        dy = y - v * stride
        row, down, square = space[abs(dy)], np.float32(dy), np.float32(dy * dy)
        value, slope_x, slope_y, weight = planes[0, v], planes[1, v], planes[2, v], planes[3, v]
        l_row, a_row, b_row = colors[0, v], colors[1, v], colors[2, v]
        inside = abs(dy) <= inner
        for u in range(left, right):
            dx = x - u * stride
            if weight[u] <= 0 or (inside and abs(dx) <= inner):
                continue
            c = abs(np.int32(l_row[u]) - light) + abs(np.int32(a_row[u]) - a) + abs(np.int32(b_row[u]) - b)
            if c >= similarity.size:
                continue
            across = np.float32(dx)
            w = weight[u] * similarity[c] * row * space[abs(dx)]
            fade = np.float32(1) / (np.float32(1) + (across * across + square) * per_square)
            d = value[u] + fade * (slope_x[u] * across + slope_y[u] * down)
            if d > largest:
                w *= factor
            _add_vote(histogram, w, d)


@helper
def _nth_within(at, reach, stride, size):
    # Return the range of n for which pixel n x stride is within reach.
    return max((at - reach + stride - 1) // stride, 0), min((at + reach) // stride + 1, size)


@helper
def _add_vote(histogram, weight, disparity):
    # Return the added weight: 0 for disparities beyond the ends of the histogram.
    k = np.int32((disparity - histogram.low) * histogram.per_pixel)
    if k < 1 or k >= len(histogram.votes) - 1:
        return np.float32(0)
    histogram.votes[k, 0] += weight
    histogram.votes[k, 1] += weight * disparity
    histogram.extent[0] = min(histogram.extent[0], k)
    histogram.extent[1] = max(histogram.extent[1], k)
    return weight


@helper
def _modes(histogram, total, values, shares):
    # Remove the modes from a histogram, the strongest first.
    votes, extent = histogram.votes, histogram.extent
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
    """Select the measured pixels, (H, W) bool, whose color belongs to a surface behind the measured one.

    A pixel is selected if its color is much less likely on the measured surface than on farther surfaces within 36
    pixels. Only the color shows an opening that near surfaces have grown over from both sides.

    ``voters`` belong to ``OPENING_LEVEL``. Only ``trusted`` pixels are tested. A surface is behind another if it is
    farther by more than ``jump`` pixels of disparity.
    """
    space = np.exp(-np.arange(_OPENING_REACH + 1) / _OPENING_SCALE).astype(np.float32)
    shape = trusted.shape
    hidden = np.zeros((-(-shape[0] // _OPENING_GRID), -(-shape[1] // _OPENING_GRID)), np.uint8)
    run_bands(
        _test_openings, len(hidden), lab, planes, *voters, trusted, color_similarity(sigma_color), space,
        np.float32(jump), hidden,
    )  # fmt: skip
    spread = np.zeros(shape, np.uint8)
    spread[::_OPENING_GRID, ::_OPENING_GRID] = hidden
    square = np.ones((_OPENING_SQUARE, _OPENING_SQUARE), np.uint8)
    return np.asarray((cv2.dilate(spread, square) > 0) & trusted, np.bool_)


@jit
def _test_openings(begin, end, lab, around, planes, colors, trusted, similarity, space, jump, hidden):
    stride = LEVELS[OPENING_LEVEL][0]
    for j in range(begin, end):
        y = _OPENING_GRID * j
        top, bottom = _nth_within(y, _OPENING_REACH, stride, planes.shape[1])
        for i in range(hidden.shape[1]):
            x = _OPENING_GRID * i
            if not trusted[y, x]:
                continue
            own, slope_x, slope_y = around.value[y, x], around.slope_x[y, x], around.slope_y[y, x]
            light, a, b = np.int32(lab[y, x, 0]), np.int32(lab[y, x, 1]), np.int32(lab[y, x, 2])
            s_own, n_own = np.float32(0), np.float32(1e-9)
            s_far, n_far = np.float32(0), np.float32(1e-9)
            left, right = _nth_within(x, _OPENING_REACH, stride, planes.shape[2])
            for v in range(top, bottom):
                dy = stride * v - y
                row = space[abs(dy)]
                for u in range(left, right):
                    dx = stride * u - x
                    if planes[3, v, u] <= 0 or max(abs(dx), abs(dy)) <= _MIN_OPENING_DISTANCE:
                        continue
                    d = planes[0, v, u]
                    here = own + slope_x * np.float32(dx) + slope_y * np.float32(dy)
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
    pixels: Ints, found: VotedModes, planes: WindowPlanes, evidence: Observed, costs: Costs, iterations: int
) -> Floats:
    """Choose a value for every unreliable pixel, (H, W) float32; NaN at other pixels, and if there is no candidate.

    A candidate costs ``-ln(share + 0.08)``. If its pixel has a measurement, it also costs ``-ln`` of the probability
    that the measurement is correct (for candidates close to it) or incorrect (for others). Differences between
    neighbors add costs, less across color edges. TRW-S minimizes the sum. ``pixels`` (N, 2) int32 are the unreliable
    pixels in raster order; reliable neighbors are fixed to their ``planes``.
    """
    chosen = np.full(evidence.disparity.shape, np.nan, np.float32)
    candidates = np.zeros((len(pixels), found.values.shape[1] + 1), np.float32)
    unary = np.full(candidates.shape, np.inf, np.float32)
    weights = np.zeros((len(pixels), 4), np.float32)
    run_bands(_costs, len(pixels), pixels, found, evidence, planes, costs, candidates, unary, weights)
    has_candidates = np.isfinite(unary[:, 0])
    pixels = pixels[has_candidates]
    if not len(pixels):
        return chosen
    active = np.zeros(chosen.shape, bool)
    active[pixels[:, 0], pixels[:, 1]] = True
    candidates, unary, weights = candidates[has_candidates], unary[has_candidates], weights[has_candidates]
    labels = trws(candidates, unary, active, weights, costs.truncation * costs.noise, iterations)
    chosen[active] = candidates[np.arange(len(pixels)), labels]
    return chosen


@jit
def _costs(begin, end, pixels, found, evidence, planes, costs, candidates, unary, weights):
    lab, disparity, p_correct, unreliable = evidence
    noise, smoothness = np.float32(costs.noise), np.float32(costs.smoothness)
    largest = np.float32(costs.truncation) * noise
    height, width = disparity.shape
    for n in range(begin, end):
        y, x = pixels[n]
        measured = disparity[y, x]
        known = not np.isnan(measured)
        count = 0
        agreed = False
        for i in range(found.values.shape[1]):
            if np.isnan(found.values[n, i]):
                break
            candidates[n, count] = found.values[n, i]
            unary[n, count] = -np.log(found.shares[n, i] + np.float32(_SHARE_FLOOR))
            agreed = agreed or (known and abs(found.values[n, i] - measured) < np.float32(AGREEMENT) * noise)
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
            if not unreliable[v, u] and not np.isnan(planes.value[v, u]):
                here = planes.value[v, u] - planes.slope_x[v, u] * np.float32(dx)
                here -= planes.slope_y[v, u] * np.float32(dy)
                for i in range(count):
                    unary[n, i] += weight * min(abs(candidates[n, i] - here), largest)
        _drop_expensive(unary[n], candidates[n], count)


@helper
def _drop_expensive(unary, candidates, count):
    # Move the cheap candidates to the front, in order; set the cost of the others to infinity.
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

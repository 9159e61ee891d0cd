"""Candidates for the disparity of every unreliable pixel: the modes of the votes of the planes around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.kinect.shadow_limits import SLOPE_FADE

# Values that the preset refine-kinect accurate was published with; nothing in the repository varies them.
LEVELS = ((1, 5), (4, 36), (12, 108))
"""Stride and reach of the voters: every pixel within 5, every fourth within 36, every twelfth within 108 pixels."""
_BIN = 5 / 3  # width of a bin of the histogram, multiples of the noise
_SPACE_SCALES = 2.0 * 1.1 ** np.arange(32)  # scales of distance that weights are tabulated for, pixels
_MIN_SHARE = 0.01  # smaller modes are no candidates
_MIN_SIMILARITY = 0.002  # of colors, however different


@dataclass(frozen=True)
class Voters:
    """The planes that vote: those of every n-th pixel of every n-th row.

    Attributes
    ----------
    stride : n
    planes : (3, h, w) float32: value and slopes, pixels
    lab : (3, h, w) uint8
    weight : (h, w) float32, 0 = does not vote
    """

    stride: int
    planes: NDArray[np.float32]
    lab: NDArray[np.uint8]
    weight: NDArray[np.float32]

    @classmethod
    def of(cls, lab: NDArray[np.uint8], planes: WindowPlanes, trust: NDArray[np.float32], stride: int) -> Voters:
        """Return every n-th plane with the weight ``trust`` (H, W) of its pixel, times the n x n pixels of its cell."""
        every = np.s_[::stride, ::stride]
        stack = np.stack([planes.value[every], planes.slope_x[every], planes.slope_y[every]])
        weight = np.where(np.isnan(stack[0]), np.float32(0), trust[every] * np.float32(stride * stride))
        colors = np.ascontiguousarray(lab[every].transpose(2, 0, 1))
        return cls(stride, np.nan_to_num(stack), colors, weight.astype(np.float32))


@dataclass(frozen=True)
class ExtraVotes:
    """What votes beside the planes around: shadows, and surfaces continued into gaps; all (H, W) float32.

    Attributes
    ----------
    limit, limit_factor : votes for disparities above ``limit``, pixels, are multiplied by ``limit_factor``
    background, extra_share : disparity of the surface behind a shadow, pixels, NaN = none, which gets in addition
        the share ``extra_share`` of all votes
    continued, continued_share : (n, H, W) the same for n surfaces continued into gaps, which get one share each
    """

    limit: NDArray[np.float32]
    limit_factor: NDArray[np.float32]
    background: NDArray[np.float32]
    extra_share: NDArray[np.float32]
    continued: NDArray[np.float32]
    continued_share: NDArray[np.float32]


def color_similarity(sigma: float) -> NDArray[np.float32]:
    """Tabulate the similarity of two colors by their L1 distance in 8-bit Lab, (766,) float32."""
    return (np.exp(-np.arange(766) / sigma) + _MIN_SIMILARITY).astype(np.float32)


def cast_votes(
    pixels: NDArray[np.int32],
    lab: NDArray[np.uint8],
    voters: list[Voters],
    prior: ExtraVotes,
    noise: float,
    candidates: int,
    sigma_color: float,
    sigma_space: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compute the candidates for the disparity of some pixels: the strongest modes of the votes.

    Each voter votes for its plane, continued to the pixel along slopes that fade with distance, with the
    weight ``exp(-|Lab difference|_1 / sigma_color - |offset|_1 / sigma_space)``.

    Parameters
    ----------
    pixels : (N, 2) int32, row and column
    lab : (H, W, 3) uint8
    voters : for each of ``LEVELS``
    prior : influence of shadows
    noise : of the disparity, pixels
    candidates : K, largest number of modes
    sigma_color : L1 in 8-bit Lab
    sigma_space : (H, W) float32, pixels

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
    _vote(
        pixels, scale, lab, tuple(v.planes for v in voters), tuple(v.lab for v in voters),
        tuple(v.weight for v in voters), prior.limit, prior.limit_factor, prior.background, prior.extra_share,
        prior.continued, prior.continued_share,
        color_similarity(sigma_color), space, np.float32(low), np.float32(unit), bins, values, shares,
    )  # fmt: skip
    return values, shares


@jit
def _gather(
    y, x, light, a, b, planes, colors, weight, stride, inner, reach, limit, limit_factor, similarity, space, low, unit,
    bins, votes, extent,
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
            k = np.int32((d - low) * unit)
            if 1 <= k < bins - 1:
                votes[k, 0] += w
                votes[k, 1] += w * d
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
                    factor, similarity, weights, low, per_unit, bins, votes, extent,
                )  # fmt: skip
                inner = reach
            total = np.float32(0)
            for k in range(extent[0], extent[1] + 1):
                total += votes[k, 0]
            cast = total
            for n_extra in range(1 + len(continued)):
                d = background[y, x] if n_extra == 0 else continued[n_extra - 1, y, x]
                share = extra_share[y, x] if n_extra == 0 else continued_share[y, x]
                if np.isnan(d):
                    continue
                k = int((d - low) * per_unit)
                if 1 <= k < bins - 1:
                    w = max(share * cast, np.float32(1e-9))
                    votes[k, 0] += w
                    votes[k, 1] += w * d
                    total += w
                    extent[0] = min(extent[0], k)
                    extent[1] = max(extent[1], k)
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

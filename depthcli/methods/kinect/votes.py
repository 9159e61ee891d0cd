"""Candidates for the disparity of a pixel, voted for by the surfaces around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.kernels.jit import jit, parallel_jit, prange

LEVELS = ((1, 5), (4, 36), (12, 108))  # every pixel within 5, every fourth within 36, every twelfth within 108
_FADE = 20.0  # pixels over which a slope is followed
_BIN = 5 / 3  # width of a bin of the histogram, multiples of the noise
_SCALES = 2.0 * 1.1 ** np.arange(32)  # pixels: of the laws of distance that there are tables for
_LEAST_SHARE = 0.01  # smaller modes are no candidates
_LEAST_LIKENESS = 0.002  # of colors; where they differ more this counts for them


@dataclass(frozen=True)
class Voters:
    """Every n-th pixel of every n-th row, packed.

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
        """Sampled from full-size maps; each stands for the ``stride ** 2`` pixels of its cell."""
        every = np.s_[::stride, ::stride]
        stack = np.stack([planes.value[every], planes.slope_x[every], planes.slope_y[every]])
        weight = np.where(np.isnan(stack[0]), np.float32(0), trust[every] * np.float32(stride * stride))
        colors = np.ascontiguousarray(lab[every].transpose(2, 0, 1))
        return cls(stride, np.nan_to_num(stack), colors, weight.astype(np.float32))


@dataclass(frozen=True)
class Evidence:
    """What is known about a pixel beside the votes; all (H, W) float32.

    Attributes
    ----------
    limit, beyond : votes for more than ``limit`` pixels count ``beyond`` times
    rim, bonus : a surface that gets the share ``bonus`` of all votes besides (NaN = none)
    """

    limit: NDArray[np.float32]
    beyond: NDArray[np.float32]
    rim: NDArray[np.float32]
    bonus: NDArray[np.float32]


def color_law(sigma: float) -> NDArray[np.float32]:
    """(766,) float32: likeness of two colors by their L1 distance in 8-bit Lab."""
    return (np.exp(-np.arange(766) / sigma) + _LEAST_LIKENESS).astype(np.float32)


def cast_votes(
    pixels: NDArray[np.int32],
    lab: NDArray[np.uint8],
    voters: list[Voters],
    evidence: Evidence,
    noise: float,
    candidates: int,
    sigma_color: float,
    sigma_space: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The strongest modes of the votes for the disparity of some pixels.

    Each voter votes for its plane, continued to the pixel along slopes that fade with distance, with the
    weight ``exp(-|Lab difference|_1 / sigma_color - |offset|_1 / sigma_space)``.

    Parameters
    ----------
    pixels : (N, 2) int32, row and column
    lab : (H, W, 3) uint8
    voters : for each of ``LEVELS``
    evidence : what else is known
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
    space = np.exp(-np.arange(reach + 1) / _SCALES[:, None]).astype(np.float32)
    scale = np.searchsorted(_SCALES[:-1], sigma_space[pixels[:, 0], pixels[:, 1]])
    near, middle, far = voters
    _vote(
        pixels, scale, lab, near.planes, near.lab, near.weight, middle.planes, middle.lab, middle.weight,
        far.planes, far.lab, far.weight, evidence.limit, evidence.beyond, evidence.rim, evidence.bonus,
        color_law(sigma_color), space, np.float32(low), np.float32(unit), bins, values, shares,
    )  # fmt: skip
    return values, shares


@jit
def _gather(  # type: ignore[no-untyped-def]
    y, x, light, a, b, planes, colors, weight, stride, inner, reach, limit, beyond, likeness, space, low, unit, bins,
    votes, extent,
):  # fmt: skip
    """Add the votes of one level to the histogram; those within ``inner`` pixels belong to the level before."""
    height, width = weight.shape
    top, bottom = max((y - reach + stride - 1) // stride, 0), min((y + reach) // stride + 1, height)
    left, right = max((x - reach + stride - 1) // stride, 0), min((x + reach) // stride + 1, width)
    per_square = np.float32(1 / (_FADE * _FADE))
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
            if c >= likeness.size:
                continue
            across = np.float32(dx)
            w = w_row[u] * likeness[c] * row * space[abs(dx)]
            fade = np.float32(1) / (np.float32(1) + (across * across + square) * per_square)
            d = value[u] + fade * (slope_x[u] * across + slope_y[u] * down)
            if d > limit:
                w *= beyond
            k = np.int32((d - low) * unit)
            if 1 <= k < bins - 1:
                votes[k, 0] += w
                votes[k, 1] += w * d
                extent[0] = min(extent[0], k)
                extent[1] = max(extent[1], k)


@parallel_jit
def _vote(  # type: ignore[no-untyped-def]
    pixels, scale, lab, planes0, colors0, weight0, planes1, colors1, weight1, planes2, colors2, weight2, limit, beyond,
    rim, bonus, likeness, space, low, unit, bins, values, shares,
):  # fmt: skip
    for block in prange((len(pixels) + 255) // 256):
        votes = np.zeros((bins, 2), np.float32)  # mass, and mass x value
        extent = np.empty(2, np.int64)
        per_unit = np.float32(1) / unit
        for n in range(block * 256, min(block * 256 + 256, len(pixels))):
            y, x = pixels[n]
            light, a, b = np.int32(lab[y, x, 0]), np.int32(lab[y, x, 1]), np.int32(lab[y, x, 2])
            extent[0], extent[1] = bins, -1
            most, factor, law = limit[y, x], beyond[y, x], space[scale[n]]
            _gather(
                y, x, light, a, b, planes0, colors0, weight0, 1, -1, 5, most, factor, likeness, law, low, per_unit,
                bins, votes, extent,
            )  # fmt: skip
            _gather(
                y, x, light, a, b, planes1, colors1, weight1, 4, 5, 36, most, factor, likeness, law, low, per_unit,
                bins, votes, extent,
            )  # fmt: skip
            _gather(
                y, x, light, a, b, planes2, colors2, weight2, 12, 36, 108, most, factor, likeness, law, low, per_unit,
                bins, votes, extent,
            )  # fmt: skip
            total = np.float32(0)
            for k in range(extent[0], extent[1] + 1):
                total += votes[k, 0]
            if not np.isnan(rim[y, x]):
                k = int((rim[y, x] - low) * per_unit)
                if 1 <= k < bins - 1:
                    w = max(bonus[y, x] * total, np.float32(1e-9))
                    votes[k, 0] += w
                    votes[k, 1] += w * rim[y, x]
                    total += w
                    extent[0] = min(extent[0], k)
                    extent[1] = max(extent[1], k)
            _modes(votes, extent, total, values[n], shares[n])
            for k in range(extent[0], extent[1] + 1):
                votes[k, 0] = np.float32(0)
                votes[k, 1] = np.float32(0)


@jit
def _modes(votes, extent, total, values, shares):  # type: ignore[no-untyped-def]
    """Take the modes out of a histogram, the strongest first."""
    for i in range(values.size):
        best, top = np.float32(0), -1
        for k in range(extent[0], extent[1] + 1):
            m = votes[k, 0] + np.float32(0.5) * (votes[k - 1, 0] + votes[k + 1, 0])
            if m > best:
                best, top = m, k
        if top < 0 or best < np.float32(_LEAST_SHARE) * total:
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

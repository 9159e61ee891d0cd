"""Adaptive support weights: means over a window, weighted by color similarity and distance.

Yoon & Kweon, "Adaptive support-weight approach for correspondence search", PAMI 2006 (thesis, eq. 3.10-3.11).
"""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from pydantic import Field

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Floats, Image8
from depthcli.core.method import Odd
from depthcli.kernels.exponential import bits_float
from depthcli.kernels.jit import float32, helper, jit, run_bands, zeros
from depthcli.kernels.lanes import LANES, WIDE, fused, load_like, ordered_sum, scaled, splat, store, wide_zero
from depthcli.methods.stereo.aggregation import Aggregator
from depthcli.methods.stereo.volume import CostVolume


class AdaptiveWeight(Aggregator):
    """Mean over the window with weights w(p, q) w'(p_d, q_d), w = exp(-(color / gamma_c + space / gamma_s)).

    Each view weights a pair of pixels by its own colors. Neighbors whose match is outside the right image do not take
    part in the mean; cells that are outside themselves keep their neutral cost.
    """

    aliases = ("AW", "ASW")

    window: Odd = Field(33, ge=1, le=99, description="side of the square window, pixels, odd")
    gamma_color: float = Field(10.0, gt=0, le=1e4, description="color difference that divides a weight by e")
    gamma_space: float = Field(36.0, gt=0, le=1e4, description="distance that divides a weight by e, pixels")
    # With AD costs, CIELab has 4.8 % bad pixels on the four scenes of 2001-2003, and RGB 5.0 % at its best gamma_color
    # (30). With AD+census both have 3.0 %.
    color_space: Literal["lab", "rgb"] = Field("lab", description="where colors are compared: CIELab or RGB 0..255")
    norm: Literal["l2", "squared"] = Field(
        "l2", description="l2: weights use distances as they are; squared: their squares (thesis, eq. 3.10-3.11)"
    )

    def halo(self) -> int | None:
        return self.window // 2

    def __call__(self, volume: CostVolume, pair: StereoPair) -> CostVolume:
        """Return weighted means: uint16 fixed point (x16) of uint8 costs, otherwise the input's dtype and scale."""
        costs = volume.costs
        fixed_point = 16 if costs.dtype == np.uint8 else 1
        out = memory.empty(costs.shape, np.float32 if costs.dtype == np.float32 else np.uint16)
        left, right = (self.planes(image) for image in pair.color8)
        rounding = np.float32(0.0 if costs.dtype == np.float32 else 0.5)
        run_bands(
            _aggregate, len(costs), costs, left, np.ascontiguousarray(right[:, :, ::-1]), self.window // 2,
            np.float32(self.gamma_color), np.float32(self.gamma_space), self.norm == "squared", np.float32(fixed_point),
            rounding, out,
        )  # fmt: skip
        return CostVolume(out, volume.scale * fixed_point)

    def planes(self, image: Image8) -> Floats:
        """Return the colors of an (H, W, 3) image in ``color_space``, (H, 3, W) float32."""
        colors = image.astype(np.float32)
        if self.color_space == "lab":
            colors = np.asarray(cv2.cvtColor(colors / np.float32(255), cv2.COLOR_RGB2Lab), np.float32)
        return np.ascontiguousarray(colors.transpose(0, 2, 1))


@helper
def _add_taps(zero, sums, weights, at, left, left_at, left_step, right, right_at, right_step, cost, cost_at, cost_step,
              taps):  # fmt: skip
    # For every k < taps: t = left[k] * right[k, :]; sums += t * cost[k, :]; weights += t, for as many disparities as
    # ``zero`` has lanes. Arrays are flat float32; ``*_at`` is the index of tap 0, ``*_step`` the distance between taps.
    total, weight = load_like(zero, sums, at), load_like(zero, weights, at)
    for k in range(taps):
        both = scaled(load_like(zero, right, right_at + k * right_step), left, left_at + k * left_step)
        total = fused(both, load_like(zero, cost, cost_at + k * cost_step), total)
        weight = ordered_sum(weight, both)
    store(sums, at, total)
    store(weights, at, weight)


@helper
def _exp2_minus(z):
    # 2 ** -z of a float32 z >= 0, relative error 2e-7; z above 125 counts as 125. It is 2 ** -n * 2 ** -0.5 * exp(u)
    # with n = int(z), u = ln 2 * (0.5 - (z - n)), |u| < 0.35. The first factor is set as the bits of an exponent; the
    # last is a series of degree 6.
    half, ln2, root = np.float32(0.5), np.float32(0.6931472), np.float32(0.70710678)
    c2, c3, c4 = np.float32(1 / 2), np.float32(1 / 6), np.float32(1 / 24)
    c5, c6 = np.float32(1 / 120), np.float32(1 / 720)
    one = np.float32(1)
    z = min(z, np.float32(125))
    n = np.int32(z)
    u = ln2 * (half - (z - np.float32(n)))
    series = one + u * (one + u * (c2 + u * (c3 + u * (c4 + u * (c5 + u * c6)))))
    return root * series * bits_float(np.int32((np.int32(127) - n) << np.int32(23)))


@helper
def _weigh(a0, a1, a2, b0, b1, b2, space, scale, squared, out):
    # out = 2 ** -(space + scale * |a - b|), in a form that compiles to vector code.
    for i in range(out.size):
        d0, d1, d2 = a0[i] - b0[i], a1[i] - b1[i], a2[i] - b2[i]
        distance = d0 * d0 + d1 * d1 + d2 * d2
        if not squared:
            distance = np.sqrt(distance)
        out[i] = _exp2_minus(space + scale * distance)


@jit
def _aggregate(begin, end, costs, left, right, radius, gamma_color, gamma_space, squared, factor, rounding, out):
    # (H, W, D) costs, (H, 3, W) colors, rows of ``right`` reversed. For every row of the window, left weights (tap, x)
    # and right weights (tap, reversed x) are computed once; then every pixel adds its taps for all disparities. In
    # reversed order, the right weights of a pixel are contiguous along d, and 0 beyond the row, outside the image.
    height, width, n_disparities = costs.shape
    padded = (n_disparities + LANES - 1) // LANES * LANES
    # An odd number of cache lines, so that the taps' rows spread over all cache sets.
    stride = (width + padded + 15) // 16 * 16
    if stride % 32 == 0:
        stride += 16
    side = 2 * radius + 1
    log2e = float32(1.4426950408889634)
    narrow, wide = splat(float32(0)), wide_zero()
    color_scale = log2e / gamma_color
    for y in range(begin, end):
        num = zeros(width * padded, np.float32)
        den = zeros(width * padded, np.float32)
        cost = zeros((width, padded), np.float32)
        left_weights = zeros((side, stride), np.float32)
        right_weights = zeros((side, stride), np.float32)
        for yq in range(max(0, y - radius), min(height, y + radius + 1)):
            row = costs[yq]
            for x in range(width):
                source, target = row[x], cost[x]
                for d in range(source.size):
                    target[d] = float32(source[d])
            for dx in range(max(-radius, 1 - width), min(radius, width - 1) + 1):
                space = float32((yq - y) * (yq - y) + dx * dx)
                if not squared:
                    space = np.sqrt(space)
                space = space * log2e / gamma_space
                # n pairs of pixels, dx apart; in the reversed row the neighbor comes first.
                n = width - abs(dx)
                a, b = max(0, -dx), max(0, dx)
                k = dx + radius
                here, there = left[y], left[yq]
                _weigh(here[0, a : a + n], here[1, a : a + n], here[2, a : a + n],
                       there[0, b : b + n], there[1, b : b + n], there[2, b : b + n],
                       space, color_scale, squared, left_weights[k, a : a + n])  # fmt: skip
                here, there = right[y], right[yq]
                _weigh(here[0, b : b + n], here[1, b : b + n], here[2, b : b + n],
                       there[0, a : a + n], there[1, a : a + n], there[2, a : a + n],
                       space, color_scale, squared, right_weights[k, b : b + n])  # fmt: skip
            for x in range(width):
                first = max(-radius, -x)
                taps = min(radius, width - 1 - x) - first + 1
                k = (first + radius) * stride
                d = 0
                while d < padded:
                    at = x * padded + d
                    left_at, right_at, cost_at = k + x, k + width - 1 - x + d, (x + first) * padded + d
                    if padded - d >= WIDE:
                        _add_taps(wide, num, den, at, left_weights, left_at, stride, right_weights, right_at, stride,
                                  cost, cost_at, padded, taps)  # fmt: skip
                        d += WIDE
                    else:
                        _add_taps(narrow, num, den, at, left_weights, left_at, stride, right_weights, right_at, stride,
                                  cost, cost_at, padded, taps)  # fmt: skip
                        d += LANES
        for x in range(width):
            source, target = costs[y, x], out[y, x]
            sums, weights = num[x * padded : x * padded + n_disparities], den[x * padded : x * padded + n_disparities]
            for d in range(target.size):
                if weights[d] > 0:
                    target[d] = sums[d] / weights[d] * factor + rounding
                else:
                    target[d] = source[d] * factor

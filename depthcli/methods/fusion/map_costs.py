"""Planes to judge maps of a left view at every pixel, from the pair and from other maps.

Given maps (``methods.given_maps``) and both ways to choose among maps (``fusion.choice``) use these planes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.filters import CORRELATED, correlation, local_moments
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Floats, Image8
from depthcli.kernels.color_steps import BEFORE, color_steps
from depthcli.kernels.jit import empty, helper, jit, run_bands
from depthcli.methods.fusion.votes import ColorSupport
from depthcli.methods.stereo.volume import CostVolume

_ALL, _BUT_LAST, _BUT_FIRST = slice(None), slice(None, -1), slice(1, None)
NEIGHBORS = (((_ALL, _BUT_LAST), (_ALL, _BUT_FIRST)), ((_BUT_LAST, _ALL), (_BUT_FIRST, _ALL)))
"""Slices of pixels and of the next ones, along the rows; the same along the columns."""
MAX_COLOR = np.float32(40.0)
"""Largest color difference and deviation in the planes, grey levels; networks are trained with it."""
VIEW_PLANES = (
    *("cost", "uncut_cost", "excess_cost", "contradiction", "hidden", "right_view_difference"),
    *("match_column", "self_occlusion", "warped", "color_difference"),
)
"""Planes of :meth:`Views.compare`, one value per pixel of every map.

| plane | measure |
|---|---|
| ``cost``, ``uncut_cost`` | matching cost along the map, at most a limit each; outside the right image, the limit |
| ``excess_cost`` | cost above the pixel's smallest one |
| ``contradiction`` | how far the map is in front of the right view's map: 0 to 1 between one and two pixels |
| ``hidden`` | 1 if the map is more than a pixel behind the right view's map, or outside |
| ``right_view_difference`` | difference from the right view's disparity at the match, at most 5 pixels; -6 outside |
| ``match_column`` | column of the match in the right image, at most 20 from its border, pixels |
| ``self_occlusion`` | by how much a nearer pixel of the map covers the match, pixels |
| ``warped`` | grey level of the right image at the match |
| ``color_difference`` | largest channel difference to the match, grey levels |
"""
Map = NDArray[np.float32]
_SOFTNESS = 15.0  # of the supports, grey levels


class Views:
    """A pair, its costs and the disparities of its right view, to judge maps of the left view."""

    pair: StereoPair
    volume: CostVolume  # (H, W, D) matching costs
    right: NDArray[np.uint16]  # (H, W) disparities of the right view

    @cached_property
    def wide(self) -> ColorSupport:
        """The wide support that costs are averaged over; networks are trained with these supports."""
        return ColorSupport(self.pair.color8[0], 8.0, _SOFTNESS)

    @cached_property
    def narrow(self) -> ColorSupport:
        """The narrow support, for planes in which outlines matter."""
        return ColorSupport(self.pair.color8[0], 2.0, _SOFTNESS)

    @cached_property
    def region(self) -> ColorSupport:
        """The support of a whole surface of one color."""
        return ColorSupport(self.pair.color8[0], 40.0, 8.0)

    @cached_property
    def grey(self) -> tuple[Map, Map]:
        """Both images, grey levels 0 .. 255 as float32."""
        left, right = (image.astype(np.float32) for image in self.pair.grey8)
        return left, right

    @property
    def light_trust(self) -> Map | np.float32:
        """Trust in the light of every pixel, 0 .. 1."""
        trust = self.pair.light_trust
        return np.float32(1) if trust is None else np.asarray(trust / np.float32(255), np.float32)

    def compare(self, maps: Map, plane: Mapping[str, Map], max_costs: tuple[float, float]) -> Map:
        """Write the planes ``VIEW_PLANES``, (N, H, W) each, of maps of that shape; return the smallest cost (H, W).

        Costs are in units of the measure; ``max_costs`` are the limits of ``cost`` and ``uncut_cost``.
        """
        lowest = np.empty(maps.shape[1:], np.float32)
        left, right = self.pair.color8
        views = self.volume.costs, np.float32(1 / self.volume.scale), self.right, left, right, self.grey[1]
        max_cost, max_uncut = map(np.float32, max_costs)
        run_bands(
            _compare, maps.shape[1], maps, *views, max_cost, max_uncut, lowest, *(plane[name] for name in VIEW_PLANES)
        )
        return lowest

    def decorrelation(self, warped: Map, out: Map) -> None:
        """Write 1 - correlation, in windows, of the left image and (N, H, W) right images warped by maps."""
        left = self.grey[0]
        np.subtract(1, correlation(left, local_moments(left, CORRELATED), warped), out=out)


def image_planes(grey: Map, sides: Iterable[int], plane: Mapping[str, Map]) -> None:
    """Write ``deviation_SIDE`` of windows with these ``sides``, and ``gradient``, of an image, grey levels."""
    for side in sides:
        deviation(grey, side, float(MAX_COLOR), plane[f"deviation_{side}"])
    np.minimum(np.abs(cv2.Sobel(grey, cv2.CV_32F, 1, 0)) / 8, 30, out=plane["gradient"])


def deviation(values: Map, side: int, most: float, out: Map) -> None:
    """Write the standard deviation of square windows of ``side`` pixels, at most ``most``."""
    np.sqrt(local_moments(values, side)[1], out=out)
    np.minimum(out, most, out=out)


def misfit(here: Map, there: Map, slope_here: Map, slope_there: Map) -> Map:
    """Return the mean difference of two neighbors from the disparities that their slopes predict, pixels."""
    step = there - here
    mean: Map = np.float32(0.5) * (abs(step - slope_here) + abs(step - slope_there))
    return mean


misfit_of_pixels = jit(misfit)
"""The same for single pixels, in kernels."""


def disagreements(maps: Map, weights: Floats, out: Map | None = None) -> Map:
    """Compute the weighted share of the other maps (N, H, W) that disagree.

    Maps within half a pixel agree; from there to one and a half their agreement fades.
    """
    out = np.empty(maps.shape, np.float32) if out is None else out
    run_bands(_disagree, maps.shape[1], maps, weights, weights.sum() - weights, out)
    return out


def agreement(values: Map, maps: Map, weights: Floats) -> Map:
    """Compute the weighted share, 0 .. 1, of maps (N, H, W) that agree with ``values`` (H, W), as ``disagreements``."""
    total = np.zeros(values.shape, np.float32)
    for one, weight in zip(maps, weights, strict=True):
        total += weight * np.clip(np.float32(1.5) - np.abs(one - values), 0, 1)
    return total / np.float32(weights.sum())


def hidden_jumps(maps: Map, image: Image8, out: Map | None = None) -> Map:
    """Compute how far every map (N, H, W) jumps at pixels where the color does not change, in [0, 4].

    Each of the four neighbors adds the part of its step beyond one pixel, at most 1, times exp(-color difference / 10
    levels).
    """
    out = np.empty(maps.shape, np.float32) if out is None else out
    sameness = np.exp(np.arange(256) * -0.1).astype(np.float32)
    run_bands(_hidden_jumps, maps.shape[1], maps, sameness[color_steps(image, BEFORE, largest=True)], out)
    return out


@helper
def cost_between(costs, value):
    """Return the cost of a pixel at a disparity between two whole ones."""
    d = min(int(value), costs.size - 1)
    cost = np.float32(costs[d])
    if d + 1 < costs.size:
        cost += (value - np.float32(d)) * (np.float32(costs[d + 1]) - cost)
    return cost


@helper
def nearest_matches(row):
    """Return the largest disparity that a row's pixels have at each pixel of the right view; -1 if none matches it."""
    nearest = np.full(row.size, np.float32(-1))
    for x in range(row.size):
        u = int(np.floor(np.float32(x) - row[x] + np.float32(0.5)))
        if u >= 0:
            nearest[u] = max(nearest[u], row[x])
    return nearest


@helper
def match_in_right(x, value, right, nearest):
    """Return some of ``VIEW_PLANES`` for pixel ``x`` of a map, and the distance to its match's disparity.

    These are ``contradiction``, ``hidden``, ``right_view_difference``, ``match_column``, ``self_occlusion``, and the
    distance, at most 8 pixels. ``right`` is the right view's row of disparities, ``nearest`` the
    :func:`nearest_matches` of the map's row.
    """
    zero, one = np.float32(0), np.float32(1)
    column = np.float32(x) - value
    u = int(np.floor(column + np.float32(0.5)))
    column = min(max(column, np.float32(-20)), np.float32(20))
    if u < 0:
        return zero, one, np.float32(-6), column, zero, np.float32(8)
    nearer = value - np.float32(right[u])
    hidden = one if nearer < -one else zero
    contradiction = min(max(nearer - one, zero), one)
    difference = min(max(nearer, np.float32(-5)), np.float32(5))
    covered = min(nearest[u] - value, np.float32(6))
    return contradiction, hidden, difference, column, covered, min(abs(nearer), np.float32(8))


@helper
def warped_right(x, value, image, other, grey):
    """Return the right view's grey level at the match of pixel ``x``, and the largest channel difference to it.

    ``image`` and ``other`` are rows of the left and of the right color image, ``grey`` is a row of the right grey one.
    """
    at = min(max(np.float32(x) - value, np.float32(0)), np.float32(grey.size - 1))
    low = int(at)
    high = min(low + 1, grey.size - 1)
    rest = at - np.float32(low)
    largest = np.float32(0)
    for c in range(3):
        a, b = np.float32(other[low, c]), np.float32(other[high, c])
        largest = max(largest, abs(np.float32(image[x, c]) - (a + rest * (b - a))))
    return grey[low] + rest * (grey[high] - grey[low]), min(largest, MAX_COLOR)


@jit
def _compare(
    begin, end, maps, costs, unit, right, image, other, grey, max_cost, max_uncut, lowest,
    cost, uncut, excess, contradiction, hidden, difference, column, occlusion, warped, color,
):  # fmt: skip
    count, _, width = maps.shape
    for y in range(begin, end):
        right_row, image_row, other_row, grey_row, costs_row = right[y], image[y], other[y], grey[y], costs[y]
        along = empty(width, np.float32)
        for x in range(width):
            curve = costs_row[x]
            least = curve[0]
            for i in range(curve.size):
                least = min(least, curve[i])
            lowest[y, x] = np.float32(least) * unit
        for n in range(count):
            row = maps[n, y]
            nearest = nearest_matches(row)
            for x in range(width):
                value = row[x]
                along[x] = cost_between(costs_row[x], value)
                outside = min(int(value), costs.shape[2] - 1) > x
                uncut[n, y, x] = max_uncut if outside else min(along[x] * unit, max_uncut)
                contradicted, behind, nearer, at, covered, _ = match_in_right(x, value, right_row, nearest)
                contradiction[n, y, x], hidden[n, y, x], difference[n, y, x] = contradicted, behind, nearer
                column[n, y, x], occlusion[n, y, x] = at, covered
                warped[n, y, x], color[n, y, x] = warped_right(x, value, image_row, other_row, grey_row)
            for x in range(width):
                cost[n, y, x] = min(uncut[n, y, x], max_cost)
                excess[n, y, x] = along[x] * unit - lowest[y, x]


@jit
def _disagree(begin, end, maps, weights, others, out):
    count, _, width = maps.shape
    zero, one, no_agreement = np.float32(0), np.float32(1), np.float32(1.5)
    for y in range(begin, end):
        agreement = empty(width, np.float32)
        for k in range(count):
            agreement[:] = 0
            own = maps[k, y]
            for m in range(count):
                if m == k:
                    continue
                weight, other = weights[m], maps[m, y]
                for x in range(own.size):
                    agreement[x] += weight * min(max(no_agreement - abs(own[x] - other[x]), zero), one)
            for x in range(width):
                out[k, y, x] = one - agreement[x] / others[k] if others[k] > 0 else zero


@jit
def _hidden_jumps(begin, end, maps, same, out):
    # ``same`` (2, H, W): how alike the colors of a pixel and of the pixel to its left, above it are.
    count, height, width = maps.shape
    for y in range(begin, end):
        for k in range(count):
            row = maps[k, y]
            for x in range(width):
                jumps = np.float32(0)
                if x > 0:
                    jumps += same[0, y, x] * _jump(row[x], row[x - 1])
                if x + 1 < width:
                    jumps += same[0, y, x + 1] * _jump(row[x], row[x + 1])
                if y > 0:
                    jumps += same[1, y, x] * _jump(row[x], maps[k, y - 1, x])
                if y + 1 < height:
                    jumps += same[1, y + 1, x] * _jump(row[x], maps[k, y + 1, x])
                out[k, y, x] = jumps


@helper
def _jump(value, other):
    return min(max(abs(value - other) - np.float32(1), np.float32(0)), np.float32(1))

"""Inputs of the network: costs along every proposal, other maps, both views, and its own shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.filters import local_moments
from depthcli.algorithms.plane_fitting.window_slopes import slopes
from depthcli.core import memory
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.fusion.choice import Proposals
from depthcli.methods.fusion.map_costs import (
    NEIGHBORS,
    contradictions,
    cost_between,
    disagreements,
    matching_costs,
    misfit,
    nearest_matches,
)

PROPOSAL_PLANES = (
    *("cost_wide", "cost_narrow", "disagreement_narrow", "disagreement_wide", "decorrelation", "color_difference"),
    *("color_difference_5", "contradiction_narrow", "contradiction_wide", "hidden_narrow", "excess_cost"),
    *("right_view_difference", "match_column", "self_occlusion", "roughness", "roughness_9", "slope_x", "slope_y"),
    *("above_mean_11", "above_mean_25", "filled"),
)
"""Planes of every proposal, one value per pixel, in their order. ``wide`` and ``narrow`` are means over that support;
numbers are the sides of windows in pixels.

| plane | what it measures |
|---|---|
| ``cost`` | fused costs along the map |
| ``disagreement`` | share of the other maps that disagree |
| ``decorrelation`` | 1 - correlation of the left image and the right one, warped by the map |
| ``color_difference`` | largest channel difference of these two, grey levels |
| ``contradiction``, ``hidden`` | by the right view: in front of what it sees; behind it, or outside |
| ``excess_cost`` | cost above the pixel's smallest one |
| ``right_view_difference`` | to the disparity of the match in the right view, pixels |
| ``match_column`` | column of the match in the right image, at most 20 from its border, pixels |
| ``self_occlusion`` | by how much a nearer pixel of the map covers the match, pixels |
| ``roughness`` | misfits of the four neighbors, pixels |
| ``slope_x``, ``slope_y`` | change to the next pixel of the row, of the column, pixels |
| ``above_mean`` | disparity above the mean of a window, pixels |
| ``filled`` | 0 measured, 1 filled, 2 filled and occluded |
"""
RELATIVE = ("cost_wide", "cost_narrow", "decorrelation", "color_difference_5")
"""These planes are also given relative to the smallest value among the proposals (``<name>_relative``)."""
PIXEL_PLANES = ("min_cost", "deviation_5", "deviation_13", "gradient", "filled_share", "light_trust")
"""Planes of the pixel, the same for all proposals: its smallest cost, standard deviations of windows and gradient of
the left image (grey levels), share of the proposals that are filled, and how far its light is trusted (0 .. 1)."""

# Networks are trained with these; another value wants another training.
_MAX_DISTANCE = np.float32(4.0)  # between two proposals, pixels
_MAX_COLOR = np.float32(40.0)  # of color differences and deviations, grey levels
_NOISE = np.float32(4.0)  # added to variances under a correlation, grey levels squared
_MAX_MISFIT = 2.0  # between neighbors, pixels
_WINDOW = 7  # side of the windows that are correlated, pixels
_REACH = 9  # half side of the window that slopes are fitted in, pixels
_RELATIVE_INDICES = np.array([PROPOSAL_PLANES.index(name) for name in RELATIVE])


def input_names(kinds: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the inputs, in their order, for proposals of these kinds."""
    relative = (f"{name}_relative" for name in RELATIVE)
    distances = (f"distance_{k}_{kind}" for k, kind in enumerate(kinds))
    return (*PROPOSAL_PLANES, *relative, *distances, *PIXEL_PLANES)


@dataclass(frozen=True)
class NetworkInputs:
    """Inputs of a pair's proposals, as planes; :meth:`rows` puts them side by side."""

    values: NDArray[np.float32]  # (N, P) float32, the proposals' disparities at P pixels
    own: NDArray[np.float32]  # (len(PROPOSAL_PLANES), N, P) float32, planes of every proposal
    shared: NDArray[np.float32]  # (len(PIXEL_PLANES), P) float32, planes of the pixel

    @classmethod
    def of(cls, proposals: Proposals) -> NetworkInputs:
        """Compute the inputs of all pixels, which are numbered row by row."""
        maps, pair, volume = proposals.values, proposals.pair, proposals.volume
        count, height, width = maps.shape
        image = pair.color8[0]
        wide, narrow = proposals.wide, proposals.narrow
        own = memory.empty((len(PROPOSAL_PLANES), count, height, width), np.float32)
        plane = {name: own[k] for k, name in enumerate(PROPOSAL_PLANES)}
        alike = np.ones(count, np.float32)
        plane["cost_wide"][:] = matching_costs(maps, volume, 0.7, wide)
        plane["cost_narrow"][:] = matching_costs(maps, volume, 1.5, narrow)
        plane["disagreement_narrow"][:] = disagreements(maps, alike, narrow)
        plane["disagreement_wide"][:] = disagreements(maps, alike, wide)
        plane["contradiction_narrow"][:] = contradictions(maps, proposals.right, 0.0, narrow)
        plane["contradiction_wide"][:] = contradictions(maps, proposals.right, 0.0, wide)
        plane["hidden_narrow"][:] = contradictions(maps, proposals.right, 1.0, narrow) - plane["contradiction_narrow"]
        grey = [channel.astype(np.float32) for channel in pair.grey8]
        shared = np.zeros((len(PIXEL_PLANES), height, width), np.float32)
        common = {name: shared[k] for k, name in enumerate(PIXEL_PLANES)}
        unit = np.float32(1 / volume.scale)
        common["min_cost"][:] = volume.costs.min(axis=2) * unit
        for side in (5, 13):
            common[f"deviation_{side}"][:] = np.minimum(np.sqrt(local_moments(grey[0], side)[1]), _MAX_COLOR)
        common["gradient"][:] = np.minimum(np.abs(cv2.Sobel(grey[0], cv2.CV_32F, 1, 0)) / 8, 30)
        plane["filled"][:] = proposals.filled
        common["filled_share"][:] = (proposals.filled > 0).mean(axis=0)
        common["light_trust"][:] = 1 if pair.light_trust is None else pair.light_trust / np.float32(255)
        warped = np.empty((height, width), np.float32)
        moments = local_moments(grey[0], _WINDOW)
        for k, values in enumerate(maps):
            own_planes = ("excess_cost", "right_view_difference", "match_column", "self_occlusion", "color_difference")
            views = (proposals.right, image, pair.color8[1], grey[1])
            out = (plane[name][k] for name in own_planes)
            _compare_views(values, volume.costs, unit, *views, common["min_cost"], warped, *out)
            plane["color_difference_5"][k] = cv2.blur(plane["color_difference"][k], (5, 5))
            plane["decorrelation"][k] = 1 - correlation(grey[0], moments, warped)
            slope = slopes(values, image, _REACH)
            plane["slope_x"][k], plane["slope_y"][k] = slope
            plane["roughness"][k] = roughness(values, slope)
            plane["roughness_9"][k] = cv2.blur(plane["roughness"][k], (9, 9))
            for side in (11, 25):
                plane[f"above_mean_{side}"][k] = np.clip(values - cv2.blur(values, (side, side)), -6, 6)
        pixels = height * width
        return cls(
            maps.reshape(count, pixels),
            own.reshape(len(PROPOSAL_PLANES), count, pixels),
            shared.reshape(len(PIXEL_PLANES), pixels),
        )

    def of_proposal(self, n: int) -> NDArray[np.float32]:
        """Return the inputs of proposal ``n`` in the order of :func:`input_names`, (inputs, P) float32."""
        compared = self.own[_RELATIVE_INDICES]
        relative = compared[:, n] - compared.min(axis=1)
        distances = np.minimum(np.abs(self.values[n] - self.values), _MAX_DISTANCE)
        return np.concatenate([self.own[:, n], relative, distances, self.shared])

    def rows(self, pixels: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the inputs of some pixels, (len(pixels), N, inputs) float32."""
        return np.stack([self.of_proposal(n)[:, pixels].T for n in range(len(self.values))], axis=1)


def correlation(grey: Any, moments: Any, warped: Any) -> Any:
    mean, variance = local_moments(warped, _WINDOW)
    product = cv2.blur(grey * warped, (_WINDOW, _WINDOW)) - mean * moments[0]
    return product / np.sqrt((variance + _NOISE) * (moments[1] + _NOISE))


@parallel_jit
def _compare_views(
    values, costs, unit, right, image, other, grey, lowest, warped, excess, difference, column, hidden, color
):
    height, width = values.shape
    last, half = np.float32(width - 1), np.float32(0.5)
    for y in prange(height):
        nearest = nearest_matches(values[y])
        for x in range(width):
            value = values[y, x]
            excess[y, x] = cost_between(costs[y, x], value) * unit - lowest[y, x]
            column[y, x] = min(max(np.float32(x) - value, np.float32(-20)), np.float32(20))
            u = int(np.floor(np.float32(x) - value + half))
            if u < 0:
                difference[y, x] = np.float32(-6)
                hidden[y, x] = np.float32(0)
            else:
                difference[y, x] = min(max(value - np.float32(right[y, u]), np.float32(-5)), np.float32(5))
                hidden[y, x] = min(nearest[u] - value, np.float32(6))
            at = min(max(np.float32(x) - value, np.float32(0)), last)
            low = int(at)
            high = min(low + 1, width - 1)
            rest = at - np.float32(low)
            warped[y, x] = grey[y, low] + rest * (grey[y, high] - grey[y, low])
            largest = np.float32(0)
            for c in range(3):
                a, b = np.float32(other[y, low, c]), np.float32(other[y, high, c])
                largest = max(largest, abs(np.float32(image[y, x, c]) - (a + rest * (b - a))))
            color[y, x] = min(largest, _MAX_COLOR)


def roughness(values: NDArray[np.float32], slope: NDArray[np.float32]) -> NDArray[np.float32]:
    # Sum of the misfits of the four neighbors: left, right, upper, lower
    rough = np.zeros_like(values)
    for axis, (here, there) in enumerate(NEIGHBORS):
        cost = misfit(values[here], values[there], slope[axis][here], slope[axis][there], _MAX_MISFIT)
        rough[there] += cost
        rough[here] += cost
    return rough

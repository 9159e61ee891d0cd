"""Replace filled values by values of surfaces that no color edge separates from the pixel."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Image8, Status
from depthcli.kernels.color_steps import color_steps
from depthcli.kernels.jit import helper, jit, run_bands
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.volume import RefinementContext

_AXES: NDArray[np.int64] = np.array([(0, 1), (1, 0), (1, 1), (1, -1)])
"""(dy, dx) of the steps of a search, which goes both ways."""
# Chosen on the tuning scenes of scripts/stereo_groups.yaml; the errors change little around these values. The device
# kernel (fills.cl) has the same values.
_SMOOTHING_RADIUS = 3  # pixels, of a Gaussian of 1 pixel
_MAX_COST = 4.0  # of a value: the search ends beyond it
_CONTRADICTION = 1.5  # added cost of a value that contradicts the right view
_MAX_EXCESS = 1.5  # pixels of disparity by which a value may exceed the right view's value at its match
_MARGIN = 1.0  # by which a value must cost less than the values that agree with the fill
_AGREEMENT = (2.0, 0.3)  # pixels, and pixels per pixel of distance: a value this close to the fill agrees with it


class DirectionalFill(Refinement):
    """Give filled pixels the nearest value of another direction if color edges contradict their fill.

    Fills along the row take the surfaces at the gap's two ends. Behind several objects, however, the gap's surface may
    only be visible above or below it. So the nearest measured values in 8 directions are compared. Their cost is the
    largest change of color on the way plus the distance. A value larger than the right view's value at its match costs
    more, because it would be in front of the surface that the right view sees. The cheapest value replaces the fill if
    it costs less by 1 than all values that agree with the fill. The strip on the left that the right view cannot see
    keeps its fill.
    """

    needs_costs = False

    color_scale: float = Field(
        3.0, gt=0, le=1e4, description="largest mean change of color from pixel to pixel that costs 1, grey levels"
    )
    distance_scale: float = Field(40.0, gt=0, le=1e4, description="distance of a value that costs 1, pixels")

    def halo(self) -> int | None:
        return int(np.ceil(_MAX_COST * self.distance_scale)) + _SMOOTHING_RADIUS

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        measured = disparity.valid & ((disparity.status & np.uint8(Status.FILLED)) == 0)
        changes = color_steps(self.smoothed(context.pair), _AXES, largest=False)
        values = disparity.values.copy()
        run_bands(
            _replace, len(disparity.values), disparity.values, measured, changes, context.right, _AXES,
            *self.rates(), values,
        )  # fmt: skip
        return DisparityMap(values, disparity.status)

    def smoothed(self, pair: StereoPair) -> Image8:
        """Return the left image, (H, W, 3), without noise that would be taken for edges."""
        side = 2 * _SMOOTHING_RADIUS + 1
        return np.asarray(cv2.GaussianBlur(pair.color8[0], (side, side), 1.0), np.uint8)

    def rates(self) -> tuple[np.float32, np.float32]:
        """Return the cost of a sum of color differences of 1, and the cost of a pixel of distance."""
        return np.float32(1 / (3 * self.color_scale)), np.float32(1 / self.distance_scale)


@jit
def _replace(begin, end, values, measured, changes, right, axes, color_rate, distance_rate, out):
    width = values.shape[1]
    for y in range(begin, end):
        first = 0
        while first < width and not measured[y, first]:
            first += 1
        for x in range(first, width):
            fill = values[y, x]
            if measured[y, x] or np.isnan(fill):
                continue
            agreeing = cheapest = np.float32(_MAX_COST)
            replacement = fill
            for k in range(2 * axes.shape[0]):
                back = k % 2
                dy, dx = (1 - 2 * back) * axes[k // 2, 0], (1 - 2 * back) * axes[k // 2, 1]
                cost, distance = _search(
                    measured, changes[k // 2], y, x, dy, dx, back, color_rate, distance_rate, agreeing
                )
                if cost >= agreeing:
                    continue
                value = values[y + distance * dy, x + distance * dx]
                u = x - int(value + np.float32(0.5))
                if u >= 0 and right[y, u] < value - np.float32(_MAX_EXCESS):
                    cost += np.float32(_CONTRADICTION)
                if abs(value - fill) <= np.float32(_AGREEMENT[0]) + np.float32(_AGREEMENT[1]) * np.float32(distance):
                    agreeing = min(agreeing, cost)
                elif cost < cheapest:
                    cheapest, replacement = cost, value
            if cheapest + np.float32(_MARGIN) < agreeing:
                out[y, x] = replacement


@helper
def _search(measured, changes, y, x, dy, dx, back, color_rate, distance_rate, limit):
    # Cost and distance (steps) of the nearest measured pixel in a direction; if there is none, at least ``limit``.
    height, width = measured.shape
    edge = np.float32(0)
    distance = 1
    while True:
        v, u = y + distance * dy, x + distance * dx
        if v < 0 or v >= height or u < 0 or u >= width:
            return limit, distance
        edge = max(edge, np.float32(changes[v - back * dy, u - back * dx]))
        cost = edge * color_rate + np.float32(distance) * distance_rate
        if measured[v, u] or cost >= limit:
            return cost, distance
        distance += 1

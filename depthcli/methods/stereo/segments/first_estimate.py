"""First disparities of the segment-based pipeline, by windows inside segments, and the segments that they cut."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.plane_fitting.segment_planes import SegmentPlaneFit
from depthcli.algorithms.regions import RegionGraph, RegionPixels, connected_components_of_labels, merge_small_regions
from depthcli.core import memory
from depthcli.core.method import ConfigModel
from depthcli.kernels.jit import empty, jit, run_bands, zeros
from depthcli.kernels.winners import left_right_difference, winners
from depthcli.methods.stereo.volume import CostVolume, FixedPoint, as_fixed_point


@dataclass(frozen=True)
class FirstEstimate:
    """Disparities (H, W) before planes are fitted."""

    values: NDArray[np.float32]  # pixels, may have fractions
    trusted: NDArray[np.bool_]  # the right view agrees
    right: NDArray[np.uint16]  # disparities of the right view
    weights: NDArray[np.float32] | None = None  # in (0, 1], of trusted pixels in the energy; None: all are 1


class Selection(ConfigModel):
    """Take the cheapest disparities of both views and check whether they agree.

    A pixel is trusted if the views agree and its costs are not all the same. In a uniform image every disparity would
    pass the check.
    """

    tolerance: float = Field(
        1.0, ge=0, le=16384, description="largest difference of the views at a trusted pixel, pixels"
    )
    subpixel: bool = Field(False, description="move disparities to the minimum of a parabola through three costs")
    least_weight: float = Field(
        1.0,
        gt=0,
        le=1,
        description="weight in dedc of a pixel whose second disparity has the same cost; 1: all pixels count alike",
    )

    def __call__(self, volume: CostVolume) -> FirstEstimate:
        minima = np.empty(volume.costs.shape[:2], np.float32) if self.subpixel else None
        left, right = winners(volume.costs, minima)
        trusted = left_right_difference(left, right) <= self.tolerance
        run_bands(_distrust_constant_costs, len(volume.costs), volume.costs, trusted)
        values = left.astype(np.float32) if minima is None else minima
        return FirstEstimate(values, trusted, right, self._weights(volume, left) if self.least_weight < 1 else None)

    def _weights(self, volume: CostVolume, best: NDArray[np.uint16]) -> NDArray[np.float32]:
        # From ``least_weight``, where a disparity elsewhere costs no more, to 1, where it costs more by the median of
        # the image or above.
        margins = np.empty(best.shape, np.float32)
        run_bands(_margins, len(best), volume.costs, best, margins)
        typical = np.float32(max(float(np.median(margins)), 1e-6))
        share = np.minimum(margins / typical, np.float32(1))
        return np.asarray(self.least_weight + (1 - self.least_weight) * share, np.float32)


@jit
def _margins(begin, end, costs, best, margins):
    # How much more the cheapest disparity inside the right image costs that is no neighbor of the best one; 0: none.
    _, width, n_disparities = costs.shape
    for y in range(begin, end):
        for x in range(width):
            row, place = costs[y, x], np.int64(best[y, x])
            second = np.float32(np.inf)
            for d in range(min(n_disparities, x + 1)):
                if d < place - 1 or d > place + 1:
                    second = min(second, np.float32(row[d]))
            margins[y, x] = second - np.float32(row[place]) if second < np.inf else np.float32(0)


def segment_window(volume: CostVolume, labels: NDArray[np.int32], radius: int) -> CostVolume:
    """Average costs, in fixed point, over the pixels of a square window that are in the same segment as its center."""
    fixed = as_fixed_point(volume) if volume.costs.dtype != np.uint8 else volume
    out = memory.empty(fixed.costs.shape, np.uint16)
    refinement = FixedPoint.FRACTION if volume.costs.dtype == np.uint8 else 1
    # Up to 257 uint8 costs fit into a uint16 sum, which is twice as fast.
    small = volume.costs.dtype == np.uint8 and (2 * radius + 1) ** 2 <= 257
    total = np.zeros(1, np.uint16 if small else np.uint32)
    run_bands(_segment_window, len(fixed.costs), fixed.costs, labels, radius, np.float32(refinement), total, out)
    return CostVolume(out, fixed.scale * refinement)


@jit
def _segment_window(begin, end, costs, labels, radius, refinement, kind, out):
    height, width, n_disparities = costs.shape
    half = np.float32(0.5)
    for y in range(begin, end):
        total = zeros(n_disparities, kind.dtype)
        for x in range(width):
            total[:] = 0
            label = labels[y, x]
            count = 0
            for j in range(max(0, y - radius), min(height, y + radius + 1)):
                for k in range(max(0, x - radius), min(width, x + radius + 1)):
                    if labels[j, k] != label:
                        continue
                    count += 1
                    row = costs[j, k]
                    for i in range(total.size):
                        total[i] += row[i]
            factor = refinement / np.float32(count)
            target = out[y, x]
            for i in range(total.size):
                target[i] = np.uint16(np.int32(np.float32(total[i]) * factor + half))


@jit
def has_information(costs):
    """Return whether any pixel has different costs inside the right image; in a uniform image none has."""
    height, width, n_disparities = costs.shape
    for y in range(height):
        for x in range(width):
            for d in range(1, min(n_disparities, x + 1)):
                if costs[y, x, d] != costs[y, x, 0]:
                    return True
    return n_disparities == 1


@jit
def _distrust_constant_costs(begin, end, costs, trusted):
    _, width, n_disparities = costs.shape
    for y in range(begin, end):
        for x in range(width):
            if not trusted[y, x]:
                continue
            row = costs[y, x, : min(n_disparities, x + 1)]
            varies = n_disparities == 1
            for i in range(row.size):
                varies |= row[i] != row[0]
            trusted[y, x] = varies


@jit
def grid_parts(labels, cell, cut):
    """Return (H, W) int32 numbers of the parts into which a grid, ``cell`` pixels wide, cuts segments, and their count.

    Segments ``labels`` (H, W) are cut where ``cut`` (n,) bool is true. If some are not cut, they keep their numbers,
    and parts are numbered from n on.
    """
    height, width = labels.shape
    parts = empty(labels.shape, np.int32)
    number, seen_in = np.arange(cut.size).astype(np.int32), np.full(cut.size, -1, np.int32)
    count = 0 if cut.all() else cut.size
    n_cells = 0
    for top in range(0, height, cell):
        for left in range(0, width, cell):
            for y in range(top, min(top + cell, height)):
                for x in range(left, min(left + cell, width)):
                    s = labels[y, x]
                    if cut[s] and seen_in[s] != n_cells:
                        number[s], seen_in[s] = count, n_cells
                        count += 1
                    parts[y, x] = number[s]
            n_cells += 1
    return parts, count


class Split(ConfigModel):
    """Cut segments that are not planar along a grid, because a curved surface of one color needs several planes.

    The cuts do not follow disparities: the rim of a foreground object, which windows widen, would become a segment of
    its own and keep its incorrect disparity.
    """

    cells: tuple[Annotated[int, Field(ge=4, le=512)], ...] = Field(
        (), max_length=8, description="cell sides of the grids that cut segments, one per pass, pixels; empty: no cuts"
    )
    tolerance: float = Field(1.0, gt=0, le=16384, description="largest distance of a pixel that fits the plane, pixels")
    misfits: float = Field(
        0.1, ge=0, le=1, description="share of trusted pixels off its plane above which a segment is cut"
    )

    def __call__(self, labels: NDArray[np.int32], first: FirstEstimate, fit: SegmentPlaneFit) -> NDArray[np.int32]:
        """Return (H, W) int32 connected segments: ``labels``, or pieces of them; ``fit`` gets this ``tolerance``."""
        plane_fit = fit.model_copy(update={"tolerance": self.tolerance})
        for cell in self.cells:
            count = int(labels.max()) + 1
            members = RegionPixels.of(labels, first.trusted, count)
            sizes = np.bincount(labels.ravel(), minlength=count)
            active = np.flatnonzero((members.sizes >= 3) & (sizes > cell * cell // 2))
            if len(active) == 0:
                continue
            planes = plane_fit(first.values, members, active)
            not_planar = np.zeros(count, bool)
            not_planar[active] = planes.support < (1 - self.misfits) * members.sizes[active]
            # Pieces of less than a quarter cell join the piece of the same segment with the longest common boundary.
            pieces = connected_components_of_labels(grid_parts(labels, cell, not_planar)[0])
            labels = merge_small_regions(pieces, labels, cell * cell // 4, by_boundary=True)
        return labels


@dataclass(frozen=True)
class SegmentedImage:
    """Segments ``labels`` (H, W), 0 .. n - 1, with their first disparities and their pixels."""

    labels: NDArray[np.int32]
    first: FirstEstimate
    graph: RegionGraph  # sizes, colors and neighbors of the segments
    trusted: RegionPixels  # those that passed the left-right check
    untrusted: RegionPixels
    everything: RegionPixels
    max_disparity: int

    @classmethod
    def of(
        cls, labels: NDArray[np.int32], first: FirstEstimate, graph: RegionGraph, max_disparity: int
    ) -> SegmentedImage:
        """Return the segments of ``labels`` with their pixels sorted."""
        everything = RegionPixels.of(labels, None, len(graph.sizes))
        return cls(labels, first, graph, *everything.divided(first.trusted), everything, max_disparity)

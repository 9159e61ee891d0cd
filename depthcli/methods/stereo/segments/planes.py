"""Assignment of a plane to every segment: candidates, data and smoothness terms (thesis, eq. 2.8-2.12), graph cuts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from depthcli.algorithms.graph_cut import alpha_expansion, potts_energy
from depthcli.algorithms.plane_fitting.segment_planes import SegmentPlaneFit, SegmentPlanes
from depthcli.algorithms.regions import RegionPixels, joined_regions
from depthcli.core.context import Clock
from depthcli.core.method import ConfigModel
from depthcli.kernels.jit import empty, helper, jit, run_bands
from depthcli.methods.stereo.boundary import Boundary
from depthcli.methods.stereo.boundary.gaussian import Gaussian
from depthcli.methods.stereo.segments.first_estimate import SegmentedImage
from depthcli.methods.stereo.volume import CostVolume

_TASKS = 64  # parts of the work on all segments, of every 64th one: some rows have larger segments than others
_MIN_GROUP_SIZE = 30  # trusted pixels of connected segments that a plane is fitted to again; choice of this program


class PlaneCandidates(SegmentPlaneFit):
    """Fit candidate planes to segments, and drop near-duplicates."""

    renamed: ClassVar[dict[str, str]] = {"most": "max_planes"}

    flat: bool = Field(False, description="also offer a plane of constant disparity for every segment")
    min_size: int = Field(
        100, ge=3, le=10**6, description="size of the smallest segment that contributes a plane, pixels"
    )
    min_trusted: float = Field(0.5, ge=0, le=1, description="share of trusted pixels that a segment with a plane needs")
    same_slope: float = Field(0.01, ge=0, le=16, description="largest difference in slope of duplicate planes")
    same_offset: float = Field(
        0.25, ge=0, le=16384, description="largest difference at the center of duplicate planes, pixels"
    )
    max_planes: int = Field(
        400, ge=1, le=5000, description="largest number of planes, the best supported ones are kept"
    )

    def of_segments(self, segments: SegmentedImage) -> SegmentPlanes | None:
        """Return the planes of segments that are large and trusted enough; None if no pixel is trusted."""
        sizes, trusted, values = segments.graph.sizes, segments.trusted.sizes, segments.first.values
        chosen = np.flatnonzero((sizes > self.min_size) & (trusted >= np.maximum(self.min_trusted * sizes, 3)))
        if len(chosen) == 0:
            # One flat plane for all trusted pixels.
            if not segments.first.trusted.any():
                return None
            everything = RegionPixels.of(np.zeros_like(segments.labels), segments.first.trusted, 1)
            return self.constant(values, everything, np.zeros(1, np.int64))
        own = self(values, segments.trusted, chosen)
        return SegmentPlanes.joined(own, self.constant(values, segments.trusted, chosen)) if self.flat else own


@dataclass(frozen=True)
class Assignment:
    """The plane of every segment: ``labels`` (n,) int32, indices in ``planes``, and their energy."""

    planes: SegmentPlanes
    labels: NDArray[np.int32]
    energy_before: float  # where every segment has its cheapest plane
    energy: float


def assign(
    segments: SegmentedImage,
    volume: CostVolume,
    candidates: PlaneCandidates,
    energy: Energy,
    rounds: int,
    sweeps: int,
    clock: Clock,
) -> Assignment | None:
    """Return the planes of all segments that minimize the energy (thesis, eq. 2.8); None if no pixel is trusted.

    Before each of the ``rounds`` of assignments but the first, planes are fitted again to groups that share one. The
    last makes at most ``sweeps`` passes over all planes, the others half as many, at most two.
    """
    clock.start("planes")
    own_planes = candidates.of_segments(segments)
    if own_planes is None:
        return None
    limits = candidates.same_slope, candidates.same_offset, candidates.max_planes
    edges, weights = segments.graph.edges, energy.smoothness * energy.boundary(segments.graph)
    planes, _ = own_planes.distinct(*limits)
    initial: NDArray[np.int32] | None = None
    for k in range(rounds):
        if initial is not None:
            clock.start("planes")
            same = initial[edges[:, 0]] == initial[edges[:, 1]]
            groups = joined_regions(len(initial), edges[same])
            members = RegionPixels.of(groups[segments.labels], segments.first.trusted, int(groups.max()) + 1)
            large = np.flatnonzero(members.sizes >= _MIN_GROUP_SIZE)
            group_planes = candidates(segments.first.values, members, large)
            planes, representative = SegmentPlanes.joined(group_planes, own_planes).distinct(*limits)
            initial = np.full(len(members.sizes), -1, np.int32)
            initial[large] = representative[: len(large)]
            initial = initial[groups]
        clock.start("data_term")
        unary = energy(segments, volume, planes)
        cheapest = np.argmin(unary, axis=1).astype(np.int32)
        initial = cheapest if initial is None else np.where(initial < 0, cheapest, initial)
        clock.start("expansion")
        n_sweeps = sweeps if k + 1 == rounds else min(max(sweeps // 2, 1), 2)
        initial, lowest = alpha_expansion(unary, edges, weights, initial, max_sweeps=n_sweeps)
    assert initial is not None
    return Assignment(planes, initial, potts_energy(cheapest, unary, edges, weights), lowest)


class Energy(ConfigModel):
    """Costs of planes in segments, and of different planes in neighboring segments."""

    renamed: ClassVar[dict[str, str]] = {"color_scale": "boundary.color_scale"}

    data_term: Annotated[
        Literal["dedc", "matching_cost"],
        BeforeValidator(lambda name: name.lower() if isinstance(name, str) else name),
    ] = Field(
        "dedc", description="cost of a plane: dedc (distance from the first disparities) or matching_cost (of pixels)"
    )
    data_weight: float = Field(10.0, ge=0, le=1e6, description="weight of the dedc data term (thesis, eq. 2.9: lambda)")
    truncation: float | None = Field(
        None, gt=0, le=16384, description="limit of a pixel's difference in dedc, pixels; null: none"
    )
    cost_weight: float = Field(10.0, ge=0, le=1e6, description="weight of the matching_cost data term")
    cost_agreement: bool = Field(
        False, description="also multiply matching costs by exp(-n / m) (thesis, eq. 2.9), as dedc is"
    )
    visibility: float = Field(
        0.0, ge=0, le=1e6, description="cost per untrusted pixel in front of the right view's surface"
    )
    smoothness: float = Field(25.0, ge=0, le=1e6, description="cost of a boundary per pixel (thesis, eq. 2.12: w)")
    boundary: Boundary = Field(
        default_factory=Gaussian, description="cost of a boundary by length and colors, times smoothness"
    )

    def __call__(self, segments: SegmentedImage, volume: CostVolume, planes: SegmentPlanes) -> NDArray[np.float64]:
        """Return the cost of every plane in every segment, (n, L) float64."""
        first, coefficients = segments.first, planes.coefficients
        width = segments.labels.shape[1]
        unary = np.zeros((segments.graph.sizes.size, len(coefficients)))
        run_bands(out_of_range, _TASKS, unary, width, *segments.everything, coefficients, segments.max_disparity)
        if self.data_term == "dedc":
            limits = self.data_weight, min(1e6 if self.truncation is None else self.truncation, 1e6)
            weights = np.ones((1, 1), np.float32) if first.weights is None else first.weights
            run_bands(discrepancy, _TASKS, unary, first.values, weights, *segments.trusted, coefficients, *limits)
        else:
            weight = self.cost_weight / volume.scale
            values = first.values if self.cost_agreement else np.empty((0, 0), np.float32)
            run_bands(matching_cost, _TASKS, unary, volume.costs, values, *segments.trusted, coefficients, weight)
        if self.visibility:
            limits_there = np.full((first.right.shape[0], width + 2), np.inf, np.float32)  # a column beyond each side
            limits_there[:, 1:-1] = first.right.astype(np.float32) + np.float32(1)
            run_bands(visibility, _TASKS, unary, limits_there, *segments.untrusted, coefficients, self.visibility)
        return unary


# The terms: costs of L planes, ``coefficients`` (L, 3), in n segments, (n, L) float64, which are added to ``unary``.
# The pixels of segment t are ``order[starts[t] : starts[t + 1]]``, as in RegionPixels.


@helper
def _coordinates(pixels, width):
    x, y = empty(pixels.size, np.float32), empty(pixels.size, np.float32)
    for i in range(pixels.size):
        x[i], y[i] = np.float32(pixels[i] % width), np.float32(pixels[i] // width)
    return x, y


@jit
def discrepancy(begin, end, unary, values, weights, order, starts, coefficients, weight, truncation):
    """Add the disparity estimate discrepancy cost (thesis, eq. 2.9), of trusted pixels.

    ``sum of weight |d_plane - d| exp(-n / m)`` over the segment's m pixels, n of which have the plane's disparity (to
    the nearest pixel). In a segment without pixels every plane costs 0. Differences above ``truncation`` count as it.
    A pixel counts as much as its ``weights`` (H, W), in the sum, n and m; (1, 1) holds the weight of all.
    """
    for task in range(begin, end):
        for t in range(task, unary.shape[0], _TASKS):
            pixels = order[starts[t] : starts[t + 1]]
            m = pixels.size
            if m == 0:
                continue
            px, py = _coordinates(pixels, values.shape[1])
            pd, pw = empty(m, np.float32), np.full(m, weights[0, 0])
            for i in range(m):
                y, x = pixels[i] // values.shape[1], pixels[i] % values.shape[1]
                pd[i] = values[y, x]
                if weights.size > 1:
                    pw[i] = weights[y, x]
            whole = np.sum(pw)
            max_difference = np.float32(truncation)
            half = np.float32(0.5)
            for label in range(coefficients.shape[0]):
                a = np.float32(coefficients[label, 0])
                b = np.float32(coefficients[label, 1])
                c = np.float32(coefficients[label, 2])
                total = np.float32(0.0)
                n = np.float32(0.0)
                for i in range(m):
                    difference = abs(a * px[i] + b * py[i] + c - pd[i])
                    n += pw[i] * np.float32(difference <= half)
                    total += pw[i] * min(difference, max_difference)
                unary[t, label] += weight * total * (np.exp(-np.float64(n) / whole) if n else 1.0)  # most planes: none


@jit
def matching_cost(begin, end, unary, costs, values, order, starts, coefficients, weight):
    """Add the (H, W, D) matching costs of trusted pixels at every plane's disparity, rounded and limited, weighted.

    With first disparities ``values`` (H, W), or (0, 0) for none, they are multiplied by ``exp(-n / m)``, as in
    :func:`discrepancy`.
    """
    _, width, n_disparities = costs.shape
    half = np.float32(0.5)
    for task in range(begin, end):
        total, agreeing = empty(coefficients.shape[0], np.float64), empty(coefficients.shape[0], np.int32)
        for t in range(task, unary.shape[0], _TASKS):
            total[:], agreeing[:] = 0, 0
            for i in range(starts[t], starts[t + 1]):
                x = order[i] % width
                y = order[i] // width
                row = costs[y, x]
                for label in range(total.size):
                    a, b, c = coefficients[label, 0], coefficients[label, 1], coefficients[label, 2]
                    d = min(max(int(np.floor(a * x + b * y + c + 0.5)), 0), n_disparities - 1)
                    total[label] += row[d]
                if values.size:
                    for label in range(total.size):
                        a = np.float32(coefficients[label, 0])
                        b = np.float32(coefficients[label, 1])
                        c = np.float32(coefficients[label, 2])
                        difference = abs(a * np.float32(x) + b * np.float32(y) + c - values[y, x])
                        agreeing[label] += np.int32(difference <= half)
            for label in range(total.size):
                share = agreeing[label] / max(starts[t + 1] - starts[t], 1)
                unary[t, label] += weight * total[label] * np.exp(-share)


@jit
def visibility(begin, end, unary, limits, order, starts, coefficients, weight):
    """Add the cost of planes that put untrusted pixels in front of the right view's surface.

    A pixel that failed the left-right check is occluded or mismatched. If the plane's disparity exceeds
    ``limits`` (H, W + 2), the right view's disparity at the match plus one pixel, the right view would see the pixel
    and would have matched it. Every such pixel costs ``weight``. A match outside the right image costs nothing.
    """
    width = limits.shape[1] - 2
    a, b, c = coefficients[:, 0].copy(), coefficients[:, 1].copy(), coefficients[:, 2].copy()
    for task in range(begin, end):
        count = empty(a.size, np.int32)
        for t in range(task, unary.shape[0], _TASKS):
            count[:] = 0
            for i in range(starts[t], starts[t + 1]):
                px, py = float(order[i] % width), float(order[i] // width)
                row = limits[order[i] // width]
                for k in range(a.size):
                    d = a[k] * px + b[k] * py + c[k]
                    target = np.uint32(min(max(np.floor(px - d + 0.5), -1.0), float(width)) + 1.0)  # vector code
                    count[k] += np.int32(d > row[target])
            for k in range(a.size):
                unary[t, k] += weight * count[k]


@jit
def out_of_range(begin, end, unary, width, order, starts, coefficients, max_disparity):
    """Set a prohibitive cost for planes that leave [0, ``max_disparity``] by more than a pixel in a segment."""
    lowest, highest = np.float32(-1), np.float32(max_disparity + 1)
    near_lowest, near_highest = np.float32(-0.99), np.float32(max_disparity + 0.99)
    planes = coefficients.astype(np.float32)
    a, b, c = planes[:, 0].copy(), planes[:, 1].copy(), planes[:, 2].copy()
    for task in range(begin, end):
        leaves = empty(a.size, np.uint8)
        for t in range(task, unary.shape[0], _TASKS):
            x, y = _coordinates(order[starts[t] : starts[t + 1]], width)
            x0, x1 = np.float32(width), np.float32(0)
            for i in range(x.size):
                x0, x1 = min(x0, x[i]), max(x1, x[i])
            y0, y1 = (y[0], y[x.size - 1]) if x.size else (np.float32(0), np.float32(0))
            # Most planes stay inside at all corners of the segment's box, and then everywhere in it.
            for k in range(a.size):
                low = c[k] + min(a[k] * x0, a[k] * x1) + min(b[k] * y0, b[k] * y1)
                high = c[k] + max(a[k] * x0, a[k] * x1) + max(b[k] * y0, b[k] * y1)
                leaves[k] = (low < near_lowest) | (high > near_highest)
            for label in np.flatnonzero(leaves):
                outside = np.int32(0)
                for i in range(x.size):
                    d = a[label] * x[i] + b[label] * y[i] + c[label]
                    outside += np.int32((d < lowest) | (d > highest))
                unary[t, label] = 1000.0 * outside

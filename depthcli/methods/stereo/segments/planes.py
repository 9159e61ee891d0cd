"""Assignment of a plane to every segment: candidates, data and smoothness terms (thesis, eq. 2.8-2.12), graph cuts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from depthcli.algorithms.graph_cut import alpha_expansion, potts_energy
from depthcli.algorithms.plane_fitting.segment_planes import SegmentPlaneFit, SegmentPlanes
from depthcli.algorithms.regions import RegionGraph, RegionPixels, joined_regions
from depthcli.core.method import ConfigModel
from depthcli.core.result import Clock
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.stereo.segments.first_estimate import SegmentedImage
from depthcli.methods.stereo.volume import CostVolume

_MIN_GROUP_SIZE = 30  # trusted pixels of connected segments that a plane is fitted to again; choice of this program


class PlaneCandidates(SegmentPlaneFit):
    """Fit the planes that segments may lie on, and drop near-duplicates."""

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
        """Return the planes of segments that are large and trusted enough; None where no pixel is trusted."""
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
    """Return the planes of all segments that minimize the energy (thesis, eq. 2.8); None where no pixel is trusted.

    Before each of the ``rounds`` of assignments but the first, planes are fitted again to groups that share one. The
    last makes at most ``sweeps`` passes over all planes, the others half as many, at most two.
    """
    clock.start("planes")
    own_planes = candidates.of_segments(segments)
    if own_planes is None:
        return None
    limits = candidates.same_slope, candidates.same_offset, candidates.max_planes
    weights = smoothness(segments.graph, energy.smoothness, energy.color_scale)
    planes, _ = own_planes.distinct(*limits)
    initial: NDArray[np.int32] | None = None
    for k in range(rounds):
        if initial is not None:
            clock.start("planes")
            group_planes, group = _regrouped(segments, initial, candidates)
            planes, representative = SegmentPlanes.joined(group_planes, own_planes).distinct(*limits)
            initial = np.where(group >= 0, representative[group], -1).astype(np.int32)
        clock.start("data_term")
        unary = energy(segments, volume, planes)
        cheapest = np.argmin(unary, axis=1).astype(np.int32)
        initial = cheapest if initial is None else np.where(initial < 0, cheapest, initial)
        clock.start("expansion")
        last = k + 1 == rounds
        labels, lowest = alpha_expansion(
            unary, segments.graph.edges, weights, initial, max_sweeps=sweeps if last else min(max(sweeps // 2, 1), 2)
        )
        initial = labels
    energy_before = potts_energy(cheapest, unary, segments.graph.edges, weights)
    return Assignment(planes, labels, energy_before, lowest)


def _regrouped(
    segments: SegmentedImage, labels: NDArray[np.int32], fit: SegmentPlaneFit
) -> tuple[SegmentPlanes, NDArray[np.int64]]:
    """Return planes fitted to groups of connected segments that share a label, and the index of every segment's.

    The index is -1 where the group is too small for a plane.
    """
    edges = segments.graph.edges
    same = labels[edges[:, 0]] == labels[edges[:, 1]]
    groups = joined_regions(len(labels), edges[same])
    members = RegionPixels.of(groups[segments.labels], segments.first.trusted, int(groups.max()) + 1)
    chosen = np.flatnonzero(members.sizes >= _MIN_GROUP_SIZE)
    index = np.full(len(members.sizes), -1, np.int64)
    index[chosen] = np.arange(len(chosen))
    return fit(segments.first.values, members, chosen), index[groups]


class Energy(ConfigModel):
    """Costs of planes in segments, and of different planes in neighboring segments."""

    data_term: Annotated[
        Literal["dedc", "matching_cost"],
        BeforeValidator(lambda name: name.lower() if isinstance(name, str) else name),
    ] = Field("dedc", description="cost of a plane: dedc (distance from the first disparities) or matching_cost")
    data_weight: float = Field(10.0, ge=0, le=1e6, description="weight of the dedc data term (thesis, eq. 2.9: lambda)")
    truncation: float | None = Field(
        None, gt=0, le=16384, description="limit of a pixel's difference in dedc, pixels; null: none"
    )
    cost_weight: float = Field(10.0, ge=0, le=1e6, description="weight of the matching_cost data term")
    visibility: float = Field(
        0.0, ge=0, le=1e6, description="cost per untrusted pixel in front of the right view's surface"
    )
    smoothness: float = Field(25.0, ge=0, le=1e6, description="cost of a boundary per pixel (thesis, eq. 2.12: w)")
    color_scale: float = Field(
        150.0, gt=0, le=1e6, description="color scale of smoothness (thesis, eq. 2.12: sigma), grey levels"
    )

    def __call__(self, segments: SegmentedImage, volume: CostVolume, planes: SegmentPlanes) -> NDArray[np.float64]:
        """Return the cost of every plane in every segment, (n, L) float64."""
        unary = out_of_range(segments.everything, segments.labels.shape[1], planes, segments.max_disparity)
        if self.data_term == "dedc":
            truncation = np.inf if self.truncation is None else self.truncation
            unary += discrepancy(segments.first.values, segments.trusted, planes, self.data_weight, truncation)
        else:
            unary += matching_cost(volume, segments.trusted, planes, self.cost_weight)
        if self.visibility:
            unary += visibility(segments.first.right, segments.untrusted, planes, self.visibility)
        return unary


def discrepancy(
    values: NDArray[np.float32], trusted: RegionPixels, planes: SegmentPlanes, weight: float, truncation: float
) -> NDArray[np.float64]:
    """Compute the disparity estimate discrepancy cost (thesis, eq. 2.9) of planes in segments, (n, L) float64.

    ``sum of weight |d_plane - d| exp(-n / m)`` over the segment's m trusted pixels, n of which have the
    plane's disparity (to the nearest pixel). In a segment without trusted pixels every plane costs 0. Differences above
    ``truncation`` count as much as it; inf: the sum as defined.
    """
    unary = np.zeros((len(trusted.starts) - 1, len(planes)))
    segments = trusted.order, trusted.starts
    _discrepancy(values.ravel(), values.shape[1], *segments, planes.coefficients, weight, min(truncation, 1e6), unary)
    return unary


@parallel_jit
def _discrepancy(values, width, order, starts, coefficients, weight, truncation, unary):
    for t in prange(unary.shape[0]):
        first = starts[t]
        m = starts[t + 1] - first
        if m == 0:
            continue
        px = np.empty(m, np.float32)
        py = np.empty(m, np.float32)
        pd = np.empty(m, np.float32)
        for i in range(m):
            pixel = order[first + i]
            px[i] = pixel % width
            py[i] = pixel // width
            pd[i] = values[pixel]
        max_difference = np.float32(truncation)
        half = np.float32(0.5)
        for label in range(coefficients.shape[0]):
            a = np.float32(coefficients[label, 0])
            b = np.float32(coefficients[label, 1])
            c = np.float32(coefficients[label, 2])
            total = np.float32(0.0)
            n = np.int32(0)
            for i in range(m):
                difference = abs(a * px[i] + b * py[i] + c - pd[i])
                n += np.int32(difference <= half)
                total += min(difference, max_difference)
            unary[t, label] = weight * total * np.exp(-n / m)


def matching_cost(
    volume: CostVolume, trusted: RegionPixels, planes: SegmentPlanes, weight: float
) -> NDArray[np.float64]:
    """Sum the matching costs of a segment's trusted pixels at every plane's disparity; (n, L) float64.

    Disparities are rounded and limited to the volume's. The sum is in units of the measure, times ``weight``.
    """
    unary = np.zeros((len(trusted.starts) - 1, len(planes)))
    width = volume.costs.shape[1]
    costs = volume.costs.reshape(-1, volume.n_disparities)
    _matching_cost(costs, width, trusted.order, trusted.starts, planes.coefficients, weight / volume.scale, unary)
    return unary


@parallel_jit
def _matching_cost(costs, width, order, starts, coefficients, weight, unary):
    n_disparities = costs.shape[1]
    for t in prange(unary.shape[0]):
        for i in range(starts[t], starts[t + 1]):
            pixel = order[i]
            x = pixel % width
            y = pixel // width
            row = costs[pixel]
            for label in range(coefficients.shape[0]):
                a, b, c = coefficients[label, 0], coefficients[label, 1], coefficients[label, 2]
                d = min(max(int(np.floor(a * x + b * y + c + 0.5)), 0), n_disparities - 1)
                unary[t, label] += row[d]
        for label in range(coefficients.shape[0]):
            unary[t, label] *= weight


def visibility(
    right: NDArray[Any], untrusted: RegionPixels, planes: SegmentPlanes, weight: float
) -> NDArray[np.float64]:
    """Compute the cost of planes that put pixels in front of the right view's surface; (n, L) float64.

    A pixel that failed the left-right check is occluded or mismatched. With a disparity more than a pixel above that
    of the right view at its match it would be visible there, and the right view would have matched it: every such pixel
    costs ``weight``. A match outside the right image costs nothing.
    """
    unary = np.zeros((len(untrusted.starts) - 1, len(planes)))
    _visibility(right, untrusted.order, untrusted.starts, planes.coefficients, weight, unary)
    return unary


@parallel_jit
def _visibility(right, order, starts, coefficients, weight, unary):
    width = right.shape[1]
    for t in prange(unary.shape[0]):
        for i in range(starts[t], starts[t + 1]):
            x = order[i] % width
            y = order[i] // width
            for label in range(coefficients.shape[0]):
                d = coefficients[label, 0] * x + coefficients[label, 1] * y + coefficients[label, 2]
                target = int(np.floor(x - d + 0.5))
                if 0 <= target < width and d > right[y, target] + 1.0:
                    unary[t, label] += weight


def out_of_range(
    everything: RegionPixels, width: int, planes: SegmentPlanes, max_disparity: float
) -> NDArray[np.float64]:
    """Compute the prohibitive cost of planes that leave [0, ``max_disparity``] by more than a pixel; (n, L) float64."""
    unary = np.zeros((len(everything.starts) - 1, len(planes)))
    _out_of_range(everything.order, everything.starts, width, planes.coefficients, max_disparity, unary)
    return unary


@parallel_jit
def _out_of_range(order, starts, width, coefficients, max_disparity, unary):
    lowest, highest = np.float32(-1), np.float32(max_disparity + 1)
    for t in prange(unary.shape[0]):
        count = starts[t + 1] - starts[t]
        x, y = np.empty(count, np.float32), np.empty(count, np.float32)
        for i in range(count):
            pixel = order[starts[t] + i]
            x[i] = np.float32(pixel % width)
            y[i] = np.float32(pixel // width)
        x0, x1 = np.float32(width), np.float32(0)
        for i in range(count):
            x0, x1 = min(x0, x[i]), max(x1, x[i])
        y0, y1 = (y[0], y[count - 1]) if count else (np.float32(0), np.float32(0))
        for label in range(coefficients.shape[0]):
            a = np.float32(coefficients[label, 0])
            b = np.float32(coefficients[label, 1])
            c = np.float32(coefficients[label, 2])
            # Most planes stay inside at all corners of the segment's box, and then everywhere in it.
            low = c + min(a * x0, a * x1) + min(b * y0, b * y1)
            high = c + max(a * x0, a * x1) + max(b * y0, b * y1)
            if low >= -0.99 and high <= max_disparity + 0.99:
                continue
            outside = np.int32(0)
            for i in range(count):
                d = a * x[i] + b * y[i] + c
                outside += np.int32((d < lowest) | (d > highest))
            unary[t, label] = 1000.0 * outside


def smoothness(graph: RegionGraph, weight: float, color_scale: float) -> NDArray[np.float64]:
    """Compute the cost of different planes in neighboring segments (thesis, eq. 2.12), (E,) float64.

    ``w beta exp(-tau^2 / sigma^2)``, where beta is the length of the common boundary in pixels, tau the distance of
    the mean colors.
    """
    first, second = graph.edges.T
    distance = np.square(graph.means[first] - graph.means[second]).sum(axis=1)
    strength: NDArray[np.float64] = weight * graph.boundary * np.exp(-distance / color_scale**2)
    return strength

"""Segment-based stereo with key points and graph cuts (thesis chapter 2)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, SerializeAsAny

from depthcli.core.frames import StereoPair
from depthcli.core.method import Family
from depthcli.core.result import Clock
from depthcli.keypoints import Detector
from depthcli.keypoints._matching import Matches, consistent, match_rectified
from depthcli.labelling.graph_cut import alpha_expansion
from depthcli.labelling.regions import region_graph
from depthcli.segmentation import Segmentation
from depthcli.segmentation.mean_shift import MeanShift
from depthcli.stereo.cost import Cost
from depthcli.stereo.optimization import Optimization
from depthcli.stereo.optimization.winner_takes_all import WinnerTakesAll
from depthcli.stereo.pipeline import StereoPipeline
from depthcli.stereo.refinement import RefinementStep
from depthcli.stereo.segments import energy, report
from depthcli.stereo.segments.assignment import Assignment, Scene, regrouped
from depthcli.stereo.segments.first_estimate import (
    discourage_outside,
    search_ranges,
    search_zones,
    segment_window,
    select,
    tells_anything,
)
from depthcli.stereo.segments.planes import Members, PlaneFit, Planes, distinct, evaluate
from depthcli.stereo.segments.splitting import split_segments
from depthcli.stereo.volume import CostVolume, Evidence, StereoResult


def _detector_or_none(value: Any) -> Any:
    return None if value is None or value == "none" else Family.of("depthcli.keypoints").parse(value)


class Segments(StereoPipeline):
    """Every segment of the left image is a plane; which plane is decided for all segments at once.

    Beyond the thesis, and why: an optimizer between window and selection and disparities that are trusted more
    often; segments that are not one plane are cut along a grid (curved things); planes are fitted again
    to groups of segments that share one (``rounds``); what occluded pixels could not be hiding behind costs
    (``visibility``). The defaults switch these off; the presets say what they use.
    """

    segmentation: Segmentation = Field(
        default_factory=MeanShift, description="how the left image is cut into segments; too many are fine"
    )
    keypoints: Annotated[Detector | None, BeforeValidator(_detector_or_none), SerializeAsAny()] = Field(
        None, description="surf, sift or none: matched key points limit the disparities of their segment"
    )
    range_margin: float = Field(
        0.25,
        ge=0,
        le=1,
        description="alpha (eq. 2.5): key-point ranges grow by this part of the whole range, each side",
    )
    range_neighbors: int = Field(
        0,
        ge=0,
        le=1000,
        description="a segment's range also covers this many key points nearest to it; 0: only its own",
    )
    range_reach: float = Field(40.0, gt=0, description="where they are not all this near, they do not count, pixels")
    range_cell: int = Field(
        0, ge=0, le=4096, description="larger segments have a range for each cell of a grid this wide, pixels; 0: one"
    )
    range_penalty: float = Field(
        100.0, ge=0, description="disparities outside the range cost this much more, in units of the cost"
    )
    cost: Cost = Field(description="matching cost of two pixels")
    window_radius: int = Field(
        4,
        ge=0,
        le=20,
        description="half side of the window whose pixels in the own segment are averaged, pixels; 0: none",
    )
    optimization: Optimization = Field(
        default_factory=WinnerTakesAll,
        description="smoothness over the image before the selection, or winner_takes_all",
    )
    check_tolerance: float = Field(
        1.0, ge=0, description="a pixel is trusted where left and right view differ by at most this, pixels"
    )
    subpixel: bool = Field(False, description="first disparities to a fraction of a pixel, by a parabola")
    split_cells: tuple[Annotated[int, Field(ge=4, le=512)], ...] = Field(
        (), description="cut segments that are not one plane along grids of these cell sizes, in turn, pixels"
    )
    split_tolerance: float = Field(1.0, gt=0, description="distance from the plane that contradicts it, pixels")
    split_misfits: float = Field(
        0.1, ge=0, le=1, description="a segment is cut where a larger part of its trusted pixels contradicts its plane"
    )
    min_plane_size: int = Field(100, ge=3, description="smaller segments contribute no plane, pixels")
    min_trusted: float = Field(
        0.5, ge=0, le=1, description="segments with a smaller part of trusted pixels contribute no plane"
    )
    plane_tolerance: float = Field(0.5, gt=0, description="distance of a RANSAC inlier from the plane, pixels")
    plane_trials: int = Field(200, ge=1, le=100_000, description="RANSAC samples a segment")
    max_slope: float = Field(1.0, ge=0, description="steepest plane, pixels of disparity a pixel")
    flatness: float = Field(
        1.0,
        ge=0,
        le=1,
        description="a sloping plane must bring the misfit below this part of a flat one's; 1: no demand",
    )
    flat_planes: bool = Field(False, description="offer the flat plane of every segment beside the sloping one")
    slope_tolerance: float = Field(0.01, ge=0, description="planes this similar in slope may be duplicates")
    offset_tolerance: float = Field(0.25, ge=0, description="planes this similar at their center too are, pixels")
    max_planes: int = Field(400, ge=1, le=5000, description="planes kept, the best supported ones")
    data_term: Literal["dedc", "matching_cost"] = Field(
        "dedc", description="what a plane costs in a segment: distance from the first disparities, or matching cost"
    )
    data_weight: float = Field(10.0, ge=0, description="lambda (eq. 2.9), weight of the dedc data term")
    truncation: float | None = Field(
        None, gt=0, description="largest distance from a first disparity that counts, pixels; null: no limit"
    )
    cost_weight: float = Field(10.0, ge=0, description="weight of the matching_cost data term")
    visibility_weight: float = Field(
        0.0, ge=0, description="cost of a pixel not trusted that a plane puts in front of what the right view sees"
    )
    smoothness: float = Field(25.0, ge=0, description="w (eq. 2.12): cost of a pixel of boundary between two planes")
    color_scale: float = Field(
        150.0, gt=0, description="sigma (eq. 2.12): difference of mean colors that makes boundaries cheap, grey levels"
    )
    rounds: int = Field(1, ge=1, le=10, description="assignments; before each but the first, planes are fitted again")
    refinement: tuple[RefinementStep, ...] = Field((), description="steps on the finished map, in order")
    details: bool = Field(False, description="also write segments, key points, planes and labels")
    seed: int = Field(0, ge=0, le=2**31 - 1, description="of the RANSAC samples")

    def __call__(self, pair: StereoPair, max_disparity: int) -> StereoResult:
        clock = Clock()
        image = pair.color8[0]
        labels = self.segmentation(image)
        clock.stop("segmentation")
        matches = self._matches(pair, max_disparity)
        clock.stop("keypoints")
        raw = self.cost(pair, max_disparity + 1)
        clock.stop("cost")
        informative = tells_anything(raw)
        volume = segment_window(raw, labels, self.window_radius) if self.window_radius else raw
        clock.stop("window")
        zones = search_zones(labels, self.range_cell) if self.range_cell else labels
        ranges = search_ranges(zones, matches, max_disparity, self.range_margin, self.range_neighbors, self.range_reach)
        if matches is not None:
            volume = discourage_outside(volume, zones, ranges, self.range_penalty)
        optimized = self.optimization(volume, pair)
        first = select(optimized, self.check_tolerance, self.subpixel)
        clock.stop("first_estimate")
        fit = PlaneFit(self.plane_tolerance, self.plane_trials, self.max_slope, self.flatness, self.seed)
        if self.split_cells:
            labels = split_segments(
                labels, first.values, first.trusted, self.split_tolerance, self.split_misfits, self.split_cells, fit
            )
        clock.stop("splitting")
        scene = Scene.of(labels, first, region_graph(labels, image), max_disparity)
        # On a flat image an optimizer would still carry the borders' costs everywhere.
        assignment = self._assign(scene, volume, fit, clock) if informative else None
        if assignment is None:
            disparity = report.nothing_known(labels.shape)
        else:
            disparity = report.finished(
                evaluate(assignment.planes.coefficients, assignment.labels[labels], max_disparity), first
            )
        evidence = Evidence(pair, optimized, first.right)
        for step in self.refinement:
            disparity = step(disparity, evidence)
        clock.stop("refinement")
        result = StereoResult(disparity, figures=report.figures(scene, assignment, matches))
        if self.details:
            result.tables = report.tables(scene, assignment, matches, report.by_segment(labels, zones, ranges))
            result.pictures = report.pictures(pair, labels, matches)
            clock.stop("details")
        result.seconds = clock.seconds
        return result

    def _matches(self, pair: StereoPair, max_disparity: int) -> Matches | None:
        if self.keypoints is None:
            return None
        left, right = pair.grey8
        return consistent(match_rectified(self.keypoints(left), self.keypoints(right), max_disparity))

    def _assign(self, scene: Scene, volume: CostVolume, fit: PlaneFit, clock: Clock) -> Assignment | None:
        """Planes and their labels; None where nothing is trusted."""
        own = self._own_planes(scene, fit)
        if own is None:
            return None
        clock.stop("planes")
        weights = energy.smoothness(scene.graph, self.smoothness, self.color_scale)
        planes, _ = distinct(own, self.slope_tolerance, self.offset_tolerance, self.max_planes)
        initial: NDArray[np.int32] | None = None
        for turn in range(self.rounds):
            if initial is not None:
                again, group = regrouped(scene, initial, fit)
                planes, stands_for = distinct(
                    Planes.joined(again, own), self.slope_tolerance, self.offset_tolerance, self.max_planes
                )
                initial = np.where(group >= 0, stands_for[group], -1).astype(np.int32)
                clock.stop("planes")
            unary = self._unary(scene, volume, planes)
            cheapest = np.argmin(unary, axis=1).astype(np.int32)
            initial = cheapest if initial is None else np.where(initial < 0, cheapest, initial)
            clock.stop("data_term")
            last = turn + 1 == self.rounds
            solved = alpha_expansion(unary, scene.graph.edges, weights, initial, max_sweeps=20 if last else 2)
            initial = solved.labels
            clock.stop("expansion")
        before = report.energy_of(cheapest, unary, scene, weights)
        return Assignment(planes, solved.labels, before, solved.energy)

    def _own_planes(self, scene: Scene, fit: PlaneFit) -> Planes | None:
        sizes = scene.graph.sizes
        trusted = scene.trusted.sizes
        chosen = np.flatnonzero((sizes > self.min_plane_size) & (trusted >= np.maximum(self.min_trusted * sizes, 3)))
        values = scene.first.values
        if len(chosen) == 0:
            # No segment is large and sure enough: one flat plane for everything that is trusted.
            if not scene.first.trusted.any():
                return None
            everything = Members.of(np.zeros_like(scene.labels), scene.first.trusted, 1)
            return fit.flat(values, everything, np.zeros(1, np.int64))
        own = fit(values, scene.trusted, chosen)
        return Planes.joined(own, fit.flat(values, scene.trusted, chosen)) if self.flat_planes else own

    def _unary(self, scene: Scene, volume: CostVolume, planes: Planes) -> NDArray[np.float64]:
        unary = energy.out_of_range(scene.everything, scene.width, planes, scene.max_disparity)
        if self.data_term == "dedc":
            most = np.inf if self.truncation is None else self.truncation
            unary += energy.discrepancy(scene.first.values, scene.trusted, planes, self.data_weight, most)
        else:
            unary += energy.matching_cost(volume, scene.trusted, planes, self.cost_weight)
        if self.visibility_weight:
            unary += energy.visibility(scene.first.right, scene.untrusted, planes, self.visibility_weight)
        return unary

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Raw costs (1 byte a cell), the window's means and two sums of path costs (2 bytes each)."""
        pixels = shape[0] * shape[1]
        bytes_a_cell = 1 + (2 if self.window_radius else 0)
        bytes_a_cell += 0 if isinstance(self.optimization, WinnerTakesAll) else 4
        return pixels * (max_disparity + 1) * max(bytes_a_cell, 3) + 300 * pixels + (64 << 20)

"""Data flow of the segment-based pipeline, from a cost volume to a disparity map."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from depthcli.algorithms.keypoints import Detection
from depthcli.algorithms.regions import region_graph
from depthcli.algorithms.segmentation import Segmentation
from depthcli.algorithms.segmentation.mean_shift import MeanShift
from depthcli.core.frames import StereoPair
from depthcli.core.result import Clock
from depthcli.methods.stereo.keypoint_matching import Matches, consistent, match_rectified
from depthcli.methods.stereo.optimization import Optimization
from depthcli.methods.stereo.optimization.winner_takes_all import WinnerTakesAll
from depthcli.methods.stereo.refinement import RefinementStep
from depthcli.methods.stereo.segments import Step, outputs
from depthcli.methods.stereo.segments.assignment import PlaneCandidates, assign
from depthcli.methods.stereo.segments.energy import Energy
from depthcli.methods.stereo.segments.first_estimate import Selection, has_information, segment_window
from depthcli.methods.stereo.segments.ranges import Ranges
from depthcli.methods.stereo.segments.segmented_image import SegmentedImage, Split
from depthcli.methods.stereo.stages import refined
from depthcli.methods.stereo.volume import CostVolume, RefinementContext, StereoResult


def _none(value: Any) -> Any:
    return None if isinstance(value, str) and value.lower() == "none" else value


class SegmentSteps(Step):
    """Explain every segment of the left image by a plane, chosen for all segments at once."""

    segmentation: Segmentation = Field(default_factory=MeanShift, description="segmentation of the left image")
    keypoints: Annotated[Detection | None, BeforeValidator(_none)] = Field(
        None, description="key points (surf, sift or none) whose matches limit the disparities of their segment"
    )
    window_radius: int = Field(4, ge=0, le=20, description="half side of the averaging window, pixels; 0: no averaging")
    ranges: Ranges = Field(default_factory=Ranges, description="search ranges of segments, from matched key points")
    optimization: Optimization = Field(
        default_factory=WinnerTakesAll, description="smoothness in the costs of the first disparities"
    )
    selection: Selection = Field(default_factory=Selection, description="how first disparities are taken and trusted")
    split: Split = Field(default_factory=Split, description="cuts of segments that are not planar")
    planes: PlaneCandidates = Field(default_factory=PlaneCandidates, description="the planes that segments may lie on")
    energy: Energy = Field(default_factory=Energy, description="energy that the assignment of planes minimizes")
    rounds: int = Field(1, ge=1, le=10, description="number of assignments; planes are fitted again in between")
    sweeps: int = Field(
        20, ge=1, le=1000, description="largest number of passes over all planes in the last assignment"
    )
    refinement: tuple[RefinementStep, ...] = Field((), description="refinement steps on the finished map, in order")
    details: bool = Field(False, description="also write segments, key points, planes and labels")

    def from_volume(self, pair: StereoPair, volume: CostVolume, max_disparity: int, clock: Clock) -> StereoResult:
        """Return the map of ``pair`` from its matching costs.

        Parameters
        ----------
        volume : (H, W, ``max_disparity`` + 1), not modified
        clock : receives the seconds of the stages
        """
        clock.start("segmentation")
        image = pair.color8[0]
        labels = self.segmentation(image)
        clock.start("keypoints")
        matches = self._matches(pair, max_disparity)
        clock.start("window")
        informative = has_information(volume)
        if self.window_radius:
            volume = segment_window(volume, labels, self.window_radius)
        clock.start("first_estimate")
        ranges = self.ranges(labels, matches, max_disparity)
        if matches is not None:
            volume = self.ranges.penalize(volume, ranges)
        optimized = self.optimization(volume, pair)
        first = self.selection(optimized)
        clock.start("splitting")
        labels = self.split(labels, first, self.planes)
        segments = SegmentedImage.of(labels, first, region_graph(labels, image), max_disparity)
        assignment = None
        if informative:  # in a uniform image an optimizer would still carry the costs of the borders everywhere
            assignment = assign(segments, volume, self.planes, self.energy, self.rounds, self.sweeps, clock)
        clock.start("refinement")
        if assignment is None:
            disparity = outputs.empty_map(labels.shape)
        else:
            values = assignment.planes.at(assignment.labels[labels], max_disparity)
            disparity = outputs.map_with_status(values, first)
        disparity = refined(disparity, self.refinement, RefinementContext(pair, optimized, first.right))
        result = StereoResult(disparity, figures=outputs.figures(segments, assignment, matches))
        if self.details:
            clock.start("details")
            result.tables = outputs.tables(segments, assignment, matches, ranges.by_segment(labels))
            result.pictures = outputs.pictures(pair, labels, matches)
        result.seconds = clock.seconds
        return result

    def _matches(self, pair: StereoPair, max_disparity: int) -> Matches | None:
        if self.keypoints is None:
            return None
        left, right = pair.grey8
        return consistent(match_rectified(self.keypoints(left), self.keypoints(right), max_disparity))

"""The data flow from a cost volume to planes, in order, on one page."""

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
from depthcli.methods.stereo.segments import Step, report
from depthcli.methods.stereo.segments.assignment import Candidates, assign
from depthcli.methods.stereo.segments.energy import Energy
from depthcli.methods.stereo.segments.first_estimate import Selection, segment_window, tells_anything
from depthcli.methods.stereo.segments.planes import evaluate
from depthcli.methods.stereo.segments.ranges import Ranges
from depthcli.methods.stereo.segments.scene import Scene
from depthcli.methods.stereo.segments.splitting import Split
from depthcli.methods.stereo.stages import refined
from depthcli.methods.stereo.volume import CostVolume, RefinementContext, StereoResult


def _none(value: Any) -> Any:
    return None if isinstance(value, str) and value.lower() == "none" else value


class SegmentSteps(Step):
    """Every segment of the left image is a plane; which plane is decided for all segments at once."""

    segmentation: Segmentation = Field(
        default_factory=MeanShift, description="how the left image is cut into segments; too many are fine"
    )
    keypoints: Annotated[Detection | None, BeforeValidator(_none)] = Field(
        None, description="surf, sift or none: matched key points limit the disparities of their segment"
    )
    window_radius: int = Field(
        4,
        ge=0,
        le=20,
        description="half side of the window whose pixels in the own segment are averaged, pixels; 0: none",
    )
    ranges: Ranges = Field(default_factory=Ranges, description="what key points say about the disparities")
    optimization: Optimization = Field(
        default_factory=WinnerTakesAll,
        description="smoothness over the image before the selection, or winner_takes_all",
    )
    selection: Selection = Field(default_factory=Selection, description="the first disparities")
    split: Split = Field(default_factory=Split, description="cuts of segments that are not one plane")
    planes: Candidates = Field(default_factory=Candidates, description="the planes that segments may lie on")
    energy: Energy = Field(default_factory=Energy, description="what the assignment of planes minimizes")
    rounds: int = Field(1, ge=1, le=10, description="assignments; before each but the first, planes are fitted again")
    sweeps: int = Field(20, ge=1, le=1000, description="passes over all planes that the last assignment makes at most")
    refinement: tuple[RefinementStep, ...] = Field((), description="steps on the finished map, in order")
    details: bool = Field(False, description="also write segments, key points, planes and labels")

    def from_volume(self, pair: StereoPair, volume: CostVolume, max_disparity: int, clock: Clock) -> StereoResult:
        """The map of ``pair`` from its matching costs.

        Parameters
        ----------
        volume : (H, W, ``max_disparity`` + 1), left as it is
        clock : runs since ``volume`` was begun
        """
        image = pair.color8[0]
        labels = self.segmentation(image)
        clock.stop("segmentation")
        matches = self._matches(pair, max_disparity)
        clock.stop("keypoints")
        informative = tells_anything(volume)
        if self.window_radius:
            volume = segment_window(volume, labels, self.window_radius)
        clock.stop("window")
        found = self.ranges(labels, matches, max_disparity)
        if matches is not None:
            volume = self.ranges.discourage(volume, found)
        optimized = self.optimization(volume, pair)
        first = self.selection(optimized)
        clock.stop("first_estimate")
        labels = self.split(labels, first, self.planes)
        clock.stop("splitting")
        scene = Scene.of(labels, first, region_graph(labels, image), max_disparity)
        # On a flat image an optimizer would still carry the borders' costs everywhere.
        assignment = (
            assign(scene, volume, self.planes, self.energy, self.rounds, self.sweeps, clock) if informative else None
        )
        if assignment is None:
            disparity = report.nothing_known(labels.shape)
        else:
            disparity = report.finished(
                evaluate(assignment.planes.coefficients, assignment.labels[labels], max_disparity), first
            )
        disparity = refined(disparity, self.refinement, RefinementContext(pair, optimized, first.right))
        clock.stop("refinement")
        result = StereoResult(disparity, figures=report.figures(scene, assignment, matches))
        if self.details:
            result.tables = report.tables(scene, assignment, matches, found.by_segment(labels))
            result.pictures = report.pictures(pair, labels, matches)
            clock.stop("details")
        result.seconds = clock.seconds
        return result

    def _matches(self, pair: StereoPair, max_disparity: int) -> Matches | None:
        if self.keypoints is None:
            return None
        left, right = pair.grey8
        return consistent(match_rectified(self.keypoints(left), self.keypoints(right), max_disparity))

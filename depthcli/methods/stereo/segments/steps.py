"""The segment-based pipeline, from a cost volume to a disparity map, with its tables and pictures."""

from __future__ import annotations

from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from depthcli.algorithms.keypoints import Detection
from depthcli.algorithms.regions import region_graph
from depthcli.algorithms.segmentation import Segmentation
from depthcli.algorithms.segmentation.mean_shift import MeanShift
from depthcli.core.context import Clock
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.method import ConfigModel
from depthcli.kernels.winners import right_at_match, winners
from depthcli.methods.stereo.keypoint_matching import KeyPointMatching, Matches
from depthcli.methods.stereo.optimization import Optimization
from depthcli.methods.stereo.optimization.winner_takes_all import WinnerTakesAll
from depthcli.methods.stereo.refinement import RefinementStep
from depthcli.methods.stereo.segments.first_estimate import (
    FirstEstimate,
    SegmentedImage,
    Selection,
    Split,
    has_information,
    segment_window,
)
from depthcli.methods.stereo.segments.planes import Assignment, Energy, PlaneCandidates, assign
from depthcli.methods.stereo.segments.ranges import Ranges
from depthcli.methods.stereo.stages import refined
from depthcli.methods.stereo.volume import CostVolume, RefinementContext, StereoResult

_STEP = 1.0  # pixels: an estimate further from the median of its 3 x 3 neighbors is noise


def _none(value: Any) -> Any:
    return None if isinstance(value, str) and value.lower() == "none" else value


class Restoration(ConfigModel):
    """Restore first disparities in areas where they are dense, smooth, and off the plane.

    A fold of cloth has one color, but needs more planes than its segments have. Its first disparities are trusted and
    smooth; on a bare wall they are neither. Narrow areas keep their plane: windows and scanlines widen objects, and
    the rims would come back.
    """

    radius: int = Field(
        0, ge=0, le=64, description="radius of the smallest disc that is restored, pixels; 0: nothing is restored"
    )
    difference: float = Field(
        1.0, gt=0, le=16384, description="distance from the plane above which a pixel is off the plane, pixels"
    )
    density: float = Field(0.9, ge=0, le=1, description="least share of trusted, smooth pixels in the window")
    window: int = Field(9, ge=1, le=129, description="side of the window, pixels")

    def __call__(self, values: NDArray[np.float32], first: FirstEstimate, volume: CostVolume) -> NDArray[np.float32]:
        """Return ``values`` (H, W), pixels, with first disparities where they are restored.

        ``volume`` is the one whose cheapest disparities are in ``first``; parabolas through its costs give fractions.
        """
        if self.radius == 0:
            return values
        fine = np.empty(values.shape, np.float32)
        whole = winners(volume.costs, fine)[0].astype(np.float32)
        sure = first.trusted & (np.abs(fine - cv2.medianBlur(whole, 3)) <= _STEP)
        size = (self.window, self.window)
        dense = cv2.blur(sure.astype(np.float32), size, borderType=cv2.BORDER_REFLECT) >= np.float32(
            self.density - 1e-6
        )
        off = np.abs(fine - values) > self.difference
        area = (dense & (off | ~sure)).astype(np.uint8)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * self.radius + 1, 2 * self.radius + 1))
        wide = cv2.morphologyEx(area, cv2.MORPH_OPEN, disc) != 0
        return np.where(wide & sure & off, fine, values)


class SegmentSteps(ConfigModel):
    """Explain every segment of the left image by a plane, chosen for all segments at once."""

    segmentation: Segmentation = Field(default_factory=MeanShift, description="segmentation of the left image")
    keypoints: Annotated[Detection | None, BeforeValidator(_none)] = Field(
        None, description="key points (surf, sift or none) whose matches limit the disparities of their segment"
    )
    matching: KeyPointMatching = Field(
        default_factory=KeyPointMatching, description="which key points of the views match"
    )
    window_radius: int = Field(4, ge=0, le=20, description="half side of the averaging window, pixels; 0: no averaging")
    ranges: Ranges = Field(default_factory=Ranges, description="search ranges of segments, from matched key points")
    optimization: Optimization = Field(
        default_factory=WinnerTakesAll, description="smoothness in the costs of the first disparities"
    )
    selection: Selection = Field(
        default_factory=Selection, description="selection of first disparities, and of trusted pixels"
    )
    split: Split = Field(default_factory=Split, description="cuts of segments that are not planar")
    planes: PlaneCandidates = Field(default_factory=PlaneCandidates, description="candidate planes of segments")
    energy: Energy = Field(default_factory=Energy, description="energy that the assignment of planes minimizes")
    rounds: int = Field(1, ge=1, le=10, description="number of assignments; planes are fitted again in between")
    sweeps: int = Field(
        20, ge=1, le=1000, description="largest number of passes over all planes in the last assignment"
    )
    restoration: Restoration = Field(
        default_factory=Restoration, description="first disparities instead of planes, on surfaces that are not planar"
    )
    refinement: tuple[RefinementStep, ...] = Field((), description="refinement steps on the finished map, in order")
    details: bool = Field(
        False, description="also write first disparities, trusted pixels, segments, key points and planes"
    )

    def from_volume(self, pair: StereoPair, volume: CostVolume, max_disparity: int, clock: Clock) -> StereoResult:
        """Return the map of ``pair`` from its costs, (H, W, ``max_disparity`` + 1); ``clock`` receives the seconds."""
        clock.start("segmentation")
        image = pair.color8[0]
        labels = self.segmentation(image)
        clock.start("keypoints")
        matches = None
        if self.keypoints is not None:
            left, right = map(self.keypoints, pair.grey8)
            matches = self.matching(left, right, max_disparity)
        clock.start("window")
        informative = has_information(volume.costs)
        of_pixels = volume
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
            assignment = assign(segments, of_pixels, self.planes, self.energy, self.rounds, self.sweeps, clock)
        clock.start("refinement")
        if assignment is None:
            disparity = DisparityMap(
                np.full(labels.shape, np.nan, np.float32), np.full(labels.shape, Status.NO_DATA, np.uint8)
            )
        else:
            values = assignment.planes.at(assignment.labels[labels], max_disparity)
            values = self.restoration(values, first, optimized)
            disparity = map_with_status(values, first)
        disparity = refined(disparity, self.refinement, RefinementContext(pair, optimized, first.right))
        figures: dict[str, float] = {
            "segments": len(segments.graph.sizes),
            "keypoints": 0 if matches is None else len(matches),
            "trusted": float(first.trusted.mean()),
            "planes": 0 if assignment is None else len(assignment.planes),
            "planes_used": 0 if assignment is None else len(np.unique(assignment.labels)),
            "energy_before": 0.0 if assignment is None else assignment.energy_before,
            "energy": 0.0 if assignment is None else assignment.energy,
        }
        result = StereoResult(disparity, figures=figures)
        if self.details:
            clock.start("details")
            result.tables = _tables(segments, assignment, matches, ranges.by_segment(labels))
            result.pictures = _pictures(pair, segments, matches) | {
                "initial_disparity": first.values,
                "trusted": np.where(first.trusted, np.uint8(255), np.uint8(0)),
            }
        result.seconds = clock.seconds
        return result


def map_with_status(values: NDArray[np.float32], first: FirstEstimate) -> DisparityMap:
    """Return the disparities (H, W), of planes or restored, with the status of every pixel.

    Trusted pixels within a pixel of their first disparity are smoothed measurements. All others are filled: occluded if
    their match is outside the right image or the right view has a larger disparity there, mismatched otherwise.
    """
    hidden = right_at_match(values, first.right) > values + 1
    reason = np.where(hidden & ~first.trusted, Status.OCCLUDED, Status.MISMATCH) | Status.FILLED
    agrees = first.trusted & (np.abs(values - first.values) <= 1)
    return DisparityMap(values, np.where(agrees, Status.SMOOTHED, reason).astype(np.uint8))


def _tables(
    segments: SegmentedImage, assignment: Assignment | None, matches: Matches | None, ranges: NDArray[np.int32]
) -> dict[str, list[dict[str, Any]]]:
    """Return tables of the planes, of the segments with their plane and search range, and of the matched key points."""
    result: dict[str, list[dict[str, Any]]] = {}
    if assignment is not None:
        planes = zip(
            assignment.planes.coefficients.tolist(),
            assignment.planes.support.tolist(),
            np.bincount(assignment.labels, minlength=len(assignment.planes)).tolist(),
            strict=True,
        )
        result["planes"] = [
            {"plane": k, "a": a, "b": b, "c": c, "support": support, "segments": used}
            for k, ((a, b, c), support, used) in enumerate(planes)
        ]
        names = ("plane", "pixels", "trusted", "lowest", "highest")
        columns = (assignment.labels, segments.graph.sizes, segments.trusted.sizes, ranges[:, 0], ranges[:, 1])
        rows = zip(*(column.tolist() for column in columns), strict=True)
        result["segment_labels"] = [{"segment": t, **dict(zip(names, row, strict=True))} for t, row in enumerate(rows)]
    if matches is not None:
        digits = {"x": 3, "y": 3, "disparity": 3, "distance": 4}
        result["keypoints"] = [
            {name: round(float(getattr(matches, name)[k]), n) for name, n in digits.items()}
            for k in range(len(matches))
        ]
    return result


def _pictures(pair: StereoPair, segments: SegmentedImage, matches: Matches | None) -> dict[str, NDArray[Any]]:
    """Return the segments as numbers and in mean colors with white rims, and the matched key points, see _lines."""
    labels = segments.labels
    picture = np.rint(segments.graph.means).astype(np.uint8)[labels]
    picture[:, 1:][labels[:, 1:] != labels[:, :-1]] = 255
    picture[1:][labels[1:] != labels[:-1]] = 255
    result: dict[str, NDArray[Any]] = {"segments_preview": picture}
    if labels.max() <= 0xFFFF:
        result["segments"] = labels.astype(np.uint16)
    if matches is not None:
        result["keypoints"] = _lines(pair, matches)
    return result


def _lines(pair: StereoPair, matches: Matches) -> NDArray[np.uint8]:
    # The left image above the right one; a line for every match, its color shows the disparity.
    left, right = pair.color8
    picture = np.vstack([left, right]) // 2 + 60
    height = left.shape[0]
    top = max(float(matches.disparity.max()) if len(matches) else 1.0, 1.0)
    palette = cv2.applyColorMap(np.arange(256, dtype=np.uint8), cv2.COLORMAP_TURBO).reshape(256, 3)[:, ::-1].tolist()
    for x, y, d in zip(matches.x, matches.y, matches.disparity, strict=True):
        color = palette[int(np.clip(d / top * 255, 0, 255))]
        ends = (round(float(x)), round(float(y))), (round(float(x - d)), round(float(y)) + height)
        cv2.line(picture, *ends, color, 1, cv2.LINE_AA)
        for end in ends:
            cv2.circle(picture, end, 2, color, -1, cv2.LINE_AA)
    return picture.astype(np.uint8)

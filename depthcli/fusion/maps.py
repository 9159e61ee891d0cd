"""Fusion one level up: finished maps of several methods, mixed by graph cuts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.result import Clock
from depthcli.fusion.surfaces import (
    Smoothness,
    Surface,
    agreement,
    contradictions,
    disagreements,
    matching_costs,
)
from depthcli.fusion.votes import ColorSupport
from depthcli.segmentation import Segmentation
from depthcli.stereo.finish import refined
from depthcli.stereo.optimization import Optimization
from depthcli.stereo.pipeline import Pipeline
from depthcli.stereo.refinement import RefinementStep
from depthcli.stereo.refinement.background_fill import fill_background
from depthcli.stereo.segments.planes import Members, PlaneFit, evaluate
from depthcli.stereo.slopes import slopes
from depthcli.stereo.volume import CostVolume, Evidence

_REACH, _SHORT, _SOFTNESS = 8.0, 2.0, 15.0  # supports of costs and of the rest, pixels and grey levels
_LEAST = 0.25  # maps closer than this are not told apart, pixels


class Proposal(BaseModel):
    """One more map: a pipeline of the stereo command, or the fused costs optimized in another way."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    weight: float = Field(1.0, ge=0, le=100, description="what it counts where maps agree; that of the own map is 1")


class Matcher(Proposal):
    """A map of a pipeline of the stereo command."""

    matcher: Pipeline = Field(description="the pipeline and its parameters, as in a config of stereo")


class Reoptimized(Proposal):
    """A map of the fused costs, optimized in another way."""

    optimization: Optimization = Field(description="optimization of the fused costs")


class Segmented(Proposal):
    """A map of planes, fitted to the median of the other maps in every segment."""

    segmentation: Segmentation = Field(description="how the left image is cut into segments")


class MapFusion(BaseModel):
    """The own map and those of other methods, each taken where costs, the other maps and the right view speak for it.

    The energy of a map is the sum over its pixels of ``cost_weight`` times the matching cost along it,
    ``agreement_weight`` times the weighted share of the other maps that disagree, ``visibility_weight`` times what the
    right view says against it, each averaged over pixels of similar color, and of a smoothness term that lets slopes
    pass for nothing. From the map of the largest weight on, every map is offered in turn, their median first, and the
    best mix of it with the current one is kept (fusion moves: Lempitsky, Rother, Roth and Blake, PAMI 2010).
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    matchers: tuple[Matcher, ...] = Field((), max_length=16, description="other methods")
    optimizations: tuple[Reoptimized, ...] = Field((), max_length=16, description="further maps of the fused costs")
    segmentations: tuple[Segmented, ...] = Field((), max_length=16, description="maps of planes")
    planes: PlaneFit = Field(
        default_factory=lambda: PlaneFit(tolerance=1.0, trials=100, flatness=0.9), description="how planes are fitted"
    )
    cost_weight: float = Field(2.0, ge=0, le=1e3, description="weight of the fused costs, in units of one measure")
    cost_truncation: float = Field(
        0.7, gt=0, le=16, description="largest cost of a pixel: what the right camera sees differently must not decide"
    )
    agreement_weight: float = Field(3.0, ge=0, le=1e3, description="weight of the other maps' disagreement")
    visibility_weight: float = Field(2.0, ge=0, le=1e3, description="weight of the right view's contradiction")
    hidden: float = Field(0.5, ge=0, le=1, description="contradiction counted where a map is hidden in the right view")
    smoothness: float = Field(4.0, ge=0, le=1e3, description="cost of a pixel of misfit between neighbors")
    truncation: float = Field(2.0, gt=0, le=1e3, description="largest misfit that counts, pixels")
    color_scale: float = Field(
        10.0, gt=0, le=1e4, description="color difference that makes misfits cheaper by 1/e, grey levels"
    )
    floor: float = Field(0.1, ge=0, le=1, description="they never become cheaper than this part")
    refinement: tuple[RefinementStep, ...] = Field((), description="steps on the mix, in order")

    def matched(self, pair: StereoPair, max_disparity: int) -> list[DisparityMap]:
        """The maps of ``matchers``: computed before the fused costs, they need no memory beside them."""
        return [matcher.matcher(pair, max_disparity).disparity for matcher in self.matchers]

    def __call__(
        self, pair: StereoPair, volume: CostVolume, right: NDArray[np.uint16], maps: list[DisparityMap], clock: Clock
    ) -> Mixed:
        """Mix ``maps``: the own one, those of ``matched``, and those of ``optimizations``, in this order.

        Parameters
        ----------
        volume : the fused costs
        right : (H, W) disparities of the right view
        """
        image = pair.color8[0]
        top = volume.disparities - 1
        filled = [np.nan_to_num(fill_background(one).values).clip(0, top) for one in maps]
        listed = [*self.matchers, *self.optimizations]
        weights = [0.0, 1.0, *(one.weight for one in listed), *(one.weight for one in self.segmentations)]
        stack = np.stack(filled)
        # Of an even number the lower one in the middle: a mean would be a value that nobody proposed.
        middle = np.partition(stack, (len(stack) - 1) // 2, axis=0)[(len(stack) - 1) // 2]
        sloped = [self._of_planes(one, middle, image, top) for one in self.segmentations]
        clock.stop("planes")
        proposals = np.stack([middle, *filled, *sloped])
        counts = np.array(weights, np.float32)
        far, near = ColorSupport(image, _REACH, _SOFTNESS), ColorSupport(image, _SHORT, _SOFTNESS)
        costs = np.float32(self.cost_weight) * matching_costs(proposals, volume, self.cost_truncation, far)
        costs += np.float32(self.agreement_weight) * disagreements(proposals, counts, near)
        costs += np.float32(self.visibility_weight) * contradictions(proposals, right, self.hidden, near)
        clock.stop("unary")
        smoothness = Smoothness.of(image, self.smoothness, self.color_scale, self.floor, self.truncation)
        start = int(counts.argmax())
        current = Surface(proposals[start], slopes(proposals[start], image), costs[start])
        for k, (values, cost) in enumerate(zip(proposals, costs, strict=True)):
            if k == start:
                continue
            offered = Surface(values, slopes(values, image), cost)
            switched = smoothness.move(current, offered, _LEAST)
            if switched is not None:
                current = current.mixed(offered, switched)
        clock.stop("moves")
        disparity = DisparityMap(current.values, _status(current.values, right))
        disparity = refined(disparity, self.refinement, Evidence(pair, volume, right))
        agreeing = agreement(disparity.values, proposals, counts)
        clock.stop("refinement")
        return Mixed(disparity, agreeing)

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate of the peak working memory of the matchers, and of the mixing beside a volume, in bytes."""
        return max((matcher.matcher.peak_bytes(shape, max_disparity) for matcher in self.matchers), default=0)

    def bytes_beside(self, shape: tuple[int, int]) -> int:
        """Estimate of what mixing needs beside the fused costs, in bytes."""
        count = 2 + len(self.matchers) + len(self.optimizations) + len(self.segmentations)
        return shape[0] * shape[1] * (12 * count + 1000)

    def _of_planes(
        self, proposal: Segmented, values: NDArray[np.float32], image: NDArray[np.uint8], top: int
    ) -> NDArray[np.float32]:
        labels = proposal.segmentation(image)
        count = int(labels.max()) + 1
        planes = self.planes(values, Members.of(labels, None, count), np.arange(count))
        return evaluate(planes.coefficients, labels, top)


@dataclass(frozen=True)
class Mixed:
    """The map, and the weighted share of the proposals that agree with it, (H, W) float32 in [0, 1]."""

    disparity: DisparityMap
    agreement: NDArray[np.float32]


def _status(values: NDArray[np.float32], right: NDArray[Any]) -> NDArray[np.uint8]:
    """Measured where the right view agrees within a pixel; else filled, and hidden from it or mismatched."""
    columns = np.arange(values.shape[1])[None] - np.rint(values).astype(np.int64)
    there = np.take_along_axis(right, np.clip(columns, 0, None), axis=1).astype(np.float32)
    hidden = (columns < 0) | (there > values + 1)
    reason = np.where(hidden, Status.OCCLUDED, Status.MISMATCH) | Status.FILLED
    agrees = (columns >= 0) & (np.abs(there - values) <= 1)
    return np.where(agrees, Status.MEASURED, reason).astype(np.uint8)

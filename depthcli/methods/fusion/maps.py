"""Fusion of finished maps of several methods: each is taken where it is right."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from depthcli.algorithms.plane_fitting.segment_planes import Members, evaluate
from depthcli.algorithms.segmentation import Segmentation
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.networks import TrainedNetwork
from depthcli.core.result import Clock
from depthcli.methods.fusion.choice import Choice, Proposals
from depthcli.methods.fusion.choice.energy import Energy
from depthcli.methods.fusion.surfaces import agreement
from depthcli.methods.stereo.optimization import Optimization
from depthcli.methods.stereo.pipeline import Pipeline
from depthcli.methods.stereo.refinement import RefinementStep
from depthcli.methods.stereo.refinement.background_fill import fill_background
from depthcli.methods.stereo.segments.planes import PlaneFit
from depthcli.methods.stereo.stages import refined
from depthcli.methods.stereo.volume import CostVolume, RefinementContext

_MIN_PIXELS, _MIN_SHARE = 20, 0.05  # pixels, and share of a segment, that a plane is fitted to; chosen by hand


class Proposal(BaseModel):
    """One more map: a pipeline of the stereo command, or the fused costs optimized in another way."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    weight: float = Field(1.0, ge=0, le=100, description="what it counts where maps agree; the own map counts 1")


class Matcher(Proposal):
    """A map of a pipeline of the stereo command."""

    matcher: Pipeline = Field(description="the pipeline and its parameters, as in a config of stereo")


class Reoptimized(Proposal):
    """A map of the fused costs, optimized in another way."""

    optimization: Optimization = Field(description="optimization of the fused costs")


class Segmented(Proposal):
    """A map of planes, fitted in every segment to the median of the other maps where most of them agree."""

    segmentation: Segmentation = Field(description="how the left image is cut into segments")


class MapFusion(BaseModel):
    """The own map and those of other methods, and which of them is taken where.

    Offered are the median of the maps, the own map, those of ``matchers``, of ``optimizations`` and of
    ``segmentations``, in this order.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    matchers: tuple[Matcher, ...] = Field((), max_length=16, description="other methods")
    optimizations: tuple[Reoptimized, ...] = Field((), max_length=16, description="further maps of the fused costs")
    segmentations: tuple[Segmented, ...] = Field((), max_length=16, description="maps of planes")
    planes: PlaneFit = Field(
        default_factory=lambda: PlaneFit(tolerance=1.0, trials=100, flatness=0.9), description="how planes are fitted"
    )
    choice: Choice = Field(default_factory=Energy, description="which map is taken where")
    refinement: tuple[RefinementStep, ...] = Field((), description="steps on the mix, in order")

    def with_network(self, trained: TrainedNetwork) -> Self:
        """Return a copy whose choice is made by ``trained``; InputError where it was trained for other maps."""
        return self.model_copy(update={"choice": self.choice.with_network(trained, self.kinds)})

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of the methods that make the proposals, in their order."""
        return (
            "median",
            "own",
            *(one.matcher.method_name() for one in self.matchers),
            *(one.optimization.method_name() for one in self.optimizations),
            *(one.segmentation.method_name() for one in self.segmentations),
        )

    def matched(self, pair: StereoPair, max_disparity: int) -> list[DisparityMap]:
        """Compute the maps of ``matchers``, before the fused costs: then they need no memory beside them."""
        return [matcher.matcher(pair, max_disparity).disparity for matcher in self.matchers]

    def proposals(
        self, pair: StereoPair, volume: CostVolume, right: NDArray[np.uint16], maps: list[DisparityMap]
    ) -> Proposals:
        """Return the maps without gaps, their median, and planes fitted to it.

        Parameters
        ----------
        volume : the fused costs
        right : (H, W) disparities of the right view
        maps : the own one, those of ``matched``, those of ``optimizations``
        """
        image, top = pair.color8[0], volume.disparities - 1
        own = [np.nan_to_num(fill_background(one).values).clip(0, top) for one in maps]
        stack = np.stack(own)
        # Of an even number the lower one in the middle: a mean would be a value that nobody proposed.
        middle = np.partition(stack, (len(stack) - 1) // 2, axis=0)[(len(stack) - 1) // 2]
        agreeing = np.count_nonzero(np.abs(stack - middle) <= 1, axis=0)
        sloped = [self._of_planes(one, middle, agreeing, image, top) for one in self.segmentations]
        listed = [*self.matchers, *self.optimizations]
        weights = [0.0, 1.0, *(one.weight for one in listed), *(one.weight for one in self.segmentations)]
        filled = np.zeros((len(weights), *pair.shape), np.uint8)
        for k, one in enumerate(maps):
            filled[k + 1] = np.count_nonzero([one.status & Status.FILLED, one.status & Status.OCCLUDED], axis=0)
        return Proposals(
            self.kinds, np.stack([middle, *own, *sloped]), filled, np.array(weights, np.float32), pair, volume, right
        )

    def __call__(
        self, pair: StereoPair, volume: CostVolume, right: NDArray[np.uint16], maps: list[DisparityMap], clock: Clock
    ) -> Mixed:
        """Mix ``maps``, as :meth:`proposals` takes them."""
        proposals = self.proposals(pair, volume, right, maps)
        clock.stop("proposals")
        chosen = self.choice(proposals)
        clock.stop("choice")
        disparity = DisparityMap(chosen.values, _status(chosen.values, right))
        disparity = refined(disparity, self.refinement, RefinementContext(pair, volume, right))
        agreeing = agreement(disparity.values, proposals.values, proposals.weights)
        clock.stop("refinement")
        return Mixed(disparity, agreeing, chosen.probability)

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate the peak working memory of the matchers for images of ``shape``, bytes."""
        return max((matcher.matcher.peak_bytes(shape, max_disparity) for matcher in self.matchers), default=0)

    def bytes_beside(self, shape: tuple[int, int]) -> int:
        """Estimate the memory that mixing needs beside the fused costs, bytes."""
        count = len(self.kinds)
        return shape[0] * shape[1] * (9 * count + self.choice.bytes_a_pixel(count))

    def _of_planes(
        self,
        proposal: Segmented,
        values: NDArray[np.float32],
        agreeing: NDArray[np.int64],
        image: NDArray[np.uint8],
        top: int,
    ) -> NDArray[np.float32]:
        labels = proposal.segmentation(image)
        count = int(labels.max()) + 1
        chosen = _largest_agreement(agreeing, labels, count)
        planes = self.planes(values, Members.of(labels, chosen.ravel(), count), np.arange(count))
        return evaluate(planes.coefficients, labels, top)


@dataclass(frozen=True)
class Mixed:
    """A mix of several maps.

    Attributes
    ----------
    disparity : the map
    agreement : (H, W) float32 in [0, 1], weighted share of the proposals that agree with it
    probability : (H, W) float32 in [0, 1], to be right; None where the choice does not know it
    """

    disparity: DisparityMap
    agreement: NDArray[np.float32]
    probability: NDArray[np.float32] | None


def _largest_agreement(agreeing: NDArray[np.int64], labels: NDArray[np.int32], count: int) -> NDArray[np.bool_]:
    # In every segment the pixels on which the largest number of maps agree that still leaves pixels enough.
    min_pixels = np.maximum(_MIN_PIXELS, _MIN_SHARE * np.bincount(labels.ravel(), minlength=count))
    threshold = np.zeros(count, np.int64)
    for number in range(1, int(agreeing.max()) + 1):
        threshold[np.bincount(labels[agreeing >= number], minlength=count) >= min_pixels] = number
    return agreeing >= threshold[labels]


def _status(values: NDArray[np.float32], right: NDArray[Any]) -> NDArray[np.uint8]:
    # Measured where the right view agrees within a pixel; else filled, and hidden from it or mismatched.
    columns = np.arange(values.shape[1])[None] - np.rint(values).astype(np.int64)
    at_match = np.take_along_axis(right, np.clip(columns, 0, None), axis=1).astype(np.float32)
    hidden = (columns < 0) | (at_match > values + 1)
    reason = np.where(hidden, Status.OCCLUDED, Status.MISMATCH) | Status.FILLED
    agrees = (columns >= 0) & (np.abs(at_match - values) <= 1)
    return np.where(agrees, Status.MEASURED, reason).astype(np.uint8)

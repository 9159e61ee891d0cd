"""The data flow of fusion: :meth:`Fusion.fuse` from a pair to fused costs, :meth:`Fusion.__call__` to a map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, LiteralString, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, PrivateAttr, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from depthcli.algorithms.pixel_network import TrainedNetwork
from depthcli.core.context import Clock, Context
from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Floats
from depthcli.core.method import ConfigModel
from depthcli.kernels.winners import left_right_difference, winners
from depthcli.methods.confidence import MeasureName, confidence_maps, measure_name
from depthcli.methods.fusion.blend import (
    UNIT,
    add_weighted,
    blend,
    measure_weights,
    normalize_confidences,
    normalize_costs,
)
from depthcli.methods.fusion.maps import MapFusion
from depthcli.methods.fusion.votes import Ballot, ColorSupport, Consensus, Support, WindowSupport
from depthcli.methods.stereo.adjustment import AdjustingMatcher, adjusted
from depthcli.methods.stereo.aggregation import Aggregation
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.cost import PartCost, light_weights
from depthcli.methods.stereo.optimization import Optimization
from depthcli.methods.stereo.optimization.winner_takes_all import WinnerTakesAll
from depthcli.methods.stereo.refinement import RefinementStep
from depthcli.methods.stereo.segments.steps import SegmentSteps
from depthcli.methods.stereo.stages import TILE_HALO, finish
from depthcli.methods.stereo.volume import CostVolume, FixedPoint, StereoResult, as_fixed_point

_NEEDS_MAPS: dict[str, LiteralString] = {
    "agreement": "'agreement' compares several maps; expected 'maps'",
    "probability": "'probability' is known where a network chooses among maps; expected 'maps' with 'choice: network'",
}
_OWN_CONFIDENCES = ("consensus", *_NEEDS_MAPS)
_MIN_LIGHT = np.float32(1e-30)  # a measure that is chosen alone keeps its weight in any light
Volumes = Mapping[str, NDArray[Any]]
"""File name of a measure -> (H, W, D) costs."""


class FusedMeasure(ConfigModel):
    """A measure to fuse: a cost measure, or a cost volume read from a file."""

    flattened: ClassVar[str] = "cost"  # a measure may be written as its cost alone

    cost: PartCost | None = Field(None, description="a cost measure of the stereo command")
    volume: str | None = Field(
        None,
        description="instead of cost: .npy file of (H, W, D) costs, lower is better, relative to the left image's "
        "folder; {scene} becomes the scene's name",
    )
    scale: float | None = Field(
        None, gt=0, le=1e9, description="cost that counts as 1 - 1/e, in units of the measure; null: the pair's median"
    )

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, value: Any) -> Any:
        if isinstance(value, str) or (isinstance(value, dict) and "method" in value):
            return {"cost": value}
        return value

    @model_validator(mode="after")
    def _one_source(self) -> FusedMeasure:
        if (self.cost is None) == (self.volume is None):
            raise ValueError("expected either cost or volume")
        return self

    def costs(self, pair: StereoPair, n_disparities: int, volumes: Volumes) -> CostVolume:
        """Return the costs of ``n_disparities`` disparities. Raise InputError if the volume is missing or unusable."""
        if self.cost is not None:
            return self.cost.checked_costs(pair, n_disparities)
        assert self.volume is not None
        if self.volume not in volumes:
            raise InputError(f"{self.volume}: no such volume")
        costs = volumes[self.volume]
        if costs.ndim != 3 or costs.shape[:2] != pair.shape or costs.shape[2] < n_disparities:
            expected = f"({pair.shape[0]}, {pair.shape[1]}, {n_disparities} or more)"
            raise InputError(f"{self.volume}: expected shape {expected}, got {costs.shape}")
        costs = costs[:, :, :n_disparities]
        if costs.dtype not in (np.uint8, np.uint16):
            with np.errstate(over="ignore"):
                costs = costs.astype(np.float32)
            if not np.isfinite(costs).all():
                raise InputError(f"{self.volume}: has NaN or infinite costs")
        return CostVolume(np.ascontiguousarray(costs))


class Fusion(AdjustingMatcher):
    """Stereo by several cost measures. At each pixel, a measure has more weight if more pixels around agree with it."""

    uses_devices: ClassVar[bool] = True

    measures: tuple[FusedMeasure, ...] = Field(min_length=1, max_length=16, description="measures to fuse")
    weights: Literal["consensus", "confidence", "equal", "select", "vote"] = Field(
        "consensus",
        description="consensus: by the votes for a measure's disparity; confidence: by its confidence alone; equal; "
        "select: only the most confident measure; vote: no costs, only votes",
    )
    exponent: float = Field(
        2.0,
        gt=0,
        le=8,
        description="power of the votes or the confidence that gives the weights (consensus, confidence)",
    )
    vote_confidence: MeasureName | None = Field(
        "lrc", description="confidence measure that weights votes; null: all count alike"
    )
    vote_aggregation: Aggregation | None = Field(
        default_factory=lambda: ConstantWindow(window=11),
        description="aggregation that gives each measure's own disparity, the one it votes for; null: none",
    )
    vote_optimization: Optimization = Field(
        default_factory=WinnerTakesAll, description="optimization that gives each measure's own disparity"
    )
    consensus: Consensus = Field(default_factory=Consensus, description="the vote")
    blend: Literal["before", "after"] = Field("before", description="weigh the measures before or after aggregation")
    aggregation: Aggregation | None = Field(
        default_factory=lambda: ConstantWindow(window=11), description="aggregation of the fused costs; null: none"
    )
    optimization: Optimization = Field(default_factory=WinnerTakesAll, description="optimization of the fused costs")
    outside: float | None = Field(
        None,
        ge=0,
        le=1,
        description="cost of a match outside the right image, in units of one measure; null: the mean of the others",
    )
    segments: SegmentSteps | None = Field(
        None,
        description="segment pipeline of stereo, applied to the fused costs; it replaces optimization, refinement and "
        "confidence; null: not used",
    )
    refinement: tuple[RefinementStep, ...] = Field((), description="steps on the disparity map, in order")
    maps: MapFusion | None = Field(
        None, description="maps of other methods that the finished map is mixed with; null: none"
    )
    confidence: tuple[Annotated[str, AfterValidator(lambda n: measure_name(n, *_OWN_CONFIDENCES))], ...] = Field(
        (),
        description="confidence maps to write: measures of the final costs, 'consensus', the share of votes, or, with "
        "maps, 'agreement', the share of maps, and, if a network chooses among them, its 'probability'",
    )

    @model_validator(mode="after")
    def _fields_fit_together(self) -> Fusion:
        wrong: list[tuple[str, LiteralString]] = []
        made = () if self.maps is None else ("agreement", *self.maps.choice.confidences)
        wrong += [("confidence", text) for name, text in _NEEDS_MAPS.items() if name in {*self.confidence} - {*made}]
        if self.segments is not None:
            for name in ("optimization", "refinement", "maps", "confidence"):
                if getattr(self, name) != type(self).model_fields[name].get_default(call_default_factory=True):
                    wrong.append((name, "has no effect with 'segments', which has its own; leave it out"))
        if wrong:
            errors = [InitErrorDetails(type=PydanticCustomError("in_vain", t), loc=(n,), input=None) for n, t in wrong]
            raise ValidationError.from_exception_data("Fusion", errors)
        return self

    # called when a pair is matched
    _read_volumes: Callable[[], Volumes] | None = PrivateAttr(None)

    @property
    def volumes(self) -> set[str]:
        """Names of the files of measures that are made elsewhere."""
        return {measure.volume for measure in self.measures if measure.volume is not None}

    def with_volumes(self, read: Callable[[], Volumes]) -> Self:
        """Return a copy that reads the measures made elsewhere by ``read()`` when a pair is matched."""
        copy = self.model_copy()
        copy._read_volumes = read
        return copy

    def tile_halo(self) -> int | None:
        """Return None if there are volumes, which cover the whole pair."""
        return None if self.volumes else TILE_HALO

    def tile_stages(self) -> None:
        """Return None: each tile is matched as a pair."""

    @property
    def network_name(self) -> str | None:
        """Name or file of the trained network that chooses among the maps, if one does."""
        return None if self.maps is None else self.maps.choice.network_name

    def with_network(self, trained: TrainedNetwork) -> Self:
        """Return a copy that chooses among the maps by ``trained``. Raise InputError if it is for other maps."""
        assert self.maps is not None
        choice = self.maps.choice.with_network(trained, self.maps.kinds)
        return self.model_copy(update={"maps": self.maps.model_copy(update={"choice": choice})})

    def __call__(self, pair: StereoPair, max_disparity: int, context: Context | None = None) -> StereoResult:
        """Match ``pair`` over disparities 0 .. ``max_disparity`` inclusive.

        InputError: a volume is missing, has another shape, or contains NaN or infinite costs. Disparities of a volume
        beyond ``max_disparity`` are cut off.
        """
        clock = Clock()
        pair = adjusted(pair, max_disparity, self.adjust, context, clock)
        other_maps = []
        if self.maps is not None:  # before the fused costs, so that matchers do not need memory besides them
            clock.start("other_maps")
            other_maps = [source.matcher(pair, max_disparity, context).disparity for source in self.maps.matchers]
        fused = self.fuse(pair, max_disparity, clock, vote="consensus" in self.confidence)
        volume = fused.volume
        if self.segments is not None:
            result = self.segments.from_volume(pair, volume, max_disparity, clock)
        else:
            measured = [name for name in self.confidence if name not in _OWN_CONFIDENCES]
            result, left, right = finish(pair, volume, self.optimization, self.refinement, measured, clock)
            if fused.ballot is not None and "consensus" in self.confidence:
                clock.start("confidence")
                result.confidence["consensus"] = fused.ballot.shares(left.astype(np.int32)[None])[0]
            if self.maps is not None:
                reoptimized = [
                    finish(pair, volume, source.optimization, self.refinement, (), clock).result.disparity
                    for source in self.maps.optimizations
                ]
                result.disparity, confidences = self.maps(
                    pair, volume, right, [result.disparity, *other_maps, *reoptimized], self.confidence, clock
                )
                result.confidence |= confidences
        result.seconds = clock.seconds
        result.figures |= {f"weight_{k}": float(mean) for k, mean in enumerate(fused.weights.mean(axis=(1, 2)))}
        return result

    def fuse(
        self, pair: StereoPair, max_disparity: int, clock: Clock | None = None, *, vote: bool = True
    ) -> FusedCosts:
        """Compute the fused cost volume.

        The steps, by the names of their times:

        1. ``cost``: costs of every measure, on one scale.
        2. ``voters``: the disparity map of every measure, which is its vote, and how much each vote counts.
        3. ``weights``: the ballot, and from it the weight of every measure at every pixel. If the light of the two
           images differs, ``light_weights`` multiply the votes' weights before the ballot, and the measures' weights
           after it. These are then divided by their sum.
        4. ``aggregation``: weighted mean of the costs, before or after their aggregation (``blend``).
        5. ``votes``: disparities with a small share of the votes get an additional cost, or, with ``weights: vote``,
           only this cost.

        With equal weights and no cost of votes, only confidences need votes: ``vote`` decides whether they are counted.
        """
        clock = clock or Clock()
        clock.start("cost")
        volumes = {} if self._read_volumes is None else self._read_volumes()
        consensus, n_disparities = self.consensus, max_disparity + 1
        parts = [
            normalize_costs(measure.costs(pair, n_disparities, volumes), measure.scale, self.outside)
            for measure in self.measures
        ]
        counted = self.weights != "equal" or consensus.vote_cost > 0
        light = light_weights([measure.cost for measure in self.measures], pair)
        ballot = self._ballot(parts, pair, light, clock) if counted or vote else None
        weights = measure_weights(self.weights, ballot, self.exponent, (len(parts), *pair.shape))
        if light is not None:
            weights = weights * np.maximum(light, _MIN_LIGHT)
            weights /= weights.sum(axis=0, keepdims=True)
        clock.start("aggregation")
        if self.weights == "vote":
            blended = None
        elif self.blend == "before":
            blended = blend(parts, weights)
            parts.clear()  # makes room for the next volumes
            if self.aggregation is not None:
                blended = self.aggregation(blended, pair)
            elif counted:
                blended = as_fixed_point(blended)
        else:
            total = np.zeros(parts[0].costs.shape, np.float32)
            for part, weight in zip(parts, weights, strict=True):
                add_weighted(total, part if self.aggregation is None else self.aggregation(part, pair), weight)
            unit = float(FixedPoint.FRACTION * UNIT)
            blended = CostVolume((total * np.float32(unit) + np.float32(0.5)).astype(np.uint16), unit)
        clock.start("votes")
        if blended is not None and not consensus.vote_cost:
            return FusedCosts(blended, weights, ballot)
        assert ballot is not None
        strength = 1.0 if blended is None else consensus.vote_cost
        return FusedCosts(ballot.costs(blended, strength, FixedPoint.LARGEST), weights, ballot)

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate the peak working memory for images of ``shape``, in bytes."""
        pixels = shape[0] * shape[1]
        # A byte per measure; raw, aggregated, voted and optimized costs of two bytes; blocks of 16 floats for votes.
        per_cell = len(self.measures) + (6 if self.blend == "before" else 10)
        temporary = max(0 if measure.cost is None else measure.cost.pixel_bytes() for measure in self.measures)
        per_pixel = 2 * 16 * 4 + 24 * len(self.measures) + temporary
        need = pixels * (max_disparity + 1) * per_cell + pixels * per_pixel + (32 << 20)
        return need if self.maps is None else self.maps.peak_bytes(shape, max_disparity, need)

    def _ballot(self, parts: list[CostVolume], pair: StereoPair, light: Floats | None, clock: Clock) -> Ballot:
        clock.start("voters")
        chosen, trust = [], []
        for part in parts:
            aggregated = part if self.vote_aggregation is None else self.vote_aggregation(part, pair)
            costs = self.vote_optimization(aggregated, pair).costs
            left, right = winners(costs)
            chosen.append(left.astype(np.int32))
            if self.vote_confidence is None:
                trust.append(np.ones(left.shape, np.float32))
            elif self.vote_confidence == "lrc":
                trust.append(-left_right_difference(left, right))
            else:
                trust.append(confidence_maps(costs, [self.vote_confidence])[self.vote_confidence])
            del aggregated, costs  # before the next ones are made
        vote_weights = np.stack(trust)
        if self.vote_confidence is not None:
            vote_weights = normalize_confidences(vote_weights, self.vote_confidence)
        clock.start("weights")
        if light is not None:
            vote_weights *= light
        consensus = self.consensus
        support: Support = (
            WindowSupport(pair.shape, consensus.window)
            if consensus.support == "window"
            else ColorSupport(pair.color8[0], max(1, consensus.window // 2), consensus.softness)
        )
        return Ballot(np.stack(chosen), vote_weights, parts[0].n_disparities, consensus.tolerance, support)


@dataclass(frozen=True)
class FusedCosts:
    """The fused costs, and the weights and votes that they were made with."""

    volume: CostVolume  # (H, W, D) uint16, at most 4080; uint8 with equal weights, no aggregation and no votes
    weights: Floats  # of the measures, (M, H, W) float32, sum 1 over M
    ballot: Ballot | None  # the votes; None if they are not counted

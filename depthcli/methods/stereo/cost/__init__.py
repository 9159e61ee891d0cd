"""Cost measures: the dissimilarity of left and right pixels of an image pair. One file per measure."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from pydantic import AfterValidator, Field

from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Floats
from depthcli.core.method import Method, Odd, method_of
from depthcli.methods.stereo.volume import CostVolume


class CostMeasure(Method):
    """A measure of the dissimilarity of two pixels."""

    @abstractmethod
    def __call__(self, pair: StereoPair, n_disparities: int) -> CostVolume:
        """Return the cost volume of disparities 0 .. ``n_disparities`` - 1."""

    def checked_costs(self, pair: StereoPair, n_disparities: int) -> CostVolume:
        """Return the cost volume of :meth:`__call__`. Raise InputError for a wrong shape or wrong numbers."""
        volume, shape = self(pair, n_disparities), (*pair.shape, n_disparities)
        if not isinstance(volume, CostVolume):
            raise InputError(f"cost {self.method_name()}: expected a CostVolume, got {type(volume).__name__}")
        costs, scale = volume.costs, volume.scale
        if costs.shape != shape:
            raise InputError(f"cost {self.method_name()}: expected costs of shape {shape}, got {costs.shape}")
        # The least and the largest cost are NaN if any cost is; integer costs, as all of ours, need no check.
        ends = (costs.min(), costs.max()) if costs.dtype == np.float32 else ()
        if not (np.isfinite([*ends, scale]).all() and scale > 0):
            raise InputError(f"cost {self.method_name()}: costs are NaN or infinite, or their scale is not positive")
        return volume

    def halo(self) -> int | None:
        """Return the radius in pixels of the window that a pixel's costs depend on; None: the whole image."""
        return None

    def pixel_bytes(self) -> int:
        """Return the temporary memory that is needed besides the volume, bytes per pixel; 0 if it is little."""
        return 0

    bytes_per_cost: ClassVar[int] = 1
    """Bytes of a cost in the returned volume."""

    compares_levels: ClassVar[bool] = False
    """Whether the measure compares grey levels or their differences: then different light raises costs of matches."""


_TRANSFERRED_WEIGHT = 0.4  # part of the weight lost by measures of grey levels that the others gain; not from a paper


def light_weights(measures: Sequence[CostMeasure | None], pair: StereoPair) -> Floats | None:
    """Return the weights of M measures in a sum at every pixel, (M, H, W), from its light trust; None: all are 1.

    If the light differs, measures that compare grey levels have weights below 1 and the others above 1. The sum of all
    weights is at most M.
    """
    levels = [measure is not None and measure.compares_levels for measure in measures]
    n_levels, n_others = sum(levels), len(levels) - sum(levels)
    if pair.light_trust is None or not n_levels or not n_others:
        return None
    trust = pair.light_trust * np.float32(1 / 255)
    gain = np.float32(1) + np.float32(_TRANSFERRED_WEIGHT * n_levels / n_others) * (np.float32(1) - trust)
    return np.stack([trust if compares else gain for compares in levels])


Cost = Annotated[CostMeasure, *method_of("depthcli.methods.stereo.cost")]
Sampling = Annotated[
    Literal["exact", "tolerant"],
    Field(description="comparison of values; tolerant: insensitive to sampling (Birchfield and Tomasi)"),
]
"""How the values of matching pixels are compared."""

Side = Annotated[int, Field(ge=1, le=255), *get_args(Odd)[1:]]
"""Side of a measure's window, pixels."""


def window_check(max_pixels: int) -> AfterValidator:
    """Return the check that a window (width, height) has 2 to ``max_pixels`` pixels."""

    def check(window: tuple[int, int]) -> tuple[int, int]:
        if not 2 <= window[0] * window[1] <= max_pixels:
            raise ValueError(f"the window must have 2 to {max_pixels} pixels")
        return window

    return AfterValidator(check)


def _check_outside(cost: CostMeasure) -> CostMeasure:
    outside = type(cost).model_fields.get("outside")
    if outside is not None and getattr(cost, "outside") != outside.default:  # noqa: B009  (not every measure has one)
        raise ValueError("'outside' is one for all measures that are combined: leave it out here")
    return cost


PartCost = Annotated[Cost, AfterValidator(_check_outside)]
"""A measure in a combination: the combination, not the measure, fills the cells outside the right image."""

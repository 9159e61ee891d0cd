"""Cost measures: how unlike two pixels are. One file a measure."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Annotated, ClassVar, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from depthcli.core.frames import StereoPair
from depthcli.core.method import Method, Odd, method_of
from depthcli.methods.stereo.volume import CostVolume


class CostMeasure(Method):
    """A similarity measure of two pixels, turned into costs."""

    @abstractmethod
    def __call__(self, pair: StereoPair, disparities: int) -> CostVolume:
        """Cost volume of disparities 0 .. ``disparities`` - 1."""

    def halo(self) -> int | None:
        """Pixels around a pixel that its costs depend on; None: the whole image."""
        return None

    compares_levels: ClassVar[bool] = False
    """Grey levels or their differences are compared: costs of right matches rise where the light differs."""


_SHIFTED = 0.4  # share of what measures of grey levels lose that the others gain


def light_weights(measures: Sequence[CostMeasure | None], pair: StereoPair) -> NDArray[np.float32] | None:
    """What measures that are summed count at every pixel, given how far its light can be trusted.

    Returns
    -------
    (M, H, W) float32, or None
        Of each measure: below 1 where it compares grey levels that are not the same light's, above 1 of the
        others there; all together never more than their number. None: all count 1, everywhere.
    """
    levels = [measure is not None and measure.compares_levels for measure in measures]
    many, others = sum(levels), len(levels) - sum(levels)
    if pair.light_trust is None or not many or not others:
        return None
    trust = pair.light_trust * np.float32(1 / 255)
    gain = np.float32(1) + np.float32(_SHIFTED * many / others) * (np.float32(1) - trust)
    return np.stack([trust if own else gain for own in levels])


Cost = Annotated[CostMeasure, *method_of("depthcli.methods.stereo.cost")]
Side = Annotated[int, Field(ge=1, le=255), *get_args(Odd)[1:]]
"""Side of a measure's window, pixels."""


def _without_outside(cost: CostMeasure) -> CostMeasure:
    outside = type(cost).model_fields.get("outside")
    if outside is not None and getattr(cost, "outside") != outside.default:  # noqa: B009  (not every measure has one)
        raise ValueError("'outside' is one for all measures that are combined: leave it out here")
    return cost


PartCost = Annotated[Cost, AfterValidator(_without_outside)]
"""A measure whose costs are combined with others, by what then fills the cells outside the right image."""

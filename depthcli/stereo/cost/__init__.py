"""Cost measures: how unlike two pixels are. One file a measure."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, get_args

from pydantic import AfterValidator, Field

from depthcli.core.frames import StereoPair
from depthcli.core.method import Method, Odd, method_of
from depthcli.stereo.volume import CostVolume


class CostMeasure(Method):
    """A similarity measure of two pixels, turned into costs."""

    @abstractmethod
    def __call__(self, pair: StereoPair, disparities: int) -> CostVolume:
        """Cost volume of disparities 0 .. ``disparities`` - 1."""

    def halo(self) -> int | None:
        """Pixels around a pixel that its costs depend on; None: the whole image."""
        return None


Cost = Annotated[CostMeasure, *method_of("depthcli.stereo.cost")]
Side = Annotated[int, Field(ge=1, le=255), *get_args(Odd)[1:]]
"""Side of a measure's window, pixels."""


def _without_outside(cost: CostMeasure) -> CostMeasure:
    outside = type(cost).model_fields.get("outside")
    if outside is not None and getattr(cost, "outside") != outside.default:  # noqa: B009  (not every measure has one)
        raise ValueError("'outside' is one for all measures that are combined: leave it out here")
    return cost


PartCost = Annotated[Cost, AfterValidator(_without_outside)]
"""A measure whose costs are combined with others, by what then fills the cells outside the right image."""

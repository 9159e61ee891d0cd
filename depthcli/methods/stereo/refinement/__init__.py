"""Refinement: what is done to a disparity map after it was selected. One file a step."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, ClassVar

from depthcli.core.maps import DisparityMap
from depthcli.core.method import Method, method_of
from depthcli.methods.stereo.volume import RefinementContext


class Refinement(Method):
    """One step of the refinement list."""

    needs_costs: ClassVar[bool] = True
    """Whether it looks at costs. Steps that do not run once on the map of an image that was matched in tiles."""

    fills: ClassVar[bool] = False
    """Whether it gives values to pixels that have none."""

    def halo(self) -> int | None:
        """Rows above and below a pixel that its result depends on; None: the whole map."""
        return None

    @abstractmethod
    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        """A new map; the input is not modified."""


RefinementStep = Annotated[Refinement, *method_of("depthcli.methods.stereo.refinement")]

"""Refinement: a better disparity map from a disparity map. One file per step."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, ClassVar

import numpy as np

from depthcli.core.maps import DisparityMap, Floats, Status
from depthcli.core.method import Method, method_of
from depthcli.methods.stereo.volume import RefinementContext


class Refinement(Method):
    """A step of refinement."""

    needs_costs: ClassVar[bool] = True
    """Whether it uses costs: then the pair must be matched whole. Other steps also refine a map made in tiles."""

    fills: ClassVar[bool] = False
    """Whether it sets values of pixels without one."""

    def halo(self) -> int | None:
        """Return the number of rows above and below a pixel on which its result depends; None: the whole map."""
        return None

    @abstractmethod
    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        """Return a new map; the input is not modified."""


def with_filled(disparity: DisparityMap, values: Floats) -> DisparityMap:
    """Return the map with new ``values``; pixels that had none are marked as filled."""
    filled = np.isnan(disparity.values) & ~np.isnan(values)
    return DisparityMap(values, disparity.status | np.uint8(Status.FILLED) * filled)


def with_smoothed(disparity: DisparityMap, values: Floats) -> DisparityMap:
    """Return the map with new ``values``; pixels whose value changed are marked as smoothed."""
    changed = ~np.isnan(disparity.values) & (values != disparity.values)
    return DisparityMap(values, disparity.status | np.uint8(Status.SMOOTHED) * changed)


RefinementStep = Annotated[Refinement, *method_of("depthcli.methods.stereo.refinement")]

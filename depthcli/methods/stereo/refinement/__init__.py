"""Refinement: a disparity map in, a better one out. One file per step."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import DisparityMap, Status
from depthcli.core.method import Method, method_of
from depthcli.methods.stereo.volume import RefinementContext


class Refinement(Method):
    """A step of refinement."""

    needs_costs: ClassVar[bool] = True
    """Whether it uses costs, for which the pair must be matched whole; others also refine the map of many tiles."""

    fills: ClassVar[bool] = False
    """Whether it sets values of pixels that have none."""

    def halo(self) -> int | None:
        """Return the number of rows above and below a pixel that its result depends on; None: the whole map."""
        return None

    @abstractmethod
    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        """Return a new map; the input is not modified."""


def marked(
    disparity: DisparityMap, values: NDArray[np.float32], pixels: NDArray[np.bool_], status: Status
) -> DisparityMap:
    """Return the map with new ``values``, and ``status`` added to the status of ``pixels`` (H, W)."""
    return DisparityMap(values, disparity.status | pixels.view(np.uint8) * np.uint8(status))


def with_filled(disparity: DisparityMap, values: NDArray[np.float32]) -> DisparityMap:
    """Return the map with new ``values``; pixels that had none are marked as filled."""
    return marked(disparity, values, ~disparity.valid & ~np.isnan(values), Status.FILLED)


def with_smoothed(disparity: DisparityMap, values: NDArray[np.float32]) -> DisparityMap:
    """Return the map with new ``values``; pixels whose value changed are marked as smoothed."""
    return marked(disparity, values, disparity.valid & (values != disparity.values), Status.SMOOTHED)


RefinementStep = Annotated[Refinement, *method_of("depthcli.methods.stereo.refinement")]

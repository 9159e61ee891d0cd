"""Refinement: a better disparity map from a disparity map. One file per step."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import DisparityMap, Status
from depthcli.core.method import Method, method_of
from depthcli.kernels.jit import jit, run_bands
from depthcli.methods.stereo.volume import RefinementContext


class Refinement(Method):
    """A step of refinement."""

    needs_costs: ClassVar[bool] = True
    """Whether it uses costs: then the pair must be matched whole. Other steps also refine a map made in tiles."""

    fills: ClassVar[bool] = False
    """Whether it sets values of pixels without one."""

    def halo(self) -> int | None:
        """Return on how many rows above and below a pixel its result depends; None: on the whole map."""
        return None

    @abstractmethod
    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        """Return a new map; the input is not modified."""


def with_filled(disparity: DisparityMap, values: NDArray[np.float32]) -> DisparityMap:
    """Return the map with new ``values``; pixels that had none are marked as filled."""
    return _marked(disparity, values, Status.FILLED)


def with_smoothed(disparity: DisparityMap, values: NDArray[np.float32]) -> DisparityMap:
    """Return the map with new ``values``; pixels whose value changed are marked as smoothed."""
    return _marked(disparity, values, Status.SMOOTHED)


def _marked(disparity: DisparityMap, values: NDArray[np.float32], status: Status) -> DisparityMap:
    marked = disparity.status.copy()
    run_bands(_mark, len(marked), disparity.values, values, status == Status.FILLED, np.uint8(status), marked)
    return DisparityMap(values, marked)


@jit
def _mark(begin, end, before, after, filled, bit, status):
    for y in range(begin, end):
        for x in range(status.shape[1]):
            old, new = before[y, x], after[y, x]
            changed = np.isnan(old) & ~np.isnan(new) if filled else ~np.isnan(old) & (new != old)
            status[y, x] |= bit * np.uint8(changed)


RefinementStep = Annotated[Refinement, *method_of("depthcli.methods.stereo.refinement")]

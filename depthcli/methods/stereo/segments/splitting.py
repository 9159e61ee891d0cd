"""Cuts segments where the first estimate shows that they are not one plane."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.regions import connected_components_of_labels, merge_small_labels
from depthcli.methods.stereo.segments import Step
from depthcli.methods.stereo.segments.first_estimate import FirstEstimate
from depthcli.methods.stereo.segments.planes import Members, PlaneFit


class Split(Step):
    """Cut segments that are not one plane along a grid: color alone takes a curved page for one plane.

    The cuts ignore disparity on purpose: cut along the disparities, the fattened rim of a foreground object
    becomes a segment of its own and keeps the wrong disparity.
    """

    cells: tuple[Annotated[int, Field(ge=4, le=512)], ...] = Field(
        (), max_length=8, description="sides of the grids' cells, pass after pass, pixels; none: no cuts"
    )
    tolerance: float = Field(1.0, gt=0, le=16384, description="distance from the plane that contradicts it, pixels")
    misfits: float = Field(
        0.1, ge=0, le=1, description="a segment is cut where a larger part of its trusted pixels contradicts its plane"
    )

    def __call__(self, labels: NDArray[np.int32], first: FirstEstimate, fit: PlaneFit) -> NDArray[np.int32]:
        """At least as many segments, each of them connected; (H, W) int32.

        Parameters
        ----------
        labels : (H, W) segments 0 .. n - 1
        fit : how planes are fitted; its own tolerance is replaced by ``tolerance``
        """
        height, width = labels.shape
        judge = fit.model_copy(update={"tolerance": self.tolerance})
        for cell in self.cells:
            count = int(labels.max()) + 1
            members = Members.of(labels, first.trusted, count)
            sizes = np.bincount(labels.ravel(), minlength=count)
            active = np.flatnonzero((members.sizes >= 3) & (sizes > cell * cell // 2))
            if len(active) == 0:
                continue
            planes = judge(first.values, members, active)
            bad = np.zeros(count, bool)
            bad[active] = planes.support < (1 - self.misfits) * members.sizes[active]
            grid = (np.arange(height)[:, None] // cell) * (width // cell + 1) + np.arange(width)[None] // cell
            # Every (segment, cell) pair becomes a value of its own; pieces of less than a quarter cell go back.
            keys = labels.astype(np.int64) * (int(grid.max()) + 1) + np.where(bad[labels], grid, 0)
            _, cut = np.unique(keys, return_inverse=True)
            pieces = connected_components_of_labels(cut.reshape(labels.shape).astype(np.int32))
            labels = merge_small_labels(pieces, labels, cell * cell // 4)
        return labels

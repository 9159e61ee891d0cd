"""The left image cut into segments, each to be explained by one plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.plane_fitting.segment_planes import SegmentPlaneFit
from depthcli.algorithms.regions import RegionGraph, RegionPixels, connected_components_of_labels, merge_small_labels
from depthcli.methods.stereo.segments import Step
from depthcli.methods.stereo.segments.first_estimate import FirstEstimate


def grid_cells(shape: tuple[int, ...], cell: int) -> tuple[NDArray[np.int64], int]:
    """Return the (H, W) numbers of the cells of a grid, ``cell`` pixels wide, and a bound above them."""
    height, width = shape
    grid = (np.arange(height)[:, None] // cell) * (width // cell + 1) + np.arange(width)[None] // cell
    return grid, int(grid.max()) + 1


class Split(Step):
    """Cut segments that are not planar along a grid: a curved page has one color, but needs several planes.

    The cuts do not follow disparities: the rim of a foreground object, which windows widen, would become a segment of
    its own and keep its wrong disparity.
    """

    cells: tuple[Annotated[int, Field(ge=4, le=512)], ...] = Field(
        (), max_length=8, description="cell sides of the grids that cut segments, one per pass, pixels; empty: no cuts"
    )
    tolerance: float = Field(1.0, gt=0, le=16384, description="largest distance of a pixel that fits the plane, pixels")
    misfits: float = Field(
        0.1, ge=0, le=1, description="share of trusted pixels off its plane above which a segment is cut"
    )

    def __call__(self, labels: NDArray[np.int32], first: FirstEstimate, fit: SegmentPlaneFit) -> NDArray[np.int32]:
        """Return (H, W) int32 connected segments: ``labels``, or pieces of them.

        Parameters
        ----------
        labels : (H, W) segments 0 .. n - 1
        fit : how planes are fitted, but with the ``tolerance`` of this step
        """
        plane_fit = fit.model_copy(update={"tolerance": self.tolerance})
        for cell in self.cells:
            count = int(labels.max()) + 1
            members = RegionPixels.of(labels, first.trusted, count)
            sizes = np.bincount(labels.ravel(), minlength=count)
            active = np.flatnonzero((members.sizes >= 3) & (sizes > cell * cell // 2))
            if len(active) == 0:
                continue
            planes = plane_fit(first.values, members, active)
            not_planar = np.zeros(count, bool)
            not_planar[active] = planes.support < (1 - self.misfits) * members.sizes[active]
            grid, n_cells = grid_cells(labels.shape, cell)
            # Every (segment, cell) pair becomes a value of its own; pieces of less than a quarter cell are merged back.
            keys = labels.astype(np.int64) * n_cells + np.where(not_planar[labels], grid, 0)
            _, cut = np.unique(keys, return_inverse=True)
            pieces = connected_components_of_labels(cut.reshape(labels.shape).astype(np.int32))
            labels = merge_small_labels(pieces, labels, cell * cell // 4)
        return labels


@dataclass(frozen=True)
class SegmentedImage:
    """Segments with their first disparities.

    Attributes
    ----------
    labels : (H, W) int32 segments 0 .. n - 1
    first : disparities before any plane
    graph : sizes, colors and neighbors of the segments
    trusted, untrusted, everything : pixels of every segment: those that passed the left-right check, the others, all
    max_disparity : pixels
    """

    labels: NDArray[np.int32]
    first: FirstEstimate
    graph: RegionGraph
    trusted: RegionPixels
    untrusted: RegionPixels
    everything: RegionPixels
    max_disparity: int

    @classmethod
    def of(
        cls, labels: NDArray[np.int32], first: FirstEstimate, graph: RegionGraph, max_disparity: int
    ) -> SegmentedImage:
        """Return the segments of ``labels`` with their pixels sorted."""
        trusted, untrusted, everything = (
            RegionPixels.of(labels, mask, len(graph.sizes)) for mask in (first.trusted, ~first.trusted, None)
        )
        return cls(labels, first, graph, trusted, untrusted, everything, max_disparity)

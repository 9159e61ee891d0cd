"""Cuts segments where the first estimate shows that they are not one plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from depthcli.labelling.regions import connected_components_of_labels, merge_small_labels
from depthcli.stereo.segments.planes import Members, PlaneFit


def split_segments(
    labels: NDArray[np.int32],
    values: NDArray[np.float32],
    trusted: NDArray[np.bool_],
    tolerance: float,
    misfits: float,
    cells: tuple[int, ...],
    fit: PlaneFit,
) -> NDArray[np.int32]:
    """Cut segments that are not one plane along a grid: colour alone takes a curved page for one plane.

    The cuts ignore disparity on purpose: cut along the disparities, the fattened rim of a foreground object
    becomes a segment of its own and keeps the wrong disparity.

    Parameters
    ----------
    labels : (H, W) segments 0 .. n - 1
    values, trusted : (H, W) first estimate, pixels, and which of it counts
    tolerance : distance from the plane beyond which a pixel does not fit, pixels of disparity
    misfits : a segment is cut where a larger part of its trusted pixels does not fit
    cells : side of the grid's cells, pass after pass, pixels
    fit : how planes are fitted; its own tolerance is replaced by ``tolerance``

    Returns
    -------
    (H, W) int32, at least as many segments, each of them connected
    """
    height, width = labels.shape
    judge = replace(fit, tolerance=tolerance)
    for cell in cells:
        count = int(labels.max()) + 1
        members = Members.of(labels, trusted, count)
        sizes = np.bincount(labels.ravel(), minlength=count)
        active = np.flatnonzero((members.sizes >= 3) & (sizes > cell * cell // 2))
        if len(active) == 0:
            continue
        planes = judge(values, members, active)
        bad = np.zeros(count, bool)
        bad[active] = planes.support < (1 - misfits) * members.sizes[active]
        grid = (np.arange(height)[:, None] // cell) * (width // cell + 1) + np.arange(width)[None] // cell
        # Every (segment, cell) pair becomes a value of its own; pieces of less than a quarter cell go back.
        keys = labels.astype(np.int64) * (int(grid.max()) + 1) + np.where(bad[labels], grid, 0)
        _, cut = np.unique(keys, return_inverse=True)
        pieces = connected_components_of_labels(cut.reshape(labels.shape).astype(np.int32))
        labels = merge_small_labels(pieces, labels, cell * cell // 4)
    return labels

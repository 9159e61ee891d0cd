"""Removal of small regions of disparity."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.algorithms.regions import BAND, join, root
from depthcli.core.maps import DisparityMap, Status
from depthcli.kernels.jit import helper, jit, run_bands
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.volume import RefinementContext

_NONE = -32768  # of a pixel without a value
_MAX_STEPS = 16  # of a pixel of disparity, as in OpenCV's 16-bit disparities; fewer above 2000 disparities


class SpeckleFilter(Refinement):
    """Remove connected regions of similar disparity that are too small to be trusted (``cv2.filterSpeckles``)."""

    needs_costs = False

    size: int = Field(50, ge=1, le=10**8, description="connected regions of at most this many pixels are removed")
    step: float = Field(1.0, ge=0, le=64, description="largest disparity step within a connected region, pixels")

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        steps = steps_of(context.volume.n_disparities)
        values, status = disparity.values.copy(), disparity.status.copy()
        limit = round(self.step * steps)
        fixed = np.empty(values.shape, np.int16)
        parent, sizes = np.empty(values.size, np.int32), np.empty(values.size, np.int32)
        run_bands(_join_inside, -(-len(values) // BAND), values, np.float32(steps), limit, fixed, parent, sizes)
        _join_rims(fixed, limit, parent, sizes)
        run_bands(_remove, len(values), values, status, parent, sizes, self.size, np.uint8(Status.MISMATCH))
        return DisparityMap(values, status)


def steps_of(n_disparities: int) -> int:
    """Return the number of steps per pixel of disparity."""
    return max(1, min(_MAX_STEPS, 32767 // n_disparities))


# Regions are joined within bands of rows, all bands in parallel, and then across the rims of the bands. Each run of
# similar values in a row is a node; its first pixel represents it in ``parent``, and its region in ``sizes``.


@jit
def _join_inside(begin, end, values, steps, limit, fixed, parent, sizes):
    height, width = values.shape
    for band in range(begin, end):
        for y in range(band * BAND, min(height, (band + 1) * BAND)):
            _find_runs(values[y], steps, limit, y * width, fixed[y], parent, sizes)
            if y > band * BAND:
                _join_rows(fixed, y, limit, parent, sizes)


@jit
def _join_rims(fixed, limit, parent, sizes):
    for y in range(BAND, fixed.shape[0], BAND):
        _join_rows(fixed, y, limit, parent, sizes)


@jit
def _remove(begin, end, values, status, parent, sizes, size, mark):
    width = values.shape[1]
    for y in range(begin, end):
        run, small = -1, False
        for x in range(width):
            if parent[y * width + x] != run:
                run = parent[y * width + x]
                region = run
                while parent[region] != region:  # not root(), which would write to rows of other threads
                    region = parent[region]
                small = sizes[region] <= size
            if small and not np.isnan(values[y, x]):
                values[y, x] = np.nan
                status[y, x] |= mark


@helper
def _find_runs(values, steps, limit, at, fixed, parent, sizes):
    first = 0
    for x in range(values.size):
        fixed[x] = np.int16(_NONE) if np.isnan(values[x]) else np.int16(np.rint(values[x] * steps))
        if x > 0 and abs(np.int32(fixed[x]) - np.int32(fixed[x - 1])) > limit:
            sizes[at + first] = x - first
            first = x
        parent[at + x] = at + first
    sizes[at + first] = values.size - first


@helper
def _join_rows(fixed, y, limit, parent, sizes):
    width = fixed.shape[1]
    below = above = -1  # the runs that were joined last
    for x in range(width):
        p = y * width + x
        if abs(np.int32(fixed[y, x]) - np.int32(fixed[y - 1, x])) > limit:
            continue
        if parent[p] == below and parent[p - width] == above:
            continue
        below, above = parent[p], parent[p - width]
        i, j = root(parent, below), root(parent, above)
        if i != j:
            join(parent, i, j)
            sizes[min(i, j)] += sizes[max(i, j)]

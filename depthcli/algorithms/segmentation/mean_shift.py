"""Mean-shift segmentation (Comaniciu and Meer, PAMI 2002)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.regions import connected_components, joined_regions, merge_small_regions, region_graph
from depthcli.algorithms.segmentation import Segmenter
from depthcli.kernels.jit import empty, jit, run_bands

_LANES = 16  # pixels of a window's row in one vector
_CONVERGED, _MAX_STEPS = 0.01, 100  # a step, in radii of the window
_PER_UNIT = 16  # resolution of the colors of modes when they are joined
_JOINS = 10  # largest number of rounds in which regions join


class MeanShift(Segmenter):
    """Move every pixel to its mode in the joint space of position and color; adjacent similar modes form a region.

    Colors are those of CIE Luv, windows are round, and a pixel moves until it has converged. Neighbors whose modes are
    similar form regions, regions whose mean modes are similar join, and small ones join the most similar neighbor.
    Small radii give many small regions. Stereo matching needs this, because a region must not cross a depth edge.
    """

    aliases = ("MS",)

    spatial_radius: float = Field(7.0, ge=1, le=50, description="hs, radius of the window, pixels")
    color_radius: float = Field(6.5, gt=0, le=255, description="hr, radius of the window in Luv, lightness is 0 to 100")
    join_distance: float = Field(
        0.5, ge=0, le=1, description="largest distance of modes that join, as a share of the radius in color"
    )
    min_size: int = Field(20, ge=1, le=10**8, description="smaller regions join a neighbor, pixels")

    def __call__(self, image: NDArray[np.uint8]) -> NDArray[np.int32]:
        modes = mode_colors(image, self.spatial_radius, self.color_radius)
        limit = self.join_distance * self.color_radius
        labels = connected_components(np.rint(modes * np.float32(_PER_UNIT)).astype(np.int32), limit * _PER_UNIT)
        for _ in range(_JOINS):
            graph = region_graph(labels, modes)
            alike = graph.distances < limit * limit
            if not alike.any():
                break
            labels = joined_regions(len(graph.sizes), graph.edges[alike])[labels]
        return merge_small_regions(labels, modes, self.min_size)


def mode_colors(image: NDArray[np.uint8], spatial_radius: float, color_radius: float) -> NDArray[np.float32]:
    """Return the color of every pixel's mode, (H, W, 3) float32 in CIE Luv, of an (H, W, 3) RGB image.

    A pixel moves to the mean of those pixels within both radii (Euclidean distances, all of one weight), until it
    moves by less than 0.01 radii.
    """
    luv = cv2.cvtColor(image.astype(np.float32) * np.float32(1 / 255), cv2.COLOR_RGB2Luv)
    planes = np.pad(luv.transpose(2, 0, 1), ((0, 0), (0, 0), (0, _LANES)))
    modes = np.empty(luv.shape, np.float32)
    run_bands(_seek, len(modes), planes, float(spatial_radius), float(color_radius), modes)
    return modes


@jit
def _seek(begin, end, planes, spatial_radius, color_radius, modes):
    # Sums of a window stay separate by lane until all its rows are added. A row's part of the round window is a run of
    # columns, so that vectors compare colors only; unsigned indices, which cannot count from the end, make vector code.
    height, width, _ = modes.shape
    stride = planes.shape[2]
    first_plane, second_plane, third_plane = planes[0].ravel(), planes[1].ravel(), planes[2].ravel()
    limit = np.float32(color_radius * color_radius)
    per_pixel, per_color = 1 / (spatial_radius * spatial_radius), 1 / (color_radius * color_radius)
    sums = empty((5, _LANES), np.float32)
    number, columns, sum_a, sum_b, sum_c = sums[0], sums[1], sums[2], sums[3], sums[4]
    for y in range(begin, end):
        for x in range(width):
            u, v = float(x), float(y)
            a, b, c = planes[0, y, x], planes[1, y, x], planes[2, y, x]
            for _ in range(_MAX_STEPS):
                sums[:] = 0
                count = rows = 0.0
                top = max(int(np.ceil(v - spatial_radius)), 0)
                bottom = min(int(np.floor(v + spatial_radius)), height - 1)
                for row in range(top, bottom + 1):
                    half = np.sqrt(max(spatial_radius * spatial_radius - (row - v) ** 2, 0.0))
                    left = max(int(np.ceil(u - half)), 0)
                    right = min(int(np.floor(u + half)), width - 1)
                    for start in range(left, right + 1, _LANES):
                        last = np.int32(right - start)
                        first = np.uint64(row * stride + start)
                        for i in range(_LANES):
                            a_there = first_plane[first + np.uint64(i)]
                            b_there = second_plane[first + np.uint64(i)]
                            c_there = third_plane[first + np.uint64(i)]
                            da, db, dc = a_there - a, b_there - b, c_there - c
                            near = np.float32((da * da + db * db + dc * dc < limit) & (np.int32(i) <= last))
                            number[i] += near
                            columns[i] += near * np.float32(start + i)
                            sum_a[i] += near * a_there
                            sum_b[i] += near * b_there
                            sum_c[i] += near * c_there
                    before, count = count, float(np.sum(number))
                    rows += (count - before) * row
                if count == 0:  # the mean lies among the window's pixels, but near none of them
                    break
                inverse = 1.0 / count
                new_u, new_v = np.sum(columns) * inverse, rows * inverse
                new_a, new_b = np.float32(np.sum(sum_a) * inverse), np.float32(np.sum(sum_b) * inverse)
                new_c = np.float32(np.sum(sum_c) * inverse)
                moved = ((new_u - u) ** 2 + (new_v - v) ** 2) * per_pixel
                moved += ((new_a - a) ** 2 + (new_b - b) ** 2 + (new_c - c) ** 2) * per_color
                u, v, a, b, c = new_u, new_v, new_a, new_b, new_c
                if moved < _CONVERGED * _CONVERGED:
                    break
            modes[y, x, 0], modes[y, x, 1], modes[y, x, 2] = a, b, c

"""Mean shift in RGB with few steps, as OpenCV filters images; the method of the paper is ``mean_shift``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.regions import connected_components, merge_small_regions
from depthcli.algorithms.segmentation import Segmenter
from depthcli.kernels.jit import empty, jit, run_bands

_LANES = 16  # pixels of a window's row in one vector
_MAX_ITERATIONS, _CONVERGED_SHIFT = 5, 1  # OpenCV's defaults; shift: pixels, plus squared grey levels


class MeanShiftRgb(Segmenter):
    """Move every pixel a few steps towards its mode, in RGB and a square window; adjacent similar modes form a region.

    Like OpenCV, it makes up to five steps. It is faster than ``mean_shift``, and its regions are less reliable.
    """

    spatial_radius: float = Field(5.0, gt=0, le=50, description="hs, radius of the window, pixels")
    color_radius: float = Field(6.0, gt=0, le=255, description="hr, radius of the window in color, grey levels")
    join_distance: float = Field(4.0, ge=0, le=442, description="largest color difference of joined neighbors")
    min_size: int = Field(20, ge=1, le=10**8, description="smaller regions join a neighbor, pixels")

    def __call__(self, image: NDArray[np.uint8]) -> NDArray[np.int32]:
        filtered = mode_colors(image, self.spatial_radius, self.color_radius)
        labels = connected_components(filtered, self.join_distance)
        return merge_small_regions(labels, image, self.min_size)


def mode_colors(image: NDArray[np.uint8], spatial_radius: float, color_radius: float) -> NDArray[np.uint8]:
    """Return the color of every pixel's mode, as ``cv2.pyrMeanShiftFiltering`` with ``maxLevel=0``, but much faster.

    The spatial radius is half the side of a square window, at least 1 pixel; colors are compared by Euclidean distance.
    """
    planes = np.pad(image.transpose(2, 0, 1), ((0, 0), (0, 0), (0, _LANES)))
    modes = np.empty(image.shape, np.uint8)
    limit = np.int32(round(color_radius * color_radius))
    run_bands(_shift, len(modes), planes, max(float(spatial_radius), 1.0), limit, modes)
    return modes


@jit
def _shift(begin, end, planes, radius, limit, modes):
    # Sums of a window stay separate by lane until all its rows are added: six sums of vectors, no branch. Unsigned
    # indices, which cannot count from the end, and numbers of 32 bits make vector code of the inner loop.
    height, width, _ = modes.shape
    stride = planes.shape[2]
    all_red, all_green, all_blue = planes[0].ravel(), planes[1].ravel(), planes[2].ravel()
    for y in range(begin, end):
        sums = empty((6, _LANES), np.int32)
        number, columns, rows, reds, greens, blues = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
        for x in range(width):
            u, v = x, y
            red, green, blue = np.int32(planes[0, y, x]), np.int32(planes[1, y, x]), np.int32(planes[2, y, x])
            for _ in range(_MAX_ITERATIONS):
                left, right = max(int(np.rint(u - radius)), 0), min(int(np.rint(u + radius)), width - 1)
                top, bottom = max(int(np.rint(v - radius)), 0), min(int(np.rint(v + radius)), height - 1)
                sums[:] = 0
                for start in range(left, right + 1, _LANES):
                    last = np.int32(right - start)
                    for row in range(top, bottom + 1):
                        first = np.uint64(row * stride + start)
                        for i in range(_LANES):
                            a = np.int32(all_red[first + np.uint64(i)])
                            b = np.int32(all_green[first + np.uint64(i)])
                            c = np.int32(all_blue[first + np.uint64(i)])
                            dr, dg, db = a - red, b - green, c - blue
                            squared = np.int32(np.int32(dr * dr) + np.int32(dg * dg)) + np.int32(db * db)
                            near = np.int32((np.int32(squared) <= limit) & (np.int32(i) <= last))
                            number[i] += near
                            columns[i] += np.int32(near * np.int32(start + i))
                            rows[i] += np.int32(near * np.int32(row))
                            reds[i] += np.int32(near * a)
                            greens[i] += np.int32(near * b)
                            blues[i] += np.int32(near * c)
                count = np.sum(number)
                if count == 0:
                    break
                inverse = 1.0 / count
                new_u, new_v = int(np.rint(np.sum(columns) * inverse)), int(np.rint(np.sum(rows) * inverse))
                new_red = np.int32(np.rint(np.sum(reds) * inverse))
                new_green = np.int32(np.rint(np.sum(greens) * inverse))
                new_blue = np.int32(np.rint(np.sum(blues) * inverse))
                shift = abs(new_u - u) + abs(new_v - v)
                change = (new_red - red) ** 2 + (new_green - green) ** 2 + (new_blue - blue) ** 2
                u, v, red, green, blue = new_u, new_v, new_red, new_green, new_blue
                if shift == 0 or shift + change <= _CONVERGED_SHIFT:
                    break
            modes[y, x, 0], modes[y, x, 1], modes[y, x, 2] = red, green, blue

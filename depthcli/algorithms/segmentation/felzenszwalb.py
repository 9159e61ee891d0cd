"""Graph-based segmentation (Felzenszwalb and Huttenlocher, IJCV 2004)."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from depthcli.algorithms.regions import connected_components_of_labels, consecutive, merge_small_regions, root
from depthcli.algorithms.segmentation import Segmenter
from depthcli.core.maps import Image8, Ints
from depthcli.kernels.jit import jit, run_bands, zeros

_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))  # down and right: half of the eight neighbors
_PER_LEVEL = 128  # resolution of costs
_NO_EDGE = 65535  # neighbor outside the image; the largest cost is 255 * 3^0.5 * _PER_LEVEL


class Felzenszwalb(Segmenter):
    """Join regions whose difference is small compared with the differences inside both; textured regions grow larger.

    Edges connect eight neighbors. Their costs are Euclidean distances of colors, rounded to 1/128 grey level.
    """

    aliases = ("FH",)

    scale: float = Field(20.0, gt=0, le=1e6, description="larger values give larger regions, grey levels x pixels")
    sigma: float = Field(
        0.8, ge=0, le=10, description="standard deviation of the smoothing before segmentation, pixels"
    )
    min_size: int = Field(20, ge=1, le=10**8, description="smaller regions join a neighbor, pixels")

    def __call__(self, image: Image8) -> Ints:
        smooth = image.astype(np.float32)
        if self.sigma:
            smooth = np.asarray(cv2.GaussianBlur(smooth, (0, 0), self.sigma, borderType=cv2.BORDER_REFLECT), np.float32)
        smooth = smooth.reshape(*image.shape[:2], -1)
        costs = np.full((*image.shape[:2], len(_STEPS)), _NO_EDGE, np.uint16)
        run_bands(_edge_costs, len(smooth), smooth, costs)
        costs = costs.ravel()
        order = np.argsort(costs, kind="stable")  # radix sort of 16-bit numbers: linear time
        order = order[: np.searchsorted(costs, _NO_EDGE, sorter=order)]
        labels = _joined(order, costs, image.shape[1], image.shape[0] * image.shape[1], self.scale, self.min_size)
        pieces = connected_components_of_labels(labels.reshape(image.shape[:2]))
        return merge_small_regions(pieces, image, self.min_size)


@jit
def _edge_costs(begin, end, image, costs):
    # Write the color distance of every pixel from its neighbors _STEPS inside the image, in 1 / _PER_LEVEL grey levels.
    height, width, channels = image.shape
    for y in range(begin, end):
        for x in range(width):
            for k in range(len(_STEPS)):
                v, u = y + _STEPS[k][0], x + _STEPS[k][1]
                if v < height and 0 <= u < width:
                    squared = np.float32(0)
                    for c in range(channels):
                        difference = image[y, x, c] - image[v, u, c]
                        squared += difference * difference
                    costs[y, x, k] = np.uint16(np.sqrt(squared) * np.float32(_PER_LEVEL) + np.float32(0.5))


@jit
def _joined(order, costs, width, n_pixels, scale, min_size):
    # Return the regions of the pixels, (N,) int32, joined by edges in the ``order`` of their costs.
    parent = np.arange(n_pixels).astype(np.int32)
    size = np.ones(n_pixels, np.int32)
    inside = zeros(n_pixels, np.float32)  # the most costly edge of each region's tree
    unit = np.float32(1 / _PER_LEVEL)
    for round_number in range(2):  # the second round joins small regions, whatever the cost
        for edge in order:
            pixel, k = divmod(edge, len(_STEPS))
            a = root(parent, pixel)
            b = root(parent, pixel + _STEPS[k][0] * width + _STEPS[k][1])
            if a == b:
                continue
            cost = np.float32(costs[edge]) * unit
            if round_number == 0:
                joins = cost < min(inside[a] + scale / size[a], inside[b] + scale / size[b])
            else:
                joins = size[a] < min_size or size[b] < min_size
            if joins:
                first, last = min(a, b), max(a, b)  # roots come before their members
                parent[last] = first
                size[first] += size[last]
                inside[first] = cost
    return consecutive(parent)

"""Statistical region merging (Nock and Nielsen, PAMI 2004), guided by known depth (thesis, section 4)."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from depthcli.algorithms.regions import consecutive, root
from depthcli.algorithms.segmentation import Segmenter
from depthcli.core.maps import Floats, Image8, Ints
from depthcli.kernels.jit import empty, helper, jit, zeros

_LEVELS = 256  # number of grey levels; g of the paper
_DEPTH_LEVELS = 4095  # small enough that sums over a large image fit into int32
_TABLE = 4096  # bounds are tabulated for smaller regions
_SIZE, _COLOR, _KNOWN, _DEPTH = 0, 1, 4, 5  # columns of a region's row of sums


class StatisticalRegionMerging(Segmenter):
    """Merge neighbors in order of their difference, unless the means of their regions differ significantly.

    With depth, the order and the test also use depth. A region of unknown depth merges by color alone, so that regions
    extend over the gaps of a sensor's map.
    """

    complexity: float = Field(128, gt=0, le=65536, description="Q of the paper; a larger Q gives more regions")
    coarser: tuple[Annotated[float, Field(gt=0, le=65536)], ...] = Field(
        (), description="Q of further, coarser layers, in falling order; each merges regions of the layer before it"
    )
    depth_guidance: float = Field(16, ge=0, le=65536, description="Q of the test on depth; 0: depth is not used")
    smoothing: float = Field(1.0, ge=0, le=10, description="sigma of the 3 x 3 Gaussian before merging; 0: none")
    min_size: int = Field(20, ge=1, le=10**8, description="smaller regions finally join a neighbor, pixels")

    @model_validator(mode="after")
    def _check_order(self) -> StatisticalRegionMerging:
        if any(b >= a for a, b in pairwise((self.complexity, *self.coarser))):
            raise ValueError("complexity and coarser must fall from layer to layer")
        return self

    def __call__(self, image: Image8, depth: Floats | None = None) -> Ints:
        return self._merged(image, depth, (self.complexity,))[0]

    def layers(self, image: Image8, depth: Floats | None = None) -> list[Ints]:
        return self._merged(image, depth, (self.complexity, *self.coarser))

    def _merged(self, image: Image8, depth: Floats | None, complexities: tuple[float, ...]) -> list[Ints]:
        smooth = np.asarray(cv2.GaussianBlur(image, (3, 3), self.smoothing) if self.smoothing else image, np.uint8)
        guide = _depth_levels(depth) if depth is not None and self.depth_guidance else np.empty((0, 0), np.int16)
        labels = np.empty((len(complexities), *image.shape[:2]), np.int32)
        sums = np.zeros((*image.shape[:2], 8), np.int32)  # a region's sums share a cache line
        sums[..., _SIZE] = 1
        sums[..., _COLOR : _COLOR + 3] = smooth
        if guide.size:
            sums[..., _KNOWN], sums[..., _DEPTH] = guide >= 0, np.maximum(guide, 0)
        pairs, sums = _sorted_pairs(smooth, guide), sums.reshape(-1, 8)
        _merge(pairs, sums, guide.size > 0, np.array(complexities), self.depth_guidance, self.min_size, labels)
        return list(labels)


def _depth_levels(depth: Floats) -> NDArray[np.int16]:
    # Return levels over the range from the 0.5 % to the 99.5 % quantile, -1 = unknown; all -1 if the range is empty.
    known = depth[~np.isnan(depth)]
    low, high = np.percentile(known, (0.5, 99.5)) if known.size else (0.0, 0.0)
    if not high > low:
        return np.full(depth.shape, -1, np.int16)
    share = np.clip((depth - np.float32(low)) / np.float32(high - low), 0, 1)
    return np.where(np.isnan(share), np.float32(-1), np.rint(share * _DEPTH_LEVELS)).astype(np.int16)


def _sorted_pairs(image: Image8, depth: NDArray[np.int16]) -> Ints:
    # Return 4-neighbor pairs sorted by difference: 2 p for (p, right of p), 2 p + 1 for (p, below p).
    keys = np.full((*image.shape[:2], 2), -1, np.int16)  # -1: the neighbor is outside the image
    neighbors: Any = ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:]))
    for step, (first, second) in enumerate(neighbors):
        change = np.maximum(image[first], image[second]) - np.minimum(image[first], image[second])
        key = np.maximum(np.maximum(change[..., 0], change[..., 1]), change[..., 2]).astype(np.int16)
        if depth.size:
            one, other = depth[first], depth[second]
            jump = 255 * np.abs(one - other).astype(np.int32) // _DEPTH_LEVELS
            key = np.maximum(key, np.where((one >= 0) & (other >= 0), jump, 0).astype(np.int16))
        keys[first][..., step] = key
    order = np.argsort(keys.ravel(), kind="stable").astype(np.int32)
    return order[sum(image.shape[:2]) :]


@helper
def _bound(size, log_pixels, complexity, levels):
    # Return b^2 of the paper for a region of ``size`` pixels with values in ``levels``.
    spread = min(size, _LEVELS) * np.log(1.0 + size) + np.log(6.0) + 2 * log_pixels
    return np.float32(levels * levels * spread / (2 * complexity * size))


@helper
def _bounds(log_pixels, complexity, levels):
    table = zeros(_TABLE, np.float32)
    for size in range(1, _TABLE):
        table[size] = _bound(size, log_pixels, complexity, levels)
    return table


@helper
def _look_up(table, size, log_pixels, complexity, levels):
    return table[size] if size < _TABLE else _bound(np.int64(size), log_pixels, complexity, levels)


@jit
def _merge(pairs, sums, guided, complexities, guidance, min_size, labels):
    _, height, width = labels.shape
    pixels = height * width
    log_pixels = np.log(float(pixels))
    n_left = pairs.size  # pairs that no layer has joined yet
    parent = np.arange(pixels).astype(np.int32)
    bound = empty((pixels, 2), np.float32)
    depth_table = _bounds(log_pixels, guidance, _DEPTH_LEVELS) if guided else empty(0, np.float32)
    for layer in range(complexities.size):
        complexity = complexities[layer]
        table = _bounds(log_pixels, complexity, _LEVELS)
        for p in range(pixels):
            if parent[p] == p:
                bound[p, 0] = _look_up(table, sums[p, _SIZE], log_pixels, complexity, _LEVELS)
                if guided and layer == 0:
                    bound[p, 1] = depth_table[1]
        count, n_left = n_left, 0
        for k in range(count):
            pair = pairs[k]
            i = pair >> 1
            j = i + 1 if pair & 1 == 0 else i + width
            i, j = root(parent, i), root(parent, j)
            if i == j:
                continue
            limit = bound[i, 0] + bound[j, 0]
            scale_a, scale_b = 1 / np.float64(sums[i, _SIZE]), 1 / np.float64(sums[j, _SIZE])
            same = True
            for c in range(_COLOR, _COLOR + 3):
                difference = sums[i, c] * scale_a - sums[j, c] * scale_b
                same &= difference * difference <= limit
            if guided and sums[i, _KNOWN] > 0 and sums[j, _KNOWN] > 0:
                difference = sums[i, _DEPTH] / np.float64(sums[i, _KNOWN]) - sums[j, _DEPTH] / np.float64(
                    sums[j, _KNOWN]
                )
                same &= difference * difference <= bound[i, 1] + bound[j, 1]
            if not same:
                pairs[n_left] = pair
                n_left += 1
                continue
            if j < i:  # the smaller index becomes the root, so that labels do not depend on the order
                i, j = j, i
            parent[j] = i
            for c in range(6):
                sums[i, c] += sums[j, c]
            bound[i, 0] = _look_up(table, sums[i, _SIZE], log_pixels, complexity, _LEVELS)
            if guided and sums[i, _KNOWN] > 0:
                bound[i, 1] = _look_up(depth_table, sums[i, _KNOWN], log_pixels, guidance, _DEPTH_LEVELS)
        found = _without_small(parent, sums[:, _SIZE].copy(), pairs[:n_left], width, min_size)
        for y in range(height):  # numba compiles the assignment of a whole array with a message about its shape
            for x in range(width):
                labels[layer, y, x] = found[y * width + x]


@helper
def _without_small(parent, size, pairs, width, min_size):
    # Return labels after small regions have joined along the most similar of the remaining ``pairs``.
    parent = parent.copy()
    for pair in pairs:
        i = pair >> 1
        j = i + 1 if pair & 1 == 0 else i + width
        i, j = root(parent, i), root(parent, j)
        if i != j and min(size[i], size[j]) < min_size:
            i, j = min(i, j), max(i, j)
            parent[j] = i
            size[i] += size[j]
    return consecutive(parent)

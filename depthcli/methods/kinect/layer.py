"""One layer of a refinement: segments, the surface of each, and what it says about every pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.polynomials import Surfaces
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthStatus
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.kinect.model import SurfaceModel
from depthcli.methods.kinect.noise import noise_level
from depthcli.methods.kinect.occlusion import farthest_fit
from depthcli.methods.kinect.surfaces import add_detail, join_segments
from depthcli.methods.kinect.suspects import jump_distance

_DEEP = 6  # pixels into the near side: where the outline of a thing that is all suspect is likely behind
_LEAST_DEEP = 5  # pixels so deep that make a model of their own

_KEPT, _FILLED, _CORRECTED, _FALLBACK, _EMPTY, _SMOOTHED = (
    int(s)
    for s in (
        DepthStatus.KEPT, DepthStatus.GAP_FILLED, DepthStatus.CORRECTED, DepthStatus.FALLBACK, DepthStatus.EMPTY,
        DepthStatus.SMOOTHED,
    )
)  # fmt: skip


@dataclass(frozen=True)
class Evidence:
    """What a frame says before anything is fitted.

    Attributes
    ----------
    disparity : (H, W) float32 measured, pixels, NaN = unknown
    trusted : (H, W) float32, the same without suspects
    deep : (H, W) bool, suspects that lie well within the near side
    limit : (H, W) float32, largest disparity that fits the gap, inf where it looks like no shadow
    noise : standard deviation of the measurement, pixels
    """

    disparity: NDArray[np.float32]
    trusted: NDArray[np.float32]
    deep: NDArray[np.bool_]
    limit: NDArray[np.float32]
    noise: float


def evidence(frame: RgbdFrame, jump: float, row_band: int, column_band: int, noise: float | None = None) -> Evidence:
    """Look at a frame.

    Parameters
    ----------
    jump : multiples of the noise
    row_band, column_band : suspects lie at most so many pixels into the near side of a jump; 0: none is
    noise : pixels, where it is known already

    Raises
    ------
    ValueError
        Where no pixel has a depth.
    """
    disparity = frame.disparity
    if np.isnan(disparity).all():
        raise ValueError("no pixel of the frame has a depth")
    noise = noise_level(disparity) if noise is None else noise
    distance = jump_distance(disparity, jump * noise)
    suspect = distance.inside(row_band, column_band)
    return Evidence(
        disparity=disparity,
        trusted=np.where(suspect, np.float32(np.nan), disparity),
        deep=suspect & (distance.row > _DEEP) & (distance.column > 1),
        limit=farthest_fit(disparity, jump * noise),
        noise=noise,
    )


@dataclass(frozen=True)
class Layer:
    """A partition of the frame with a surface for every part.

    Attributes
    ----------
    labels : (H, W) int32, the surface of every pixel, -1 where there is none
    surfaces : n of them
    own : (H, W) bool, the surface was fitted to the pixel's own segment, not to one that the segment joined
    """

    labels: NDArray[np.int32]
    surfaces: Surfaces
    own: NDArray[np.bool_]

    def estimate(self, seen: Evidence, reach: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(H, W) float32 value and scale at every pixel; detail within ``reach`` pixels of what is trusted, 0: none."""
        values = self.surfaces.at(self.labels)
        if reach:
            add_detail(values, seen.trusted, self.labels, self.surfaces.scale, reach)
        scale = np.where(self.labels < 0, np.float32(np.nan), self.surfaces.scale[self.labels])
        return values, scale


def fit_layer(
    seen: Evidence,
    labels: NDArray[np.int32],
    color: NDArray[np.uint8],
    model: SurfaceModel,
    min_known: int,
    min_share: float,
    join: bool,
) -> Layer:
    """Fit ``model`` to the segments ``labels`` (H, W), and let those where it cannot be fitted join others.

    Parameters
    ----------
    color : (H, W, 3) uint8 CIELAB
    min_known, min_share : trusted pixels that a segment needs, and their share of it. Failing that, one whose
        measured pixels mostly lie deep in the band of suspects is fitted to those
    join : False: a segment without a model stays without a surface
    """
    count = int(labels.max()) + 1
    sizes = _count(labels, seen.disparity, seen.trusted, seen.deep, count)
    size, known, suspects, deep = sizes.T
    modelled = (known >= min_known) & (known >= min_share * size)
    by_suspects = ~modelled & (deep >= _LEAST_DEEP) & (2 * deep >= known + suspects)
    values = seen.trusted
    if by_suspects.any():
        values = np.where(by_suspects[labels] & seen.deep, seen.disparity, seen.trusted)
    surfaces = model(values, labels, seen.noise)
    modelled |= by_suspects
    owners = np.where(modelled, np.arange(count, dtype=np.int32), np.int32(-1))
    if join:
        owners = join_segments(labels, modelled, surfaces, color, seen.limit)
    return Layer(owners[labels], surfaces, modelled[labels])


@jit
def _count(labels, disparity, trusted, deep, count):  # type: ignore[no-untyped-def]
    """Pixels of every segment: all, trusted, suspect, deep among the suspects."""
    sizes = np.zeros((count, 4), np.int32)
    height, width = labels.shape
    for y in range(height):
        for x in range(width):
            s = labels[y, x]
            sizes[s, 0] += 1
            if not np.isnan(trusted[y, x]):
                sizes[s, 1] += 1
            elif not np.isnan(disparity[y, x]):
                sizes[s, 2] += 1
                if deep[y, x]:
                    sizes[s, 3] += 1
    return sizes


@dataclass(frozen=True)
class Refined:
    """(H, W) maps: disparity and its scale, float32 pixels, NaN = none; status uint8."""

    disparity: NDArray[np.float32]
    scale: NDArray[np.float32]
    status: NDArray[np.uint8]


def combine(layers: list[Layer], seen: Evidence, reach: float, tolerance: float, smooth: bool) -> Refined:
    """The median of what the layers say, where the measurement is unknown or a suspect that contradicts it.

    Parameters
    ----------
    reach : of detail, see :meth:`Layer.estimate`
    tolerance : a measured value contradicts the surface from so many scales on
    smooth : a measured value that does not is replaced by the surface as well
    """
    shape = (len(layers), *seen.disparity.shape)
    values, scales, own = np.empty(shape, np.float32), np.empty(shape, np.float32), np.zeros(shape[1:], bool)
    for k, layer in enumerate(layers):
        values[k], scales[k] = layer.estimate(seen, reach)
        own |= layer.own
    result = Refined(np.empty(shape[1:], np.float32), np.empty(shape[1:], np.float32), np.empty(shape[1:], np.uint8))
    _decide(
        values, scales, own, seen.disparity, seen.trusted, np.float32(tolerance), np.float32(seen.noise), smooth,
        result.disparity, result.scale, result.status,
    )  # fmt: skip
    return result


@jit
def _median(sorted_values, count):  # type: ignore[no-untyped-def]
    middle = count >> 1
    if count & 1:
        return sorted_values[middle]
    return np.float32(0.5) * (sorted_values[middle - 1] + sorted_values[middle])


@parallel_jit
def _decide(values, scales, own, disparity, trusted, tolerance, noise, smooth, out, scale, status):  # type: ignore[no-untyped-def]
    layers, height, width = values.shape
    for y in prange(height):
        value, spread = np.empty(layers, np.float32), np.empty(layers, np.float32)
        for x in range(width):
            count = 0
            for k in range(layers):
                if np.isnan(values[k, y, x]):
                    continue
                i = count
                while i > 0 and value[i - 1] > values[k, y, x]:
                    value[i] = value[i - 1]
                    i -= 1
                value[i] = values[k, y, x]
                i = count
                while i > 0 and spread[i - 1] > scales[k, y, x]:
                    spread[i] = spread[i - 1]
                    i -= 1
                spread[i] = scales[k, y, x]
                count += 1
            measured = disparity[y, x]
            if count == 0:
                out[y, x] = measured
                scale[y, x] = np.nan if np.isnan(measured) else noise
                status[y, x] = _EMPTY if np.isnan(measured) else _KEPT
                continue
            middle = _median(value, count)
            scale[y, x] = max(_median(spread, count), noise)
            if np.isnan(measured):
                out[y, x] = middle
                status[y, x] = _FILLED if own[y, x] else _FALLBACK
            elif abs(measured - middle) <= tolerance * scale[y, x]:
                out[y, x] = middle if smooth else measured
                status[y, x] = _KEPT | _SMOOTHED if smooth else _KEPT
            elif np.isnan(trusted[y, x]):
                out[y, x] = middle
                status[y, x] = _CORRECTED
            else:
                out[y, x] = measured
                status[y, x] = _KEPT


def lab_of(color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 CIELAB of RGB."""
    return np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2Lab), dtype=np.uint8)

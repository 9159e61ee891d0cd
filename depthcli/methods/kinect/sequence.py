"""What is carried from frame to frame, and what of it still holds in the next one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.polynomials import Surfaces, surface_at
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.kinect.layer import Evidence, Layer
from depthcli.methods.kinect.surfaces import SHADOW_PENALTY

_SURFACE = ("coefficients", "center", "bounds", "scale")


@dataclass(frozen=True)
class SequenceState:
    """What a sequence knows after a frame.

    Attributes
    ----------
    layers : the segments' labels and surfaces
    color : (H, W, 3) uint8, of the frame
    disparity : (H, W) float32, refined, pixels, NaN = none
    noise : of the frame that was segmented last, pixels
    age : frames since then
    """

    layers: tuple[Layer, ...]
    color: NDArray[np.uint8]
    disparity: NDArray[np.float32]
    noise: float
    age: int

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Everything as arrays by name, for ``np.savez``; :meth:`from_arrays` gives the same state back."""
        found: dict[str, NDArray[Any]] = {
            "color": self.color,
            "disparity": self.disparity,
            "noise": np.array(self.noise),
            "age": np.array(self.age),
        }
        for k, layer in enumerate(self.layers):
            found |= {f"labels_{k}": layer.labels, f"own_{k}": layer.own, f"unit_{k}": np.array(layer.surfaces.unit)}
            found |= {f"{name}_{k}": getattr(layer.surfaces, name) for name in _SURFACE}
        return found

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> SequenceState:
        """The state that :meth:`arrays` came from; KeyError where something is missing."""
        layers: list[Layer] = []
        while f"labels_{len(layers)}" in arrays:
            k = len(layers)
            surfaces = Surfaces(
                **{name: arrays[f"{name}_{k}"] for name in _SURFACE}, unit=float(arrays[f"unit_{k}"])
            )  # fmt: skip
            layers.append(Layer(arrays[f"labels_{k}"], surfaces, arrays[f"own_{k}"]))
        return cls(
            tuple(layers), arrays["color"], arrays["disparity"], float(arrays["noise"]), int(arrays["age"])
        )  # fmt: skip


def still_pixels(
    color: NDArray[np.uint8],
    color_before: NDArray[np.uint8],
    trusted: NDArray[np.float32],
    disparity_before: NDArray[np.float32],
    color_change: int,
    disparity_change: float,
) -> NDArray[np.bool_]:
    """(H, W) bool: no color channel and no trusted disparity is off by more than the changes given.

    What has no trusted disparity, now or before, is judged by its color.
    """
    still = np.empty(trusted.shape, np.bool_)
    _still(color, color_before, trusted, disparity_before, color_change, np.float32(disparity_change), still)
    return still


@parallel_jit
def _still(color, color_before, trusted, before, color_change, change, still):  # type: ignore[no-untyped-def]
    height, width = trusted.shape
    for y in prange(height):
        for x in range(width):
            most = np.int64(0)
            for c in range(3):
                most = max(most, abs(np.int64(color[y, x, c]) - np.int64(color_before[y, x, c])))
            moved = abs(trusted[y, x] - before[y, x]) > change  # False where either is NaN
            still[y, x] = most <= color_change and not moved


def carried_labels(
    layer: Layer, still: NDArray[np.bool_], color: NDArray[np.uint8], seen: Evidence, jump: float
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Labels and ``own`` of a layer in the next frame, both (H, W).

    A still pixel keeps its segment, unless its trusted disparity is off the surface by more than a jump and three
    scales, or the surface is nearer by a jump than its shadow allows. Others take the segment of the 8-neighbor that is
    nearest: along the path the absolute differences of color add up, and at every pixel what the surface is off
    its trusted disparity, in fifths of the noise, or much where the surface is nearer than the shadow allows. Two
    raster sweeps, so that bent paths may be missed. Label -1 where no segment holds anywhere.

    Parameters
    ----------
    still : (H, W) bool
    color : (H, W, 3) uint8
    seen : of the next frame
    jump : pixels
    """
    surfaces = layer.surfaces
    shapes = (surfaces.coefficients, surfaces.center, surfaces.bounds, surfaces.unit)
    cost = np.empty(still.shape, np.float32)
    _held(layer.labels, still, seen.trusted, seen.limit, *shapes, surfaces.scale, np.float32(jump), cost)
    labels, own = layer.labels.copy(), layer.own.copy()
    _sweep(cost, labels, own, color, seen.trusted, seen.limit, *shapes, np.float32(5 / seen.noise))
    return labels, own


@parallel_jit
def _held(labels, still, trusted, limit, coefficients, center, bounds, unit, scale, jump, cost):  # type: ignore[no-untyped-def]
    """0 where a pixel keeps its segment, else infinite."""
    height, width = labels.shape
    for y in prange(height):
        for x in range(width):
            s = labels[y, x]
            cost[y, x] = np.inf
            if s < 0 or not still[y, x]:
                continue
            value = surface_at(coefficients, center, bounds, unit, s, y, x)
            off = abs(trusted[y, x] - value)
            if not off > jump + 3 * scale[s] and not value > limit[y, x] + jump:  # False where it is unknown
                cost[y, x] = 0


@jit
def _sweep(cost, labels, own, color, trusted, limit, coefficients, center, bounds, unit, weight):  # type: ignore[no-untyped-def]
    height, width = labels.shape
    for y in range(height):
        for x in range(width):
            if cost[y, x] > 0:
                labels[y, x] = -1
    held = cost.copy()
    for step in (1, -1):
        for j in range(height):
            y = j if step == 1 else height - 1 - j
            for i in range(width):
                x = i if step == 1 else width - 1 - i
                if held[y, x] == 0:
                    continue
                for k in range(4):
                    v = y if k == 0 else y - step
                    u = x - step if k == 0 else x + (k - 2)
                    if not (0 <= v < height and 0 <= u < width) or labels[v, u] < 0:
                        continue
                    total = cost[v, u]
                    for c in range(3):
                        total += np.float32(abs(np.int64(color[y, x, c]) - np.int64(color[v, u, c])))
                    value = surface_at(coefficients, center, bounds, unit, labels[v, u], y, x)
                    apart = weight * np.float32(abs(trusted[y, x] - value))
                    if not np.isnan(apart):
                        total += apart
                    if value > limit[y, x]:
                        total += np.float32(SHADOW_PENALTY)
                    if total < cost[y, x]:
                        cost[y, x] = total
                        labels[y, x] = labels[v, u]
                        own[y, x] = own[v, u]

"""A small trained network, evaluated at every pixel: two layers of rectified units, and one output, the log odds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.kernels.lanes import LANES, load, minimum, splat, store

INPUT_BOUND = np.float32(4.0)  # standard deviations; scripts/train_choice.py clips at the same
TILE = 4  # units of a layer that are summed at a time: their sums stay in registers
_CHUNK = 64  # vectors of pixels a task


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A network of two hidden layers of rectified units: the log odds that each of N maps is right at a pixel.

    Attributes
    ----------
    maps : names of the N methods whose maps it was trained for
    inputs : names of its F inputs
    mean, scale : (F,) float32; the first layer gets ``(x - mean) scale`` of an input x
    layers : three pairs (weights, offsets), float32, of shapes (F, U) and (N, U); (U, V) and (V,); (V, 1) and (1,).
        The first layer has one row of offsets per map; all other weights are shared by the maps
    trained_on : names of the scenes that it was trained on

    Raises
    ------
    InputError
        The shapes do not fit each other, or a number is not finite.
    """

    maps: tuple[str, ...]
    inputs: tuple[str, ...]
    mean: NDArray[np.float32]
    scale: NDArray[np.float32]
    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    trained_on: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        arrays = [self.mean, self.scale, *(array for layer in self.layers for array in layer)]
        shapes = [array.shape for array in arrays]
        n, f = len(self.maps), len(self.inputs)
        u, v = (shapes[k][-1] if len(shapes) > k and shapes[k] else 0 for k in (2, 4))
        if shapes != [(f,), (f,), (f, u), (n, u), (u, v), (v,), (v, 1), (1,)]:
            raise InputError(f"arrays of shapes {str(shapes)[:200]} for {n} maps and {f} inputs")
        if not all(np.isfinite(array).all() for array in arrays):
            raise InputError("weights that are not finite")


def log_odds(
    trained: TrainedNetwork, offsets: NDArray[np.float32], planes: NDArray[np.float32], others: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the log odds of every pixel, in the shape of a plane, float32.

    Parameters
    ----------
    offsets : (U,) of the units of the first layer
    planes, others : the network's inputs in their order, (F1, ...) and (F2, ...) float32, F1 + F2 = F
    """
    out = np.empty(planes.shape[1:], np.float32)
    (w1, _), (w2, b2), (w3, b3) = trained.layers
    inputs = (planes.reshape(-1), others.reshape(-1), trained.mean, trained.scale)
    layers = (_tiled(w1), offsets.astype(np.float32), _tiled(w2), b2, w3.ravel(), b3)
    _evaluate(*inputs, *layers, out.reshape(-1))
    return out


def _tiled(weights: NDArray[np.float32]) -> NDArray[np.float32]:
    # (units / 4, inputs, 4): in the order in which the kernel reads them
    inputs, units = weights.shape
    return np.ascontiguousarray(weights.reshape(inputs, units // TILE, TILE).transpose(1, 0, 2))


@jit
def _positive(a):
    return splat(np.float32(0)) - minimum(splat(np.float32(0)) - a, splat(np.float32(0)))


@jit
def _layer(source, inputs, weights, offsets, target):
    # Rectified units of LANES pixels: flat ``source`` and ``target`` hold LANES values an input, a unit.
    for tile in range(weights.shape[0]):
        w = weights[tile]
        a, b = splat(offsets[tile * TILE]), splat(offsets[tile * TILE + 1])
        c, d = splat(offsets[tile * TILE + 2]), splat(offsets[tile * TILE + 3])
        for i in range(inputs):
            x = load(source, i * LANES)
            a += splat(w[i, 0]) * x
            b += splat(w[i, 1]) * x
            c += splat(w[i, 2]) * x
            d += splat(w[i, 3]) * x
        store(target, (tile * TILE) * LANES, _positive(a))
        store(target, (tile * TILE + 1) * LANES, _positive(b))
        store(target, (tile * TILE + 2) * LANES, _positive(c))
        store(target, (tile * TILE + 3) * LANES, _positive(d))


@parallel_jit
def _evaluate(alone, others, mean, scale, w1, b1, w2, b2, w3, b3, out):
    pixels = out.size
    n_alone, size = alone.size // pixels, mean.size
    groups = (pixels + LANES - 1) // LANES
    for task in prange((groups + _CHUNK - 1) // _CHUNK):
        inputs = np.zeros(size * LANES, np.float32)
        hidden = np.empty(w1.shape[0] * TILE * LANES, np.float32)
        second = np.empty(w2.shape[0] * TILE * LANES, np.float32)
        last = np.empty(LANES, np.float32)
        for group in range(task * _CHUNK, min(groups, (task + 1) * _CHUNK)):
            first = group * LANES
            count = min(LANES, pixels - first)
            for k in range(n_alone):
                center, factor, at = mean[k], scale[k], k * pixels + first
                for i in range(count):
                    z = (alone[at + i] - center) * factor
                    inputs[k * LANES + i] = min(max(z, -INPUT_BOUND), INPUT_BOUND)
            for k in range(n_alone, size):
                center, factor, at = mean[k], scale[k], (k - n_alone) * pixels + first
                for i in range(count):
                    z = (others[at + i] - center) * factor
                    inputs[k * LANES + i] = min(max(z, -INPUT_BOUND), INPUT_BOUND)
            _layer(inputs, size, w1, b1, hidden)
            _layer(hidden, w1.shape[0] * TILE, w2, b2, second)
            total = splat(b3[0])
            for k in range(w3.size):
                total += splat(w3[k]) * load(second, k * LANES)
            store(last, 0, total)
            for i in range(count):
                out[first + i] = last[i]

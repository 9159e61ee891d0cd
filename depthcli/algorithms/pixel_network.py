"""A small trained network, evaluated at every pixel: two layers of rectified units, and one output, the log odds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.kernels.lanes import LANES, load, maximum, minimum, splat, store

INPUT_BOUND = np.float32(4.0)  # standard deviations; scripts/train_choice.py clips at the same
TILE = 4  # units of a layer that are summed at a time: their sums stay in registers
_CHUNK = 32  # pairs of vectors of pixels a task


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


def of_first(trained: TrainedNetwork, count: int) -> TrainedNetwork:
    """Return the network of the first ``count`` inputs where all others are 0."""
    (w1, rows), *rest = trained.layers
    zeros = ((0 - trained.mean[count:]) * trained.scale[count:]).clip(-INPUT_BOUND, INPUT_BOUND)
    first = np.ascontiguousarray(w1[:count]), (rows + zeros @ w1[count:]).astype(np.float32)
    return replace(
        trained,
        inputs=trained.inputs[:count],
        mean=trained.mean[:count],
        scale=trained.scale[:count],
        layers=(first, *rest),
    )


def _tiled(weights: NDArray[np.float32]) -> NDArray[np.float32]:
    # (units / 4, inputs, 4): in the order in which the kernel reads them
    inputs, units = weights.shape
    return np.ascontiguousarray(weights.reshape(inputs, units // TILE, TILE).transpose(1, 0, 2))


@jit
def _positive(a):
    return maximum(a, splat(np.float32(0)))


@jit
def _layer(source, inputs, weights, offsets, target):
    # Rectified units of two vectors of pixels: flat ``source`` and ``target`` hold both, an input, a unit. Eight sums
    # are enough for none of them to wait for the one before.
    for tile in range(weights.shape[0]):
        w, unit = weights[tile], tile * TILE
        a, b, c, d = splat(offsets[unit]), splat(offsets[unit + 1]), splat(offsets[unit + 2]), splat(offsets[unit + 3])
        e, f, g, h = a, b, c, d
        for i in range(inputs):
            x, y = load(source, 2 * i * LANES), load(source, (2 * i + 1) * LANES)
            p, q, r, s = splat(w[i, 0]), splat(w[i, 1]), splat(w[i, 2]), splat(w[i, 3])
            a += p * x
            e += p * y
            b += q * x
            f += q * y
            c += r * x
            g += r * y
            d += s * x
            h += s * y
        at = 2 * unit * LANES
        store(target, at, _positive(a))
        store(target, at + LANES, _positive(e))
        store(target, at + 2 * LANES, _positive(b))
        store(target, at + 3 * LANES, _positive(f))
        store(target, at + 4 * LANES, _positive(c))
        store(target, at + 5 * LANES, _positive(g))
        store(target, at + 6 * LANES, _positive(d))
        store(target, at + 7 * LANES, _positive(h))


@jit
def _scaled(planes, at, center, factor, inputs, k):
    # Two vectors of a plane become those of input ``k``.
    low, high = splat(-INPUT_BOUND), splat(INPUT_BOUND)
    for half in range(2):
        z = (load(planes, at + half * LANES) - splat(center)) * splat(factor)
        store(inputs, (2 * k + half) * LANES, minimum(maximum(z, low), high))


@parallel_jit
def _evaluate(alone, others, mean, scale, w1, b1, w2, b2, w3, b3, out):
    pixels = out.size
    n_alone, size, width = alone.size // pixels, mean.size, 2 * LANES
    groups = (pixels + width - 1) // width
    for task in prange((groups + _CHUNK - 1) // _CHUNK):
        inputs = np.empty(size * width, np.float32)
        hidden = np.empty(w1.shape[0] * TILE * width, np.float32)
        second = np.empty(w2.shape[0] * TILE * width, np.float32)
        last = np.zeros(width, np.float32)
        for group in range(task * _CHUNK, min(groups, (task + 1) * _CHUNK)):
            first = group * width
            count = min(width, pixels - first)
            for k in range(size):
                source, at = (alone, k * pixels + first) if k < n_alone else (others, (k - n_alone) * pixels + first)
                if count < width:  # the last pixels
                    last[:count] = source[at : at + count]
                    source, at = last, 0
                _scaled(source, at, mean[k], scale[k], inputs, k)
            _layer(inputs, size, w1, b1, hidden)
            _layer(hidden, w1.shape[0] * TILE, w2, b2, second)
            x, y = splat(b3[0]), splat(b3[0])
            for k in range(w3.size):
                x += splat(w3[k]) * load(second, 2 * k * LANES)
                y += splat(w3[k]) * load(second, (2 * k + 1) * LANES)
            store(last, 0, x)
            store(last, LANES, y)
            out[first : first + count] = last[:count]

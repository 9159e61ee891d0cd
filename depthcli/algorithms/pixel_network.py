"""A small trained network, evaluated at every pixel: two layers of rectified units, and the log odds as output."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from depthcli.core.errors import InputError
from depthcli.core.maps import Floats
from depthcli.kernels.jit import empty, helper, jit, run_bands
from depthcli.kernels.lanes import WIDE, load_like, maximum, minimum, splat_like, store, wide_zero

INPUT_BOUND = np.float32(4.0)  # standard deviations; scripts/train_choice.py clips at the same value
TILE = 4  # units of a layer that are summed together: their sums stay in registers
CHUNK = 2048
"""Pixels per task."""


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A network with two hidden layers of rectified units, for the log odds that each of N maps is correct at a pixel.

    Attributes
    ----------
    maps : names of the N methods of the maps
    inputs : names of the F inputs
    mean, scale : (F,) float32; the first layer gets ``(x - mean) scale`` for an input x
    layers : three pairs (weights, offsets), float32, of shapes (F, U) and (N, U); (U, V) and (V,); (V, 1) and (1,).
        The first layer has one row of offsets per map; all maps share the other weights
    trained_on : names of the training scenes

    Raises
    ------
    InputError
        The shapes do not match, or a number is not finite.
    """

    maps: tuple[str, ...]
    inputs: tuple[str, ...]
    mean: Floats
    scale: Floats
    layers: tuple[tuple[Floats, Floats], ...]
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


def log_odds(trained: TrainedNetwork, offsets: Floats, planes: Floats, others: Floats) -> Floats:
    """Return the log odds of every pixel, in the shape of a plane, float32.

    Parameters
    ----------
    offsets : (U,) offsets of the first layer
    planes, others : the network's inputs in order, (F1, ...) and (F2, ...) float32, F1 + F2 = F
    """
    alone, together = (at_least_wide(each.reshape(len(each), planes[0].size)) for each in (planes, others))
    out = np.empty(max(planes[0].size, WIDE), np.float32)
    network = trained.mean, trained.scale, offsets.astype(np.float32), *kernel_layers(trained)
    run_bands(_evaluate, -(-out.size // CHUNK), alone, together, *network, out)
    return out[: planes[0].size].reshape(planes.shape[1:])


def at_least_wide(planes: Floats) -> Floats:
    """Return (..., P) planes, padded with zeros to WIDE pixels if they have fewer."""
    missing = max(0, WIDE - planes.shape[-1])
    return np.pad(planes, [(0, 0)] * (planes.ndim - 1) + [(0, missing)]) if missing else planes


def kernel_layers(trained: TrainedNetwork) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return the arrays of the layers, without the first layer's offsets, in the format of :func:`run_layers`."""
    (w1, _), (w2, b2), (w3, b3) = trained.layers
    return _tiled(w1), _tiled(w2), b2, w3.ravel(), b3


def of_first(trained: TrainedNetwork, count: int) -> TrainedNetwork:
    """Return a network of the first ``count`` inputs that assumes 0 for all others."""
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


def _tiled(weights: Floats) -> Floats:
    # Return (units / 4, inputs, 4): weights in the order in which the kernel reads them.
    inputs, units = weights.shape
    return np.ascontiguousarray(weights.reshape(inputs, units // TILE, TILE).transpose(1, 0, 2))


@helper
def set_input(values, center, factor, inputs, k):
    """Write input ``k`` of WIDE pixels, given as a vector, to flat ``inputs``, input by input."""
    low, high = splat_like(values, -INPUT_BOUND), splat_like(values, INPUT_BOUND)
    z = (values - splat_like(values, center)) * splat_like(values, factor)
    store(inputs, k * WIDE, minimum(maximum(z, low), high))


@helper
def run_layers(inputs, offsets, w1, w2, b2, w3, b3, hidden, out, at):
    """Write the log odds of WIDE pixels to ``out`` from ``at`` on; flat ``hidden`` is scratch for all units."""
    first, second = w1.shape[0] * TILE, w2.shape[0] * TILE
    units = hidden[: first * WIDE], hidden[first * WIDE : (first + second) * WIDE]
    _layer(inputs, w1, offsets, units[0])
    _layer(units[0], w2, b2, units[1])
    zero = wide_zero()
    odds = splat_like(zero, b3[0])
    for k in range(w3.size):
        odds += splat_like(zero, w3[k]) * load_like(zero, units[1], k * WIDE)
    store(out, at, odds)


@helper
def _layer(source, weights, offsets, target):
    # Rectified units of a wide vector of pixels. Four sums at a time hide the latency of the additions.
    zero = wide_zero()
    for tile in range(weights.shape[0]):
        w, unit = weights[tile], tile * TILE
        a, b = splat_like(zero, offsets[unit]), splat_like(zero, offsets[unit + 1])
        c, d = splat_like(zero, offsets[unit + 2]), splat_like(zero, offsets[unit + 3])
        for i in range(w.shape[0]):
            x = load_like(zero, source, i * WIDE)
            a += splat_like(zero, w[i, 0]) * x
            b += splat_like(zero, w[i, 1]) * x
            c += splat_like(zero, w[i, 2]) * x
            d += splat_like(zero, w[i, 3]) * x
        store(target, unit * WIDE, maximum(a, zero))
        store(target, (unit + 1) * WIDE, maximum(b, zero))
        store(target, (unit + 2) * WIDE, maximum(c, zero))
        store(target, (unit + 3) * WIDE, maximum(d, zero))


@jit
def _evaluate(begin, end, alone, others, mean, scale, offsets, w1, w2, b2, w3, b3, out):
    pixels, n_alone = out.size, len(alone)
    for task in range(begin, end):
        inputs = empty(mean.size * WIDE, np.float32)
        hidden = empty((w1.shape[0] + w2.shape[0]) * TILE * WIDE, np.float32)
        zero, start = wide_zero(), task * CHUNK
        for at in range(start, min(pixels, start + CHUNK), WIDE):
            first = min(at, pixels - WIDE)  # the last vector may overlap the previous one
            for k in range(mean.size):
                if k < n_alone:
                    values = load_like(zero, alone, k * pixels + first)
                else:
                    values = load_like(zero, others, (k - n_alone) * pixels + first)
                set_input(values, mean[k], scale[k], inputs, k)
            run_layers(inputs, offsets, w1, w2, b2, w3, b3, hidden, out, first)

"""The network that says of every pixel of a map how likely it is to be right, or to be hidden from the right view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.core.networks import TrainedNetwork
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.kernels.lanes import LANES, load, splat, store
from depthcli.methods.fusion.choice.network import INPUT_BOUND, TILE, layer, tiled

_CHUNK = 64  # vectors of pixels a task


def log_odds(
    trained: TrainedNetwork, offsets: NDArray[np.float32], planes: tuple[NDArray[np.float32], NDArray[np.float32]]
) -> NDArray[np.float32]:
    """Return the log odds of every pixel, (H, W) float32.

    Parameters
    ----------
    offsets : (U,) of the units of the first layer
    planes : the network's inputs in their order, (F1, H, W) and (F2, H, W) float32, F1 + F2 = F
    """
    first, second = planes
    out = np.empty(first.shape[1:], np.float32)
    (w1, _), (w2, b2), (w3, b3) = trained.layers
    inputs = (first.reshape(-1), second.reshape(-1), trained.mean, trained.scale)
    layers = (tiled(w1), offsets.astype(np.float32), tiled(w2), b2, w3.ravel(), b3)
    _evaluate(*inputs, *layers, out.reshape(-1))
    return out


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
            layer(inputs, size, w1, b1, hidden)
            layer(hidden, w1.shape[0] * TILE, w2, b2, second)
            total = splat(b3[0])
            for k in range(w3.size):
                total += splat(w3[k]) * load(second, k * LANES)
            store(last, 0, total)
            for i in range(count):
                out[first + i] = last[i]

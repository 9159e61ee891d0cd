"""Trained networks as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError


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

"""Pairs and methods that the stereo tests share."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from depthcli.core.frames import StereoPair
from depthcli.core.method import Family
from depthcli.methods.stereo.volume import CostVolume
from tests.methods.stereo._networks import has_onnx, local_features

# Parameters of methods that have no default for everything.
PARAMETERS: dict[str, dict[str, Any]] = {
    "combined": {
        "parts": [
            {"cost": "absolute_difference", "lambda": 10},
            {"cost": "census", "lambda": 30},
            {"cost": "gradient", "lambda": 4},
        ]
    }
}

# (height, width, disparities): one pixel, narrow, flat, a range wider than the image, sizes around SIMD widths.
TINY = [(1, 1, 1), (1, 1, 5), (1, 9, 4), (9, 1, 4), (2, 3, 1), (3, 2, 17), (5, 31, 33), (8, 40, 64), (6, 17, 16)]


def methods(package: str) -> list[Any]:
    """One pytest parameter for every method in the folder ``package``."""
    family = Family.of(package)
    return [_parameter(family, name) for name in family.names()]


def _parameter(family: Family, name: str) -> Any:
    fields = PARAMETERS.get(name, {})
    if name == "onnx":
        if not has_onnx():
            return pytest.param(None, id=name, marks=pytest.mark.skip(reason="onnxruntime or onnx is not installed"))
        file = local_features(Path(tempfile.mkdtemp()) / "features.onnx", channels=None)
        fields = {"model": str(file), "normalization": "image", "distance": "l1", "truncation": 2}
    return pytest.param(family.parse({family.key: name, **fields}), id=name)


def texture(shape: tuple[int, ...], seed: int = 0, dtype: Any = np.uint8) -> NDArray[Any]:
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)


def shifted_pair(height: int, width: int, shift: int, color: bool = True, seed: int = 0, noise: int = 0) -> StereoPair:
    """A fronto-parallel plane of random texture at disparity ``shift``."""
    rng = np.random.default_rng(seed)
    plane = texture((height, width + shift, 3) if color else (height, width + shift), seed).astype(int)
    views = [plane[:, :width], plane[:, shift:]]
    if noise:
        views = [view + rng.integers(-noise, noise + 1, view.shape) for view in views]
    left, right = (np.ascontiguousarray(np.clip(view, 0, 255).astype(np.uint8)) for view in views)
    return StereoPair(left, right)


def blocky_pair(height: int, width: int, color: bool = True, seed: int = 0) -> StereoPair:
    """Two unrelated views of flat patches, so that supports have edges and insides."""
    rng = np.random.default_rng(seed)
    rows, columns = -(-height // 3), -(-width // 4)
    views = []
    for _ in range(2):
        patches = rng.integers(0, 256, (rows, columns, 3) if color else (rows, columns))
        view = np.repeat(np.repeat(patches, 3, axis=0), 4, axis=1)[:height, :width]
        views.append(np.clip(view + rng.integers(-6, 7, view.shape), 0, 255).astype(np.uint8))
    return StereoPair(*views)


def random_volume(height: int, width: int, disparities: int, dtype: Any = np.uint8, seed: int = 0) -> CostVolume:
    costs = np.random.default_rng(seed).integers(0, 256, (height, width, disparities))
    return CostVolume(costs.astype(dtype))


def inside(shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    """(H, W, D): the match lies inside the right image."""
    return np.broadcast_to(np.arange(shape[2]) <= np.arange(shape[1])[:, None], shape)


@contextmanager
def threads(count: int) -> Iterator[None]:
    before = numba.get_num_threads()
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    try:
        yield
    finally:
        numba.set_num_threads(before)


def assert_pure(run: Callable[[], Any], *inputs: NDArray[Any]) -> None:
    """``run`` gives the same bytes at 1 and 2 threads and leaves its inputs as they were."""
    before = [array.copy() for array in inputs]
    results = []
    for count in (1, 2, 1):
        with threads(count):
            results.append(run())
    for result in results[1:]:
        np.testing.assert_array_equal(result, results[0])
    for array, copy in zip(inputs, before, strict=True):
        np.testing.assert_array_equal(array, copy)

"""Images, cost volumes and maps for the tests of methods, and a test of a common promise."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import StereoPair
from depthcli.kernels.jit import n_threads, set_threads
from depthcli.methods.stereo.volume import CostVolume

TestedT = TypeVar("TestedT")

# (height, width, disparities): one pixel, narrow, flat, a range wider than the image, sizes around SIMD widths.
TINY = [(1, 1, 1), (1, 1, 5), (1, 9, 4), (9, 1, 4), (2, 3, 1), (3, 2, 17), (5, 31, 33), (8, 40, 64), (6, 17, 16)]


def run_checks(tested: TestedT, checks: Iterable[Callable[[TestedT], None]]) -> None:
    """Run all checks; AssertionError names the class and the broken promise or the exception."""
    for check in checks:
        try:
            check(tested)
        except (Exception, SystemExit) as error:
            promise = (check.__doc__ or check.__name__).splitlines()[0].rstrip(".")
            reason = error if isinstance(error, AssertionError) else f"{type(error).__name__}: {error}"
            raise AssertionError(f"{type(tested).__name__} fails {check.__name__} ({promise}): {reason}") from error


def texture(shape: tuple[int, ...], seed: int = 0, dtype: Any = np.uint8) -> NDArray[Any]:
    """Return random values over the full range of the integer type ``dtype``."""
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)


def shifted_pair(height: int, width: int, shift: int, color: bool = True, seed: int = 0, noise: int = 0) -> StereoPair:
    """Return a fronto-parallel plane of random texture at disparity ``shift``."""
    rng = np.random.default_rng(seed)
    plane = texture((height, width + shift, 3) if color else (height, width + shift), seed).astype(int)
    views = [plane[:, :width], plane[:, shift:]]
    if noise:
        views = [view + rng.integers(-noise, noise + 1, view.shape) for view in views]
    left, right = (np.ascontiguousarray(np.clip(view, 0, 255).astype(np.uint8)) for view in views)
    return StereoPair(left, right)


def changed(pair: StereoPair, change: Callable[[Any], Any]) -> StereoPair:
    """Return a pair of both images after ``change``."""
    return StereoPair(change(pair.left), change(pair.right))


def blocky_pair(height: int, width: int, color: bool = True, seed: int = 0) -> StereoPair:
    """Return two unrelated views of flat patches, so that supports have edges and insides."""
    rng = np.random.default_rng(seed)
    rows, columns = -(-height // 3), -(-width // 4)
    views = []
    for _ in range(2):
        patches = rng.integers(0, 256, (rows, columns, 3) if color else (rows, columns))
        view = np.repeat(np.repeat(patches, 3, axis=0), 4, axis=1)[:height, :width]
        views.append(np.clip(view + rng.integers(-6, 7, view.shape), 0, 255).astype(np.uint8))
    return StereoPair(*views)


def random_volume(height: int, width: int, disparities: int, dtype: Any = np.uint8, seed: int = 0) -> CostVolume:
    """Return a volume of random costs 0 .. 255."""
    costs = np.random.default_rng(seed).integers(0, 256, (height, width, disparities))
    return CostVolume(costs.astype(dtype))


def inside(shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Return (H, W, D) bool: the match is inside the right image."""
    return np.broadcast_to(np.arange(shape[2]) <= np.arange(shape[1])[:, None], shape)


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Run the block with ``count`` kernel threads."""
    before = n_threads()
    set_threads(count)
    try:
        yield
    finally:
        set_threads(before)


def assert_pure(run: Callable[[], Any], *inputs: NDArray[Any]) -> None:
    """Raise AssertionError unless ``run`` gives the same array at 1 and 2 threads and leaves its inputs unchanged."""
    before = [array.copy() for array in inputs]
    results = []
    for count in (1, 2, 1):
        with threads(count):
            results.append(run())
    for result in results[1:]:
        np.testing.assert_array_equal(result, results[0], "the result depends on the number of threads, or on chance")
    for array, copy in zip(inputs, before, strict=True):
        np.testing.assert_array_equal(array, copy, "an input was changed")

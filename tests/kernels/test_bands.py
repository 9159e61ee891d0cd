"""Kernels whose numbers are spread over threads; 16 floats or 32 short integers as one value, against numpy."""

import os
from collections.abc import Iterator

import numpy as np
import pytest

from depthcli.kernels import lanes
from depthcli.kernels.jit import jit, n_threads, run_bands, set_threads
from tests.command_line import in_threads
from tests.golden import refused


@pytest.fixture(params=[1, 2, 3, 16])
def _threads(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr("depthcli.kernels.jit._threads.most", 16)
    before = n_threads()
    set_threads(request.param)
    assert n_threads() == request.param
    yield
    set_threads(before)


def square(begin: int, end: int, out: np.ndarray) -> None:
    for k in range(begin, end):
        out[k] += k * k


@pytest.mark.parametrize("count", [0, 1, 2, 5, 100])
@pytest.mark.usefixtures("_threads")
def test_every_number_is_in_one_band(count: int):
    out = np.zeros(count, np.int64)
    run_bands(square, count, out)
    assert out.tolist() == [k * k for k in range(count)]


@pytest.mark.usefixtures("_threads")
def test_many_threads_may_call_at_a_time_and_kernels_may_call_others():
    found = np.zeros((8, 40, 30), np.int64)

    def rows(begin: int, end: int, out: np.ndarray) -> None:
        for k in range(begin, end):
            run_bands(square, out.shape[1], out[k])

    in_threads([lambda k=k: run_bands(rows, 40, found[k]) for k in range(8)])
    assert (found == np.arange(30) ** 2).all()


@pytest.mark.usefixtures("_threads")
def test_an_error_in_any_band_reaches_the_caller():
    def refuse(begin: int, end: int) -> None:
        if end == 20:
            raise MemoryError("too large")

    refused(MemoryError, run_bands, refuse, 20)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs copies of this process")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.usefixtures("_threads")
def test_a_copy_of_this_process_has_threads_of_its_own():
    out = np.zeros(50, np.int64)
    run_bands(square, 50, out)
    child = os.fork()
    if child == 0:
        run_bands(square, 50, out)
        os._exit(0 if (out == 2 * np.arange(50) ** 2).all() else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@jit
def _compute(a, b, levels, factor, out, bytes_out):
    x, y, z = lanes.load(a, 1), lanes.load(b, 0), lanes.load(levels, 1)
    lanes.store(out, 0, x + y)
    lanes.store(out, 16, x - y)
    lanes.store(out, 32, x * lanes.splat(factor))
    lanes.store(out, 48, x / y)
    lanes.store(out, 64, lanes.minimum(x, y))
    lanes.store(out, 80, lanes.maximum(x, y))
    lanes.store(out, 96, lanes.where_at_most(x, y, x + y, z))
    lanes.store(out, 112, lanes.lane_exp_minus_16(x * x))
    share = lanes.as_bytes(lanes.where_at_most(x, y, z, lanes.splat(np.float32(200.7))))
    lanes.store(bytes_out, 18, lanes.load_like(share, levels, 1) + share)
    lanes.store(bytes_out, 34, lanes.load_like(share, levels, 1) - share)
    lanes.store(bytes_out, 50, lanes.absolute_difference(lanes.load_like(share, levels, 1), share))
    lanes.store(bytes_out, 66, lanes.minimum(lanes.load_like(share, levels, 1), share))
    y += x
    lanes.store(out, 128, y)
    return lanes.lane_max(x)


def test_floats_and_bytes_compute_as_numpy_does():
    rng = np.random.default_rng(2)
    a, b = rng.normal(0, 2, 17).astype(np.float32), rng.normal(0, 2, 16).astype(np.float32)
    b += np.sign(b)
    levels = rng.integers(0, 255, 17).astype(np.uint8)
    out, bytes_out = np.zeros((9, lanes.LANES), np.float32), np.zeros(82, np.uint8)
    assert _compute(a, b, levels, np.float32(-1.5), out.reshape(-1), bytes_out) == a[1:].max()
    a, z = a[1:], levels[1:].astype(np.float32)
    either = np.where(a <= b, a + b, z)
    expected = (a + b, a - b, a * np.float32(-1.5), a / b, np.minimum(a, b), np.maximum(a, b), either)
    np.testing.assert_allclose(out[:7], expected, rtol=1e-6)
    np.testing.assert_allclose(out[7], np.exp(-16 * np.minimum(a * a, 1)), atol=1e-4)
    np.testing.assert_array_equal(out[8], out[0])
    assert not bytes_out[:18].any()
    share = np.where(a <= b, z, 200)
    of_bytes = (np.minimum(z + share, 255), np.maximum(z - share, 0), np.abs(z - share), np.minimum(z, share))
    np.testing.assert_array_equal(bytes_out[18:].reshape(4, 16), of_bytes)


@jit
def _compute_shorts(a, levels, out, bytes_out, floats):
    x, y = lanes.load_shorts(a, 1), lanes.load_shorts(levels, 2)
    lanes.store(out, 0, x + y)
    lanes.store(out, 32, x - y)
    lanes.store(out, 64, lanes.minimum(x, y))
    lanes.store(out, 96, lanes.maximum(x, y))
    lanes.store(out, 128, lanes.absolute_difference(x, y))
    lanes.store(out, 160, lanes.shifted_right(y, np.int16(3)))
    lanes.store(out, 192, lanes.splat(np.int16(-7)))
    lanes.store(bytes_out, 0, y)
    low, high = lanes.halves(x)
    lanes.store(floats, 0, low)
    lanes.store(floats, 16, high)


def test_short_integers_compute_as_numpy_does():
    rng = np.random.default_rng(3)
    a = rng.integers(-2000, 2000, 33).astype(np.int16)
    levels = rng.integers(0, 256, 34).astype(np.uint8)
    out, bytes_out, floats = np.zeros((7, 32), np.int16), np.zeros(32, np.uint8), np.zeros(32, np.float32)
    _compute_shorts(a, levels, out.reshape(-1), bytes_out, floats)
    x, y = a[1:], levels[2:].astype(np.int16)
    seven = np.full(32, -7, np.int16)
    expected = (x + y, x - y, np.minimum(x, y), np.maximum(x, y), np.abs(x - y), y >> 3, seven)
    np.testing.assert_array_equal(out, expected)
    np.testing.assert_array_equal(bytes_out, y)
    np.testing.assert_array_equal(floats, x)

"""Sixteen floats as one value in kernels, against numpy."""

from __future__ import annotations

import numpy as np

from depthcli.kernels import lanes
from depthcli.kernels.jit import jit
from depthcli.kernels.lanes import exp_minus, lane_min, lane_sum, load, minimum, splat, store


@jit
def _compute(a, b, factor, out):
    x, y = load(a, 1), load(b, 0)
    store(out, 0, x + y)
    store(out, 16, x - y)
    store(out, 32, x * splat(factor))
    store(out, 48, minimum(x, y))
    store(out, 64, exp_minus(x * x))
    y += x
    store(out, 80, y)
    return lane_sum(x), lane_min(x)


def test_lanes_compute_as_numpy_does():
    rng = np.random.default_rng(1)
    a, b = (rng.normal(0, 2, 17).astype(np.float32) for _ in range(2))
    out = np.zeros(6 * lanes.LANES, np.float32)
    total, smallest = _compute(a, b, np.float32(-1.5), out)
    x, y = a[1:], b[:16]
    rows = out.reshape(6, 16)
    for row, expected in zip(rows, (x + y, x - y, x * np.float32(-1.5), np.minimum(x, y)), strict=False):
        np.testing.assert_allclose(row, expected, rtol=1e-6)
    np.testing.assert_allclose(rows[4], np.exp(-(x.astype(np.float64) ** 2)), rtol=2e-6)
    np.testing.assert_array_equal(rows[5], rows[0])
    assert smallest == x.min()
    np.testing.assert_allclose(total, x.sum(), rtol=1e-5)


def test_exponentials_of_large_numbers_are_as_good_as_zero():
    a = np.linspace(0, 3e38, 17, dtype=np.float32)
    a[:3] = (0, 0, 79)
    out = np.zeros(96, np.float32)
    _exponentials(a, out)
    np.testing.assert_allclose(out[:2], (1, np.exp(-79)), rtol=2e-6)
    assert (out[2:16] < 1e-34).all()


@jit
def _exponentials(a, out):
    store(out, 0, exp_minus(load(a, 1)))

"""The noise of a disparity map."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.methods.kinect.disparity import noise_level


@pytest.mark.parametrize("sigma", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("shape", [(60, 80), (480, 640)])
def test_noise_on_a_slope_with_edges_and_gaps(sigma, shape):
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    values = 20 + 0.3 * columns + 0.1 * rows + 15 * (columns > shape[1] / 2) + sigma * rng.standard_normal(shape)
    values[rng.random(shape) < 0.2] = np.nan
    assert noise_level(values.astype(np.float32)) == pytest.approx(sigma, rel=0.08)


def test_rounded_values():
    _, columns = np.mgrid[:60, :80]
    values = (np.round((20 + 0.01 * columns) / 0.5) * 0.5).astype(np.float32)
    assert noise_level(values) == pytest.approx(0.5 / 12**0.5)


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (2, 5)])
def test_without_differences_the_noise_is_the_floor(shape):
    assert noise_level(np.full(shape, np.nan, np.float32)) == 0.1
    assert noise_level(np.full(shape, 7, np.float32), floor=0.2) == 0.2

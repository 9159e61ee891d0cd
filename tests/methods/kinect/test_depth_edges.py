"""The band beside depth edges, and the noise of a disparity map."""

import numpy as np
import pytest

from depthcli.methods.kinect.depth_edges import near_side
from depthcli.methods.kinect.disparity import noise_level
from tests.naive import kinect as naive


@pytest.mark.parametrize("shape", [(1, 1), (1, 20), (20, 1), (7, 64), (9, 65), (30, 130), (2, 700), (700, 2)])
@pytest.mark.parametrize(("jump", "tolerance"), [(1.5, np.inf), (0.5, 0.4), (9.0, 2.5)])
@pytest.mark.parametrize("unknown", [0.0, 0.2, 0.8, 1.0])
def test_near_sides_agree_with_the_reference(shape, jump, tolerance, unknown):
    rng = np.random.default_rng(0)
    disparity = rng.integers(5, 9, shape).astype(np.float32)
    disparity[rng.random(shape) < unknown] = np.nan
    if max(shape) == 700:  # long runs
        disparity = np.sort(disparity, axis=None).reshape(shape)
        disparity[disparity.shape[0] // 2 :, disparity.shape[1] // 2 :] = 6
    copy = disparity.copy()
    row, column = naive.edge_distance(disparity.astype(float), jump, tolerance)
    for bands in ((1, 0), (0, 3), (5, 2), (64, 64)):
        expected = (row <= bands[0]) | (column <= bands[1])
        np.testing.assert_array_equal(near_side(disparity, jump, *bands, tolerance), expected)
    np.testing.assert_array_equal(disparity, copy)


@pytest.mark.parametrize("sigma", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("shape", [(60, 80), (480, 640)])
def test_noise_on_a_slope_with_edges_and_gaps(sigma, shape):
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    values = 20 + 0.3 * columns + 0.1 * rows + 15 * (columns > shape[1] / 2) + sigma * rng.standard_normal(shape)
    values[rng.random(shape) < 0.2] = np.nan
    assert noise_level(values.astype(np.float32)) == pytest.approx(sigma, rel=0.08)


def test_the_noise_of_rounded_values_and_where_there_are_no_differences():
    values = np.tile(np.round((20 + 0.01 * np.arange(80)) / 0.5) * 0.5, (60, 1))
    assert noise_level(values.astype(np.float32)) == pytest.approx(0.5 / 12**0.5)
    for shape in ((1, 1), (1, 2), (2, 5)):
        assert noise_level(np.full(shape, np.nan, np.float32)) == 0.1
        assert noise_level(np.full(shape, 7, np.float32), floor=0.2) == 0.2

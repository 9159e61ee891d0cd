"""The band beside depth edges."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.methods.kinect.depth_edges import near_side
from tests.naive import kinect as naive


def random_disparity(height, width, seed=0, unknown=0.2):
    rng = np.random.default_rng(seed)
    values = rng.integers(5, 9, (height, width)).astype(np.float32)
    values[rng.random((height, width)) < unknown] = np.nan
    return values


@pytest.mark.parametrize(
    ("height", "width"), [(1, 1), (1, 20), (20, 1), (7, 64), (9, 65), (30, 130), (2, 700), (700, 2)]
)
@pytest.mark.parametrize(("jump", "tolerance"), [(1.5, np.inf), (0.5, 0.4), (9.0, 2.5)])
@pytest.mark.parametrize("unknown", [0.0, 0.2, 0.8, 1.0])
def test_near_sides_agree_with_the_reference(height, width, jump, tolerance, unknown):
    disparity = random_disparity(height, width, unknown=unknown)
    if max(height, width) == 700:  # long runs
        disparity = np.sort(disparity, axis=None).reshape(height, width)
        disparity[disparity.shape[0] // 2 :, disparity.shape[1] // 2 :] = 6
    copy = disparity.copy()
    row, column = naive.edge_distance(disparity.astype(float), jump, tolerance)
    for bands in ((1, 0), (0, 3), (5, 2), (64, 64)):
        expected = (row <= bands[0]) | (column <= bands[1])
        np.testing.assert_array_equal(near_side(disparity, jump, *bands, tolerance), expected)
    np.testing.assert_array_equal(disparity, copy)

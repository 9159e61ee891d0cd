"""The band beside depth edges."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.methods.kinect.depth_edges import NO_EDGE, edge_distance
from tests.naive import kinect as naive

NAN = np.nan


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
def test_edge_distance_agrees_with_the_reference(height, width, jump, tolerance, unknown):
    disparity = random_disparity(height, width, unknown=unknown)
    if max(height, width) == 700:  # long runs
        disparity = np.sort(disparity, axis=None).reshape(height, width)
        disparity[disparity.shape[0] // 2 :, disparity.shape[1] // 2 :] = 6
    copy = disparity.copy()
    found = edge_distance(disparity, jump, tolerance)
    row, column = naive.edge_distance(disparity.astype(float), jump, tolerance)
    np.testing.assert_array_equal(found.row, row)
    np.testing.assert_array_equal(found.column, column)
    np.testing.assert_array_equal(disparity, copy)


def test_only_the_near_side_is_in_the_band():
    line = np.array([[3, 3, NAN, NAN, 9, 9, 9, 9, 9, 9, 9, 9, 4, 4]], np.float32)
    found = edge_distance(line, 1.5)
    assert found.row.tolist() == [[NO_EDGE] * 4 + [1, 2, 3, 4, 4, 3, 2, 1] + [NO_EDGE] * 2]
    assert found.inside(2, 0).tolist() == [[False] * 4 + [True] * 2 + [False] * 4 + [True] * 2 + [False] * 2]


def test_both_sides_of_a_gap_that_is_wider_than_its_jump_are_near():
    line = np.full((1, 30), 9, np.float32)
    line[0, :10] = 5
    line[0, 10:14] = NAN  # as wide as the jump: a shadow on what lies to the left
    found = edge_distance(line)
    assert (found.row[0, :10] == NO_EDGE).all() and found.row[0, 14] == 1
    line[0, 7:10] = NAN
    assert edge_distance(line).row[0, 5:7].tolist() == [2, 1]
    line[0, 14:] = 5  # no jump at all
    assert edge_distance(line).row[0, [6, 14]].tolist() == [1, 1]
    assert edge_distance(line, gap_tolerance=np.inf).row.min() == NO_EDGE

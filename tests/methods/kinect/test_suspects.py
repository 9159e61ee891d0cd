"""The band beside depth jumps."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.methods.kinect.suspects import NO_JUMP, jump_distance
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
def test_agrees_with_the_definition(height, width, jump, tolerance, unknown):
    disparity = random_disparity(height, width, unknown=unknown)
    if max(height, width) == 700:  # long runs
        disparity = np.sort(disparity, axis=None).reshape(height, width)
        disparity[disparity.shape[0] // 2 :, disparity.shape[1] // 2 :] = 6
    copy = disparity.copy()
    found = jump_distance(disparity, jump, tolerance)
    row, column, length = naive.jump_distance(disparity.astype(float), jump, tolerance)
    np.testing.assert_array_equal(found.row, row)
    np.testing.assert_array_equal(found.column, column)
    np.testing.assert_array_equal(found.length, length)
    np.testing.assert_array_equal(disparity, copy)


def test_only_the_near_side_is_in_the_band():
    line = np.array([[3, 3, NAN, NAN, 9, 9, 9, 9, 9, 9, 9, 9, 4, 4]], np.float32)
    found = jump_distance(line, 1.5)
    assert found.row.tolist() == [[NO_JUMP] * 4 + [1, 2, 3, 4, 4, 3, 2, 1] + [NO_JUMP] * 2]
    assert found.length.tolist() == [[NO_JUMP] * 4 + [8] * 8 + [NO_JUMP] * 2]
    assert found.inside(2, 0).tolist() == [[False] * 4 + [True] * 2 + [False] * 4 + [True] * 2 + [False] * 2]


def test_both_sides_of_a_gap_that_is_wider_than_its_jump_are_near():
    line = np.full((1, 30), 9, np.float32)
    line[0, :10] = 5
    line[0, 10:14] = NAN  # as wide as the jump: a shadow on what lies to the left
    found = jump_distance(line)
    assert (found.row[0, :10] == NO_JUMP).all() and found.row[0, 14] == 1
    line[0, 7:10] = NAN
    assert jump_distance(line).row[0, 5:7].tolist() == [2, 1]
    line[0, 14:] = 5  # no jump at all
    assert jump_distance(line).row[0, [6, 14]].tolist() == [1, 1]
    assert jump_distance(line, gap_tolerance=np.inf).row.min() == NO_JUMP


def test_trust_rises_with_the_distance_but_thin_things_keep_some():
    line = np.full((1, 60), 3, np.float32)
    line[0, 5:45] = 9
    line[0, 50:58] = 9
    trust = jump_distance(line, 1.5).trust(5, 8)[0]
    assert trust[:5].tolist() == [1] * 5
    np.testing.assert_allclose(trust[5:14], [0, 0, 0, 0, 0, 1 / 3, 2 / 3, 1, 1], atol=1e-6)
    assert trust[50:58].tolist() == [0, 0, 0.5, 0.5, 0.5, 0.5, 0, 0]

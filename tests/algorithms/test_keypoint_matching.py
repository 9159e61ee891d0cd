"""Matching along epipolar lines, against a naive reference."""

import numpy as np
import pytest

from depthcli.algorithms.keypoints import KeyPoints
from depthcli.methods.stereo.keypoint_matching import KeyPointMatching
from tests.naive import segments as naive


def _points(rng, count, rows=4):
    descriptors = rng.random((count, 8)).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True) + 1e-9
    return KeyPoints(
        rng.uniform(0, 40, count).astype(np.float32),
        rng.uniform(0, rows, count).astype(np.float32),
        rng.uniform(1, 1.3, count).astype(np.float32),
        rng.random(count).astype(np.float32),
        rng.choice([-1, 1], count).astype(np.int8),
        descriptors,
    )


@pytest.mark.parametrize("counts", [(0, 0), (0, 5), (5, 0), (1, 1), (40, 50), (90, 60)])
@pytest.mark.parametrize("ratio", [0.7, 1.0])
def test_agrees_with_the_naive_matcher(counts, ratio):
    rng = np.random.default_rng(sum(counts))
    left, right = _points(rng, counts[0]), _points(rng, counts[1])
    settings = dict(ratio=ratio, max_distance=0.9, max_scale_ratio=1.1)
    found = KeyPointMatching(**settings, agreeing=0)(left, right, 20)
    pairs = set(zip(found.left.tolist(), found.right.tolist(), strict=True))
    assert pairs == naive.matches(left, right, 20, 0.5, **settings)
    assert np.array_equal(found.disparity, left.x[found.left] - right.x[found.right])


def test_repetition_is_rejected():
    """Two candidates that look alike, far from each other: ambiguous; two responses at one spot: not."""
    one = np.array([[1.0, 0.0]], np.float32)

    def at(*xs):
        n = len(xs)
        ones = np.ones(n, np.float32)
        return KeyPoints(np.array(xs, np.float32), ones, ones, ones, np.ones(n, np.int8), one.repeat(n, axis=0))

    match = KeyPointMatching(agreeing=0)
    assert len(match(at(30), at(20), 20)) == 1
    assert len(match(at(30), at(20, 14), 20)) == 0
    assert len(match(at(30), at(20, 5), 20)) == 1  # the second is out of range
    assert len(match(at(30), at(20, 19), 20)) == 1

"""The OpenCV peers: padded, cropped, and brought into our maps."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.core.maps import Status
from depthcli.methods.stereo.pipeline.opencv_bm import OpencvBm
from depthcli.methods.stereo.pipeline.opencv_sgbm import OpencvSgbm
from tests.methods.stereo._pairs import TINY, shifted_pair

PEERS = [
    pytest.param(OpencvSgbm(), id="sgbm"),
    pytest.param(OpencvSgbm(mode="hh", fill=False), id="hh"),
    pytest.param(OpencvSgbm(mode="3way", block=3, wls={}), id="3way-wls"),
    pytest.param(OpencvBm(), id="bm"),
    pytest.param(OpencvBm(wls={}), id="bm-wls"),
]


def smooth_pair(height, width, shift, color=True):
    pair = shifted_pair(height, width + 8, shift, color)
    return StereoPair(
        *(np.ascontiguousarray(cv2.GaussianBlur(v, (0, 0), 1.2)[:, 4:-4]) for v in (pair.left, pair.right))
    )


@pytest.mark.parametrize("peer", PEERS)
@pytest.mark.parametrize("color", [False, True])
def test_a_plane_is_found_up_to_the_left_border(peer, color):
    shift, pair = 6, smooth_pair(60, 120, 6, color)
    result = peer(pair, 20)
    error = np.abs(result.disparity.values - shift)
    assert np.mean(error[:, shift + 4 :] <= 0.5) > 0.95
    # Without padding the first 32 columns would be empty.
    assert np.mean(error[:, shift + 4 : 32] <= 0.5) > 0.9
    assert all(seconds >= 0 for seconds in result.seconds.values())


@pytest.mark.parametrize("peer", PEERS)
@pytest.mark.parametrize(("height", "width", "disparities"), TINY)
def test_tiny_images_and_wide_ranges(peer, height, width, disparities):
    pair = shifted_pair(height, width, 1)
    before = pair.left.copy(), pair.right.copy()
    disparity = peer(pair, disparities - 1).disparity
    assert disparity.values.shape == (height, width)
    known = disparity.values[disparity.valid]
    assert np.all((known >= 0) & (known < disparities))
    assert np.all(disparity.status[~disparity.valid] != 0)
    np.testing.assert_array_equal(pair.left, before[0])
    np.testing.assert_array_equal(pair.right, before[1])


def test_holes_are_mismatches_and_fills_keep_the_reason():
    pair = smooth_pair(60, 120, 6)
    right = pair.right.copy()
    right[20:40, 50:80] = np.random.default_rng(9).integers(0, 256, (20, 30, 3))
    pair = StereoPair(pair.left, right)
    holes = OpencvSgbm(fill=False)(pair, 20).disparity
    filled = OpencvSgbm()(pair, 20).disparity
    empty = ~holes.valid
    assert empty[20:40, 60:80].any()
    assert filled.density == 1
    assert np.all(holes.status[empty] & (Status.MISMATCH | Status.OUT_OF_RANGE))
    np.testing.assert_array_equal(filled.status[empty], holes.status[empty] | Status.FILLED)
    np.testing.assert_array_equal(filled.values[~empty], holes.values[~empty])

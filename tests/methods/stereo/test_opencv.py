"""The OpenCV peers: padded, cropped, and brought into our maps."""

from functools import partial

import cv2
import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.core.maps import Status
from depthcli.testing.inputs import changed, shifted_pair
from tests.contracts.checks import pairs_of_any_size_have_values_within_the_range_or_a_reason
from tests.contracts.inputs import part

sgbm, bm = (partial(part, "methods.stereo.pipeline", f"opencv_{name}") for name in ("sgbm", "bm"))
PEERS = {
    "sgbm": sgbm(), "hh": sgbm(mode="hh", fill=False), "3way-wls": sgbm(mode="3way", block=3, wls={}),
    "bm": bm(), "bm-wls": bm(wls={}),
}  # fmt: skip


def smooth_pair(height, width, shift, color=True):
    pair = shifted_pair(height, width + 8, shift, color)
    return changed(pair, lambda view: np.ascontiguousarray(cv2.GaussianBlur(view, (0, 0), 1.2)[:, 4:-4]))


@pytest.mark.parametrize("peer", PEERS.values(), ids=PEERS)
def test_a_plane_is_found_up_to_the_left_border_and_in_pairs_of_any_size(peer):
    for color in (False, True):
        error = np.abs(peer(smooth_pair(60, 120, 6, color), 20).disparity.values - 6)
        assert np.mean(error[:, 10:] <= 0.5) > 0.95
        assert np.mean(error[:, 10:32] <= 0.5) > 0.9  # without padding the first 32 columns would be empty
    pairs_of_any_size_have_values_within_the_range_or_a_reason(peer)


def test_holes_are_mismatches_and_fills_keep_the_reason():
    pair = smooth_pair(60, 120, 6)
    right = pair.right.copy()
    right[20:40, 50:80] = np.random.default_rng(9).integers(0, 256, (20, 30, 3))
    pair = StereoPair(pair.left, right)
    penalties = {"p1": 8 * 3 * 5**2, "p2": 32 * 3 * 5**2}  # the default: for each channel
    holes, filled, by_hand = (sgbm(**fields)(pair, 20).disparity for fields in ({"fill": False}, {}, penalties))
    empty = ~holes.valid
    assert empty[20:40, 60:80].any() and filled.density == 1
    assert np.all(holes.status[empty] & (Status.MISMATCH | Status.OUT_OF_RANGE))
    np.testing.assert_array_equal(filled.status[empty], holes.status[empty] | Status.FILLED)
    np.testing.assert_array_equal(filled.values[~empty], holes.values[~empty])
    np.testing.assert_array_equal(filled.values, by_hand.values)

"""OpenCV's threads while a filter needs one thread alone; what no round of filling can reach."""

import contextlib

import cv2
import numpy as np

from depthcli.algorithms.filters import JointBilateral, single_thread


def test_opencv_gets_its_threads_back_when_the_last_has_left():
    before = cv2.getNumThreads()
    with contextlib.ExitStack() as outer:
        outer.enter_context(single_thread())
        with contextlib.ExitStack() as inner:
            inner.enter_context(single_thread())
            outer.pop_all().close()  # the one that came first leaves first
            assert cv2.getNumThreads() == 1
        assert cv2.getNumThreads() == before


def test_pixels_unlike_all_known_ones_stay_unknown():
    """Dark pixels are filled from dark ones, bright ones have no like: their weights are 0."""
    color = np.zeros((1, 8, 3), np.uint8)
    color[:, 5:] = 255
    values = np.full((1, 8), np.nan, np.float32)
    values[0, 0] = 3
    filled = JointBilateral(window=5, sigma_color=5).fill(color, values)
    np.testing.assert_allclose(filled, [[3] * 5 + [np.nan] * 3], rtol=1e-6)
    assert np.isnan(JointBilateral().fill(color, np.full((1, 8), np.nan, np.float32))).all()

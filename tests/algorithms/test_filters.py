"""OpenCV's threads while a filter needs one thread alone."""

import contextlib

import cv2

from depthcli.algorithms.filters import single_thread


def test_opencv_gets_its_threads_back_when_the_last_has_left():
    before = cv2.getNumThreads()
    with contextlib.ExitStack() as outer:
        outer.enter_context(single_thread())
        with contextlib.ExitStack() as inner:
            inner.enter_context(single_thread())
            outer.pop_all().close()  # the one that came first leaves first
            assert cv2.getNumThreads() == 1
        assert cv2.getNumThreads() == before

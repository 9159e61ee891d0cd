"""OpenCV on one thread, where more of them give other bytes."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import cv2


@contextlib.contextmanager
def single_thread() -> Iterator[None]:
    """Within it OpenCV uses one thread.

    The fast global smoother, and the WLS filter that is made of it, cut images into as many stripes as there are
    threads and round differently at the ends of vectors: the last bits depend on the number of threads.
    """
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)

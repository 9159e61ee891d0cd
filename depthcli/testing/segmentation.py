"""What every segmentation promises: connected regions numbered from 0, large enough, the same every time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from depthcli.algorithms.segmentation import Segmenter
from depthcli.testing.inputs import run_checks


def check_segmentation(segment: Segmenter) -> None:
    """Raise AssertionError unless a segmentation keeps what pipelines rely on."""
    run_checks(segment, CHECKS)


def _checked(labels: NDArray[np.int32], shape: tuple[int, ...]) -> None:
    assert labels.shape == shape, f"want labels {shape}, got {labels.shape}"
    assert labels.dtype == np.int32, f"want int32, got {labels.dtype}"
    assert np.array_equal(np.unique(labels), np.arange(labels.max() + 1)), "want labels 0 .. n - 1, all of them used"
    for label, place in enumerate(ndimage.find_objects(labels + 1)):
        assert ndimage.label(labels[place] == label)[1] == 1, f"region {label} is not 4-connected"


def regions_follow_the_edge(segment: Segmenter) -> None:
    """A bright block before a dark ground shares no region with it, and the labels are the same again."""
    image = np.full((60, 80, 3), (40, 60, 90), np.uint8)
    image[15:45, 20:50] = (200, 150, 60)
    image = (image + np.random.default_rng(0).integers(-3, 4, image.shape)).astype(np.uint8)
    copy = image.copy()
    labels = segment(image)
    _checked(labels, image.shape[:2])
    block = np.zeros(labels.shape, bool)
    block[15:45, 20:50] = True
    assert not set(labels[block]) & set(labels[~block]), "a region lies on both sides of the edge"
    assert np.array_equal(image, copy), "the image was changed"
    assert np.array_equal(segment(image), labels), "the same image has other regions the second time"


def tiny_and_textureless_images(segment: Segmenter) -> None:
    """Images of a single pixel, row or color have connected regions."""
    for shape in ((1, 1), (1, 9), (9, 1), (2, 2), (7, 11)):
        random = np.random.default_rng(1).integers(0, 256, (*shape, 3)).astype(np.uint8)
        for image in (random, np.full_like(random, 7)):
            _checked(segment(image), shape)


CHECKS = (regions_follow_the_edge, tiny_and_textureless_images)
"""One function a promise."""

"""What every segmentation promises: connected regions numbered from 0, large enough, the same every time."""

import numpy as np
import pytest

from depthcli.algorithms.segmentation import Segmenter
from depthcli.core.method import Family
from depthcli.simulate.stereo_scenes import make_scene
from tests.contracts.inputs import gaps
from tests.naive import segments as naive

NAMES = Family.of("depthcli.algorithms.segmentation").names()
every = pytest.mark.parametrize("name", NAMES)


def method(name: str, **fields) -> Segmenter:
    found = Family.of("depthcli.algorithms.segmentation").parse({"method": name, **fields}, None)
    assert isinstance(found, Segmenter)
    return found


@every
def test_regions_are_connected_and_large(name):
    labels = method(name, min_size=20)(gaps()[0].color)
    assert np.bincount(labels.ravel()).min() >= 20
    assert np.array_equal(naive.components(labels[..., None], 0), labels)  # each label is one piece


@every
def test_textureless_images_are_one_region(name):
    if name != "slic":  # its superpixels have a size, whatever is there
        assert method(name, min_size=1)(np.full((7, 11, 3), 7, np.uint8)).max() == 0


@pytest.mark.parametrize(("scale", "min_size"), [(60, 1), (300, 30)])
def test_regions_by_edges_are_those_of_scikit_image(scale, min_size):
    """But for costs that are rounded, and for the order of equal ones."""
    from skimage.metrics import variation_of_information
    from skimage.segmentation import felzenszwalb

    made = make_scene("planes", 1, 200, 150, 24)
    expected = felzenszwalb(made.left, scale=scale, sigma=0.8, min_size=min_size, channel_axis=-1)
    found = method("felzenszwalb", scale=scale, min_size=min_size)(made.left)
    split, joined = variation_of_information(expected, found)
    entropy = variation_of_information(np.zeros_like(expected), expected).sum()
    assert max(split, joined) < 0.1 * entropy

"""Segmentations: large regions, those of scikit-image, and merging by statistics, also of depth, by its definition."""

import numpy as np
import pytest
from pydantic import ValidationError

from depthcli.algorithms.segmentation.statistical_region_merging import StatisticalRegionMerging, _depth_levels
from depthcli.core.method import Family
from depthcli.simulate.stereo_scenes import make_scene
from tests.contracts.inputs import gaps, part
from tests.methods.kinect._made import blocks
from tests.naive import kinect
from tests.naive import segments as naive

PACKAGE = "algorithms.segmentation"


@pytest.mark.parametrize("name", Family.of(f"depthcli.{PACKAGE}").names())
def test_regions_are_connected_and_large(name):
    labels = part(PACKAGE, name, min_size=20)(gaps()[0].color)
    assert np.bincount(labels.ravel()).min() >= 20
    assert np.array_equal(naive.components(labels[..., None], 0), labels)  # each label is one piece
    if name != "statistical_region_merging":  # which has coarser ones; the others ignore depth
        (layer,) = part(PACKAGE, name, min_size=20).layers(gaps()[0].color, gaps()[1])
        np.testing.assert_array_equal(layer, labels)
    if name != "slic":  # its superpixels have a size, whatever is there
        assert part(PACKAGE, name, min_size=1)(np.full((7, 11, 3), 7, np.uint8)).max() == 0


@pytest.mark.parametrize(("scale", "min_size"), [(60, 1), (300, 30)])
def test_regions_by_edges_are_those_of_scikit_image(scale, min_size):
    """But for costs that are rounded, and for the order of equal ones."""
    from skimage.metrics import variation_of_information
    from skimage.segmentation import felzenszwalb

    made = make_scene("planes", 1, 200, 150, 24)
    expected = felzenszwalb(made.left, scale=scale, sigma=0.8, min_size=min_size, channel_axis=-1)
    found = part(PACKAGE, "felzenszwalb", scale=scale, min_size=min_size)(made.left)
    split, joined = variation_of_information(expected, found)
    entropy = variation_of_information(np.zeros_like(expected), expected).sum()
    assert max(split, joined) < 0.1 * entropy


def depths(height, width, unknown):
    rng = np.random.default_rng(100)
    values = rng.integers(1, 6, (height // 7 + 1, width // 7 + 1)).repeat(7, axis=0).repeat(7, axis=1)[:height, :width]
    values = (values + 0.1 * rng.standard_normal(values.shape)).astype(np.float32)
    values[rng.random(values.shape) < unknown] = np.nan
    return values


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 17), (17, 1), (2, 3), (12, 19), (23, 16)])
@pytest.mark.parametrize("unknown", [0.0, 0.4, 1.0, None])
@pytest.mark.parametrize("min_size", [1, 6])
def test_agrees_with_the_definition(height, width, unknown, min_size):
    image = blocks(height, width)
    depth = None if unknown is None else depths(height, width, unknown)
    fields = {"complexity": 2000, "coarser": (300, 20), "depth_guidance": 1000, "smoothing": 0}
    method = StatisticalRegionMerging(**fields, min_size=min_size)
    levels = None if depth is None else _depth_levels(depth)
    expected = kinect.region_merging(image, levels, (2000, 300, 20), 1000, min_size)
    for found, want in zip(method.layers(image, depth), expected, strict=True):
        np.testing.assert_array_equal(found, want)
    np.testing.assert_array_equal(method(image, depth), expected[0])


def test_layers_get_coarser():
    for coarser in ((300, 300), (3000,), (300, 400)):
        with pytest.raises(ValidationError, match="must fall from layer to layer"):
            StatisticalRegionMerging(complexity=2000, coarser=coarser)

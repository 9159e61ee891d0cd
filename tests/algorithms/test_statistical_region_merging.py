"""Statistical region merging against its definition, and what depth does to it."""

import numpy as np
import pytest

from depthcli.algorithms.segmentation.statistical_region_merging import StatisticalRegionMerging, _depth_levels
from tests.methods.kinect._made import blocks
from tests.naive import kinect as naive


def depths(height, width, seed=0, unknown=0.3):
    rng = np.random.default_rng(seed + 100)
    values = rng.integers(1, 6, (height // 7 + 1, width // 7 + 1)).repeat(7, axis=0).repeat(7, axis=1)[:height, :width]
    values = (values + 0.1 * rng.standard_normal(values.shape)).astype(np.float32)
    values[rng.random(values.shape) < unknown] = np.nan
    return values


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 17), (17, 1), (2, 3), (12, 19), (23, 16)])
@pytest.mark.parametrize("unknown", [0.0, 0.4, 1.0, None])
@pytest.mark.parametrize("min_size", [1, 6])
def test_agrees_with_the_definition(height, width, unknown, min_size):
    image = blocks(height, width)
    depth = None if unknown is None else depths(height, width, unknown=unknown)
    method = StatisticalRegionMerging(
        complexity=2000, coarser=(300, 20), depth_guidance=1000, smoothing=0, min_size=min_size
    )
    levels = None if depth is None else _depth_levels(depth)
    expected = naive.region_merging(image, levels, (2000, 300, 20), 1000, min_size)
    for found, want in zip(method.layers(image, depth), expected, strict=True):
        np.testing.assert_array_equal(found, want)
    np.testing.assert_array_equal(method(image, depth), expected[0])


def test_depth_keeps_apart_what_color_would_join():
    image = np.full((40, 60, 3), 90, np.uint8)
    depth = np.full((40, 60), 2.0, np.float32)
    depth[:, 30:] = 5
    depth[:, 26:34] = np.nan
    labels = StatisticalRegionMerging(depth_guidance=1000)(image, depth)
    assert labels.max() == 1
    assert len(np.unique(labels[:, :26])) == len(np.unique(labels[:, 34:])) == 1  # the gap joins either
    assert StatisticalRegionMerging(depth_guidance=0)(image, depth).max() == 0
    assert StatisticalRegionMerging()(image).max() == 0

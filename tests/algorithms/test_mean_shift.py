"""Regions: connected components, merging, the region graph, and mean shift as a whole."""

import cv2
import numpy as np
import pytest

from depthcli.algorithms.regions import RegionPixels, connected_components, merge_small_regions, region_graph
from depthcli.algorithms.segmentation.mean_shift import mode_colors
from tests.naive import segments as naive


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (7, 11), (20, 20), (70, 5)])
@pytest.mark.parametrize("distance", [0.0, 1.0, 1.5, 2.0])
def test_components_agree_with_flood_fill(shape, distance):
    color = np.random.default_rng(1).integers(0, 3, (*shape, 3)).astype(np.uint8)
    assert np.array_equal(connected_components(color, distance), naive.components(color, distance))


def test_the_graph_of_regions_counts_pixels_and_common_boundaries():
    rng = np.random.default_rng(4)
    labels, image = rng.integers(0, 9, (12, 17)).astype(np.int32), rng.integers(0, 256, (12, 17, 3)).astype(np.uint8)
    graph = region_graph(labels, image)
    pairs = np.concatenate([np.stack([labels[:, 1:], labels[:, :-1]], -1).reshape(-1, 2),
                            np.stack([labels[1:], labels[:-1]], -1).reshape(-1, 2)])  # fmt: skip
    pairs = np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1)
    edges, boundary = np.unique(pairs, axis=0, return_counts=True)
    np.testing.assert_array_equal(graph.edges, edges)
    np.testing.assert_array_equal(graph.boundary, boundary)
    np.testing.assert_array_equal(graph.sizes, np.bincount(labels.ravel()))
    means = np.stack([image[labels == k].mean(axis=0) for k in range(9)])
    np.testing.assert_allclose(graph.means, means)
    np.testing.assert_allclose(graph.distances, [np.sum((means[a] - means[b]) ** 2) for a, b in edges])


def test_small_regions_join_the_nearest_color():
    image = np.full((8, 9, 3), 100, np.uint8)
    image[:, 5:] = 180
    image[3, 4] = 170  # between the halves, nearer to the right one
    labels = connected_components(image, 1.0)
    assert labels.max() == 2
    merged = merge_small_regions(labels, image, 5)
    assert merged.max() == 1
    assert merged[3, 4] == merged[3, 5]


@pytest.mark.parametrize("by_boundary", [False, True])
@pytest.mark.parametrize(("shape", "n_regions"), [((1, 1), 1), ((1, 12), 12), ((9, 13), 117), ((14, 16), 60)])
@pytest.mark.parametrize("min_size", [2, 9, 1000])
def test_merging_agrees_with_rounds_of_single_joins(shape, n_regions, min_size, by_boundary):
    rng = np.random.default_rng(n_regions)
    labels = np.sort(rng.integers(0, n_regions, shape), axis=1)
    labels = np.unique(labels, return_inverse=True)[1].reshape(shape).astype(np.int32)
    colors = rng.integers(0, 2, (labels.max() + 1, 3))[labels] if by_boundary else rng.integers(0, 256, (*shape, 3))
    image = colors.astype(np.uint8)
    expected = naive.merge_small(labels, image, min_size, by_boundary)
    np.testing.assert_array_equal(merge_small_regions(labels, image, min_size, by_boundary), expected)


def test_pixels_of_regions_are_divided_in_order():
    rng = np.random.default_rng(1)
    labels, chosen = rng.integers(0, 5, (9, 11)).astype(np.int32), rng.random((9, 11)) < 0.4
    for part, mask in zip(RegionPixels.of(labels, None, 6).divided(chosen), (chosen, ~chosen), strict=True):
        expected = RegionPixels.of(labels, mask, 6)
        np.testing.assert_array_equal(part.order, expected.order)
        np.testing.assert_array_equal(part.starts, expected.starts)


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (30, 1), (17, 33), (40, 61)])
@pytest.mark.parametrize(("spatial_radius", "color_radius"), [(5, 20), (2.5, 60), (0.4, 20), (9, 255), (50, 30)])
def test_modes_are_those_of_opencv(shape, spatial_radius, color_radius):
    rng = np.random.default_rng(sum(shape))
    image = np.clip(rng.normal(120, 40, (*shape, 3)), 0, 255).astype(np.uint8)
    image[shape[0] // 2 :] //= 3
    expected = cv2.pyrMeanShiftFiltering(image, spatial_radius, color_radius, maxLevel=0)
    np.testing.assert_array_equal(mode_colors(image, spatial_radius, color_radius), expected)

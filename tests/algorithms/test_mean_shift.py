"""Regions: connected components, merging, the region graph, and mean shift as a whole."""

import cv2
import numpy as np
import pytest

from depthcli.algorithms.regions import RegionPixels, connected_components, merge_small_regions, region_graph
from depthcli.algorithms.segmentation.mean_shift import MeanShift, mode_colors
from depthcli.algorithms.segmentation.mean_shift_rgb import mode_colors as rgb_mode_colors
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
    ends = ((labels[:, 1:], labels[:, :-1]), (labels[1:], labels[:-1]))
    pairs = np.concatenate([np.stack(both, -1).reshape(-1, 2) for both in ends])
    pairs = np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1)
    edges, boundary = np.unique(pairs, axis=0, return_counts=True)
    means = np.stack([image[labels == k].mean(axis=0) for k in range(9)])
    distances = [np.sum((means[a] - means[b]) ** 2) for a, b in edges]
    expected = {"edges": edges, "boundary": boundary, "sizes": np.bincount(labels.ravel())}
    for name, values in {**expected, "means": means, "distances": distances}.items():
        np.testing.assert_allclose(getattr(graph, name), values, err_msg=name)


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
    np.testing.assert_array_equal(rgb_mode_colors(image, spatial_radius, color_radius), expected)


def patches(shape, noise=4):
    """Flat patches with noise."""
    rng = np.random.default_rng(sum(shape))
    colors = rng.integers(40, 216, (-(-shape[0] // 6), -(-shape[1] // 6), 3)).repeat(6, axis=0).repeat(6, axis=1)
    noisy = colors[: shape[0], : shape[1]] + rng.normal(0, noise, (*shape, 3))
    return np.clip(noisy, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (25, 1), (14, 37)])
@pytest.mark.parametrize(("spatial_radius", "color_radius"), [(1, 3), (5, 4), (7.5, 12), (20, 90)])
def test_modes_are_those_of_the_paper(shape, spatial_radius, color_radius):
    """But for pixels at which the sums in another order decide whether a color is in the window."""
    image = patches(shape)
    luv = cv2.cvtColor(image.astype(np.float32) * np.float32(1 / 255), cv2.COLOR_RGB2Luv)
    found, expected = mode_colors(image, spatial_radius, color_radius), naive.modes(luv, spatial_radius, color_radius)
    assert np.mean(np.abs(found - expected).max(axis=2) < 0.05) > 0.98


@pytest.mark.parametrize("join_distance", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("min_size", [1, 12])
def test_regions_of_modes_join_until_none_are_alike(join_distance, min_size):
    image = patches((30, 41), 9)
    method = MeanShift(spatial_radius=4, color_radius=9, join_distance=join_distance, min_size=min_size)
    expected = naive.mean_shift_regions(mode_colors(image, 4, 9), 9 * join_distance, min_size)
    np.testing.assert_array_equal(method(image), expected)

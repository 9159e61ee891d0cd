"""Mean field against all pairs of points; the lattice against a point-by-point reference."""

import numpy as np
import pytest

from depthcli.algorithms.dense_crf import GaussianKernel, mean_field
from depthcli.algorithms.dense_crf.permutohedral import Lattice
from depthcli.testing.inputs import assert_pure
from tests.golden import refused
from tests.naive import dense_crf as naive


def _features(seed, count, dimensions, spread):
    return (np.random.default_rng(seed).random((count, dimensions)) * spread).astype(np.float32)


def _unary(seed, count, labels, max_energy=3.0):
    return (np.random.default_rng(seed).random((count, labels)) * max_energy).astype(np.float32)


def _linear(labels, truncation):
    label = np.arange(labels, dtype=np.float32)
    return np.minimum(np.abs(label[:, None] - label), np.float32(truncation))


@pytest.mark.parametrize("dimensions", [1, 2, 3, 4, 5, 6, 8])
def test_the_lattice_filters_as_the_naive_reference(dimensions):
    features, values = _features(dimensions, 60, dimensions, 3) - np.float32(1.2), _unary(1, 60, 3)
    lattice = Lattice.of(features)
    np.testing.assert_allclose(lattice.weights.sum(axis=1), 1, atol=1e-5)
    expected = naive.filter_values(features.astype(float), values)
    np.testing.assert_allclose(lattice.filter(values), expected, atol=1e-5 * expected.max())


@pytest.mark.parametrize("dimensions", [1, 2, 3, 5])
@pytest.mark.parametrize("spread", [0.1, 1, 6, 40])
def test_own_share_is_the_diagonal_of_the_filter(dimensions, spread):
    lattice = Lattice.of(_features(2, 80, dimensions, spread))
    matrix = lattice.filter(np.eye(80, dtype=np.float32))
    density = matrix.sum(axis=1)
    own = lattice.own_share(density)
    matters = np.diag(matrix) > 0.06 * density
    np.testing.assert_allclose(own[matters], np.diag(matrix)[matters], rtol=1e-4)
    np.testing.assert_allclose(own, np.diag(matrix), atol=0.03 * density.max())


def test_marginals_agree_with_the_naive_reference_for_the_kernel_of_the_lattice():
    features, unary = _features(4, 80, 3, 2), _unary(5, 80, 7)
    expected = naive.mean_field(unary, [naive.lattice_matrix(features.astype(float))], [2.0], _linear(7, 3), 4)
    ours = mean_field(unary, [GaussianKernel(features, 2.0)], 3, 4)
    np.testing.assert_allclose(ours, expected, atol=2e-3)


def test_same_bytes_at_any_thread_count_and_inputs_untouched():
    count = 40_000  # several bands, the last one not full
    features, wide, unary = _features(12, count, 3, 30), _features(13, count, 2, 60), _unary(14, count, 9)
    kernels = [GaussianKernel(features, 1.0), GaussianKernel(wide, 0.5)]
    assert_pure(lambda: mean_field(unary, kernels, 3, 3), features, wide, unary)


def test_points_of_different_bands_hear_each_other():
    """The same points twice, the second time far behind the first in order: each hears its double."""
    half = _features(16, 17_000, 2, 40)
    unary = np.zeros((34_000, 3), np.float32)
    unary[:17_000, 0] = -4
    ours = mean_field(unary, [GaussianKernel(np.concatenate([half, half]), 8.0)], 1, 2)
    assert (ours[17_000:].argmax(axis=1) == 0).mean() > 0.99


@pytest.mark.parametrize(("count", "dimensions"), [
    (0, 2), (1, 2), (63, 2), (64, 2), (65, 2), *((300, dimensions) for dimensions in (2, 3, 5, 6))])  # fmt: skip
@pytest.mark.parametrize(("labels", "truncation"), [
    (1, 1), (2, 1), (5, 9), (12, 4), (16, 2), (17, 1), (33, 5), (64, 8), (83, 30), (130, 200)])  # fmt: skip
def test_marginals_are_those_of_all_pairs(count, dimensions, labels, truncation):
    """At sizes around the tiles. The lattice's kernel is not quite a Gaussian: 0.03 off, 0.002 in the mean of many."""
    near, wide, unary = _features(1, count, dimensions, 2), _features(2, count, 2, 5), _unary(3, count, labels)
    ours = mean_field(unary, [GaussianKernel(near, 1.0), GaussianKernel(wide, 0.3)], truncation)
    assert ours.shape == (count, labels)
    if count:
        matrices = [naive.kernel_matrix(near), naive.kernel_matrix(wide)]
        exact = naive.mean_field(unary, matrices, [1.0, 0.3], _linear(labels, truncation), 5)
        assert np.abs(ours - exact).max() < 0.03 and (np.abs(ours - exact).mean() < 0.002 or count < 300)
        np.testing.assert_allclose(ours.sum(axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("features", [np.full((4, 2), np.nan), np.eye(4, 6) * 1e6])
def test_features_outside_the_lattice_are_refused(features):
    refused(ValueError, mean_field, np.zeros((4, 3), np.float32), [GaussianKernel(features.astype(np.float32), 1.0)], 1)

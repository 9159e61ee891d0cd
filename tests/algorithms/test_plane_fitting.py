"""Planes and polynomials over segments and among samples: against references, and with outliers."""

import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.polynomials import Polynomial
from depthcli.algorithms.plane_fitting.sample_planes import SamplePlaneFit, Samples
from depthcli.testing.inputs import texture
from tests.naive import transparent as naive


@pytest.mark.parametrize("shape", [(40, 400), (400, 40), (100, 100), (30, 3000)])
def test_a_plane_is_found_whatever_the_width_of_its_segment(shape: tuple[int, int]):
    """With every n-th pixel, the chosen ones of a width that n divides lie on a few columns."""
    y, x = np.indices(shape)
    plane, one = 20 + 0.05 * x - 0.03 * y, np.zeros(shape, np.int32)
    noisy = (plane + np.random.default_rng(0).normal(0, 0.1, shape)).astype(np.float32)
    found = Polynomial(huber=None, iterations=10, samples=200)(noisy, one, 0.01).at(one)
    assert abs(found - plane).max() < 0.15


def test_outliers_at_one_side_hardly_tilt_a_steep_plane():
    """The first surface is flat and its residuals as large as the slope: a scale of these would spare outliers."""
    y, x = np.indices((40, 60))
    errors, true, one = [], 50 + 0.5 * (x - 30) + 0.25 * (y - 20), np.zeros((40, 60), np.int32)
    for rng in map(np.random.default_rng, range(10)):
        values = (true + rng.normal(0, 0.3, true.shape) + (x < 6) * rng.uniform(3, 12)).astype(np.float32)
        errors.append(abs(Polynomial(samples=2000)(values, one, 0.06).at(one) - true).mean())
    assert np.mean(errors) < 0.2


def _scattered(seed, shape, count):
    """Distinct pixels, and inverse depths of a slanted plane with noise; every fourth one wrong."""
    rng = np.random.default_rng(seed)
    rows, columns = np.divmod(rng.choice(shape[0] * shape[1], count, replace=False), shape[1])
    values = 1.5 + 0.001 * columns - 0.0008 * rows + 0.01 * rng.standard_normal(count)
    values[::4] = rng.uniform(0.8, 3.0, len(values[::4]))
    return Samples(rows.astype(np.int32), columns.astype(np.int32), values.astype(np.float32))


@pytest.mark.parametrize("skip_own", [False, True])
def test_the_fit_agrees_with_the_reference(skip_own):
    shape = (24, 31)
    samples, image = _scattered(3, shape, 90), texture((*shape, 3), 4)
    fit = SamplePlaneFit(neighbors=12, color_scale=80, steps=4)
    at = (samples.rows, samples.columns)
    ours = fit(samples, image, 0.01, at, skip_own)
    expected = np.array([
        naive.robust_fit(samples.rows, samples.columns, samples.values, image, y, x, 0.01, 12, 80, 0.8, 4, skip_own)
        for y, x in zip(*at, strict=True)
    ])  # fmt: skip
    # A sample on the edge of a gate may fall either way in single precision: a few pixels differ.
    for got, want in zip((ours.values, ours.sigma, ours.confidence), expected.T, strict=True):
        assert np.mean(np.abs(got - want) <= 1e-3 * np.abs(want) + 1e-4) > 0.95

"""The robust fit and its search for neighbors against their references, and on planes with outliers."""

import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.sample_planes import SamplePlaneFit, Samples
from depthcli.testing.inputs import assert_pure, texture
from tests.naive import transparent as naive


def _pixels(shape):
    rows, columns = (axis.ravel().astype(np.int32) for axis in np.mgrid[: shape[0], : shape[1]])
    return rows, columns


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


def test_a_plane_is_found_among_outliers():
    shape = (60, 80)
    samples = _scattered(5, shape, 600)
    rows, columns = _pixels(shape)
    ours = SamplePlaneFit()(samples, np.full((*shape, 3), 90, np.uint8), 0.01, (rows, columns))
    error = np.abs(ours.values - (1.5 + 0.001 * columns - 0.0008 * rows))
    assert np.median(error) < 0.004
    assert np.mean(error > 0.03) < 0.01
    assert np.median(ours.confidence) > 0.6


def test_same_bytes_at_any_thread_count_and_inputs_untouched():
    shape = (50, 70)
    samples, image, at = _scattered(7, shape, 400), texture((*shape, 3), 8), _pixels(shape)
    inputs = (samples.rows, samples.columns, samples.values, image)
    assert_pure(lambda: SamplePlaneFit()(samples, image, 0.01, at).values, *inputs)
    assert_pure(lambda: SamplePlaneFit()(samples, image, 0.01, at).sigma, *inputs)

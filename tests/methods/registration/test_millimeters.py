"""Measures of the search in millimeters."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.methods.registration.pipeline.search import isotonic, monotone, structured_voxels


def test_isotonic_regression_pools_falling_values():
    found = isotonic(np.array([1.0, 3.0, 2.0, 4.0, 0.0]), np.array([1.0, 1.0, 1.0, 1.0, 2.0]))
    np.testing.assert_allclose(found, [1, 1.8, 1.8, 1.8, 1.8])
    assert isotonic(np.arange(4.0), np.ones(4)).tolist() == [0, 1, 2, 3]


def test_fitted_error_rises_with_the_score():
    rng = np.random.default_rng(0)
    score = rng.standard_normal((10, 10, 10)).astype(np.float32)
    error = np.maximum(score + rng.standard_normal(score.shape) + 3, 0).astype(np.float32)
    found = monotone(score, error, rng.random(score.shape) < 0.5)
    order = np.argsort(score.ravel())
    assert (np.diff(found.ravel()[order]) >= 0).all() and (found >= 0).all()
    assert found.mean() == pytest.approx(error.mean(), rel=0.05)


def test_result_does_not_depend_on_the_order_of_the_axes():
    """Errors that grow along one axis: a regular sample in raster order would be of a few columns only."""
    rng = np.random.default_rng(0)
    shape = (80, 250, 10)
    error = (np.arange(10) + rng.random(shape)).astype(np.float32)
    score = (error + rng.standard_normal(shape)).astype(np.float32)
    volume = rng.standard_normal(shape).astype(np.float32) * np.arange(1, 11, dtype=np.float32)
    chosen = structured_voxels(volume, volume > -3)
    assert np.count_nonzero(chosen) == pytest.approx(0.2 * np.count_nonzero(volume > -3), rel=1e-3)
    found = monotone(score, error, chosen)
    across = np.ascontiguousarray(volume.transpose(2, 0, 1))
    other = structured_voxels(across, across > -3)
    assert np.count_nonzero(other != chosen.transpose(2, 0, 1)) <= 1e-4 * chosen.size  # rounding of the smoothing
    turned = monotone(*(np.ascontiguousarray(v.transpose(2, 0, 1)) for v in (score, error, chosen)))
    np.testing.assert_allclose(turned, found.transpose(2, 0, 1), rtol=1e-5)

"""Measures as millimeters."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.methods.registration.millimeters import isotonic, monotone


def test_isotonic_pools_what_falls():
    found = isotonic(np.array([1.0, 3.0, 2.0, 4.0, 0.0]), np.array([1.0, 1.0, 1.0, 1.0, 2.0]))
    np.testing.assert_allclose(found, [1, 1.8, 1.8, 1.8, 1.8])
    assert isotonic(np.arange(4.0), np.ones(4)).tolist() == [0, 1, 2, 3]


def test_monotone_keeps_the_order_of_the_score():
    rng = np.random.default_rng(0)
    score = rng.standard_normal((10, 10, 10)).astype(np.float32)
    error = np.maximum(score + rng.standard_normal(score.shape) + 3, 0).astype(np.float32)
    found = monotone(score, error, np.arange(0, score.size, 2))
    order = np.argsort(score.ravel())
    assert (np.diff(found.ravel()[order]) >= 0).all() and (found >= 0).all()
    assert found.mean() == pytest.approx(error.mean(), rel=0.05)

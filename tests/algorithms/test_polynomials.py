"""Polynomials over segments: what is left of a plane that lies in many more pixels than are used."""

import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.polynomials import Polynomial


@pytest.mark.parametrize("shape", [(40, 400), (400, 40), (100, 100), (30, 3000)])
def test_a_plane_is_found_whatever_the_width_of_its_segment(shape: tuple[int, int]):
    """With every n-th pixel, the chosen ones of a width that n divides lie on a few columns."""
    y, x = np.indices(shape)
    plane = 20 + 0.05 * x - 0.03 * y + np.random.default_rng(0).normal(0, 0.1, shape)
    fit = Polynomial(huber=None, iterations=10, samples=200)
    surfaces = fit(plane.astype(np.float32), np.zeros(shape, np.int32), 0.01)
    found = surfaces.at(np.zeros(shape, np.int32))
    assert abs(found - (20 + 0.05 * x - 0.03 * y)).max() < 0.15


def test_outliers_at_one_side_hardly_tilt_a_steep_plane():
    """The first surface is flat and its residuals as large as the slope: a scale of these would spare outliers."""
    y, x = np.indices((40, 60))
    errors = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        true = 50 + 0.5 * (x - 30) + 0.25 * (y - 20)
        values = (true + rng.normal(0, 0.3, true.shape) + (x < 6) * rng.uniform(3, 12)).astype(np.float32)
        surfaces = Polynomial(samples=2000)(values, np.zeros(true.shape, np.int32), 0.06)
        errors.append(abs(surfaces.at(np.zeros(true.shape, np.int32)) - true).mean())
    assert np.mean(errors) < 0.2

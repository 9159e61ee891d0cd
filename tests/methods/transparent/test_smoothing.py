"""Smoothing by color against its reference, and which pixels it changes."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.sample_planes import Samples
from depthcli.methods.transparent.pipeline.robust import Smoothing
from tests.methods.stereo._pairs import texture
from tests.naive import transparent as naive


def _samples(shape, rows, columns):
    known = np.full(shape, np.nan, np.float32)
    known[rows, columns] = 1
    return Samples.of(known)


def _scene(shape, seed):
    rng = np.random.default_rng(seed)
    values = (1.5 + 0.1 * rng.standard_normal(shape)).astype(np.float32)
    values[rng.random(shape) < 0.1] = np.nan
    return values, texture((*shape, 3), seed), rng.random(shape) < 0.7


@pytest.mark.parametrize("shape", [(1, 1), (1, 17), (13, 2), (14, 19)])
@pytest.mark.parametrize("radius", [0, 1, 4])
def test_smoothing_agrees_with_the_reference_far_from_samples(shape, radius):
    values, image, wanted = _scene(shape, 1)
    samples = _samples(shape, [0], [0])
    ours = Smoothing(radius=radius, color_scale=40, reach=3.5 / shape[1])(values, samples, image, wanted)
    y, x = np.mgrid[: shape[0], : shape[1]]
    far = wanted & (np.hypot(y, x) > 3.5)
    np.testing.assert_allclose(ours, naive.smoothed(values, image, far, radius, 40), rtol=1e-5)


def test_near_samples_and_elsewhere_values_stay():
    values, image, wanted = _scene((20, 30), 2)
    every = _samples((20, 30), *np.mgrid[:20:2, :30:2])
    np.testing.assert_array_equal(Smoothing(reach=0.1)(values, every, image, wanted), values)
    one = _samples((20, 30), [10], [15])
    changed = Smoothing(reach=0.1)(values, one, image, wanted) != values
    assert changed[wanted & np.isfinite(values)].sum() > 100
    assert not changed[~wanted & np.isfinite(values)].any()

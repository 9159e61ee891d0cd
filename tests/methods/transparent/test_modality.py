"""Costs of flat windows, and costs at disparities between whole ones."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.methods.stereo.volume import CostVolume
from depthcli.methods.transparent.cross_modal import cost_at, faded_costs, local_deviation, mean_cost
from tests.methods.stereo._pairs import assert_pure, texture
from tests.naive import transparent as naive


def volume(shape, dtype=np.uint16, seed=0):
    costs = np.random.default_rng(seed).integers(0, 200 if dtype == np.uint8 else 4000, shape).astype(dtype)
    return CostVolume(costs, 100.0)


def half_flat(height, width, seed=0):
    image = texture((height, width), seed)
    image[:, : width // 2] = image[:, : width // 2] // 64 + 100
    return np.asarray(image, np.uint8)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(14, 33, 9), (1, 12, 20), (9, 1, 4), (3, 2, 1)])
def test_faded_costs_agree_with_the_reference(shape, dtype):
    costs = volume(shape, dtype)
    left, right = half_flat(*shape[:2]), half_flat(*shape[:2], 1)
    shares = [np.minimum(local_deviation(image) / 30, 1) for image in (left, right)]
    found = faded_costs(costs, left, right, 30.0).costs
    assert found.dtype == np.uint16
    assert np.abs(found.astype(int) - naive.faded_costs(costs.costs, *shares)).max() <= 1
    assert_pure(lambda: faded_costs(costs, left, right, 30.0).costs, left, right, costs.costs)


def test_costs_beside_a_disparity():
    costs = volume((4, 5, 6))
    rows, columns = np.mgrid[:4, :5]
    disparity = np.full((4, 5), 2.5, np.float32)
    disparity[0], disparity[1, 1], disparity[2] = 3.0, np.nan, 99.0
    found = cost_at(costs, disparity)
    at = costs.costs[rows, columns] / 100
    np.testing.assert_allclose(found[3], np.minimum(at[3, :, 2], at[3, :, 3]), rtol=1e-6)
    np.testing.assert_allclose(found[0], np.minimum(at[0, :, 3], at[0, :, 4]), rtol=1e-6)
    np.testing.assert_allclose(found[2], at[2, :, 5], rtol=1e-6)
    assert np.isnan(found[1, 1])
    np.testing.assert_allclose(mean_cost(costs), at.mean(axis=2), rtol=1e-5)

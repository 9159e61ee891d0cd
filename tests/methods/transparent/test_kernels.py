"""Kernels against their references: costs of flat windows, costs between whole disparities, smoothing by color."""

import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.sample_planes import Samples
from depthcli.methods.stereo.volume import CostVolume
from depthcli.methods.transparent.cross_modal import faded_costs
from depthcli.methods.transparent.match_selection import cost_at, local_deviation
from depthcli.methods.transparent.pipeline.robust import Smoothing
from depthcli.testing.inputs import assert_pure, texture
from tests.naive import transparent as naive


def volume(shape, dtype=np.uint16):
    costs = np.random.default_rng(0).integers(0, 200 if dtype == np.uint8 else 4000, shape).astype(dtype)
    return CostVolume(costs, 100.0)


def half_flat(height, width, seed):
    image = texture((height, width), seed)
    image[:, : width // 2] = image[:, : width // 2] // 64 + 100
    return image


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(14, 33, 9), (1, 12, 20), (9, 1, 4), (3, 2, 1)])
def test_faded_costs_agree_with_the_reference(shape, dtype):
    costs, left, right = volume(shape, dtype), half_flat(*shape[:2], 0), half_flat(*shape[:2], 1)
    shares = [np.minimum(local_deviation(image) / 30, 1) for image in (left, right)]
    found = faded_costs(costs, left, right, 30.0).costs
    assert found.dtype == np.uint16
    assert np.abs(found.astype(int) - naive.faded_costs(costs.costs, *shares)).max() <= 1
    assert_pure(lambda: faded_costs(costs, left, right, 30.0).costs, left, right, costs.costs)


def test_costs_beside_a_disparity():
    costs = volume((4, 5, 6))
    disparity = np.full((4, 5), 2.5, np.float32)
    disparity[0], disparity[1, 1], disparity[2] = 3.0, np.nan, 99.0
    found, at = cost_at(costs, disparity), costs.costs / 100
    for row, expected in ((3, at[3, :, 2:4].min(axis=1)), (0, at[0, :, 3:5].min(axis=1)), (2, at[2, :, 5])):
        np.testing.assert_allclose(found[row], expected, rtol=1e-6)
    assert np.isnan(found[1, 1])


def scene(shape, seed, samples):
    """Values with gaps, colors, which pixels to smooth, and samples at some pixels."""
    rng = np.random.default_rng(seed)
    values = (1.5 + 0.1 * rng.standard_normal(shape)).astype(np.float32)
    values[rng.random(shape) < 0.1] = np.nan
    known = np.full(shape, np.nan, np.float32)
    known[samples] = 1
    return values, Samples.of(known), texture((*shape, 3), seed), rng.random(shape) < 0.7


@pytest.mark.parametrize("shape", [(1, 1), (1, 17), (13, 2), (14, 19)])
@pytest.mark.parametrize("radius", [0, 1, 4])
def test_smoothing_agrees_with_the_reference_far_from_samples(shape, radius):
    values, samples, image, wanted = scene(shape, 1, (0, 0))
    ours = Smoothing(radius=radius, color_scale=40, reach=3.5 / shape[1])(values, samples, image, wanted)
    y, x = np.mgrid[: shape[0], : shape[1]]
    far = wanted & (np.hypot(y, x) > 3.5)
    np.testing.assert_allclose(ours, naive.smoothed(values, image, far, radius, 40), rtol=1e-5)


def test_near_samples_and_elsewhere_values_stay():
    given = scene((20, 30), 2, np.s_[::2, ::2])
    np.testing.assert_array_equal(Smoothing(reach=0.1)(*given), given[0])
    values, one, image, wanted = scene((20, 30), 2, (10, 15))
    changed = (Smoothing(reach=0.1)(values, one, image, wanted) != values) & np.isfinite(values)
    assert changed[wanted].sum() > 100 and not changed[~wanted].any()

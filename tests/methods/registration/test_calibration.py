"""What turns measures into millimeters."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.data.formats.volumes import linear
from depthcli.methods.registration._volume import moved
from depthcli.methods.registration.calibration import fit, isotonic, monotone
from depthcli.methods.registration.own_errors import blocks, misregister, random_error


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


def test_moved_is_linear_interpolation_with_repeated_borders():
    rng = np.random.default_rng(1)
    for shape in ((5, 6, 7), (1, 6, 5), (2, 1, 3)):
        volume = rng.standard_normal(shape).astype(np.float32)
        field = (3 * rng.standard_normal((3, *shape))).astype(np.float32)
        places = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij")) + field
        expected = linear(volume, places.reshape(3, -1).T.astype(float)).reshape(shape)
        np.testing.assert_allclose(moved(volume, field), expected, atol=1e-4)


def test_a_part_is_moved_as_the_whole_is():
    rng = np.random.default_rng(2)
    volume = rng.standard_normal((9, 10, 11)).astype(np.float32)
    field = (2 * rng.standard_normal((3, *volume.shape))).astype(np.float32)
    part = (slice(2, 7), slice(3, 9), slice(4, 5))
    found = moved(volume, field[(slice(None), *part)], (2, 3, 4))
    np.testing.assert_allclose(found, moved(volume, field)[part], atol=1e-5)


@pytest.mark.parametrize(
    ("shape", "stride"), [((100, 90, 120), 2), ((60, 60, 60), 3), ((1, 200, 90), 2), ((20, 20, 20), 2)]
)
def test_blocks_lie_inside_and_their_cores_away_from_faces_that_are_not_the_volumes(shape, stride):
    steps = [stride if n > 1 else 1 for n in shape]
    chosen = np.ones([-(-n // step) for n, step in zip(shape, steps, strict=True)], bool)
    found = blocks(chosen, shape, stride, np.random.default_rng(5))
    assert found == blocks(chosen, shape, stride, np.random.default_rng(5))
    assert len(found) == 1 if max(shape) <= 40 else len(found) >= 2
    for block in found:
        for start, side, core, n, step in zip(block.start, block.shape, block.core, shape, steps, strict=True):
            assert 0 <= start <= start + side <= n and start % step == 0
            first, last = start + core.start * step, start + (core.stop - 1) * step
            assert first < last <= start + side - 1 or n == 1
            assert first == 0 or first - start >= 12
            assert n - 1 - last < step or start + side - 1 - last >= 11


def test_the_error_put_in_is_the_one_reported():
    """x -> x + a (x - c) moves what belongs at x to c + (x - c) / (1 + a)."""
    shape, a = (9, 11, 21), 0.2
    place = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij")).astype(np.float32)
    middle = (np.array(shape, np.float32).reshape(3, 1, 1, 1) - 1) / 2
    stretch = np.zeros_like(place)
    stretch[2] = a * (place - middle)[2]
    correction = np.zeros_like(place)
    correction[1] = 2
    volume = place[1] + 100 * place[2]
    found, error = misregister(volume, correction, stretch.astype(np.float32))
    inner = (slice(None), slice(0, 8), slice(3, -3))
    np.testing.assert_allclose(error[inner], np.abs((place - middle)[2] * a / (1 + a))[inner], atol=2e-3)
    np.testing.assert_allclose(found[inner], (place[1] + 2 + 100 * (place[2] + stretch[2]))[inner], rtol=1e-5)


@pytest.mark.parametrize("shape", [(20, 24, 31), (1, 30, 30)])
def test_random_errors_are_smooth_and_as_large_as_asked(shape):
    one, other = (random_error(np.random.default_rng(seed), shape, 5.0, 6.0) for seed in (3, 3))
    assert one.shape == (3, *shape) and np.array_equal(one, other)
    length = np.linalg.norm(one, axis=0)
    assert 4 < length.max() <= 5.001
    assert all(np.abs(np.diff(one, axis=1 + axis)).max() < 2 for axis in range(3) if shape[axis] > 1)
    assert shape[0] > 1 or not one[0].any()


def test_fit_finds_a_rising_function_and_never_falls():
    rng = np.random.default_rng(4)
    good, useless = rng.uniform(0, 4, 6000).astype(np.float32), rng.standard_normal(6000).astype(np.float32)
    misleading = (-good).astype(np.float32)
    error = (good**2 / 2 + 0.2 * rng.standard_normal(6000)).astype(np.float32)
    table = {"good": good, "useless": useless, "misleading": misleading}
    model = fit(table, error)
    assert np.abs(model(table) - error).mean() < 0.25
    assert all((np.diff(steps) >= 0).all() for steps in model.steps.values())
    assert "misleading" not in model.centers or not np.ptp(model.steps["misleading"]) > 0.1
    ahead = model({name: values + np.float32(0.5) for name, values in table.items()})
    assert (ahead >= model(table)).all() and (model(table) >= 0).all()
    again = fit(table, error)
    assert all(np.array_equal(again.steps[name], steps) for name, steps in model.steps.items())


def test_fit_of_what_does_not_vary_is_its_mean():
    table = {"flat": np.zeros(50, np.float32)}
    error = np.linspace(0, 2, 50, dtype=np.float32)
    np.testing.assert_allclose(fit(table, error)(table), 1, atol=1e-6)

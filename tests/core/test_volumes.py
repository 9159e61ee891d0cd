"""Volumes as radiologists hang them: in all orientations that a scanner may store them in."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest

from depthcli.core.volumes import ENDS, Grid

WORLD = ((2, 1), (1, -1), (0, -1))
"""Axis of the LPS frame, and its sign, that is positive towards superior, anterior and right."""


def rotation(degrees: float) -> np.ndarray:
    """A turn about an oblique axis (Rodrigues)."""
    x, y, z = np.array([1, 2, 3]) / np.sqrt(14)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


@pytest.mark.parametrize("order", list(permutations(range(3))))
@pytest.mark.parametrize("signs", list(product((1, -1), repeat=3)))
@pytest.mark.parametrize("degrees", [0, 20])
def test_all_48_orientations_are_shown_alike(order, signs, degrees):
    direction = np.zeros((3, 3))
    for column, (row, sign) in enumerate(zip(order, signs, strict=True)):
        direction[row, column] = sign
    grid = Grid((4, 5, 6), (1.0, 2.0, 3.0), (7.0, -8.0, 9.0), tuple((rotation(degrees) @ direction).ravel()))
    places = np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1).reshape(-1, 3).astype(float)
    points = grid.to_point(places).reshape(*grid.shape, 3)
    for axis, (world, sign) in enumerate(WORLD):
        towards_first_side = sign * grid.turned(points[..., world])
        assert (np.diff(towards_first_side, axis=axis) < 0).all()
        middle = [n // 2 if k != axis else slice(None) for k, n in enumerate(towards_first_side.shape)]
        first, step = grid.slice_positions(axis)
        assert step == pytest.approx(np.diff(towards_first_side[tuple(middle)])[0])
        if degrees == 0:
            assert first + step * np.arange(towards_first_side.shape[axis]) == pytest.approx(
                towards_first_side[tuple(middle)]
            )
            assert -step == pytest.approx(grid.spacing[2 - grid.anatomical_axes()[0][axis]])
    assert len(ENDS) == 3

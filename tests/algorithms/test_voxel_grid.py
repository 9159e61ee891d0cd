"""Clouds of points joined on a grid."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.algorithms import voxel_grid
from depthcli.algorithms.voxel_grid import VoxelGrid
from depthcli.core.errors import InputError


def naive(points: np.ndarray, color: np.ndarray, edge: float) -> dict[tuple[int, ...], tuple[np.ndarray, np.ndarray]]:
    cells: dict[tuple[int, ...], list[int]] = {}
    for n, point in enumerate(points):
        cells.setdefault(tuple(int(np.floor(value / edge)) for value in point), []).append(n)
    return {cell: (points[rows].mean(0), np.rint(color[rows].mean(0))) for cell, rows in sorted(cells.items())}


@pytest.mark.parametrize("merged", [1, 1 << 20])
def test_a_cell_holds_the_means_of_its_points(merged: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(voxel_grid, "_MIN_MERGED", merged)
    rng = np.random.default_rng(0)
    points, color = rng.normal(0, 1, (900, 3)) - (0, 50, 0), rng.integers(0, 256, (900, 3), dtype=np.uint8)
    grid = VoxelGrid(0.25)
    for part in np.split(np.arange(900), 9):
        grid.add(points[part], color[part])
    found, colors = grid.points()
    expected = naive(points, color, 0.25)
    np.testing.assert_allclose(found, [point for point, _ in expected.values()], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(colors, [each for _, each in expected.values()])
    again, _ = grid.points()
    np.testing.assert_array_equal(found, again)


def test_points_too_far_apart_are_refused_and_leave_the_grid_as_it_was():
    grid = VoxelGrid(0.01)
    assert len(grid.points()[0]) == 0
    color = np.zeros((1, 3), np.uint8)
    grid.add(np.array([[5e5, 1e6, 0.0]]), color)
    for far in (1e5, 1e300, np.nan):
        with pytest.raises(InputError):
            grid.add(np.array([[far, 1e6, 0.0]]), color)
    grid.add(np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    found, _ = grid.points()
    np.testing.assert_allclose(found, [[5e5, 1e6, 0.0]])

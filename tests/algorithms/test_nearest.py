"""The nearest points against a stable sort, with ties and with centers outside the points."""

import numpy as np
import pytest

from depthcli.algorithms.nearest import nearest_points


@pytest.mark.parametrize("points", [0, 1, 7, 80])
@pytest.mark.parametrize("count", [0, 1, 5, 24])
@pytest.mark.parametrize("extent", [(1, 1), (1, 30), (13, 9), (400, 300)])
@pytest.mark.parametrize("skip_own", [False, True])
@pytest.mark.parametrize("whole", [False, True])
def test_nearest_points_agree_with_a_sort(points, count, extent, skip_own, whole):
    rng = np.random.default_rng(points)
    places = rng.uniform(0, extent, (points, 2)).T.astype(np.float32), rng.uniform(-5, np.add(extent, 5), (40, 2)).T
    (x, y), (center_x, center_y) = (np.floor(both) for both in places) if whole else places
    found = nearest_points(center_x, center_y, x, y, count, skip_own)
    squared = (center_x[:, None] - x) ** 2 + (center_y[:, None] - y) ** 2
    for row, distances in zip(found, squared, strict=True):
        order = np.argsort(distances, kind="stable")
        order = order[distances[order] > 0][:count] if skip_own else order[:count]
        np.testing.assert_array_equal(row[: len(order)], order)
        assert (row[len(order) :] == -1).all()

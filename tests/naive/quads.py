"""Slow and obvious reference of the kernel that draws quadrilaterals; numpy only."""

import numpy as np


def draw_quads(x, y, inverse, shape):
    """The largest inverse depth of all triangles that cover a pixel's center, 0 where there is none."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    image = np.zeros(shape)
    for corners_x, corners_y, values in zip(x, y, inverse, strict=True):
        first = abs(values[0] - values[2]) <= abs(values[1] - values[3])
        for triangle in ([0, 1, 2], [2, 3, 0]) if first else ([1, 2, 3], [3, 0, 1]):
            points = np.stack([corners_x[triangle], corners_y[triangle], np.ones(3)])
            if np.linalg.det(points) <= 0:  # seen from behind
                continue
            pixels = np.stack([columns.ravel(), rows.ravel(), np.ones(rows.size)])
            shares = np.linalg.solve(points, pixels).reshape(3, *shape)
            value = np.tensordot(values[triangle], shares, axes=1)
            image = np.where((shares >= -1e-9).all(axis=0), np.maximum(image, value), image)
    return image

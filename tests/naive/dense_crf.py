"""Mean field by all pairs of points, and the permutohedral lattice point by point; numpy only."""

import numpy as np


def kernel_matrix(features):
    """(N, N) Gaussian kernel, normalized symmetrically."""
    squared = ((features[:, None, :] - features[None, :, :]) ** 2).sum(axis=2)
    kernel = np.exp(-squared / 2)
    scale = 1 / np.sqrt(kernel.sum(axis=1))
    return kernel * scale[:, None] * scale[None, :]


def lattice_matrix(features):
    """(N, N) matrix of the lattice filter, normalized symmetrically."""
    kernel = np.stack([filter_values(features, row[:, None])[:, 0] for row in np.eye(len(features))], axis=1)
    scale = 1 / np.sqrt(kernel.sum(axis=1))
    return kernel * scale[:, None] * scale[None, :]


def softmax(energy):
    weights = np.exp(-(energy - energy.min(axis=1, keepdims=True)))
    return weights / weights.sum(axis=1, keepdims=True)


def mean_field(unary, matrices, weights, mu, iterations):
    """(N, L) marginals; ``matrices`` (N, N) normalized kernels, whose diagonals do not count."""
    q = softmax(unary)
    for _ in range(iterations):
        message = sum(w * (m - np.diag(np.diag(m))) @ q for w, m in zip(weights, matrices, strict=True))
        q = softmax(unary + message @ mu.T)
    return q


def simplex(point):
    """Vertices (tuples of d + 1 whole numbers that sum to 0) around a point in R^d, and its weights in them.

    The space is embedded in the plane of R^(d+1) whose coordinates sum to 0, scaled as Adams et al. do.
    """
    d = len(point)
    basis = np.zeros((d + 1, d))
    for i in range(d):
        basis[: i + 1, i] = 1
        basis[i + 1, i] = -(i + 1)
        basis[:, i] /= np.sqrt((i + 1) * (i + 2))
    place = basis @ np.asarray(point, float) * np.sqrt(2 / 3) * (d + 1)
    # The nearest vertex whose coordinates are multiples of d + 1: of all roundings up or down, the one that sums to 0.
    base = np.round(place / (d + 1)).astype(int) * (d + 1)
    while base.sum() != 0:
        step = -np.sign(base.sum())
        rest = (place - base) * step
        base[np.argmax(rest)] += step * (d + 1)
    order = np.argsort(-(place - base), kind="stable")  # the largest rest first
    vertices = []
    for r in range(d + 1):
        vertex = base + r
        vertex[order[d + 1 - r :]] -= d + 1
        vertices.append(vertex)
    system = np.vstack([np.array(vertices).T, np.ones(d + 1)])
    weights = np.linalg.lstsq(system, np.append(place, 1.0), rcond=None)[0]
    return [tuple(int(v) for v in vertex) for vertex in vertices], weights


def filter_values(features, values):
    """(N, C) values spread over the lattice, blurred along its axes and read back."""
    found = [simplex(point) for point in features]
    cells = {}
    for (vertices, weights), value in zip(found, values, strict=True):
        for vertex, weight in zip(vertices, weights, strict=True):
            cells[vertex] = cells.get(vertex, 0) + weight * value
    d = features.shape[1]
    for axis in range(d + 1):
        step = np.ones(d + 1, int)
        step[axis] -= d + 1
        cells = {
            vertex: value
            + 0.5 * (cells.get(tuple(np.array(vertex) + step), 0) + cells.get(tuple(np.array(vertex) - step), 0))
            for vertex, value in cells.items()
        }
    return np.array([sum(w * cells[v] for v, w in zip(*pair, strict=True)) for pair in found])

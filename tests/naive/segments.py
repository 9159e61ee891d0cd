"""Slow and obvious references for the segment pipeline's kernels; numpy only."""

import itertools
import math

import numpy as np


def potts(labels, unary, edges, weights):
    data = sum(unary[n][label] for n, label in enumerate(labels))
    return data + sum(w for (p, q), w in zip(edges, weights, strict=True) if labels[p] != labels[q])


def best_expansion(labels, alpha, unary, edges, weights):
    """Lowest energy over all sets of nodes that could switch to ``alpha``."""
    choices = itertools.product((False, True), repeat=len(labels))
    return min(
        potts([alpha if s else n for s, n in zip(choice, labels, strict=True)], unary, edges, weights)
        for choice in choices
    )


def components(color, max_distance):
    height, width = color.shape[:2]
    labels = np.full((height, width), -1, np.int32)
    count = 0
    for start in itertools.product(range(height), range(width)):
        if labels[start] >= 0:
            continue
        labels[start] = count
        stack = [start]
        while stack:
            y, x = stack.pop()
            for y2, x2 in ((y + 1, x), (y - 1, x), (y, x + 1), (y, x - 1)):
                if not (0 <= y2 < height and 0 <= x2 < width) or labels[y2, x2] >= 0:
                    continue
                apart = color[y, x].astype(float) - color[y2, x2].astype(float)
                if math.sqrt((apart**2).sum()) <= max_distance:
                    labels[y2, x2] = count
                    stack.append((y2, x2))
        count += 1
    return labels


def modes(luv, spatial_radius, color_radius):
    """Mean shift of every pixel with flat kernels in a round window, until it has converged (Comaniciu and Meer)."""
    height, width = luv.shape[:2]
    y, x = np.mgrid[:height, :width]
    found = np.empty(luv.shape)
    for start in np.ndindex(height, width):
        place, color = np.array(start, float), luv[start].astype(float)
        for _ in range(100):
            inside = (y - place[0]) ** 2 + (x - place[1]) ** 2 <= spatial_radius**2
            inside &= ((luv - color) ** 2).sum(axis=2) < color_radius**2
            if not inside.any():
                break
            new_place, new_color = np.array([y[inside].mean(), x[inside].mean()]), luv[inside].mean(axis=0)
            moved = ((new_place - place) ** 2).sum() / spatial_radius**2
            moved += ((new_color - color) ** 2).sum() / color_radius**2
            place, color = new_place, new_color
            if moved < 0.01**2:
                break
        found[start] = color
    return found


def mean_shift_regions(mode_colors, limit, min_size):
    """Pieces of similar modes; then pieces with similar means in rounds; then small ones join."""
    labels = components(np.rint(mode_colors * 16).astype(int), limit * 16)
    for _ in range(10):
        means = [mode_colors[labels == s].astype(float).mean(axis=0) for s in range(labels.max() + 1)]
        pairs = [(labels[:, 1:], labels[:, :-1]), (labels[1:], labels[:-1])]
        pairs = {(s, t) for a, b in pairs for s, t in zip(a.ravel().tolist(), b.ravel().tolist(), strict=True)}
        alike = [(s, t) for s, t in pairs if s != t and math.dist(means[s], means[t]) < limit]
        if not alike:
            break
        group = list(range(len(means)))
        for s, t in alike:
            group = [group[t] if g == group[s] else g for g in group]
        labels = components(np.array(group)[labels][..., None], 0)
    return merge_small(labels, mode_colors.astype(float), min_size, False)


def merge_small(labels, image, min_size, by_boundary):
    """Join small regions in rounds, as ``merge_small_regions`` does."""
    while True:
        means = {s: image[labels == s].mean(axis=0) for s in np.unique(labels).tolist()}
        length = {s: {} for s in means}
        for one, other in ((labels[:, 1:], labels[:, :-1]), (labels[1:], labels[:-1])):
            for s, t in zip(one.ravel().tolist(), other.ravel().tolist(), strict=True):
                if s != t:
                    length[s][t] = length[t][s] = length[s].get(t, 0) + 1
        target = {}
        for s in means:
            apart = {t: ((means[s] - means[t]) ** 2).sum() for t in length[s]}
            ranks = [(apart[t], t) for t in apart]
            if by_boundary:
                ranks = [(-length[s][t], t) for t in apart if apart[t] == 0]
            if (labels == s).sum() < min_size and ranks:
                target[s] = min(ranks)[1]
        if not target:
            return np.unique(labels, return_inverse=True)[1].reshape(labels.shape)
        name = {s: s for s in means}  # that of the first member
        for s, t in target.items():
            old, new = sorted((name[s], name[t]), reverse=True)
            name = {k: new if v == old else v for k, v in name.items()}
        labels = np.vectorize(name.get)(labels)


def segment_window(costs, labels, radius):
    height, width, _ = costs.shape
    out = np.empty(costs.shape, np.float64)
    for y, x in np.ndindex(height, width):
        window = slice(max(0, y - radius), y + radius + 1), slice(max(0, x - radius), x + radius + 1)
        out[y, x] = costs[window][labels[window] == labels[y, x]].mean(axis=0)
    return out


def discrepancy(values, trusted, labels, coefficients, weight, truncation, weights):
    count = labels.max() + 1
    unary = np.zeros((count, len(coefficients)))
    for t in range(count):
        ys, xs = np.nonzero(trusted & (labels == t))
        if len(ys) == 0:
            continue
        for k, (a, b, c) in enumerate(coefficients):
            apart = np.abs(a * xs + b * ys + c - values[ys, xs])
            own = weights[ys, xs]
            share = own[apart <= 0.5].sum() / own.sum()
            unary[t, k] = weight * (own * np.minimum(apart, truncation)).sum() * math.exp(-share)
    return unary


def matching_cost(costs, trusted, labels, coefficients, values=None):
    count = labels.max() + 1
    unary = np.zeros((count, len(coefficients)))
    for y, x in zip(*np.nonzero(trusted), strict=True):
        for k, (a, b, c) in enumerate(coefficients):
            d = min(max(math.floor(a * x + b * y + c + 0.5), 0), costs.shape[2] - 1)
            unary[labels[y, x], k] += float(costs[y, x, d])
    for t, k in np.ndindex(unary.shape if values is not None else (0, 0)):
        ys, xs = np.nonzero(trusted & (labels == t))
        a, b, c = coefficients[k]
        unary[t, k] *= math.exp(-(np.abs(a * xs + b * ys + c - values[ys, xs]) <= 0.5).sum() / max(len(ys), 1))
    return unary


def hessian_masks(size):
    """The box filters of SURF as explicit (size, size) masks: dxx, dyy, dxy."""
    lobe, half = size // 3, size // 2
    dyy = np.zeros((size, size))
    dyy[:, half - lobe + 1 : half + lobe] = 1
    dyy[half - lobe // 2 : half - lobe // 2 + lobe, half - lobe + 1 : half + lobe] = -2
    dxy = np.zeros((size, size))
    dxy[half - lobe : half, half + 1 : half + lobe + 1] = 1
    dxy[half + 1 : half + lobe + 1, half - lobe : half] = 1
    dxy[half - lobe : half, half - lobe : half] = -1
    dxy[half + 1 : half + lobe + 1, half + 1 : half + lobe + 1] = -1
    return dyy.T, dyy, dxy


def hessian(image, y, x, size):
    """Determinant and sign of the trace of the box-filter Hessian at one pixel."""
    half = size // 2
    patch = image[y - half : y + half + 1, x - half : x + half + 1].astype(float)
    dxx, dyy, dxy = ((patch * mask).sum() / size**2 for mask in hessian_masks(size))
    return dxx * dyy - 0.81 * dxy**2, 1 if dxx + dyy >= 0 else -1


def matches(left, right, max_disparity, max_row_difference, ratio, max_distance, max_scale_ratio):
    """Pairs (i, j) that are mutually nearest and pass the ratio test."""

    def nearest(one, other, direction):
        result = {}
        for i in range(len(one.x)):
            candidates = []
            for j in range(len(other.x)):
                disparity = direction * (one.x[i] - other.x[j])
                scales = sorted((float(one.scale[i]), float(other.scale[j])))
                if (
                    abs(one.y[i] - other.y[j]) < max_row_difference
                    and 0 <= disparity <= max_disparity
                    and one.sign[i] == other.sign[j]
                    and scales[1] <= max_scale_ratio * scales[0]
                ):
                    candidates.append((float(np.linalg.norm(one.descriptors[i] - other.descriptors[j])), j))
            if not candidates:
                continue
            best, winner = min(candidates)
            elsewhere = [d for d, j in candidates if abs(other.x[j] - other.x[winner]) >= 2]
            if ratio >= 1 or best < ratio * min(elsewhere, default=math.inf):
                result[i] = (winner, best)
        return result

    there, back = nearest(left, right, 1), nearest(right, left, -1)
    return {(i, j) for i, (j, d) in there.items() if d <= max_distance and back.get(j, (-1,))[0] == i}

"""Slow and obvious references of the kernels of refine-kinect; numpy only."""

import heapq
import itertools
import math

import numpy as np


def edge_distance_of_line(line, jump, gap_tolerance):
    """Distance of every pixel of a line from the nearest edge whose near side it lies on, capped at 255."""
    known = [i for i in range(len(line)) if not np.isnan(line[i])]
    # Every event (a, b): consecutive known pixels; does a near side end at a, does one begin at b?
    events = []
    for a, b in itertools.pairwise(known):
        step = line[b] - line[a]
        if b - a - 1 > abs(step) + gap_tolerance:
            events.append((a, b, True, True))
        elif abs(step) > jump:
            events.append((a, b, step < 0, step > 0))
    nearest = np.full(len(line), 255)
    for i in known:
        left = [e for e in events if e[1] <= i][-1:]
        right = [e for e in events if e[0] >= i][:1]
        from_left = i - left[0][1] + 1 if left and left[0][3] else None
        from_right = right[0][0] - i + 1 if right and right[0][2] else None
        nearest[i] = min([255] + [v for v in (from_left, from_right) if v is not None])
    return nearest


def edge_distance(disparity, jump, gap_tolerance):
    """Distances along rows and along columns."""
    height, width = disparity.shape
    rows = [edge_distance_of_line(disparity[y], jump, gap_tolerance) for y in range(height)]
    columns = [edge_distance_of_line(disparity[:, x], jump, np.inf) for x in range(width)]
    return np.array(rows), np.array(columns).T


def max_disparity_in_gaps(disparity, jump, tolerance, scale, covered, behind):
    """Of shadows on the left of near surfaces."""
    limit = np.full(disparity.shape, np.inf)
    for y, row in enumerate(disparity):
        known = np.flatnonzero(~np.isnan(row))
        for a, b in itertools.pairwise(known):
            width = b - a - 1 + covered
            near, far = row[b], row[a]
            if b - a > 1 and near - far > jump and (behind or abs(width - scale * (near - far)) <= 4):
                largest = near - width / scale
                limit[y, a + 1 : b] = (max(largest, far) if largest >= far - tolerance else largest) + tolerance
    return limit


def cheapest_paths(lab, segments, limit, values, cost):
    """Cost of the cheapest path to every unknown pixel, by Dijkstra, and the value at its start."""
    height, width = values.shape
    known = ~np.isnan(values)
    total, start = np.where(known, cost.astype(float), np.inf), np.where(known, values, np.nan)
    queue = [(total[y, x], y, x) for y, x in np.argwhere(known)]
    heapq.heapify(queue)
    while queue:
        so_far, y, x = heapq.heappop(queue)
        if so_far > total[y, x]:
            continue
        for v, u in itertools.product((y - 1, y, y + 1), (x - 1, x, x + 1)):
            if (v, u) == (y, x) or not (0 <= v < height and 0 <= u < width) or known[v, u]:
                continue
            path = so_far + (1 if v == y or u == x else 1.4)
            path += 0.2 * np.abs(lab[y, x].astype(int) - lab[v, u].astype(int)).sum()
            path += 5 * np.count_nonzero(segments[:, y, x] != segments[:, v, u])
            path += 1000 * (start[y, x] > limit[v, u])
            if path < total[v, u] - 1e-6:
                total[v, u], start[v, u] = path, start[y, x]
                heapq.heappush(queue, (path, v, u))
    return total, start


def region_merging(image, levels, complexities, guidance, min_size):
    """Labels of every layer; ``levels`` is depth in 0 .. 4095, -1 = unknown, or None."""
    height, width = image.shape[:2]
    pixels = height * width
    color = image.reshape(-1, 3).astype(int)
    depth = None if levels is None else levels.ravel().astype(int)
    pairs = []
    for p in range(pixels):
        for q, inside in ((p + 1, p % width + 1 < width), (p + width, p + width < pixels)):
            if inside:
                key = np.abs(color[p] - color[q]).max()
                if depth is not None and depth[p] >= 0 and depth[q] >= 0:
                    key = max(key, 255 * abs(depth[p] - depth[q]) // 4095)
                pairs.append((key, p, q))
    pairs.sort(key=lambda pair: pair[0])  # stable: else in raster order, right before below
    regions = np.arange(pixels)

    def bound(size, q, span):
        spread = min(size, 256) * math.log(1 + size) + math.log(6) + 2 * math.log(pixels)
        return np.float32(span * span * spread / (2 * q * size))

    def alike(a, b, q):
        limit = bound(len(a), q, 256) + bound(len(b), q, 256)
        if ((color[a].mean(axis=0) - color[b].mean(axis=0)) ** 2 > limit).any():
            return False
        if depth is None:
            return True
        known = [depth[r][depth[r] >= 0] for r in (a, b)]
        if not all(k.size for k in known):
            return True
        limit = sum(bound(k.size, guidance, 4095) for k in known)
        return (known[0].mean() - known[1].mean()) ** 2 <= limit

    def members(p):
        return np.flatnonzero(regions == regions[p])

    layers = []
    for q in complexities:
        for _, a, b in pairs:
            if regions[a] != regions[b] and alike(members(a), members(b), q):
                regions[members(b)] = regions[a]
        before = regions.copy()
        for _, a, b in pairs:
            if regions[a] != regions[b] and min(members(a).size, members(b).size) < min_size:
                regions[members(b)] = regions[a]
        _, first, labels = np.unique(regions, return_index=True, return_inverse=True)
        layers.append(np.argsort(np.argsort(first))[labels].reshape(height, width))
        regions = before
    return layers


def huber_plane(z, x, y, k, floor, iterations=200):
    """(3,) coefficients of 1, x, y by iteratively reweighted least squares; the scale never rises."""
    basis = np.stack([np.ones_like(x), x, y], axis=1)
    beta = np.array([np.sort(z)[len(z) // 2], 0, 0])

    def spread(r):
        return max(1.4826 * np.sort(np.abs(r - np.sort(r)[len(r) // 2]))[len(r) // 2], floor)

    scale = np.inf
    for _ in range(iterations):
        r = z - basis @ beta
        scale = min(scale, spread(r))
        w = np.where(np.abs(r) <= k * scale, 1, k * scale / np.maximum(np.abs(r), 1e-300))
        beta = np.linalg.lstsq(basis * np.sqrt(w)[:, None], z * np.sqrt(w), rcond=None)[0]
    return beta, spread(z - basis @ beta)


def detail(surface, known, labels, scale, reach):
    """Surface plus smoothed residuals: along rows, then along columns, within runs of one label."""
    residual = np.clip(known - surface, -3 * scale[labels], 3 * scale[labels])
    weight = (~np.isnan(residual)).astype(float)
    residual = np.where(weight > 0, residual, 0)
    for _ in range(2):
        sums = [np.zeros(surface.shape), np.zeros(surface.shape)]
        for y, x in np.ndindex(*surface.shape):
            for direction in (-1, 1):
                u = x
                while 0 <= u < surface.shape[1] and labels[y, u] == labels[y, x]:
                    if u != x or direction == 1:
                        near = math.exp(-abs(u - x) / reach)
                        sums[0][y, x] += near * residual[y, u]
                        sums[1][y, x] += near * weight[y, u]
                    u += direction
        residual, weight = sums[0].T, sums[1].T
        surface, labels = surface.T, labels.T
    return surface + residual / (weight + 0.5)


def owners(labels, modelled, color, value_at, limit):
    """The modelled segment that each one joins along the cheapest path (Bellman and Ford)."""
    count = len(modelled)
    mean = [color[labels == s].astype(float).mean(axis=0) for s in range(count)]
    middle = [np.argwhere(labels == s).mean(axis=0) for s in range(count)]
    most = []
    for s in range(count):
        here = limit[labels == s]
        most.append(here[np.isfinite(here)].mean() if 3 * np.isfinite(here).sum() > here.size else np.inf)
    touching = {}
    for a, b in ((labels[:, :-1], labels[:, 1:]), (labels[:-1], labels[1:])):
        for s, t in zip(a[a != b], b[a != b], strict=True):
            for pair in ((s, t), (t, s)):
                touching[pair] = touching.get(pair, 0) + 1
    # The queue takes (cost, segment, owner) in order; a segment is settled once.
    owner = {s: s for s in range(count) if modelled[s]}
    frontier = [(0.0, s, s) for s in owner]
    settled = {}
    while frontier:
        frontier.sort()
        cost, s, o = frontier.pop(0)
        if s in settled:
            continue
        settled[s] = o
        for (a, t), boundary in touching.items():
            if a == s and t not in settled and not modelled[t]:
                step = np.abs(mean[s] - mean[t]).sum() + 10 / math.sqrt(boundary)
                step += 1000 * (value_at(o, *middle[t]) > most[t])
                frontier.append((cost + step, t, o))
    return np.array([settled.get(s, -1) for s in range(count)])


def carried_labels(labels, own, still, color, reliable, limit, value_at, scale, jump, noise):
    height, width = labels.shape
    cost = np.full(labels.shape, np.inf)
    for y, x in np.ndindex(height, width):
        s = labels[y, x]
        if s >= 0 and still[y, x]:
            value = value_at(s, y, x)
            off = abs(reliable[y, x] - value)
            fits = np.isnan(off) or off <= jump + 3 * scale[s]
            if fits and value <= limit[y, x] + jump:
                cost[y, x] = 0
    held = cost == 0
    labels, own = np.where(held, labels, -1), own.copy()
    for forward in (True, False):
        order = list(np.ndindex(height, width))
        before = [(0, -1), (-1, -1), (-1, 0), (-1, 1)]
        if not forward:
            order.reverse()
            before = [(-dy, -dx) for dy, dx in before]
        for y, x in order:
            if held[y, x]:
                continue
            steps = [before[0], *sorted(before[1:], key=lambda step: step[1])]
            for dy, dx in steps:
                v, u = y + dy, x + dx
                if not (0 <= v < height and 0 <= u < width) or labels[v, u] < 0:
                    continue
                value = value_at(labels[v, u], y, x)
                total = cost[v, u] + np.abs(color[y, x].astype(int) - color[v, u]).sum()
                if not np.isnan(reliable[y, x]):
                    total += 5 / noise * abs(reliable[y, x] - value)
                if value > limit[y, x]:
                    total += 1000
                if total < cost[y, x]:
                    cost[y, x], labels[y, x], own[y, x] = total, labels[v, u], own[v, u]
    return labels, own


def smoothed_gaps(filled, known, lab, limit, strides, max_contrast):
    """Medians of 3 x 3 pixels at each of the strides; those of another color, or outside, count as the center."""
    result = filled.copy()
    height, width = filled.shape
    for stride in strides:
        source = result.copy()
        for y, x in zip(*np.nonzero(~known), strict=True):
            samples = []
            for v in (y - stride, y, y + stride):
                for u in (x - stride, x, x + stride):
                    inside = 0 <= v < height and 0 <= u < width
                    alike = inside and np.abs(lab[v, u].astype(int) - lab[y, x]).sum() <= max_contrast
                    samples.append(source[v, u] if alike else source[y, x])
            result[y, x] = np.median(samples)
    return np.where(result > limit, filled, result)


def local_plane(disparity, trust, noise, y, x):
    """Value, slopes and residual scale of the plane around one pixel, after three reweightings."""
    rows, columns = np.mgrid[max(y - 4, 0) : y + 5, max(x - 4, 0) : x + 5]
    inside = (rows < disparity.shape[0]) & (columns < disparity.shape[1])
    rows, columns = rows[inside], columns[inside]
    used = ~np.isnan(disparity[rows, columns]) & (trust[rows, columns] > 0)
    rows, columns = rows[used], columns[used]
    fx, fy = (columns - x).astype(float), (rows - y).astype(float)
    v = disparity[rows, columns].astype(float) - disparity[y, x]
    plane = np.zeros(3)
    for step in range(3):
        gate = 4.0 * noise if step else (6.4 + np.maximum(np.abs(fx), np.abs(fy))) * noise
        r = (v - (plane[0] * fx + plane[1] * fy + plane[2])) / gate
        w = trust[rows, columns] * np.maximum(0, 1 - r * r) ** 2
        total = max(w.sum(), 1e-6)
        mx, my, md = ((w * a).sum() / total for a in (fx, fy, v))
        xx, yy = (w * (fx - mx) ** 2).sum() + 1, (w * (fy - my) ** 2).sum() + 1
        xy = (w * (fx - mx) * (fy - my)).sum()
        xd, yd = (w * (fx - mx) * (v - md)).sum(), (w * (fy - my) * (v - md)).sum()
        slopes = np.linalg.solve([[xx, xy], [xy, yy]], [xd, yd]) if total >= 8 else np.zeros(2)
        slopes = np.clip(slopes, -0.7, 0.7)
        plane = np.array([*slopes, md - slopes[0] * mx - slopes[1] * my])
    residual = v - (plane[0] * fx + plane[1] * fy + plane[2])
    return disparity[y, x] + plane[2], plane[0], plane[1], np.sqrt((w * residual**2).sum() / total)


def histogram(pixel, lab, planes, trust, limit, beyond, low, unit, bins, sigma_color, sigma_space):
    """Mass and moment (bins,) of the votes for one pixel: every pixel, every fourth, every twelfth, by distance."""
    y, x = pixel
    mass, moment = np.zeros(bins), np.zeros(bins)
    value, slope_x, slope_y = planes
    for v in range(value.shape[0]):
        for u in range(value.shape[1]):
            far = max(abs(u - x), abs(v - y))
            stride = 1 if far <= 5 else 4 if far <= 36 else 12
            if far > 108 or v % stride or u % stride or not trust[v, u] > 0 or np.isnan(value[v, u]):
                continue
            contrast = np.abs(lab[v, u].astype(int) - lab[y, x]).sum()
            w = trust[v, u] * stride**2 * (np.exp(-contrast / sigma_color) + 0.002)
            w *= np.exp(-(abs(u - x) + abs(v - y)) / sigma_space)
            fade = 1 / (1 + ((u - x) ** 2 + (v - y) ** 2) / 400)
            d = value[v, u] + fade * (slope_x[v, u] * (x - u) + slope_y[v, u] * (y - v))
            k = int((d - low) / unit)
            if 1 <= k < bins - 1:
                w *= beyond[y, x] if d > limit[y, x] else 1
                mass[k] += w
                moment[k] += w * d
    return mass, moment


def modes(mass, moment, most):
    """Values and shares of the modes, the strongest first."""
    mass, moment, total = mass.copy(), moment.copy(), mass.sum()
    found = []
    for _ in range(most):
        smooth = mass.copy()
        smooth[1:-1] += 0.5 * (mass[:-2] + mass[2:])
        top = int(smooth.argmax())
        if smooth[top] <= 0 or smooth[top] < 0.01 * total:
            break
        value = moment[top - 1 : top + 2].sum() / mass[top - 1 : top + 2].sum()
        found.append((value, mass[max(top - 2, 0) : top + 3].sum() / total))
        mass[max(top - 2, 0) : top + 3] = 0
        moment[max(top - 2, 0) : top + 3] = 0
    return found

"""Slow, obvious numpy references of the stereo kernels: loops as the papers write them. Never imports depthcli.

Disparities run along the last axis; left (y, x) matches right (y, x - d).
"""

import itertools

import numpy as np

from tests.naive.segments import components


def volume(shape, disparities, cost, outside):
    """``cost(y, x, d)`` for every match inside the right image, ``outside`` elsewhere."""
    out = np.full((*shape, disparities), outside, float)
    for y, x in np.ndindex(shape):
        for d in range(min(disparities, x + 1)):
            out[y, x, d] = cost(y, x, d)
    return out


def absolute_difference(left, right, disparities, truncation, outside):
    """Eq. 3.1: sum over the channels, truncated."""
    left, right = (np.atleast_3d(image).astype(int) for image in (left, right))

    def cost(y, x, d):
        return min(truncation, np.abs(left[y, x] - right[y, x - d]).sum())

    return volume(left.shape[:2], disparities, cost, outside)


def tolerant_difference(left, right, disparities, truncation, outside, divisor=1):
    """Birchfield and Tomasi: difference from the nearest value within half a pixel, the smaller of both ways round."""

    def reach(row, x, c):
        values = [int(row[x, c])]
        for u in (x - 1, x + 1):
            values.append((int(row[x, c]) + int(row[min(max(u, 0), len(row) - 1), c])) // 2)
        return min(values), max(values)

    def apart(value, low, high):
        return max(value - high, low - value, 0)

    def cost(y, x, d):
        total = 0
        for c in range(left.shape[2]):
            a, b = int(left[y, x, c]), int(right[y, x - d, c])
            total += min(apart(a, *reach(right[y], x - d, c)), apart(b, *reach(left[y], x, c)))
        return min(truncation, (total + divisor // 2) // divisor)

    return volume(left.shape[:2], disparities, cost, outside)


def windows(image, width, height):
    """Return (H, W, height, width): the pixels around each one, the border repeated."""
    padded = np.pad(image, ((height // 2,) * 2, (width // 2,) * 2), mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, (height, width))


def census(left, right, disparities, window, outside):
    """Eq. 3.5: number of neighbors that are brighter than the center in one view only."""
    bits = [windows(image, *window) > image[:, :, None, None] for image in (left, right)]
    return volume(left.shape, disparities, lambda y, x, d: np.sum(bits[0][y, x] != bits[1][y, x - d]), outside)


def rank(left, right, disparities, window, outside):
    """Eq. 3.3-3.4."""
    ranks = [(windows(image, *window) < image[:, :, None, None]).sum(axis=(2, 3)) for image in (left, right)]
    return volume(left.shape, disparities, lambda y, x, d: abs(ranks[0][y, x] - ranks[1][y, x - d]), outside)


def gradient(left, right, disparities, truncation, outside):
    """Eq. 3.2 with a derivative-of-Gaussian filter, sigma 1, 5 x 5, that gives 1 on a ramp of 1."""
    offsets = np.arange(-2, 3)
    smooth = np.exp(-(offsets**2) / 2.0)
    slope = offsets * smooth
    smooth, slope = smooth / smooth.sum(), slope / np.sum(offsets * slope)

    def derivatives(image):
        around = windows(image.astype(float), 5, 5)
        return np.array([around @ slope @ smooth, around @ smooth @ slope])

    def cost(y, x, d):
        return min(truncation, np.abs(a[:, y, x] - b[:, y, x - d]).sum())

    a, b = derivatives(left), derivatives(right)
    return volume(left.shape, disparities, cost, outside)


def intensity_gradient(colors, greys, disparities, outside, filter="sobel", limits=None):
    """Eq. 2.6 + 2.7: (H, W, C) ``colors``, the mean over their channels; (H, W) ``greys`` with their derivatives.

    With (H, W, C) ``greys`` both are sums over the channels. ``outside``: a cost, or "border", the first column's.
    """
    if filter == "sobel":
        mask = np.outer([1, 2, 1], [-1, 0, 1])
    else:
        offsets = np.arange(-2, 3)
        gauss = np.exp(-(offsets**2) / 2)
        slope = offsets * gauss
        mask = np.outer(gauss / gauss.sum(), slope / slope[3:].sum())

    def slopes(image):
        planes = image[..., None] if image.ndim == 2 else image
        around = [windows(planes[..., c].astype(float), *mask.shape) for c in range(planes.shape[2])]
        return np.stack([(each * m).sum(axis=(2, 3)) for each in around for m in (mask, mask.T)], axis=2)

    left, right = (color.astype(int) for color in colors)
    a, b = map(slopes, greys)
    channels = 1 if greys[0].ndim == 3 else left.shape[2]
    largest = limits or (np.inf, np.inf)

    def cost(y, x, d):
        there = max(x - d, 0)
        level = np.abs(left[y, x] - right[y, there]).sum() / channels
        return min(level, largest[0]) + min(np.abs(a[y, x] - b[y, there]).sum(), largest[1])

    if outside == "border":
        return np.array([[[cost(y, x, d) for d in range(disparities)] for x in range(left.shape[1])]
                         for y in range(left.shape[0])])  # fmt: skip
    return volume(left.shape[:2], disparities, cost, outside)


def zncc(left, right, disparities, window, noise, outside):
    around = [windows(image.astype(float), *window) for image in (left, right)]

    def cost(y, x, d):
        a, b = around[0][y, x], around[1][y, x - d]
        a, b = a - a.mean(), b - b.mean()
        floor = noise**2
        correlation = ((a * b).mean() + floor) / np.sqrt(((a * a).mean() + floor) * ((b * b).mean() + floor))
        return np.clip(1 - correlation, 0, 1)

    return volume(left.shape, disparities, cost, outside)


def combined(parts, outside, weights=None):
    """Eq. 3.6: ``parts`` is a list of (costs, lambda); ``weights`` of every part at every pixel, (H, W)."""
    weights = np.ones((len(parts), 1, 1)) if weights is None else weights
    total = sum(w[:, :, None] * (1 - np.exp(-costs / scale)) for w, (costs, scale) in zip(weights, parts, strict=True))
    for x in range(total.shape[1]):
        total[:, x, x + 1 :] = outside
    return total


def constant_window(costs, window):
    """Mean over the window, clipped at the border."""
    r = window // 2
    out = np.empty(costs.shape)
    for y, x in np.ndindex(costs.shape[:2]):
        out[y, x] = costs[max(0, y - r) : y + r + 1, max(0, x - r) : x + r + 1].mean(axis=(0, 1))
    return out


def cross_arms(image, length, threshold, inner_length, inner_threshold):
    """Mei et al.'s two-threshold arms: (4, H, W) left, right, up, down; at least 1 inside the image."""
    image = image.astype(int)
    height, width = image.shape[:2]
    arms = np.zeros((4, height, width), int)
    for y, x in np.ndindex(height, width):
        for side, (dy, dx) in enumerate(((0, -1), (0, 1), (-1, 0), (1, 0))):
            for n in range(1, length + 1):
                v, u = y + n * dy, x + n * dx
                if not (0 <= v < height and 0 <= u < width):
                    break
                far = np.abs(image[v, u] - image[y, x]).max()
                jump = np.abs(image[v, u] - image[v - dy, u - dx]).max()
                limit = threshold if n <= inner_length else inner_threshold
                if n > 1 and (far > limit or jump > threshold):
                    break
                if n == 1 and far > limit:
                    arms[side, y, x] = 1
                    break
                arms[side, y, x] = n
    return arms


def thesis_arms(image, length, threshold):
    """Arms of eq. 3.8 and 3.9 of the thesis: (4, H, W) left, right, up, down; 0 only at the image border."""

    def alike(here, there):
        return all(0 <= at < size for at, size in zip(there, image.shape, strict=False)) and (
            abs(image[there].astype(int) - image[here].astype(int)).max() <= threshold
        )

    arms = np.zeros((4, *image.shape[:2]), int)
    for side, (dy, dx) in enumerate(((0, -1), (0, 1), (-1, 0), (1, 0))):
        for y, x in np.ndindex(image.shape[:2]):
            delta = [alike((y, x), (y + i * dy, x + i * dx)) for i in range(1, length + 1)]
            arms[side, y, x] = 1 + np.argmax([n * np.prod(delta[:n]) for n in range(1, length + 1)])
    arms[0, :, 0] = arms[1, :, -1] = arms[2, 0] = arms[3, -1] = 0
    return arms


def cross(costs, arms, horizontal_first, target=None):
    """One aggregation: mean over the union of the first arms along the second arm, pixel by pixel.

    With ``target`` (the right view's arms) the arms of (y, x) are cut to those of its match (y, x - d);
    a match outside the right image cuts nothing.
    """
    height, width, disparities = costs.shape
    out = np.empty(costs.shape)
    for d in range(disparities):
        cut = arms.copy()
        if target is not None and d < width:
            cut[:, :, d:] = np.minimum(cut[:, :, d:], target[:, :, : width - d])
        left, right, up, down = cut
        for y, x in np.ndindex(height, width):
            support = []
            if horizontal_first:
                for v in range(y - up[y, x], y + down[y, x] + 1):
                    support.append(costs[v, x - left[v, x] : x + right[v, x] + 1, d])
            else:
                for u in range(x - left[y, x], x + right[y, x] + 1):
                    support.append(costs[y - up[y, u] : y + down[y, u] + 1, u, d])
            out[y, x, d] = np.concatenate(support).mean()
    return out


def adaptive_weight(costs, left, right, radius, gamma_color, gamma_space, squared=False):
    """Yoon & Kweon's weighted mean in float64; left, right are (H, W, 3) colors as floats.

    Neighbors outside either image are left out; cells with d > x keep their cost.
    """
    height, width, disparities = costs.shape
    out = costs.astype(float)
    for y, x in np.ndindex(height, width):
        for d in range(min(disparities, x + 1)):
            rows, columns = slice(max(0, y - radius), y + radius + 1), slice(max(0, x - radius, d), x + radius + 1)
            v, u = np.arange(height)[rows, None], np.arange(width)[None, columns]
            color_l = np.sum((left[y, x] - left[v, u]) ** 2, axis=2)
            color_r = np.sum((right[y, x - d] - right[v, u - d]) ** 2, axis=2)
            space = (y - v) ** 2 + (x - u) ** 2
            if not squared:
                color_l, color_r, space = np.sqrt(color_l), np.sqrt(color_r), np.sqrt(space)
            weight = np.exp(-((color_l + color_r) / gamma_color + 2 * space / gamma_space))
            out[y, x, d] = (weight * costs[v, u, d]).sum() / weight.sum()
    return out


PATHS = ((0, -1), (-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1))


def scanline(costs, image, p1, p2, paths, edge_threshold, edge_divisor):
    """Sum over the paths of Hirschmueller's path costs; integer costs and penalties.

    ``image`` is (H, W, C); across a step of more than the threshold both penalties are divided.
    """
    costs, image = costs.astype(int), image.astype(int)
    height, width, disparities = costs.shape
    total = np.zeros(costs.shape, int)
    for dy, dx in PATHS if paths == 8 else PATHS[::2]:
        path = np.zeros(costs.shape, int)
        for y in range(height) if dy <= 0 else range(height - 1, -1, -1):
            for x in range(width) if dx <= 0 else range(width - 1, -1, -1):
                v, u = y + dy, x + dx
                if not (0 <= v < height and 0 <= u < width):
                    path[y, x] = costs[y, x]
                    continue
                edge = np.abs(image[y, x] - image[v, u]).max() > edge_threshold
                q1, q2 = (round(p1 / edge_divisor), round(p2 / edge_divisor)) if edge else (p1, p2)
                before = path[v, u]
                for d in range(disparities):
                    ways = [before[d], before.min() + q2]
                    if d > 0:
                        ways.append(before[d - 1] + q1)
                    if d + 1 < disparities:
                        ways.append(before[d + 1] + q1)
                    path[y, x, d] = costs[y, x, d] + min(ways) - before.min()
        total += path
    return total


def winners(costs):
    """Cheapest disparities of the left and the right view; the smaller one wins ties."""
    return gathered_winners(costs, np.ones(costs.shape, bool))[:2]


def left_right_check(values, right, disparities, tolerance):
    """(kept values, occluded, mismatch): a removed pixel is occluded if no right pixel points to it."""
    values = values.copy()
    occluded, mismatch = np.zeros(values.shape, bool), np.zeros(values.shape, bool)
    for y, x in np.ndindex(values.shape):
        d = values[y, x]
        if np.isnan(d):
            continue
        u = x - int(np.floor(d + 0.5))
        if u >= 0 and abs(d - right[y, u]) <= tolerance:
            continue
        points_back = any(right[y, x - other] == other for other in range(min(disparities, x + 1)))
        (mismatch if points_back else occluded)[y, x] = True
        values[y, x] = np.nan
    return values, occluded, mismatch


def background_fill(values):
    """The smaller of the nearest values in the row; rows without any from the nearest row above, else below."""
    out = values.copy()
    for y, row in enumerate(values):
        known = np.flatnonzero(~np.isnan(row))
        for x in np.flatnonzero(np.isnan(row)):
            sides = [known[known < x][-1:], known[known > x][:1]]
            candidates = [row[side[0]] for side in sides if side.size]
            if candidates:
                out[y, x] = min(candidates)
    rows = np.flatnonzero(~np.isnan(out).all(axis=1))
    for y in range(len(out)):
        if rows.size and y not in rows:
            above, below = rows[rows < y], rows[rows > y]
            out[y] = out[above[-1]] if above.size else out[below[0]]
    return out


def median(values, window):
    """Median where the whole window (border repeated) has values; elsewhere the value itself."""
    medians = np.median(windows(values, window, window), axis=(2, 3))
    return np.where(np.isnan(medians), values, medians)


def subpixel(costs, values):
    """Minimum of the parabola through three costs, where the middle one is a local minimum inside the range."""
    costs, out = costs.astype(float), values.copy()
    for y, x in np.ndindex(values.shape):
        d = values[y, x]
        if np.isnan(d) or d != int(d) or not 1 <= d < min(costs.shape[2], x + 1) - 1:
            continue
        below, here, above = costs[y, x, int(d) - 1 : int(d) + 2]
        if below >= here <= above and below + above > 2 * here:
            out[y, x] = d + 0.5 * (below - above) / (below + above - 2 * here)
    return out


def region_voting(values, arms, disparities, votes, majority):
    """One round: an empty pixel takes the most frequent disparity of its support, the smallest on a tie."""
    out = values.copy()
    left, right, up, down = arms
    for y, x in np.argwhere(np.isnan(values)):
        support = []
        for v in range(y - up[y, x], y + down[y, x] + 1):
            support += list(values[v, x - left[v, x] : x + right[v, x] + 1])
        known = np.array([d for d in support if not np.isnan(d)])
        if len(known) > votes:
            counts = np.bincount(np.minimum(np.floor(known + 0.5).astype(int), disparities - 1))
            if counts.max() > majority * len(known):
                out[y, x] = counts.argmax()
    return out


def interpolation(values, occluded, image):
    """Nearest values in 16 directions: the lowest for occluded pixels, else the most similarly colored."""
    height, width = values.shape
    image = image.astype(int)
    out = values.copy()
    for y, x in np.argwhere(np.isnan(values)):
        seen = []
        for dy in range(-2, 3):
            for dx in range(-2, 3):
                if max(abs(dy), abs(dx)) == 0 or {abs(dy), abs(dx)} in ({0, 2}, {2}):
                    continue
                v, u = y + dy, x + dx
                while 0 <= v < height and 0 <= u < width:
                    if not np.isnan(values[v, u]):
                        seen.append((np.abs(image[y, x] - image[v, u]).sum(), values[v, u]))
                        break
                    v, u = v + dy, u + dx
        if seen and occluded[y, x]:
            out[y, x] = min(d for _, d in seen)
        elif seen:
            closest = min(difference for difference, _ in seen)
            out[y, x] = np.nan if len({d for c, d in seen if c == closest}) > 1 else dict(seen)[closest]
    return out


def directional_fill(values, measured, image, right, color_scale, distance_scale):
    """Filled values, right of the first measured one, replaced by the cheapest of 8 directions if it costs 1 less.

    Returns the map and which pixels are decided by more than rounding.
    """
    height, width = values.shape
    image = image.astype(float)
    out, decided = values.copy(), np.ones(values.shape, bool)
    for y, x in np.argwhere(~measured & ~np.isnan(values)):
        if not measured[y, :x].any():
            continue
        agreeing, others = [4.0], [(4.0, values[y, x])]
        for dy, dx in itertools.product((-1, 0, 1), repeat=2):
            steps = [(y + k * dy, x + k * dx) for k in range(max(height, width) * (dy != 0 or dx != 0))]
            steps = [(v, u) for v, u in steps if 0 <= v < height and 0 <= u < width]
            end = next((k for k, place in enumerate(steps) if measured[place]), None)
            if end is None:
                continue
            colors = np.array([image[place] for place in steps[: end + 1]])
            cost = np.abs(np.diff(colors, axis=0)).sum(axis=1).max() / (3 * color_scale) + end / distance_scale
            value = values[steps[end]]
            u = x - int(value + 0.5)
            if u >= 0 and right[y, u] < value - 1.5:
                cost += 1.5
            if abs(value - values[y, x]) <= 2 + 0.3 * end:
                agreeing.append(cost)
            else:
                others.append((cost, value))
        others.sort()
        if others[0][0] + 1 < min(agreeing):
            out[y, x] = others[0][1]
        close = [value for cost, value in others if cost < others[0][0] + 1e-4]
        decided[y, x] = abs(others[0][0] + 1 - min(agreeing)) > 1e-4 and len(set(close)) == 1
    return out, decided


def discontinuity_adjustment(values, costs):
    """Beside a jump of more than 1, the cheapest of a pixel's own and its two neighbors' disparities."""
    for dy, dx in ((0, 1), (1, 0)):
        out = values.copy()
        for y in range(dy, values.shape[0] - dy):
            for x in range(dx, values.shape[1] - dx):
                offers = np.array([values[y, x], values[y - dy, x - dx], values[y + dy, x + dx]])
                if np.isnan(offers).any() or np.abs(offers - offers[0]).max() <= 1:
                    continue
                whole = np.floor(offers + 0.5).astype(int)
                price = [costs[y, x, d] if d <= x and d < costs.shape[2] else np.inf for d in whole]
                out[y, x] = offers[int(np.argmin(price))]
        values = out
    return values


def middle(values, weights, slack):
    """Lowest and highest value that may have half of the weight below it."""
    order = np.argsort(values, kind="stable")
    share = np.cumsum(weights[order]) / weights.sum()
    return values[order][np.searchsorted(share, [0.5 - slack, 0.5 + slack])]


def speckle_filter(values, size, step):
    """Empty what belongs to a 4-connected region of at most ``size`` pixels; neighbors differ by at most ``step``."""
    labels = components(values[..., None], step)
    return np.where(np.bincount(labels.ravel())[labels] <= size, np.nan, values)


def surface_fill(values, rows, reach, support, largest):
    """Both surfaces beside a gap, continued along its row; the one farther back."""
    height, width = values.shape
    out = values.copy()

    def same(v, u, level):
        return 0 <= v < height and 0 <= u < width and abs(values[v, u] - level) <= 1

    def surface(y, x, away):
        """The pixels (u, v, d) of the surface that (y, x) belongs to, relative to (y, x)."""
        pixels = []
        for lines in (range(y - 1, y - rows - 1, -1), range(y, y + rows + 1)):
            column, level = x, values[y, x]
            for v in lines:
                near = [column + side * offset for offset in range(12) for side in (away, -away)]
                column = next((u for u in near if same(v, u, level)), None)
                if column is None:
                    break
                level = last = values[v, column]
                strangers = 0
                for u in range(column, column + away * reach, away):
                    strangers = 0 if same(v, u, last) else strangers + 1
                    if strangers > 3 or not 0 <= u < width:
                        break
                    if strangers == 0:
                        last = values[v, u]
                        pixels.append((u - x, v - y, last - values[y, x]))
        return np.array(pixels, float)

    def plane(y, x, away):
        """(slope along the row, value at (y, x))"""
        pixels = surface(y, x, away)
        if len(pixels) < support:
            return 0.0, values[y, x]
        terms = np.column_stack([pixels[:, :2], np.ones(len(pixels))])
        weights, solution = np.ones(len(pixels)), np.zeros(3)
        for _ in range(4):
            # One pixel of variance more in u and v.
            normal = (terms * weights[:, None]).T @ terms + weights.sum() * np.diag([1.0, 1.0, 0.0])
            solution = np.linalg.solve(normal, (terms * weights[:, None]).T @ pixels[:, 2])
            weights = 1 / np.maximum(1, 2 * np.abs(pixels[:, 2] - terms @ solution))
        return solution[0], values[y, x] + solution[2]

    for y in range(height):
        known = np.flatnonzero(~np.isnan(values[y]))
        for x in np.flatnonzero(np.isnan(values[y])):
            offers = []
            for end, away in ((known[known < x][-1:], -1), (known[known > x][:1], 1)):
                if end.size:
                    slope, value = plane(y, end[0], away)
                    offers.append(value + slope * (x - end[0]))
            if offers:
                out[y, x] = min(max(min(offers), 0), largest)
    return out


def slopes(values, image, radius):
    """(2, H, W): plane through similar pixels of a 9 x 9 grid, fitted twice, shrunk by doubt."""
    height, width = values.shape
    image = image.astype(int)
    step = max(1, radius // 4)
    found = np.zeros((2, height, width))
    for y, x in np.argwhere(~np.isnan(values)):
        samples = []
        for dy in range(-4 * step, 4 * step + 1, step):
            for dx in range(-4 * step, 4 * step + 1, step):
                v, u = y + dy, x + dx
                if not (0 <= v < height and 0 <= u < width) or np.isnan(values[v, u]):
                    continue
                apart = float(values[v, u]) - float(values[y, x])
                if np.abs(image[v, u] - image[y, x]).sum() <= 75 and abs(apart) <= 1 + 0.15 * np.hypot(dy, dx):
                    samples.append((dx, dy, apart))
        dx, dy, apart = np.array(samples).T
        weight, plane = np.ones(len(dx)), np.zeros(3)
        for turn in range(2):
            if turn:
                weight = np.maximum(1 - (apart - plane @ [dx, dy, np.ones(len(dx))]) ** 2, 0)
            if weight.sum() < 6:
                plane = np.zeros(3)
                continue
            share = weight / weight.sum()
            mx, my, md = (share * dx).sum(), (share * dy).sum(), (share * apart).sum()
            moments = np.array([[0.2, 0], [0, 0.2]])
            for k, a in enumerate((dx - mx, dy - my)):
                for m, b in enumerate((dx - mx, dy - my)):
                    moments[k, m] += (share * a * b).sum()
            sides = np.array([(share * (dx - mx) * (apart - md)).sum(), (share * (dy - my) * (apart - md)).sum()])
            a, b = np.clip(np.linalg.solve(moments, sides), -1, 1)
            plane = np.array([a, b, md - a * mx - b * my])
        residual = apart - plane @ [dx, dy, np.ones(len(dx))]
        variance = (weight * residual**2).sum() / max(weight.sum(), 1)
        steep = plane[0] ** 2 + plane[1] ** 2
        found[:, y, x] = plane[:2] * steep / (steep + 4 * (variance + 0.01) * 3 / radius**2)
    return found


def weighted_median(values, image, radius, color_scale, distance_scale, trust=None, gradient=None):
    """(lowest, highest) acceptable median of the values, in steps of 1/8, or of values extrapolated by a gradient."""
    image, low, high = image.astype(float), values.astype(float), values.astype(float)
    for y, x in np.argwhere(~np.isnan(values)):
        window = np.s_[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1]
        v, u = (axis[: values[window].shape[0], : values[window].shape[1]] for axis in np.mgrid[window])
        color = np.abs(image[window] - image[y, x]).mean(axis=2)
        weight = np.exp(-np.minimum(color / color_scale + np.hypot(v - y, u - x) / distance_scale, 16))
        if gradient is None:
            votes, weight = np.floor(values[window] * 8 + 0.5) / 8, weight * trust[window]
        else:
            votes = values[window] + gradient[0][window] * (x - u) + gradient[1][window] * (y - v)
        known = ~np.isnan(votes) & (weight > 0)
        if known.any():
            low[y, x], high[y, x] = middle(votes[known], weight[known], 1e-5 if gradient is None else 1e-3)
    return low, high


def gathered_winners(costs, allowed):
    """Winners of both views over the cells ``allowed`` (H, W, D), and the left one's minima; right -1 where none."""
    height, width, n_disparities = costs.shape
    left, right = np.zeros((height, width), np.int64), np.full((height, width), -1)
    minima = np.zeros((height, width))
    for y in range(height):
        best = {}
        for x in range(width):
            cells = [(float(costs[y, x, d]), d) for d in range(min(n_disparities, x + 1)) if allowed[y, x, d]]
            for cost, d in cells:
                best[x - d] = min(best.get(x - d, (np.inf, 0)), (cost, d))
            d = min(cells)[1] if cells else 0
            left[y, x] = minima[y, x] = d
            if not 1 <= d < min(n_disparities, x + 1) - 1 or not allowed[y, x, d - 1 : d + 2].all():
                continue
            a, b, c = (float(costs[y, x, d + k]) for k in (-1, 0, 1))
            if a >= b and c >= b and a + c > 2 * b:
                minima[y, x] = d + 0.5 * (a - c) / (a + c - 2 * b)
        for x, (_, d) in best.items():
            right[y, x] = d
    return left, right, minima

"""Slow, obvious versions of the metrics, pixel by pixel, from the benchmarks' definitions. Never imports depthcli."""

import itertools
import math

import numpy as np


def known_pixels(truth, mask):
    """Places (y, x) of the pixels that count."""
    height, width = truth.shape
    return [(y, x) for y in range(height) for x in range(width) if mask[y, x] and not math.isnan(truth[y, x])]


def bad_v2(estimate, truth, mask, t):
    """(wrong, pixels): wrong if off by more than t or without a value, as below 0."""
    wrong, pixels = 0, known_pixels(truth, mask)
    for y, x in pixels:
        d = float(estimate[y, x])
        if math.isnan(d) or d < 0 or abs(d - float(truth[y, x])) > t:
            wrong += 1
    return wrong, len(pixels)


def evaldisp(estimate, truth, mask, t, max_disparity, rounded):
    """(bad %, invalid %, total %, average error) of a map that may be 1, 1/2, 1/4 of the truth's size."""
    factor = truth.shape[1] // estimate.shape[1]
    top = factor * math.ceil(max_disparity / factor)
    bad, invalid, total, pixels = 0, 0, 0.0, known_pixels(truth, mask)
    for y, x in pixels:
        d = factor * float(estimate[y // factor, x // factor])
        if math.isnan(d) or d > 1000 * top:  # -inf is a number, as in the SDK
            invalid += 1
            continue
        d = max(0.0, min(top, d))
        if rounded:
            d = math.floor(d + 0.5)
        error = abs(d - float(truth[y, x]))
        total += error
        bad += error > t
    n = len(pixels)
    average = total / (n - invalid) if n > invalid else math.nan
    return 100 * bad / n, 100 * invalid / n, 100 * (bad + invalid) / n, average


def eth3d(estimate, truth, mask, t):
    """(bad %, coverage %, average error, median) among the estimated pixels; 100 % bad where there is none."""
    pixels = known_pixels(truth, mask)
    values = [(float(estimate[place]), float(truth[place])) for place in pixels]
    errors = [abs(d - true) for d, true in values if not math.isnan(d) and abs(d) <= truth.shape[1]]
    if not errors:
        return 100.0, 0.0, math.nan, math.nan
    errors.sort()
    bad = 100 * sum(e > t for e in errors) / len(errors)
    return bad, 100 * len(errors) / len(pixels), sum(errors) / len(errors), errors[len(errors) // 2]


def interpolate_background(disparity):
    """Rows: runs between values get the smaller one, ends are extended; then columns, to top and bottom only."""
    out = disparity.copy()
    for row in out:
        known = [x for x in range(len(row)) if not math.isnan(row[x])]
        for a, b in itertools.pairwise(known):
            for x in range(a + 1, b):
                row[x] = min(row[a], row[b])
        extend(row, known)
    for column in out.T:
        extend(column, [y for y in range(len(column)) if not math.isnan(column[y])])
    return out


def extend(line, known):
    """Write the first and the last of the known values into what lies before and behind them."""
    for k in range(len(line)):
        if known and k < known[0]:
            line[k] = line[known[0]]
        if known and k > known[-1]:
            line[k] = line[known[-1]]


def submitted(disparity):
    """What a 16-bit PNG holds of a map: whole 256ths from 1 to 65535, nothing below zero."""
    out = disparity.copy()
    for place, d in np.ndenumerate(disparity.astype(float)):
        out[place] = min(max(round(d * 256), 1), 65535) / 256 if d >= 0 else math.nan
    return out


def kitti_frame(estimate, truth, mask, wrong):
    """Sums of one frame by the rules of both kits, in loops over columns, then rows.

    Written from the rules (frames averaged or pooled, divisors of at least 1); the kits' programs are not run here.
    What they printed for maps with estimates in every frame is in ``test_numbers_of_evaluate_stereo`` and
    ``test_numbers_of_evaluate_scene_flow``.

    ``wrong(error, true)`` judges a pixel. (wrong, error sum, pixels) of the interpolated map, then of the pixels that
    the map itself has a value for. A pixel that the interpolation leaves empty holds -1, and counts by it.
    """
    filled = interpolate_background(estimate)
    bad, total, pixels = [0, 0], [0.0, 0.0], [0, 0]
    for x in range(truth.shape[1]):
        for y in range(truth.shape[0]):
            true = float(truth[y, x])
            if not mask[y, x] or not true >= 0:
                continue
            d = -1.0 if math.isnan(filled[y, x]) else float(filled[y, x])
            for k in range(1 if math.isnan(estimate[y, x]) else 2):
                bad[k] += wrong(abs(d - true), true)
                total[k] += abs(d - true)
                pixels[k] += 1
    return bad, total, pixels


def d1(error, true):
    """The rule of KITTI 2015; exactly 5 % is wrong."""
    return error > 3 and error >= 0.05 * true


def kitti_2012(frames, wrong):
    """(%, average error) of interpolated and estimated pixels, and density %: each the mean of the frames' own figures.

    A frame's sums are divided by at least 1, so that one without any estimate gives 0.
    """
    rows = [figures(*kitti_frame(*frame, wrong)) for frame in frames]
    return [sum(column) / len(frames) for column in zip(*rows, strict=True)]


def kitti_2015(frames, wrong):
    """The same five figures, each a quotient of the sums over all frames; the divisor is at least 1."""
    return figures(*np.sum([kitti_frame(*frame, wrong) for frame in frames], axis=0))


def figures(bad, total, pixels):
    both = [(100 * bad[k] / max(pixels[k], 1), total[k] / max(pixels[k], 1)) for k in (0, 1)]
    return [*both[0], *both[1], 100 * pixels[1] / max(pixels[0], 1)]


def expected_sparsification(confidence, wrong, percentages):
    """Error rates of the most confident pixels, averaged over every order that respects the confidence."""
    n = len(wrong)
    sums = [0.0] * len(percentages)
    orders = 0
    for order in itertools.permutations(range(n)):
        if any(confidence[a] < confidence[b] for a, b in itertools.pairwise(order)):
            continue
        orders += 1
        for i, percent in enumerate(percentages):
            size = percent * n / 100
            whole = int(size + 1e-9)
            count = sum(wrong[p] for p in order[:whole])
            if whole < n:
                count += (size - whole) * wrong[order[whole]]
            sums[i] += count / size
    return [s / orders for s in sums]


def sparsification_area(confidence, error, steps=4000):
    """Integral over the share of the surest pixels of their mean error, by many small steps."""
    shares = [100 * (k + 0.5) / steps for k in range(steps)]
    return sum(expected_sparsification(confidence, error, shares)) / steps

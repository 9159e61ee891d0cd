"""Slow and obvious twins of the kernels of refine-kinect; numpy only."""

from __future__ import annotations

import itertools

import numpy as np


def jump_distance_of_line(line, jump, slope):
    """(distance to the nearest jump, length of the run) of every pixel of a line, capped at 255."""
    known = [i for i in range(len(line)) if not np.isnan(line[i])]
    rises, falls = [], []  # first and last pixels of near sides
    for a, b in itertools.pairwise(known):
        if abs(line[b] - line[a]) > max(jump, slope * (b - a)):
            (rises if line[b] > line[a] else falls).append((a, b))
    nearest = np.full(len(line), 255)
    length = np.full(len(line), 255)
    for i in known:
        # The last event a walker from the left met, and the first one from the right.
        left = max((e for e in rises + falls if e[1] <= i), key=lambda e: e[1], default=None)
        right = min((e for e in rises + falls if e[0] >= i), key=lambda e: e[0], default=None)
        from_left = i - left[1] + 1 if left in rises else None
        from_right = right[0] - i + 1 if right in falls else None
        nearest[i] = min([255] + [v for v in (from_left, from_right) if v is not None])
        if from_left is not None and from_right is not None and from_left < 255:
            length[i] = min(255, from_left + from_right - 1)
    return nearest, length


def jump_distance(disparity, jump, slope):
    """(row, column, length) as in depthcli.kinect.suspects.jump_distance."""
    height, width = disparity.shape
    rows = [jump_distance_of_line(disparity[y], jump, slope) for y in range(height)]
    columns = [jump_distance_of_line(disparity[:, x], jump, slope)[0] for x in range(width)]
    return np.array([r[0] for r in rows]), np.array(columns).T, np.array([r[1] for r in rows])

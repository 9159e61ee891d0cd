"""Slow and obvious twins of the kernels of refine-kinect; numpy only."""

from __future__ import annotations

import itertools

import numpy as np


def jump_distance_of_line(line, jump, gap_tolerance):
    """(distance to the nearest jump, length of the run) of every pixel of a line, capped at 255."""
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
    length = np.full(len(line), 255)
    for i in known:
        left = [e for e in events if e[1] <= i][-1:]
        right = [e for e in events if e[0] >= i][:1]
        from_left = i - left[0][1] + 1 if left and left[0][3] else None
        from_right = right[0][0] - i + 1 if right and right[0][2] else None
        nearest[i] = min([255] + [v for v in (from_left, from_right) if v is not None])
        if from_left is not None and from_right is not None and from_left < 255:
            length[i] = min(255, from_left + from_right - 1)
    return nearest, length


def jump_distance(disparity, jump, gap_tolerance):
    """(row, column, length) as in depthcli.kinect.suspects.jump_distance."""
    height, width = disparity.shape
    rows = [jump_distance_of_line(disparity[y], jump, gap_tolerance) for y in range(height)]
    columns = [jump_distance_of_line(disparity[:, x], jump, np.inf)[0] for x in range(width)]
    return np.array([r[0] for r in rows]), np.array(columns).T, np.array([r[1] for r in rows])

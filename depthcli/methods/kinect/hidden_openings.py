"""Measurements where the near surfaces on both sides of an opening have grown over it: neither gap nor step is left."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.kinect.candidates import Voters, color_similarity

# Values that the preset refine-kinect accurate was published with; nothing in the repository varies them.
_MIN_LIKELIHOOD_RATIO = 0.3  # of a pixel's color on its own surface to that on surfaces behind it
_MIN_OPENING_DISTANCE = 9  # pixels: nearer ones may lie in the same opening
_OPENING_REACH = 36  # pixels
_OPENING_GRID, _OPENING_SQUARE = 3, 5  # one pixel of a square of 3 x 3 is tested, for all of 5 x 5 around it
_OPENING_SCALE = 20.0  # distance over which weights fall by 1/e, pixels


def hidden_openings(
    lab: NDArray[np.uint8],
    planes: WindowPlanes,
    voters: Voters,
    trusted: NDArray[np.bool_],
    jump: float,
    sigma_color: float,
) -> NDArray[np.bool_]:
    """Select the measured pixels, (H, W) bool, whose color is that of a surface behind the measured one.

    A pixel is selected if its color is much less likely on the surface that was measured there than on those farther
    away within 36 pixels. Only the color shows an opening that near surfaces have grown over from both sides.

    Parameters
    ----------
    lab : (H, W, 3) uint8
    planes : of the measured disparity
    voters : with a stride of 4
    trusted : (H, W) bool, pixels to test
    jump : surfaces that are farther by more lie behind, pixels
    sigma_color : as in :func:`cast_votes`
    """
    space = np.exp(-np.arange(_OPENING_REACH + 1) / _OPENING_SCALE).astype(np.float32)
    shape = trusted.shape
    hidden = np.zeros((-(-shape[0] // _OPENING_GRID), -(-shape[1] // _OPENING_GRID)), np.uint8)
    _test_openings(
        lab, planes.value, planes.slope_x, planes.slope_y, trusted, voters.planes, voters.lab, voters.weight,
        color_similarity(sigma_color), space, np.float32(jump), hidden,
    )  # fmt: skip
    spread = np.zeros(shape, np.uint8)
    spread[::_OPENING_GRID, ::_OPENING_GRID] = hidden
    opened: NDArray[np.bool_] = (
        cv2.dilate(spread, np.ones((_OPENING_SQUARE, _OPENING_SQUARE), np.uint8)) > 0
    ) & trusted
    return opened


@parallel_jit
def _test_openings(lab, value, slope_x, slope_y, trusted, planes, colors, weight, similarity, space, jump, hidden):
    for j in prange(hidden.shape[0]):
        y = _OPENING_GRID * j
        for i in range(hidden.shape[1]):
            x = _OPENING_GRID * i
            if not trusted[y, x]:
                continue
            own = value[y, x]
            light, a, b = np.int32(lab[y, x, 0]), np.int32(lab[y, x, 1]), np.int32(lab[y, x, 2])
            s_own, n_own = np.float32(0), np.float32(1e-9)
            s_far, n_far = np.float32(0), np.float32(1e-9)
            top, bottom = max((y - _OPENING_REACH + 3) // 4, 0), min((y + _OPENING_REACH) // 4 + 1, weight.shape[0])
            left, right = max((x - _OPENING_REACH + 3) // 4, 0), min((x + _OPENING_REACH) // 4 + 1, weight.shape[1])
            for v in range(top, bottom):
                dy = 4 * v - y
                row = space[abs(dy)]
                for u in range(left, right):
                    dx = 4 * u - x
                    if weight[v, u] <= 0 or (abs(dx) <= _MIN_OPENING_DISTANCE and abs(dy) <= _MIN_OPENING_DISTANCE):
                        continue
                    d = planes[0, v, u]
                    here = own + slope_x[y, x] * np.float32(dx) + slope_y[y, x] * np.float32(dy)
                    z = row * space[abs(dx)]
                    c = abs(np.int32(colors[0, v, u]) - light) + abs(np.int32(colors[1, v, u]) - a)
                    c += abs(np.int32(colors[2, v, u]) - b)
                    if d < min(own, here) - jump:
                        s_far += z * similarity[c]
                        n_far += z
                    elif abs(d - own) < jump or abs(d - here) < jump:
                        s_own += z * similarity[c]
                        n_own += z
            if (
                n_far > np.float32(1e-6)
                and n_own > np.float32(1e-6)
                and s_own * n_far < _MIN_LIKELIHOOD_RATIO * s_far * n_own
            ):
                hidden[j, i] = 1

"""Measured pixels whose color speaks for a surface behind the one that was measured.

Where near surfaces grow over a narrow opening from both sides, it is closed: neither a gap nor a step is left, and
only the color shows what lies behind.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.kinect.votes import Voters, color_law

_RATIO = 0.3  # own likelihood of the color over that of what lies behind, below which a pixel is in doubt
_OWN_REACH = 9  # pixels: what is nearer may lie in the same opening
_REACH = 36
_GRID = 3  # one pixel of a square this wide is asked ...
_SPREAD = 5  # ... for all of a square this wide
_SIGMA_SPACE = 20.0  # pixels


def hidden_openings(
    lab: NDArray[np.uint8],
    planes: WindowPlanes,
    voters: Voters,
    trusted: NDArray[np.bool_],
    jump: float,
    sigma_color: float,
) -> NDArray[np.bool_]:
    """(H, W) bool, those of the ``trusted`` pixels that may show through an opening in what was measured.

    Parameters
    ----------
    lab : (H, W, 3) uint8
    planes : of the measured disparity
    voters : every fourth pixel
    trusted : (H, W) bool, which pixels to ask
    jump : a surface that is farther by more is another one, pixels
    sigma_color : as in :func:`depthcli.methods.kinect.votes.cast_votes`
    """
    space = np.exp(-np.arange(_REACH + 1) / _SIGMA_SPACE).astype(np.float32)
    shape = trusted.shape
    doubt = np.zeros((-(-shape[0] // _GRID), -(-shape[1] // _GRID)), np.uint8)
    _ask(
        lab, planes.value, planes.slope_x, planes.slope_y, trusted, voters.planes, voters.lab, voters.weight,
        color_law(sigma_color), space, np.float32(jump), doubt,
    )  # fmt: skip
    spread = np.zeros(shape, np.uint8)
    spread[::_GRID, ::_GRID] = doubt
    opened: NDArray[np.bool_] = (cv2.dilate(spread, np.ones((_SPREAD, _SPREAD), np.uint8)) > 0) & trusted
    return opened


@parallel_jit
def _ask(lab, value, slope_x, slope_y, trusted, planes, colors, weight, likeness, space, jump, doubt):  # type: ignore[no-untyped-def]
    """Every ``_GRID``-th pixel of such rows."""
    for j in prange(doubt.shape[0]):
        y = _GRID * j
        for i in range(doubt.shape[1]):
            x = _GRID * i
            if not trusted[y, x]:
                continue
            own = value[y, x]
            light, a, b = np.int32(lab[y, x, 0]), np.int32(lab[y, x, 1]), np.int32(lab[y, x, 2])
            s_own, n_own = np.float32(0), np.float32(1e-9)
            s_far, n_far = np.float32(0), np.float32(1e-9)
            top, bottom = max((y - _REACH + 3) // 4, 0), min((y + _REACH) // 4 + 1, weight.shape[0])
            left, right = max((x - _REACH + 3) // 4, 0), min((x + _REACH) // 4 + 1, weight.shape[1])
            for v in range(top, bottom):
                dy = 4 * v - y
                row = space[abs(dy)]
                for u in range(left, right):
                    dx = 4 * u - x
                    if weight[v, u] <= 0 or (abs(dx) <= _OWN_REACH and abs(dy) <= _OWN_REACH):
                        continue
                    d = planes[0, v, u]
                    here = own + slope_x[y, x] * np.float32(dx) + slope_y[y, x] * np.float32(dy)
                    z = row * space[abs(dx)]
                    c = abs(np.int32(colors[0, v, u]) - light) + abs(np.int32(colors[1, v, u]) - a)
                    c += abs(np.int32(colors[2, v, u]) - b)
                    if d < min(own, here) - jump:
                        s_far += z * likeness[c]
                        n_far += z
                    elif abs(d - own) < jump or abs(d - here) < jump:
                        s_own += z * likeness[c]
                        n_own += z
            if n_far > np.float32(1e-6) and n_own > np.float32(1e-6) and s_own * n_far < _RATIO * s_far * n_own:
                doubt[j, i] = 1

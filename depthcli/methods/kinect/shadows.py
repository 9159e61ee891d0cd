"""Shadows: gaps next to near surfaces. Their side and width, measured in each frame, limit the surfaces in them.

If the projector is on the camera's right, it does not reach some pixels left of a near surface. These pixels have no
depth: in a row, the pixels x with ``x - d(x) >= x' - d(x')`` for a nearer pixel x' on their right. On one far surface
they form a strip as wide as the disparity step. If depth was converted to disparity with another baseline, the strip is
wider or narrower by a factor. If the near surface has grown over its shadow, the strip is narrower by some pixels. A
depth map that was registered to a color camera also has such gaps on the right of near surfaces.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from depthcli.core.maps import Floats
from depthcli.kernels.jit import empty, helper, jit

# Chosen on simulated sensors and on blocks cut out of real frames; nothing in the repository varies them.
WIDTH_TOLERANCE = 4.0
"""Largest difference between a gap's width and a shadow's width if the gap counts as a shadow, pixels."""
_MAX_WIDTH_DIFFERENCE = 3.0  # largest difference of widths that count as equal, pixels
_FULL_SHARE = 0.5  # excess share of gaps as wide as shadows, above chance, at which the confidence reaches 1
_PRIOR_ROWS = 0.25  # prior number of gaps that are no shadows, per row of the frame: about as many as an object has
_PRIOR_PAIRS = 20.0  # prior number of pairs of gaps with different steps
_PRIOR_CHANCE = 0.1  # prior probability that a gap is as wide as a shadow by chance
_SCALES = 2.0 ** np.linspace(-2, 0.5, 21)  # candidate widths of a shadow per pixel of step
_COVERED = np.arange(9.0)  # candidate numbers of shadow pixels that the near surface covers
_LIKELY = 0.4  # smallest confidence at which a side's gaps are taken for shadows
_MIN_OF_BEST = 0.4  # a side with a smaller share of the other side's confidence has no shadows
_MIN_GAIN = 1.2  # another width must fit more gaps than the width of their step, by this factor
_MAX_GAPS = 2000  # more gaps do not change the estimate
_STEP_WEIGHT = 2.0  # weight of a pixel in a non-shadow gap next to a step; a pixel in a hole of one surface has 1
_STEEPNESS = 6  # exponent of the ratio in the odds of holes
_EQUAL_RATIO = 6.5  # non-shadow gap pixels / shadow pixels at which the probability of holes is 0.5


@dataclass(frozen=True)
class Shadow:
    """The shadows on one side of near surfaces."""

    confidence: float = 0.0  # confidence that gaps next to steps are shadows, 0 .. 1
    scale: float = 1.0  # width of a shadow per pixel of its step
    covered: float = 0.0  # pixels of a shadow that the near surface has grown over


@dataclass(frozen=True)
class Shadows:
    """The shadows on the left and on the right of near surfaces."""

    left: Shadow = Shadow()
    right: Shadow = Shadow()
    p_hole: float = 0.0  # probability that the other gaps are holes: visible surfaces that the sensor missed

    def figures(self) -> dict[str, float]:
        """Return widths and confidences of both sides, for the report."""
        sides = {"left": self.left, "right": self.right}
        widths = {f"shadow_width_{name}": round(side.scale, 3) for name, side in sides.items()}
        return widths | {f"shadows_{name}": round(side.confidence, 3) for name, side in sides.items()}

    def likely(self) -> Shadows:
        """Return only the sides that probably have shadows, for methods that do not weight by confidence."""
        left, right = (side if side.confidence >= _LIKELY else Shadow() for side in (self.left, self.right))
        return Shadows(left, right, self.p_hole)

    def sides(self) -> Iterator[tuple[Shadow, int, bool]]:
        """Yield each side that has shadows, its column step (1 left, -1 right), and whether holes are judged by it.

        With column step -1 the frame is mirrored, and its shadows on the right are on the left.
        """
        holes_right = self.right.confidence > self.left.confidence
        min_confidence = _MIN_OF_BEST * max(self.left.confidence, self.right.confidence)
        for shadow, step in ((self.left, 1), (self.right, -1)):
            if shadow.confidence > 0 and shadow.confidence >= min_confidence:
                yield shadow, step, (step < 0) == holes_right


Side = Literal["left", "right"]
SHADOW_SIDES = "where shadows are: true: measured in each frame; left, right of near surfaces; false: there are none"
"""Description of the ``shadows`` option of pipelines."""


def shadows_of(disparity: Floats, jump: float, where: bool | Side) -> Shadows:
    """Return the measured shadows: both sides (True), one side with confidence 1, or none (False)."""
    if where is False:
        return Shadows()
    found = measure_shadows(disparity, jump)
    if where is True:
        return found
    side = replace(getattr(found, where), confidence=1.0)
    return Shadows(**{where: side}, p_hole=found.p_hole)


def measure_shadows(disparity: Floats, jump: float) -> Shadows:
    """Estimate the side and width of a frame's shadows from the gaps next to steps.

    The confidence of a side grows with the share of gaps as wide as their step's shadow, in excess of the share as
    wide as another gap's shadow. Holes are more probable if more pixels are in gaps that are no shadows. ``jump`` is
    the smallest step, in pixels.
    """
    gaps = _gaps(disparity)
    is_step = np.abs(gaps[:, 1]) > np.float32(jump)
    others, shadow_pixels = float(gaps[~is_step & (gaps[:, 0] > 2), 0].sum(dtype=np.float64)), 0.0
    gaps = gaps[is_step & (gaps[:, 0] > 1)]
    found = []
    for side in (gaps[:, 1] > 0, gaps[:, 1] < 0):
        shadow, chance = _shadow(gaps[side], _PRIOR_ROWS * len(disparity))
        width, step = np.abs(gaps[side]).T
        fits = np.abs(width + shadow.covered - shadow.scale * step) <= _MAX_WIDTH_DIFFERENCE
        others += _STEP_WEIGHT * float(width[~fits].sum())
        shadow_pixels += float(width[fits].sum()) - chance * float(width.sum())
        found.append(shadow)
    ratio = others / max(shadow_pixels, 1.0)
    odds = (ratio / _EQUAL_RATIO) ** _STEEPNESS
    return Shadows(found[0], found[1], odds / (1 + odds))


def _shadow(gaps: Floats, prior: float) -> tuple[Shadow, float]:
    # Return the shadows of one side, and the probability that a gap is as wide as a shadow by chance.
    every = 1 + len(gaps) // _MAX_GAPS
    gaps = np.abs(gaps[::every])
    if not len(gaps):
        return Shadow(), 0.0
    fits = np.zeros((2, _SCALES.size, _COVERED.size), np.int64)
    pairs = np.zeros(_SCALES.size, np.int64)
    _count_fits(gaps, _SCALES, _COVERED, fits, pairs)
    k = int(fits[0].argmax())
    plain = (int(np.flatnonzero(_SCALES == 1)[0]), 0)
    best = divmod(k, _COVERED.size) if fits[0].ravel()[k] > _MIN_GAIN * fits[0][plain] + 1 else plain
    chance = float((_PRIOR_CHANCE * _PRIOR_PAIRS + fits[1][best]) / (_PRIOR_PAIRS + pairs[best[0]]))
    excess = float(fits[0][best]) - chance * len(gaps)
    confidence = float(np.clip(excess / (len(gaps) + prior / every) / _FULL_SHARE, 0, 1))
    return Shadow(confidence, float(_SCALES[best[0]]), float(_COVERED[best[1]])), chance


@helper
def gaps_of(d, first):
    """Return (n, 2), the known pixels on both sides of each gap in a row.

    If ``first``, the gap before the first known pixel counts too, with -1 on its left.
    """
    ends = empty((d.size, 2), np.int64)
    count, last = 0, -1
    for x in range(d.size):
        if not np.isnan(d[x]):
            if x - last > 1 and (first or last >= 0):
                ends[count, 0], ends[count, 1] = last, x
                count += 1
            last = x
    return ends[:count]


@jit
def _gaps(disparity):
    # Return (n, 2): width and step of every gap between known pixels of a row.
    gaps, n = empty((disparity.size // 2 + 1, 2), np.float32), 0
    for y in range(disparity.shape[0]):
        d = disparity[y]
        for last, x in gaps_of(d, False):
            gaps[n, 0], gaps[n, 1] = x - last - 1, d[x] - d[last]
            n += 1
    return gaps[:n]


@jit
def _count_fits(gaps, scales, covered, found, pairs):
    # Count the gaps as wide as the shadow of their own step. Among the ``pairs`` of gaps with different steps, count
    # the gaps as wide as the shadow of the other gap's step.
    n = len(gaps)
    for k in range(n):
        step, other = gaps[k, 1], gaps[(k + n // 2) % n, 1]
        for i in range(scales.size):
            different = scales[i] * abs(step - other) > 2 * _MAX_WIDTH_DIFFERENCE
            pairs[i] += different
            for j in range(covered.size):
                width = gaps[k, 0] + covered[j]
                found[0, i, j] += abs(width - scales[i] * step) <= _MAX_WIDTH_DIFFERENCE
                found[1, i, j] += different and abs(width - scales[i] * other) <= _MAX_WIDTH_DIFFERENCE

"""Shadows: gaps beside near surfaces, which say what surfaces can lie in them. Each frame shows where they lie.

Pixels left of a near surface that the camera sees but a projector on its right does not reach have no depth: of a
row, the pixels x with ``x - d(x) >= x' - d(x')`` for a nearer pixel x' on their right. On one surface that is a strip
as wide as the step of disparity. With another baseline than the one that depth was turned into disparity with, it is
wider or narrower by a factor; where the near surface has grown over its shadow, by some pixels. A depth map that was
moved into the pixels of a color camera has such gaps on the right of near surfaces as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from depthcli.core.maps import Floats
from depthcli.kernels.jit import jit

# Chosen on simulated sensors and on blocks taken out of real frames; nothing in the repository varies them.
WIDTH_TOLERANCE = 4.0
"""Pixels by which a gap that counts as a shadow may be wider or narrower than one."""
_MAX_WIDTH_DIFFERENCE = 3.0  # between a gap and the width of a shadow that still count as equal, pixels
_FULL_SHARE = 0.5  # share of gaps as wide as shadows, above that of chance, from which on the confidence is 1
_PRIOR_ROWS = 0.25  # gaps added to those of the frame, as if not as wide as shadows, for each row: an object's rows
_PRIOR_PAIRS = 20.0  # pairs of gaps added to those of different steps
_PRIOR_CHANCE = 0.1  # that a gap is as wide as a shadow by chance
_SCALES = 2.0 ** np.linspace(-2, 0.5, 21)  # of shadows: pixels of width a pixel of step
_COVERED = np.arange(9.0)  # pixels of a shadow that the near surface may cover
_LIKELY = 0.4  # confidence from which a side's gaps are taken for shadows
_MIN_OF_BEST = 0.4  # confidence of a side, as a share of the other side's, below which it has none by chance
_MIN_GAIN = 1.2  # by which more gaps must agree with another width than with that of their step
_MAX_GAPS = 2000  # more do not change the estimate
_STEP_WEIGHT = 2.0  # of a pixel in a gap beside a step that is no shadow, beside one in a hole of one surface
_STEEPNESS = 6  # exponent of the ratio in the odds of holes
_EQUAL_RATIO = 6.5  # of the pixels in gaps that are no shadows to those in shadows, at which holes are as probable


@dataclass(frozen=True)
class Shadow:
    """The shadows on one side of near surfaces."""

    confidence: float = 0.0  # 0 .. 1, that gaps beside steps are shadows
    scale: float = 1.0  # width of a shadow per pixel of the step beside it
    covered: float = 0.0  # pixels of it that the near surface has grown over


@dataclass(frozen=True)
class Shadows:
    """The shadows on the left and on the right of near surfaces."""

    left: Shadow = Shadow()
    right: Shadow = Shadow()
    p_hole: float = 0.0  # probability that the sensor missed what lies in other gaps, which nothing hides

    def figures(self) -> dict[str, float]:
        """Return what was measured, as numbers for the report."""
        sides = {"left": self.left, "right": self.right}
        widths = {f"shadow_width_{name}": round(side.scale, 3) for name, side in sides.items()}
        return widths | {f"shadows_{name}": round(side.confidence, 3) for name, side in sides.items()}

    def likely(self) -> Shadows:
        """Return the sides of which it is likely that they have shadows at all, for methods that do not weigh."""
        left, right = (side if side.confidence >= _LIKELY else Shadow() for side in (self.left, self.right))
        return Shadows(left, right, self.p_hole)

    def sides(self) -> Iterator[tuple[Shadow, int, bool]]:
        """Yield each side that has shadows, 1 or for the right one -1, and whether holes are judged by it.

        Along columns in steps of -1 the shadows on the right are those on the left of a mirrored frame.
        """
        holes_right = self.right.confidence > self.left.confidence
        min_confidence = _MIN_OF_BEST * max(self.left.confidence, self.right.confidence)
        for shadow, step in ((self.left, 1), (self.right, -1)):
            if shadow.confidence > 0 and shadow.confidence >= min_confidence:
                yield shadow, step, (step < 0) == holes_right


Side = Literal["left", "right"]
SHADOW_SIDES = "where shadows lie: true: measured in each frame; left, right of near surfaces; false: there are none"
"""Description of the option of pipelines."""


def shadows_of(disparity: Floats, jump: float, where: bool | Side) -> Shadows:
    """Return what :func:`measure_shadows` finds, of one side alone if ``where`` says so, or nothing for False."""
    if where is False:
        return Shadows()
    found = measure_shadows(disparity, jump)
    if where is True:
        return found
    side = replace(getattr(found, where), confidence=1.0)
    return Shadows(**{where: side}, p_hole=found.p_hole)


def measure_shadows(disparity: Floats, jump: float) -> Shadows:
    """Estimate where a frame's shadows lie and how wide they are, from the gaps beside steps.

    The confidence of a side is the share of gaps that are as wide as shadows, above that of gaps with a different step
    of another one. The more pixels lie in gaps that are no shadows, the more probable are holes. ``jump`` is the
    smallest step, pixels.
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
    # The shadows of one side, and the probability that a gap is as wide as one by chance.
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


@jit
def gaps_of(d, first):
    """Return (n, 2), the known pixels beside the gaps within a row, and -1 and the first one if ``first``."""
    ends = np.empty((d.size, 2), np.int64)
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
    # (n, 2): width and step of every gap between known pixels of a row.
    gaps, n = np.empty((disparity.size // 2 + 1, 2), np.float32), 0
    for y in range(disparity.shape[0]):
        d = disparity[y]
        for last, x in gaps_of(d, False):
            gaps[n, 0], gaps[n, 1] = x - last - 1, d[x] - d[last]
            n += 1
    return gaps[:n]


@jit
def _count_fits(gaps, scales, covered, found, pairs):
    # Gaps as wide as a shadow of their own step, and, of ``pairs`` of gaps, as one of the other gap's different step.
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

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

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.core.arrays import Floats, Image8
from depthcli.kernels.jit import jit, parallel_jit, prange

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
# Values that the preset refine-kinect accurate was published with; nothing in the repository varies them.
SHADOW_FACTOR, GAP_FACTOR, HOLE_FACTOR = 0.02, 0.06, 0.5
"""Likelihood of a surface that is nearer than a shadow allows: in a shadow, another gap, a hole of one surface."""
SHADOW_BAND = 8
"""Width of the band on the right of a shadow where the near surface may have grown over the far one, pixels."""
SLOPE_FADE = 20.0
"""Distance from a surface at which half of its slope is left when it is continued, pixels."""
_MAX_COLOR_DIFFERENCE = 10  # between a hole and the surface around it, L1 in 8-bit Lab
# Share of the votes that the surface on the left of a shadow gets: least; where the shadow is as wide as its step.
_MIN_EXTRA_SHARE, _MAX_EXTRA_SHARE = 0.1, 0.6
_EXTRA_SHARE_SCALE = 2.0  # pixels between the shadow's width and the step over which the share falls by 1/e


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


def shadow_limits(
    lab: Image8, disparity: Floats, planes: WindowPlanes, jump: float, tolerance: float, shadows: Shadows
) -> tuple[Floats, Floats]:
    """Compute the largest disparity that a shadow allows at each pixel, and the likelihood of surfaces above it.

    Both are (H, W) float32: pixels, inf outside gaps; a factor in (0, 1], 1 outside gaps and without shadows.
    """
    limit, limit_factor = np.full(disparity.shape, np.inf, np.float32), np.ones(disparity.shape, np.float32)
    for shadow, step, holes in shadows.sides():
        turn = np.s_[:, ::step]
        given = [np.ascontiguousarray(m[turn]) for m in (lab, disparity, planes.value, step * planes.slope_x)]
        hidden = shadow.confidence * (1 - shadows.p_hole)
        factors = np.array([SHADOW_FACTOR**shadow.confidence, GAP_FACTOR**hidden, HOLE_FACTOR**hidden], np.float32)
        sizes = (np.float32(size) for size in (jump, tolerance, shadow.scale, shadow.covered))
        _limits(limit[turn], limit_factor[turn], holes, factors, *given, *sizes)
    return limit, limit_factor


def shadow_background(disparity: Floats, planes: WindowPlanes, jump: float, shadows: Shadows) -> tuple[Floats, Floats]:
    """Compute the disparity of the surface behind each shadow and the band beyond it, and its share of the votes.

    It is the surface on the far side, continued along its slope. A shadow is as wide as the step to the surface that it
    falls on: the nearer its width is to the step to the surface on the far side, the larger the share. Both are
    (H, W) float32: pixels, NaN = no shadow; the share of all votes that the background gets in addition.
    """
    background, extra_share = np.full(disparity.shape, np.nan, np.float32), np.zeros(disparity.shape, np.float32)
    for shadow, step, _ in shadows.sides():
        turn = np.s_[:, ::step]
        given = [np.ascontiguousarray(m[turn]) for m in (disparity, planes.value, step * planes.slope_x)]
        low, high = (shadow.confidence * share for share in (_MIN_EXTRA_SHARE, _MAX_EXTRA_SHARE))
        sizes = (np.float32(size) for size in (jump, low, high, shadow.scale, shadow.covered))
        _background(background[turn], extra_share[turn], *given, *sizes)
    return background, extra_share


@jit
def lab_difference(lab, y, x, v, u):
    """Return the L1 difference of two pixels' colors, int32; for other kernels."""
    difference = np.int32(0)
    for i in range(3):
        difference += abs(np.int32(lab[y, x, i]) - np.int32(lab[v, u, i]))
    return difference


@jit
def _rim_contrast(lab, d, y, u, left, right):
    # Smallest difference of color between pixel u and the first few known ones beyond the rims of its gap.
    smallest = np.int32(1000)
    for k in range(8):
        for v in (left - k, right + k):
            if 0 <= v < d.size and not np.isnan(d[v]):
                smallest = min(smallest, lab_difference(lab, y, u, y, v))
    return smallest


@parallel_jit
def _limits(limit, limit_factor, holes, factors, lab, disparity, value, slope_x, jump, tolerance, scale, covered):
    for y in prange(disparity.shape[0]):
        d = disparity[y]
        for last, x in gaps_of(d, True):
            gap = np.float32(x - last - 1)
            step = d[x] - d[last] if last >= 0 else np.float32(0)
            if step <= jump and not holes:
                continue
            shadow = step > jump and abs(gap + covered - scale * step) <= np.float32(WIDTH_TOLERANCE)
            factor = factors[0] if shadow else factors[1]
            one_surface = False
            if last >= 0 and abs(step) < jump + np.float32(0.2) * gap:
                far = gap + np.float32(1)
                off = abs(value[y, last] + slope_x[y, last] * far - d[x])
                off = min(off, abs(value[y, x] - slope_x[y, x] * far - d[last]))
                one_surface = off < tolerance + np.float32(0.05) * far
            for u in range(last + 1, x):
                if one_surface:
                    # a hole in one surface, if the color is that of the rims
                    factor = factors[2 if _rim_contrast(lab, d, y, u, last, x) < _MAX_COLOR_DIFFERENCE else 1]
                limit[y, u] = d[x] - (np.float32(x - u) + covered) / scale + tolerance
                limit_factor[y, u] = factor


@parallel_jit
def _background(background, extra_share, disparity, value, slope_x, jump, low, high, scale, covered):
    for y in prange(disparity.shape[0]):
        d = disparity[y]
        for last, x in gaps_of(d, False):
            width, step = (np.float32(x - last - 1) + covered) / scale, d[x] - d[last]
            if step > jump and abs(width - step) <= np.float32(WIDTH_TOLERANCE):
                end = min(x + SHADOW_BAND, d.size)
                for u in range(last + 1, end):
                    far = np.float32(u - last)
                    fade = 1 + (far / np.float32(SLOPE_FADE)) ** 2
                    background[y, u] = value[y, last] + slope_x[y, last] * far / fade
                off = (width - (d[x] - background[y, x])) / np.float32(_EXTRA_SHARE_SCALE)
                extra_share[y, last + 1 : end] = low + (high - low) * np.float32(np.exp(-off * off))


def max_disparity_in_gaps(disparity: Floats, jump: float, shadows: Shadows, tolerance: float = 2.5) -> Floats:
    """Compute the largest disparity (H, W) float32 that a gap allows if it is a shadow; inf where it is none.

    One value per gap, from its rims only (:func:`shadow_limits` is finer, and weighs). A gap of n pixels beside a step
    is the shadow of its near side on a surface that is farther by about n pixels of disparity: on the far side of the
    step, if that is as far, or else on a surface behind it, unless holes are as probable. Gaps between known pixels
    that differ by less than ``jump`` are taken for reflections.
    """
    limit = np.full(disparity.shape, np.inf, np.float32)
    for shadow, step, _ in shadows.sides():
        turned = np.ascontiguousarray(disparity[:, ::step])
        sizes = (np.float32(size) for size in (jump, tolerance, shadow.scale, shadow.covered))
        _max_in_gaps(limit[:, ::step], turned, shadows.p_hole < 0.5, *sizes)
    return limit


@parallel_jit
def _max_in_gaps(limit, disparity, behind, jump, tolerance, scale, covered):
    for y in prange(disparity.shape[0]):
        d = disparity[y]
        for last, x in gaps_of(d, False):
            near, far = d[x], d[last]
            if near - far <= jump:
                continue
            gap = np.float32(x - last - 1)
            largest = near - (gap + covered) / scale
            if largest >= far - tolerance:
                largest = max(largest, far)
            if behind or abs(gap + covered - scale * (near - far)) <= np.float32(WIDTH_TOLERANCE):
                limit[y, last + 1 : x] = largest + tolerance

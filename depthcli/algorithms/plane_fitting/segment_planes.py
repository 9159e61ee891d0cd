"""Planes of segments: RANSAC and least squares over the inliers, and a small set of distinct planes of the scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.plane_fitting.least_squares import plane_slopes, smallest
from depthcli.algorithms.regions import RegionPixels
from depthcli.core.maps import Doubles, Floats, Ints
from depthcli.core.method import ConfigModel
from depthcli.kernels.jit import empty, helper, jit, n_threads, run_bands, zeros

# Chosen by hand; nothing in the repository varies them.
_SAMPLED_PIXELS = 2000  # in larger segments, the misfit of a RANSAC plane is computed from about this many pixels
_MIN_CROSS = 0.5  # smallest cross product of three pixels that determine a plane, square pixels
_REFITS = 5  # largest number of least squares after RANSAC
_MIN_WORK = 100  # constant work of a segment, in pixels: drawing samples takes time, too
_BLOCK = 64  # pixels after which a RANSAC plane is dropped if its misfit is too large


@dataclass(frozen=True)
class SegmentPlanes:
    """Disparity planes ``d = a x + b y + c``."""

    coefficients: Doubles  # (L, 3) float64 a, b, c
    support: NDArray[np.int64]  # (L,) int64 number of inliers: pixels of the segment within the tolerance
    center: Doubles  # (L, 2) float64 mean x and y of the inliers

    def __len__(self) -> int:
        return len(self.support)

    def __getitem__(self, index: Any) -> SegmentPlanes:
        return SegmentPlanes(self.coefficients[index], self.support[index], self.center[index])

    @classmethod
    def joined(cls, *sets: SegmentPlanes) -> SegmentPlanes:
        """Return all planes of several sets, in order."""
        columns = ((planes.coefficients, planes.support, planes.center) for planes in sets)
        return cls(*(np.concatenate(parts) for parts in zip(*columns, strict=True)))

    def distinct(self, slope_tolerance: float, offset_tolerance: float, max_planes: int) -> tuple[SegmentPlanes, Ints]:
        """Return at most ``max_planes`` planes without near-duplicates, the best supported ones first.

        A plane is a near-duplicate of a better supported one if their slopes differ by at most ``slope_tolerance`` and
        their disparities at its center by at most ``offset_tolerance`` pixels. The second result is, for every plane,
        the index of the returned plane that replaces it; -1 if there is none.
        """
        order = np.argsort(-self.support, kind="stable")
        by_support = self[order]
        representative = np.full(len(self), -1, np.int32)
        limits = slope_tolerance, offset_tolerance, max_planes
        kept = _distinct(by_support.coefficients, by_support.center, *limits, representative)
        return by_support[kept], representative[np.argsort(order)]

    def at(self, choice: Ints, max_disparity: float) -> Floats:
        """Return the value of the plane ``choice`` (H, W), an index, at every pixel; (H, W) float32, pixels.

        Values are limited to [0, ``max_disparity``].
        """
        a, b, c = self.coefficients.T
        x, y = np.arange(choice.shape[1]), np.arange(choice.shape[0])[:, None]
        disparity = a[choice] * x + b[choice] * y + c[choice]
        return np.asarray(np.clip(disparity, 0, max_disparity), np.float32)


class SegmentPlaneFit(ConfigModel):
    """RANSAC planes through the disparities of segments, refined by least squares over their inliers."""

    tolerance: float = Field(0.5, gt=0, le=16384, description="distance of a RANSAC inlier from the plane, pixels")
    trials: int = Field(200, ge=1, le=100_000, description="RANSAC samples per segment")
    max_slope: float = Field(1.0, ge=0, le=16, description="steepest plane, pixels of disparity per pixel")
    flatness: float = Field(
        1.0,
        ge=0,
        le=1,
        description="a sloping plane is kept if its misfit is below this share of the misfit of the flat plane",
    )
    seed: int = Field(
        0, ge=0, le=2**31 - 1, description="seed of the RANSAC samples, combined with the segment's number"
    )

    def __call__(self, values: Floats, members: RegionPixels, chosen: NDArray[np.int64]) -> SegmentPlanes:
        """Fit one plane to each of the segments ``chosen`` (K,), none of which is empty.

        If no three of the ``members`` define a plane with an allowed slope, the plane is flat, at the median of the
        ``values`` (H, W).
        """
        planes = SegmentPlanes(np.zeros((len(chosen), 3)), np.zeros(len(chosen), np.int64), np.zeros((len(chosen), 2)))
        sizes, tasks = members.sizes[chosen], n_threads()
        share = _shares(np.argsort(-sizes), sizes, tasks)
        segments = (members.order, members.starts, np.asarray(chosen, np.int64), share)
        limits = (self.tolerance, self.trials, self.max_slope, self.flatness, self.seed)
        run_bands(_fit, tasks, values, *segments, limits, planes.coefficients, planes.support, planes.center)
        return planes

    def constant(self, values: Floats, members: RegionPixels, chosen: NDArray[np.int64]) -> SegmentPlanes:
        """Return the flat plane at the median disparity of each of the segments ``chosen`` (K,)."""
        flat: dict[str, Any] = {"trials": 0, "max_slope": 0.0, "flatness": 0.0}
        return self.model_copy(update=flat)(values, members, chosen)


@jit
def _shares(largest_first, sizes, count):
    # Return the task, 0 .. count - 1, of each segment, (K,): a segment goes to the task with the least work so far.
    share, work = empty(sizes.size, np.int64), zeros(count, np.int64)
    for k in largest_first:
        share[k] = np.argmin(work)
        work[share[k]] += sizes[k] + _MIN_WORK
    return share


@helper
def _median(values):
    # As np.median, which takes three times as long to compile.
    ordered, half = values.copy(), values.size // 2
    middle = smallest(ordered, half)
    if values.size % 2 == 1:
        return middle
    below = ordered[0]
    for i in range(half):
        below = max(below, ordered[i])
    return (below + middle) / 2


@jit
def _fit(begin, end, values, order, starts, chosen, share, limits, coefficients, support, center):
    width = values.shape[1]
    tolerance, trials, max_slope, flatness, seed = limits
    for task in range(begin, end):
        for k in range(chosen.size):
            if share[k] != task:
                continue
            pixels = order[starts[chosen[k]] : starts[chosen[k] + 1]]
            px, py, pd = empty(pixels.size, np.float64), empty(pixels.size, np.float64), empty(pixels.size, np.float64)
            for i in range(pixels.size):
                px[i], py[i] = pixels[i] % width, pixels[i] // width
                pd[i] = values[pixels[i] // width, pixels[i] % width]
            mx, my, flat = px.mean(), py.mean(), _median(pd)
            for i in range(pixels.size):
                px[i] -= mx
                py[i] -= my
            state = np.uint64(seed + 1) * np.uint64(0x9E3779B97F4A7C15)
            state += np.uint64(chosen[k] + 1) * np.uint64(0xBF58476D1CE4E5B9)
            a, b, c = _ransac(px, py, pd, flat, tolerance, trials, max_slope, state)
            a, b, c = _refit(px, py, pd, a, b, c, tolerance, max_slope)
            # A slope that hardly lowers the misfit follows noise.
            misfit = _misfit(px, py, pd, a, b, c, tolerance, np.inf)
            if flatness * _misfit(px, py, pd, 0.0, 0.0, flat, tolerance, np.inf) <= misfit:
                a, b, c = 0.0, 0.0, flat
            n, sx, sy, _ = _inlier_sums(px, py, pd, a, b, c, tolerance)
            coefficients[k, 0], coefficients[k, 1], coefficients[k, 2] = a, b, c - a * mx - b * my
            center[k, 0], center[k, 1] = mx + sx / max(n, 1), my + sy / max(n, 1)
            support[k] = n


@helper
def _pick(state, count):
    # Return the next state of xorshift64* (without its multiplication) and the index of one of ``count`` pixels.
    state ^= state >> np.uint64(12)
    state ^= state << np.uint64(25)
    state ^= state >> np.uint64(27)
    return state, int(state >> np.uint64(11)) % count


@helper
def _ransac(px, py, pd, flat, tolerance, trials, max_slope, state):
    # Return the plane through three pixels with the smallest misfit, or the flat plane.
    count = px.size
    stride = max(1, count // _SAMPLED_PIXELS)
    sx, sy, sd = px[::stride].copy(), py[::stride].copy(), pd[::stride].copy()
    a, b, c = 0.0, 0.0, flat
    best = _misfit(sx, sy, sd, a, b, c, tolerance, np.inf)
    for _ in range(trials if count >= 3 else 0):
        state, i0 = _pick(state, count)
        state, i1 = _pick(state, count)
        state, i2 = _pick(state, count)
        ux, uy, ud = px[i1] - px[i0], py[i1] - py[i0], pd[i1] - pd[i0]
        vx, vy, vd = px[i2] - px[i0], py[i2] - py[i0], pd[i2] - pd[i0]
        cross = ux * vy - uy * vx
        if abs(cross) >= _MIN_CROSS:
            ta = (ud * vy - uy * vd) / cross
            tb = (ux * vd - ud * vx) / cross
            if abs(ta) <= max_slope and abs(tb) <= max_slope:
                tc = pd[i0] - ta * px[i0] - tb * py[i0]
                misfit = _misfit(sx, sy, sd, ta, tb, tc, tolerance, best)
                if misfit < best:
                    a, b, c, best = ta, tb, tc, misfit
    return a, b, c


@helper
def _refit(px, py, pd, a, b, c, tolerance, max_slope):
    # Repeat least squares over the inliers as long as the misfit falls.
    for _ in range(_REFITS):
        n, sx, sy, sd = _inlier_sums(px, py, pd, a, b, c, tolerance)
        if n < 3:
            break
        sx, sy, sd = sx / n, sy / n, sd / n
        xx, xy, yy, xd, yd = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(px.size):
            if abs(a * px[i] + b * py[i] + c - pd[i]) <= tolerance:
                x, y, d = px[i] - sx, py[i] - sy, pd[i] - sd
                xx += x * x
                xy += x * y
                yy += y * y
                xd += x * d
                yd += y * d
        determinant = xx * yy - xy * xy
        if determinant <= 1e-6 * (xx + yy) * (xx + yy) + 1e-12:  # the pixels are on a line
            break
        ta, tb = plane_slopes(xx, xy, yy, xd, yd, determinant)
        if abs(ta) > max_slope or abs(tb) > max_slope:
            break
        tc = sd - ta * sx - tb * sy
        misfit = _misfit(px, py, pd, ta, tb, tc, tolerance, np.inf)
        if misfit >= _misfit(px, py, pd, a, b, c, tolerance, np.inf):
            break
        a, b, c = ta, tb, tc
    return a, b, c


@helper
def _inlier_sums(px, py, pd, a, b, c, tolerance):
    # Return the number of inliers, and the sums of their x, y and disparity.
    n, sx, sy, sd = 0, 0.0, 0.0, 0.0
    for i in range(px.size):
        if abs(a * px[i] + b * py[i] + c - pd[i]) <= tolerance:
            n += 1
            sx += px[i]
            sy += py[i]
            sd += pd[i]
    return n, sx, sy, sd


@helper
def _misfit(px, py, pd, a, b, c, tolerance, enough):
    # Return the sum of squared distances, each at most tolerance squared (MSAC); stop once it exceeds ``enough``.
    limit = tolerance * tolerance
    total = 0.0
    for start in range(0, px.size, _BLOCK):
        part = 0.0
        x, y, d = px[start : start + _BLOCK], py[start : start + _BLOCK], pd[start : start + _BLOCK]
        for i in range(x.size):  # from 0, so that it needs no wraparound, which would prevent vector code
            distance = a * x[i] + b * y[i] + c - d[i]
            part += min(distance * distance, limit)
        total += part
        if total > enough:
            break
    return total


@jit
def _distinct(coefficients, center, slope_tolerance, offset_tolerance, max_planes, stands_for):
    kept = empty(coefficients.shape[0], np.int64)
    count = 0
    for k in range(coefficients.shape[0]):
        for j in range(count):
            first, other = coefficients[k], coefficients[kept[j]]
            da, db, dc = first[0] - other[0], first[1] - other[1], first[2] - other[2]
            apart = abs(da * center[k, 0] + db * center[k, 1] + dc)
            if max(abs(da), abs(db)) <= slope_tolerance and apart <= offset_tolerance:
                stands_for[k] = j
                break
        if stands_for[k] < 0 and count < max_planes:
            stands_for[k] = count
            kept[count] = k
            count += 1
    return kept[:count].copy()

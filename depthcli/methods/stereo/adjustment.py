"""Adjusting the right image to the left one: rows that do not quite match, light that differs.

Real pairs are rectified to a fraction of a pixel, taken by two cameras or one after the other. Both errors are smooth,
so a match of the pair at a smaller size is enough to measure them; corrected once, they need not be tolerated by every
matching cost.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.frames import Image, StereoPair
from depthcli.core.result import Clock
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.finish import finish
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.refinement.left_right_check import LeftRightCheck
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.refinement.subpixel import Subpixel

Adjust = Annotated[
    tuple[Literal["rows", "light"], ...],
    Field(
        max_length=2,
        description="what of the right image is adjusted to the left one first: rows (imperfect rectification), light "
        "(exposure, lamps)",
    ),
]

_MOST, _MOST_CELLS = 1 << 17, 1 << 24  # pixels of the smaller size, and cells of its costs
_FEWEST_DISPARITIES = 3  # with fewer everything is mutual
_FEWEST = 500  # matches that anything is concluded from
_COST = Census(window=(7, 7))
_OPTIMIZATION = Scanline(p1=25, p2=120, edge_threshold=15, edge_divisor=6)
_STEPS = (LeftRightCheck(), SpeckleFilter(size=50), Subpixel())

_CELL = 4  # side of the cells that light is summed in, pixels of the smaller size
_NEAR, _FAR = 12.0, 30.0  # reaches of the local and of the wide mean of light, pixels of the smaller size
_FEW = np.float32(0.2)  # matches a pixel; where there are no more, those farther away count as much
_PRIOR = 0.5  # what the wide mean counts, in matches a pixel
_DARK = np.float32(8.0)  # grey levels: darker pixels say little about a factor
_UNLIKE = (1.6, 1.2)  # factors beyond that of all matches, then of those around, at which a match is none
_GAINS = (0.1, 10.0)
# Parts of the largest sample from which, and over which, one is taken for saturated.
_KNEE, _SOFT = np.float32(0.92), np.float32(0.07)
_UNTRUSTED = np.float32(6.0)  # grey levels that right matches differ by where half of the trust is gone

_TERMS = 6  # of a polynomial of the second degree: what small rotations and unlike focal lengths do
_STEPS_AT_MOST, _CLOSE = 4, 0.01  # Gauss-Newton steps; change of the coefficients that ends them, rows
_EDGE, _OUTLIER = np.float32(4.0), np.float32(20.0)  # grey levels: residuals that count half, that count nothing
_BLOCK = 8  # side of the blocks that share an error of disparity, pixels of the smaller size
_RIDGE = 3000.0  # grey levels squared: offsets of a quarter of a row that hardly anything speaks for are none
_WORSE = 0.9  # share of the matches before: with fewer, what was found is not believed
_PASSES, _ASTRAY = 4, 0.3  # rows of the smaller size: matches across more are worth another look


def adjusted(pair: StereoPair, max_disparity: int, what: Adjust, clock: Clock | None = None) -> StereoPair:
    """The pair with a right image whose rows and light are the left one's.

    The pair is matched at a smaller size (census, scanlines). ``rows``: the vertical offset, a polynomial of the second
    degree over the image, that lets the matches' grey levels differ least (Gauss-Newton steps, robustly weighted), is
    taken out by cubic interpolation along the columns; where it was large, the pair is matched again without it.
    ``light``: every channel is multiplied by the ratio of what the matches around have in the left and the right image;
    how far their grey levels are apart then gives the pair's ``light_trust``. The left image stays as it is, and so do
    disparities.

    Parameters
    ----------
    max_disparity : of the search, pixels
    what : which of the two; nothing: the pair itself
    clock : books the stage
    """
    if not what:
        return pair
    small = _Small.of(pair, max_disparity)
    found = before = _NONE
    seen = None
    most = 0
    for _ in range(_PASSES):
        now = small.matches(found)
        count = 0 if now is None else int(np.count_nonzero(~np.isnan(now)))
        if now is None or count < _WORSE * most:
            found = before  # what was thought better is not
            break
        seen, before, most = now, found, max(most, count)
        if "light" in what:
            found = replace(found, gains=small.gains(seen, found))
        if "rows" in what:
            found = replace(found, rows=small.rows(seen, found))
        if np.abs(found.rows - before.rows).sum() <= _ASTRAY:
            break
    pair = found.of(pair, small.factor)
    if "light" in what and seen is not None:
        pair = replace(pair, light_trust=small.light_trust(seen, found, pair.shape))
    if clock is not None:
        clock.stop("adjustment")
    return pair


@dataclass(frozen=True)
class _Adjustment:
    """What is to be done to a right image.

    Attributes
    ----------
    rows : (6,) how far below its row in the left image the right one has what belongs there, pixels of the smaller
        size: coefficients of 1, u, v, u u, u v, v v, column u and row v from -1 to 1
    gains : (h, w, 3) float32 factors of cells of 4 pixels of the smaller size, or of the whole image
    """

    rows: NDArray[np.float64]
    gains: NDArray[np.float32]

    def of(self, pair: StereoPair, factor: int) -> StereoPair:
        """The pair, ``factor`` times the smaller size, adjusted."""
        if not self.rows.any() and self.gains is _NONE.gains:
            return pair
        right = np.ascontiguousarray(pair.clamped[1]).reshape(*pair.shape, -1)
        out = np.empty_like(right)
        _resample(right, self.rows * factor, self.gains, _CELL * factor, np.float32(pair.top), out)
        return StereoPair(pair.left, cast(Image, out.reshape(pair.right.shape)), pair.bits)


_NONE = _Adjustment(np.zeros(_TERMS), np.ones((1, 1, 3), np.float32))


@dataclass(frozen=True)
class _Small:
    """The pair at a smaller size, ``factor`` times, and what is searched there."""

    pair: StereoPair
    factor: int
    max_disparity: int

    @classmethod
    def of(cls, pair: StereoPair, max_disparity: int) -> _Small:
        factor, pixels = 2, pair.shape[0] * pair.shape[1]
        while pixels > _MOST * factor**2 or pixels * max_disparity > _MOST_CELLS * factor**3:
            factor *= 2
        height, width = (-(-side // factor) for side in pair.shape)
        left, right = (
            cast(Image, cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)) for image in pair.clamped
        )
        small = StereoPair(*StereoPair(left, right, pair.bits).color8)
        return cls(small, factor, -(-max_disparity // factor))

    def matches(self, found: _Adjustment) -> NDArray[np.float32] | None:
        """(H, W) float32 disparities, NaN where the views do not agree; None where they hardly ever do."""
        if min(self.pair.shape) < _BLOCK or self.max_disparity + 1 < _FEWEST_DISPARITIES:
            return None
        pair = found.of(self.pair, 1)
        volume = _COST(pair, self.max_disparity + 1)
        disparity = finish(pair, volume, _OPTIMIZATION, _STEPS, (), Clock())[0].disparity
        return disparity.values if np.count_nonzero(disparity.valid) >= _FEWEST else None

    def gains(self, seen: NDArray[np.float32], found: _Adjustment) -> NDArray[np.float32]:
        """(ceil(H / 4), ceil(W / 4), 3) float32."""
        left, right = self.pair.left, replace(found, gains=_NONE.gains).of(self.pair, 1).right
        cells = tuple(-(-side // _CELL) for side in seen.shape)
        usual = _usual_gain(seen, left, right)
        gains: NDArray[np.float32] = np.zeros((*cells, 3), np.float32) + usual
        for unlike in _UNLIKE:
            sums = np.zeros((3, *cells, 3), np.float32)
            _sum_light(seen, left, right, gains, np.float32(unlike), sums)
            wide, local = _around(sums)
            count = _PRIOR * wide[2] + np.float32(1e-3)
            around = (wide[0] + count * usual * _DARK) / (wide[1] + count * _DARK)
            count = _PRIOR * np.maximum(local[2], np.float32(0.05))
            gains = np.asarray((local[0] + count * around * _DARK) / (local[1] + count * _DARK), np.float32)
        return np.asarray(np.clip(gains, *_GAINS), np.float32)

    def light_trust(self, seen: NDArray[np.float32], found: _Adjustment, shape: tuple[int, int]) -> NDArray[np.uint8]:
        """(H, W) uint8 of the pair of ``shape``, 255 where matches have the same grey levels once adjusted."""
        sums = np.zeros((2, *(-(-side // _CELL) for side in seen.shape)), np.float32)
        _sum_differences(seen, self.pair.left, found.of(self.pair, 1).right, sums)
        usual = sums[0].sum() / sums[1].sum()
        wide, local = _around(sums)
        around = (wide[0] + _FEW * usual) / (wide[1] + _FEW)
        differences = (local[0] + _FEW * around) / (local[1] + _FEW)
        trust = np.asarray(np.rint(255 / (1 + (differences / _UNTRUSTED) ** 2)), np.uint8)
        side = _CELL * self.factor
        whole = cv2.resize(trust, (side * trust.shape[1], side * trust.shape[0]), interpolation=cv2.INTER_LINEAR)
        return np.ascontiguousarray(whole[: shape[0], : shape[1]], np.uint8)

    def rows(self, seen: NDArray[np.float32], found: _Adjustment) -> NDArray[np.float64]:
        """(6,), beginning with those found before."""
        lit = replace(found, rows=_NONE.rows).of(self.pair, 1)
        ours, theirs = _Details.of(lit.left), _Details.of(lit.right)
        rows = best = found.rows
        least = float("inf")
        for _ in range(_STEPS_AT_MOST + 1):  # the last is only looked at
            sums = np.zeros((len(_Sums._fields), *(-(-side // _BLOCK) for side in seen.shape)))
            _sum_blocks(seen, ours, theirs, rows, sums)
            block = _Sums(*sums)
            cost = block.residual.sum()
            if cost >= least:
                break
            best, least = rows, cost
            matrix, vector = block.equations(seen.shape)
            change = np.linalg.solve(matrix + _RIDGE * np.eye(_TERMS), vector - _RIDGE * rows)
            if np.abs(change).max() < _CLOSE:
                break
            rows = rows + change
        return best


class _Details(NamedTuple):
    """(H, W) float32: grey levels, slightly smoothed, without what is smooth anyway, and their slopes."""

    grey: NDArray[np.float32]
    across: NDArray[np.float32]
    down: NDArray[np.float32]

    @classmethod
    def of(cls, image: Image) -> _Details:
        fine = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 0.8)
        grey = np.asarray(fine - cv2.GaussianBlur(fine, (0, 0), 6.0), np.float32)
        down, across = np.gradient(grey)
        return cls(grey, np.asarray(across, np.float32), np.asarray(down, np.float32))


class _Sums(NamedTuple):
    """Sums over blocks, (h, w) float64: robust weights, columns of the right image, products of slopes and residuals,
    and what the residuals cost.
    """

    weight: NDArray[np.float64]
    column: NDArray[np.float64]
    across_across: NDArray[np.float64]
    across_down: NDArray[np.float64]
    down_down: NDArray[np.float64]
    across_residual: NDArray[np.float64]
    down_residual: NDArray[np.float64]
    residual: NDArray[np.float64]

    def equations(self, shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Normal equations of a step, (6, 6) and (6,).

        Every block has an error of disparity of its own, which is eliminated: on slanted edges it would look like an
        offset of rows.
        """
        leak = self.across_down / (self.across_across + 1.0)
        certain = self.down_down - leak * self.across_down
        wanted = self.down_residual - leak * self.across_residual
        u = 2 * self.column / np.maximum(self.weight, 1e-9) / shape[1] - 1
        v = (2 * (_BLOCK * np.arange(u.shape[0])[:, None] + (_BLOCK - 1) / 2) / shape[0] - 1) + np.zeros_like(u)
        terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v]).reshape(_TERMS, -1)
        return (terms * certain.ravel()) @ terms.T, terms @ wanted.ravel()


def _usual_gain(seen: NDArray[np.float32], left: Image, right: Image) -> NDArray[np.float32]:
    """(3,) float32: median ratio of the channels over some thousand matches."""
    y, x = np.nonzero(~np.isnan(seen))
    some = slice(None, None, 1 + y.size // 4096)
    y, x = y[some], x[some]
    u = np.maximum(x - np.rint(seen[y, x]).astype(np.int64), 0)
    return np.asarray(np.median((left[y, x] + _DARK) / (right[y, u] + _DARK), axis=0), np.float32)


def _around(sums: NDArray[np.float32]) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]]:
    """Wide and local means of grids of cells."""

    def blurred(grid: NDArray[np.float32], reach: float) -> NDArray[np.float32]:
        sigma = reach / _CELL
        return np.asarray(cv2.GaussianBlur(grid, (0, 0), sigma, borderType=cv2.BORDER_REFLECT), np.float32)

    return [blurred(one, _FAR) for one in sums], [blurred(one, _NEAR) for one in sums]


@jit
def _partner(x: int, disparity: Any) -> int:
    """Column of the right image's pixel."""
    return max(x - int(disparity + np.float32(0.5)), 0)


@parallel_jit
def _sum_light(seen: Any, left: Any, right: Any, gains: Any, unlike: Any, sums: Any) -> None:
    """Per cell of the right image what matches have left and right, and how many there are, over its pixels.

    Saturated samples count like others: grey levels are to agree, whether or not they tell a factor.
    """
    height, width = seen.shape
    share = np.float32(1 / _CELL**2)
    for i in prange(sums.shape[1]):
        for y in range(i * _CELL, min(height, (i + 1) * _CELL)):
            for x in range(width):
                if np.isnan(seen[y, x]):
                    continue
                u = _partner(x, seen[y, x])
                j = u // _CELL
                for c in range(3):
                    ours, theirs = np.float32(left[y, x, c]), np.float32(right[y, u, c])
                    expected = (theirs + _DARK) * gains[i, j, c]
                    if ours + _DARK < unlike * expected and expected < unlike * (ours + _DARK):
                        sums[0, i, j, c] += share * ours
                        sums[1, i, j, c] += share * theirs
                        sums[2, i, j, c] += share


@parallel_jit
def _sum_differences(seen: Any, left: Any, right: Any, sums: Any) -> None:
    """Per cell of the left image how far its matches' grey levels are apart, mean of the channels, and their number,
    both over its pixels.
    """
    height, width = seen.shape
    share = np.float32(1 / _CELL**2)
    for i in prange(sums.shape[1]):
        for y in range(i * _CELL, min(height, (i + 1) * _CELL)):
            for x in range(width):
                if np.isnan(seen[y, x]):
                    continue
                u = _partner(x, seen[y, x])
                sums[1, i, x // _CELL] += share
                for c in range(3):
                    apart = abs(np.float32(left[y, x, c]) - np.float32(right[y, u, c]))
                    sums[0, i, x // _CELL] += share * apart / np.float32(3)


@jit
def _polynomial(c: Any, u: Any, v: Any) -> Any:
    return c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v


@jit
def _cubic(before: Any, here: Any, after: Any, later: Any, t: Any) -> Any:
    """Between ``here`` (t = 0) and ``after`` (Catmull and Rom)."""
    half = np.float32(0.5)
    a = half * (after - before)
    b = before - np.float32(2.5) * here + np.float32(2) * after - half * later
    c = half * (later - before) + np.float32(1.5) * (here - after)
    return here + t * (a + t * (b + t * c))


@jit
def _between(image: Any, v: int, u: int, t: Any, part: Any) -> Any:
    upper = image[v, u] + part * (image[v, u + 1] - image[v, u])
    lower = image[v + 1, u] + part * (image[v + 1, u + 1] - image[v + 1, u])
    return upper + t * (lower - upper)


@parallel_jit
def _sum_blocks(seen: Any, ours: Any, theirs: Any, rows: Any, sums: Any) -> None:
    """What :class:`_Sums` holds, for matches moved by ``rows``."""
    height, width = seen.shape
    right = theirs.grey
    half = np.float32(0.5)
    for i in prange(sums.shape[1]):
        for y in range(i * _BLOCK, min(height, (i + 1) * _BLOCK)):
            for x in range(width):
                at = np.float32(x) - seen[y, x]
                if np.isnan(at) or at < 0 or at >= width - 1:
                    continue
                u = int(at)
                part = at - np.float32(u)
                below = np.float32(
                    float(y) + _polynomial(rows, (2.0 * at - width) / width, (2.0 * y - height) / height)
                )
                below = min(max(below, np.float32(1)), np.float32(height - 3))  # leaving the image must not pay
                v = min(int(below), height - 4)
                t = below - np.float32(v)
                block = sums[:, i, x // _BLOCK]
                one = _cubic(right[v - 1, u], right[v, u], right[v + 1, u], right[v + 2, u], t)
                other = _cubic(right[v - 1, u + 1], right[v, u + 1], right[v + 1, u + 1], right[v + 2, u + 1], t)
                residual = ours.grey[y, x] - (one + part * (other - one))
                relative = min(abs(residual), _OUTLIER) / _EDGE
                block[7] += np.log(np.float32(1) + relative * relative)
                if abs(residual) >= _OUTLIER:
                    continue
                across = half * (ours.across[y, x] + _between(theirs.across, v, u, t, part))
                down = half * (ours.down[y, x] + _between(theirs.down, v, u, t, part))
                weight = np.float32(1) / (np.float32(1) + relative * relative)
                block[0] += weight
                block[1] += weight * at
                block[2] += weight * across * across
                block[3] += weight * across * down
                block[4] += weight * down * down
                block[5] += weight * across * residual
                block[6] += weight * down * residual


@parallel_jit
def _resample(image: Any, rows: Any, gains: Any, cell: int, top: Any, out: Any) -> None:
    """(H, W, C) ``image``, its rows moved by a polynomial, times ``gains`` between whose cells it is interpolated."""
    height, width, channels = image.shape
    grid_height, grid_width = gains.shape[:2]
    half = np.float32(0.5)
    kind = image.dtype.type
    for y in prange(height):
        gy = min(max((np.float32(y) + half) / np.float32(cell) - half, np.float32(0)), np.float32(grid_height - 1))
        i0 = int(gy)
        i1 = min(i0 + 1, grid_height - 1)
        ty = gy - np.float32(i0)
        down = (2.0 * y - height) / height
        for x in range(width):
            gx = min(max((np.float32(x) + half) / np.float32(cell) - half, np.float32(0)), np.float32(grid_width - 1))
            j0 = int(gx)
            j1 = min(j0 + 1, grid_width - 1)
            tx = gx - np.float32(j0)
            below = np.float32(float(y) + _polynomial(rows, (2.0 * x - width) / width, down))
            v = int(np.floor(below))
            t = below - np.float32(v)
            v0, v1 = min(max(v - 1, 0), height - 1), min(max(v, 0), height - 1)
            v2, v3 = min(max(v + 1, 0), height - 1), min(max(v + 2, 0), height - 1)
            for c in range(channels):
                upper = gains[i0, j0, c] + tx * (gains[i0, j1, c] - gains[i0, j0, c])
                lower = gains[i1, j0, c] + tx * (gains[i1, j1, c] - gains[i1, j0, c])
                before, here = np.float32(image[v0, x, c]), np.float32(image[v1, x, c])
                after, later = np.float32(image[v2, x, c]), np.float32(image[v3, x, c])
                value = _cubic(before, here, after, later, t)
                gain = upper + ty * (lower - upper)
                if gain < 1:  # what is saturated stays so: times a factor it would seem to have a slope
                    gain += (np.float32(1) - gain) * min(
                        max((value / top - _KNEE) / _SOFT, np.float32(0)), np.float32(1)
                    )
                out[y, x, c] = kind(min(max(value * gain + half, np.float32(0)), top))

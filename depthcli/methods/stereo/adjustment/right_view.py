"""Estimation of the row shift and the gains of a right image from matches, and their correction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import Doubles, Floats, Image8
from depthcli.kernels.jit import empty, helper, jit, run_bands

CELL = 4  # side of a cell, which has one gain, pixels of the reduced size
N_TERMS = 6  # of a polynomial of the second degree, which models small rotations and different focal lengths
# Parts of the largest grey level: where samples begin to count as saturated, and the range over which that rises to 1.
_SATURATION_START, _SATURATION_RANGE = np.float32(0.92), np.float32(0.07)
# Rows
BLOCK = 8  # side of a block, which has one disparity error, pixels of the reduced size
_FINE_SIGMA, _COARSE_SIGMA = 0.8, 6.0  # of the band pass before comparison: removes noise, and light that varies slowly
N_SUMS = 8
_MAX_ITERATIONS = 4
_MIN_CHANGE = 0.01  # rows: a smaller change of every coefficient ends the iteration
_HALF_WEIGHT, _MAX_RESIDUAL = np.float32(4.0), np.float32(20.0)  # grey levels: residuals of weight 1/2 (Cauchy) and 0
_RIDGE = 3000.0  # grey levels squared: pulls a shift of a quarter of a row to 0 if few pixels support it
# Light
_LOCAL_SIGMA, _WIDE_SIGMA = 12.0, 30.0  # of the Gaussian means over cells, pixels of the reduced size
_OFFSET = np.float32(8.0)  # grey levels added on both sides of a ratio: noise dominates the ratio of darker pixels
_PRIOR_WEIGHT = 0.5  # of the next wider mean, in matches per pixel
_MIN_WIDE_DENSITY, _MIN_LOCAL_DENSITY = np.float32(1e-3), np.float32(0.05)  # matches per pixel: keep the priors > 0
_MAX_RATIOS = (1.6, 1.2)  # between the grey levels of a match, relative to the global, then to the local gain
_GAIN_BOUNDS = (0.1, 10.0)
_MAX_MEDIAN_SAMPLES = 4096  # more do not change the median
_TRUST_PRIOR = np.float32(0.2)  # of the wider mean of differences, in matches per pixel
_HALF_TRUST = np.float32(6.0)  # grey levels: mean difference of matches at which the trust is one half


@dataclass(frozen=True)
class Correction:
    """Geometric and radiometric correction of a right image."""

    # (6,) rows by which a point is lower in the right image than in the left one, pixels of the reduced size:
    # coefficients of 1, u, v, u u, u v, v v, for column u and row v from -1 to 1.
    row_shift: Doubles
    gains: Floats  # (h, w, 3) factors, one per cell of 4 x 4 pixels of the reduced size, or (1, 1, 3)

    def apply(self, pair: StereoPair, factor: int) -> StereoPair:
        """Return ``pair``, which is ``factor`` times the reduced size, with its right image corrected."""
        if not self.row_shift.any() and self.gains is IDENTITY.gains:
            return pair
        right = cast(Image, np.ascontiguousarray(pair.clamped[1]).reshape(*pair.shape, -1))
        out = np.empty_like(right)
        resample(right, self.row_shift * factor, self.gains, CELL * factor, np.float32(pair.top), out)
        return StereoPair(pair.left, cast(Image, out.reshape(pair.right.shape)), pair.bits)


IDENTITY = Correction(np.zeros(N_TERMS), np.ones((1, 1, 3), np.float32))
"""The correction that changes nothing."""


@helper
def polynomial(c, u, v):
    """Return the value at (u, v) of the polynomial with the 6 coefficients ``c``."""
    return c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v


@helper
def cubic(p0, p1, p2, p3, t):
    """Return the Catmull-Rom spline through four samples, between ``p1`` (t = 0) and ``p2`` (t = 1)."""
    half = np.float32(0.5)
    a = half * (p2 - p0)
    b = p0 - np.float32(2.5) * p1 + np.float32(2) * p2 - half * p3
    c = half * (p3 - p0) + np.float32(1.5) * (p1 - p2)
    return p1 + t * (a + t * (b + t * c))


def resample(
    image: NDArray[Any],
    row_shift: Doubles,
    gains: Floats,
    cell: int,
    top: np.float32,
    out: NDArray[Any],
) -> None:
    """Write (H, W, C) ``image`` with its rows shifted, times the bilinearly interpolated ``gains``, to ``out``.

    Gains below 1 rise to 1 towards the largest grey level ``top``. Otherwise, saturated samples times a varying gain
    would seem to have a slope.
    """
    along = np.empty((gains.shape[0], image[0].size), np.float32)  # gains interpolated along the rows of the grid
    run_bands(_interpolate_gains, len(gains), gains, cell, image.shape[2], along)
    # Channels are part of the rows. Runs of pixels with samples from the same image rows are interpolated together.
    source, result = image.reshape(len(image), -1), out.reshape(len(image), -1)
    run_bands(_resample, len(image), source, image.shape[2], row_shift, along, cell, top, result)


@jit
def _interpolate_gains(begin, end, gains, cell, channels, along):
    grid_width = gains.shape[1]
    half = np.float32(0.5)
    for i in range(begin, end):
        for x in range(along.shape[1] // channels):
            gx = min(max((np.float32(x) + half) / np.float32(cell) - half, np.float32(0)), np.float32(grid_width - 1))
            j0 = int(gx)
            j1 = min(j0 + 1, grid_width - 1)
            tx = gx - np.float32(j0)
            for c in range(channels):
                along[i, x * channels + c] = gains[i, j0, c] + tx * (gains[i, j1, c] - gains[i, j0, c])


@jit
def _resample(begin, end, source, channels, row_shift, along, cell, top, result):
    height, width = source.shape[0], source.shape[1] // channels
    grid_height = along.shape[0]
    half = np.float32(0.5)
    kind = source.dtype.type
    for y in range(begin, end):
        gy = min(max((np.float32(y) + half) / np.float32(cell) - half, np.float32(0)), np.float32(grid_height - 1))
        i0 = int(gy)
        i1 = min(i0 + 1, grid_height - 1)
        ty = gy - np.float32(i0)
        down = (2.0 * y - height) / height
        row = empty(width, np.float32)
        for x in range(width):
            row[x] = np.float32(float(y) + polynomial(row_shift, (2.0 * x - width) / width, down))
        rest = empty(width * channels, np.float32)
        x = 0
        while x < width:
            start, v = x, int(np.floor(row[x]))
            while x < width and int(np.floor(row[x])) == v:
                for c in range(channels):
                    rest[x * channels + c] = row[x] - np.float32(v)
                x += 1
            part = slice(start * channels, x * channels)
            p0 = source[min(max(v - 1, 0), height - 1), part]
            p1 = source[min(max(v, 0), height - 1), part]
            p2 = source[min(max(v + 1, 0), height - 1), part]
            p3 = source[min(max(v + 2, 0), height - 1), part]
            t, upper, lower, target = rest[part], along[i0, part], along[i1, part], result[y, part]
            for k in range(target.size):
                value = cubic(np.float32(p0[k]), np.float32(p1[k]), np.float32(p2[k]), np.float32(p3[k]), t[k])
                gain = upper[k] + ty * (lower[k] - upper[k])
                if gain < 1:
                    gain += (np.float32(1) - gain) * min(
                        max((value / top - _SATURATION_START) / _SATURATION_RANGE, np.float32(0)), np.float32(1)
                    )
                target[k] = kind(min(max(value * gain + half, np.float32(0)), top))


def estimate_row_shift(disparity: Floats, left: Image, right: Image, initial: Doubles) -> Doubles:
    """Return the (6,) coefficients of the vertical shift of matches: the best of a few Gauss-Newton steps.

    Images are (H, W, 3) uint8, the right one with its light adjusted but not its rows; ``disparity`` is NaN without a
    match. The steps begin at ``initial``.
    """
    left_details, right_details = Details.of(left), Details.of(right)
    row_shift = best = initial
    best_cost = float("inf")
    for _ in range(_MAX_ITERATIONS + 1):  # the last pass only computes the cost
        sums = np.zeros((N_SUMS, *(-(-side // BLOCK) for side in disparity.shape)))
        run_bands(sum_blocks, sums.shape[1], disparity, left_details, right_details, row_shift, sums)
        weight, column, dx_dx, dx_dy, dy_dy, dx_residual, dy_residual, costs = sums
        cost = costs.sum()
        if cost >= best_cost:
            break
        best, best_cost = row_shift, cost
        # Eliminate the disparity error of every block: on slanted edges it would look like a shift of rows.
        leak = dx_dy / (dx_dx + 1.0)
        u = 2 * column / np.maximum(weight, 1e-9) / disparity.shape[1] - 1
        v = 2 * (BLOCK * np.arange(u.shape[0])[:, None] + (BLOCK - 1) / 2) / disparity.shape[0] - 1 + np.zeros_like(u)
        terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v]).reshape(N_TERMS, -1)
        matrix = (terms * (dy_dy - leak * dx_dy).ravel()) @ terms.T
        vector = terms @ (dy_residual - leak * dx_residual).ravel()
        change = np.linalg.solve(matrix + _RIDGE * np.eye(N_TERMS), vector - _RIDGE * row_shift)
        if np.abs(change).max() < _MIN_CHANGE:
            break
        row_shift = row_shift + change
    return best


class Details(NamedTuple):
    """Band-passed grey levels of an image and their slopes along x and y, (H, W) float32."""

    grey: Floats
    dx: Floats
    dy: Floats

    @classmethod
    def of(cls, image: Image) -> Details:
        """Return the details of an (H, W, 3) uint8 image."""
        fine = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
        fine = np.asarray(cv2.GaussianBlur(fine, (0, 0), _FINE_SIGMA), np.float32)
        grey = np.asarray(fine - cv2.GaussianBlur(fine, (0, 0), _COARSE_SIGMA), np.float32)
        dy, dx = np.gradient(grey)
        return cls(grey, np.asarray(dx, np.float32), np.asarray(dy, np.float32))


@helper
def _along_column(image, v, u, t):
    return cubic(image[v - 1, u], image[v, u], image[v + 1, u], image[v + 2, u], t)


@helper
def _bilinear(image, v, u, t, s):
    upper = image[v, u] + s * (image[v, u + 1] - image[v, u])
    lower = image[v + 1, u] + s * (image[v + 1, u + 1] - image[v + 1, u])
    return upper + t * (lower - upper)


@jit
def sum_blocks(begin, end, disparity, left, right, row_shift, sums):
    """Add sums over the matches of every block, shifted by ``row_shift``, to ``sums`` (8, h, w).

    They are, in order: robust weights; weighted columns of the right image, products of slopes (xx, xy, yy) and
    products of slopes and residuals (x, y); the robust cost of the residuals.
    """
    height, width = disparity.shape
    right_grey = right.grey
    half = np.float32(0.5)
    for i in range(begin, end):
        for y in range(i * BLOCK, min(height, (i + 1) * BLOCK)):
            for x in range(width):
                column = np.float32(x) - disparity[y, x]
                if np.isnan(column) or column < 0 or column >= width - 1:
                    continue
                u = int(column)
                s = column - np.float32(u)
                row = np.float32(
                    float(y) + polynomial(row_shift, (2.0 * column - width) / width, (2.0 * y - height) / height)
                )
                row = min(max(row, np.float32(1)), np.float32(height - 3))  # no lower cost by leaving the image
                v = min(int(row), height - 4)
                t = row - np.float32(v)
                block = sums[:, i, x // BLOCK]
                g0, g1 = _along_column(right_grey, v, u, t), _along_column(right_grey, v, u + 1, t)
                residual = left.grey[y, x] - (g0 + s * (g1 - g0))
                relative = min(abs(residual), _MAX_RESIDUAL) / _HALF_WEIGHT
                block[7] += np.log(np.float32(1) + relative * relative)
                if abs(residual) >= _MAX_RESIDUAL:
                    continue
                dx = half * (left.dx[y, x] + _bilinear(right.dx, v, u, t, s))
                dy = half * (left.dy[y, x] + _bilinear(right.dy, v, u, t, s))
                weight = np.float32(1) / (np.float32(1) + relative * relative)
                block[0] += weight
                block[1] += weight * column
                block[2] += weight * dx * dx
                block[3] += weight * dx * dy
                block[4] += weight * dy * dy
                block[5] += weight * dx * residual
                block[6] += weight * dy * residual


def estimate_gains(disparity: Floats, left: Image, right: Image) -> Floats:
    """Return the local ratio of left to right grey levels of matches, (ceil(H / 4), ceil(W / 4), 3) float32.

    The images are (H, W, 3) uint8; the right one has no gains applied. The ratio is a mean over matches around every
    cell of the right image. A wide mean is the prior of the local one, and the median ratio is the prior of the wide
    one. Matches with an outlier ratio do not count.
    """
    cells = tuple(-(-side // CELL) for side in disparity.shape)
    y, x = np.nonzero(~np.isnan(disparity))
    sample = slice(None, None, 1 + y.size // _MAX_MEDIAN_SAMPLES)
    y, x = y[sample], x[sample]
    u = np.maximum(x - np.rint(disparity[y, x]).astype(np.int64), 0)
    median = np.asarray(np.median((left[y, x] + _OFFSET) / (right[y, u] + _OFFSET), axis=0), np.float32)
    gains: Floats = np.zeros((*cells, 3), np.float32) + median
    for max_ratio in _MAX_RATIOS:
        sums = np.zeros((3, *cells, 3), np.float32)
        run_bands(sum_light, sums.shape[1], disparity, left, right, gains, np.float32(max_ratio), sums)
        wide, local = _means(sums)
        prior = _PRIOR_WEIGHT * wide[2] + _MIN_WIDE_DENSITY
        wide_gains = (wide[0] + prior * median * _OFFSET) / (wide[1] + prior * _OFFSET)
        prior = _PRIOR_WEIGHT * np.maximum(local[2], _MIN_LOCAL_DENSITY)
        gains = np.asarray((local[0] + prior * wide_gains * _OFFSET) / (local[1] + prior * _OFFSET), np.float32)
    return np.asarray(np.clip(gains, *_GAIN_BOUNDS), np.float32)


def light_trust(disparity: Floats, left: Image, right: Image, factor: int, shape: tuple[int, int]) -> Image8:
    """Return how far grey levels of corrected matches agree: (H, W) uint8 of the full ``shape``, 255 for "entirely".

    ``factor`` is the full size divided by the size of ``disparity`` and of the images, which are (H, W, 3) uint8.
    """
    sums = np.zeros((2, *(-(-side // CELL) for side in disparity.shape)), np.float32)
    run_bands(sum_differences, sums.shape[1], disparity, left, right, sums)
    mean = sums[0].sum() / sums[1].sum()
    wide, local = _means(sums)
    wide_differences = (wide[0] + _TRUST_PRIOR * mean) / (wide[1] + _TRUST_PRIOR)
    differences = (local[0] + _TRUST_PRIOR * wide_differences) / (local[1] + _TRUST_PRIOR)
    trust = np.asarray(np.rint(255 / (1 + (differences / _HALF_TRUST) ** 2)), np.uint8)
    side = CELL * factor
    whole = cv2.resize(trust, (side * trust.shape[1], side * trust.shape[0]), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(whole[: shape[0], : shape[1]], np.uint8)


def _means(sums: Floats) -> list[list[Floats]]:
    def mean(grid: Floats, sigma: float) -> Floats:
        return np.asarray(cv2.GaussianBlur(grid, (0, 0), sigma / CELL, borderType=cv2.BORDER_REFLECT), np.float32)

    return [[mean(grid, sigma) for grid in sums] for sigma in (_WIDE_SIGMA, _LOCAL_SIGMA)]


@helper
def _matching_column(x, disparity):
    return max(x - int(disparity + np.float32(0.5)), 0)


@jit
def sum_light(begin, end, disparity, left, right, gains, max_ratio, sums):
    """Add left and right grey levels of matches, and their number, to ``sums`` (3, h, w, 3), per pixel of a cell.

    Cells are in the right image. Saturated samples count too: grey levels have to agree even if they do not determine a
    gain.
    """
    height, width = disparity.shape
    share = np.float32(1 / CELL**2)
    for i in range(begin, end):
        for y in range(i * CELL, min(height, (i + 1) * CELL)):
            for x in range(width):
                if np.isnan(disparity[y, x]):
                    continue
                u = _matching_column(x, disparity[y, x])
                j = u // CELL
                for c in range(3):
                    left_level, right_level = np.float32(left[y, x, c]), np.float32(right[y, u, c])
                    expected = (right_level + _OFFSET) * gains[i, j, c]
                    if left_level + _OFFSET < max_ratio * expected and expected < max_ratio * (left_level + _OFFSET):
                        sums[0, i, j, c] += share * left_level
                        sums[1, i, j, c] += share * right_level
                        sums[2, i, j, c] += share


@jit
def sum_differences(begin, end, disparity, left, right, sums):
    """Add the mean difference of matches over the channels, and their number, to ``sums`` (2, h, w), per pixel of a
    cell of the left image.
    """
    height, width = disparity.shape
    share = np.float32(1 / CELL**2)
    for i in range(begin, end):
        for y in range(i * CELL, min(height, (i + 1) * CELL)):
            for x in range(width):
                if np.isnan(disparity[y, x]):
                    continue
                u = _matching_column(x, disparity[y, x])
                sums[1, i, x // CELL] += share
                for c in range(3):
                    difference = abs(np.float32(left[y, x, c]) - np.float32(right[y, u, c]))
                    sums[0, i, x // CELL] += share * difference / np.float32(3)

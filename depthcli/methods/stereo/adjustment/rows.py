"""Alignment of rows: the vertical shift over the image at which the grey levels of matches agree best."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import Image
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.stereo.adjustment.resampling import N_TERMS, cubic, polynomial

BLOCK = 8  # side of the blocks that share an error of disparity, pixels of the reduced size
_FINE_SIGMA, _COARSE_SIGMA = 0.8, 6.0  # of the band pass before comparison: noise, and light that varies slowly
_MAX_ITERATIONS = 4
_MIN_CHANGE = 0.01  # rows: a smaller change of every coefficient ends the iteration
_HALF_WEIGHT, _MAX_RESIDUAL = np.float32(4.0), np.float32(20.0)  # grey levels: weight 1/2 (Cauchy), weight 0
_RIDGE = 3000.0  # grey levels squared: pulls a shift of a quarter of a row that few pixels support to 0


def estimate_row_shift(
    disparity: NDArray[np.float32], left: Image, right: Image, initial: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the (6,) coefficients of the vertical shift of matches, the best of some Gauss-Newton steps.

    Parameters
    ----------
    disparity : (H, W) float32, NaN without a match
    left, right : (H, W, 3) uint8, the right one with its light adjusted but not its rows
    initial : (6,) coefficients to begin with
    """
    left_details, right_details = Details.of(left), Details.of(right)
    row_shift = best = initial
    best_cost = float("inf")
    for _ in range(_MAX_ITERATIONS + 1):  # in the last one only the cost counts
        sums = np.zeros((len(BlockSums._fields), *(-(-side // BLOCK) for side in disparity.shape)))
        sum_blocks(disparity, left_details, right_details, row_shift, sums)
        blocks = BlockSums(*sums)
        cost = blocks.cost.sum()
        if cost >= best_cost:
            break
        best, best_cost = row_shift, cost
        matrix, vector = blocks.normal_equations(disparity.shape)
        change = np.linalg.solve(matrix + _RIDGE * np.eye(N_TERMS), vector - _RIDGE * row_shift)
        if np.abs(change).max() < _MIN_CHANGE:
            break
        row_shift = row_shift + change
    return best


class Details(NamedTuple):
    """Band-passed grey levels of an image and their slopes along x and y, (H, W) float32."""

    grey: NDArray[np.float32]
    dx: NDArray[np.float32]
    dy: NDArray[np.float32]

    @classmethod
    def of(cls, image: Image) -> Details:
        """Return the details of an (H, W, 3) uint8 image."""
        fine = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
        fine = np.asarray(cv2.GaussianBlur(fine, (0, 0), _FINE_SIGMA), np.float32)
        grey = np.asarray(fine - cv2.GaussianBlur(fine, (0, 0), _COARSE_SIGMA), np.float32)
        dy, dx = np.gradient(grey)
        return cls(grey, np.asarray(dx, np.float32), np.asarray(dy, np.float32))


class BlockSums(NamedTuple):
    """Sums over the matches of every block, (h, w) float64: robust weights; and, times these weights, columns of the
    right image and products of slopes and residuals; and the robust cost of the residuals.
    """

    weight: NDArray[np.float64]
    column: NDArray[np.float64]
    dx_dx: NDArray[np.float64]
    dx_dy: NDArray[np.float64]
    dy_dy: NDArray[np.float64]
    dx_residual: NDArray[np.float64]
    dy_residual: NDArray[np.float64]
    cost: NDArray[np.float64]

    def normal_equations(self, shape: tuple[int, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the (6, 6) matrix and the (6,) right-hand side of a Gauss-Newton step.

        Every block has an error of disparity of its own, which is eliminated: on slanted edges it would look like a
        shift of rows.
        """
        leak = self.dx_dy / (self.dx_dx + 1.0)
        certainty = self.dy_dy - leak * self.dx_dy
        right_hand_side = self.dy_residual - leak * self.dx_residual
        u = 2 * self.column / np.maximum(self.weight, 1e-9) / shape[1] - 1
        v = (2 * (BLOCK * np.arange(u.shape[0])[:, None] + (BLOCK - 1) / 2) / shape[0] - 1) + np.zeros_like(u)
        terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v]).reshape(N_TERMS, -1)
        return (terms * certainty.ravel()) @ terms.T, terms @ right_hand_side.ravel()


@jit
def _bilinear(image, v, u, t, s):
    upper = image[v, u] + s * (image[v, u + 1] - image[v, u])
    lower = image[v + 1, u] + s * (image[v + 1, u + 1] - image[v + 1, u])
    return upper + t * (lower - upper)


@parallel_jit
def sum_blocks(disparity, left, right, row_shift, sums):
    """Add the fields of :class:`BlockSums` over the matches, shifted by ``row_shift``, to ``sums`` (8, h, w)."""
    height, width = disparity.shape
    right_grey = right.grey
    half = np.float32(0.5)
    for i in prange(sums.shape[1]):
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
                row = min(max(row, np.float32(1)), np.float32(height - 3))  # leaving the image must not pay
                v = min(int(row), height - 4)
                t = row - np.float32(v)
                block = sums[:, i, x // BLOCK]
                g0 = cubic(right_grey[v - 1, u], right_grey[v, u], right_grey[v + 1, u], right_grey[v + 2, u], t)
                g1 = cubic(
                    right_grey[v - 1, u + 1],
                    right_grey[v, u + 1],
                    right_grey[v + 1, u + 1],
                    right_grey[v + 2, u + 1],
                    t,
                )
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

"""Error bounds, and probabilities of small errors, from log odds: one table, monotone in both arguments."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np

from depthcli.core.maps import Doubles, Floats
from depthcli.kernels.jit import jit, run_bands

_POINTS = 4096  # equidistant log odds between which a column is interpolated
_LIMITS = 64  # equidistant limits of log2 errors, for a limit per value


@dataclass(frozen=True, eq=False)
class ErrorTable:
    """Quantiles of errors of maps with ground truth, by the log odds of a small error.

    ``scripts/train_bounds.py`` makes the table for disparity maps, with errors in pixels;
    ``scripts/train_depth_bounds.py`` makes the table for depth maps, with errors in multiples of the noise. The table
    is interpolated in the log odds, the log odds of the level, and the logarithm of the error. Therefore a bound does
    not decrease as the level grows or increase as the odds grow, and a probability does not decrease as the limit
    grows.
    """

    log_odds: Doubles  # (R,) ascending
    levels: Doubles  # (L,) ascending, in 0 .. 1
    log2_errors: Doubles  # (R, L); columns fall, rows rise

    def bound(self, log_odds: Floats, level: float) -> Floats:
        """Return the error bound with coverage ``level`` of values with these log odds."""
        at, places = _logit(level), _logit(self.levels)
        column = np.array([np.interp(at, places, row) for row in self.log2_errors])
        return self._looked_up(log_odds, np.exp2(np.interp(self._points, self.log_odds, column)))

    def probability(self, log_odds: Floats, within: float | Floats) -> Floats:
        """Return the share of the values with these log odds whose error is at most ``within``.

        ``within`` is a number, or an array with a limit per value. In the second case, both arrays are (H, W), and the
        shares are also interpolated between limits.
        """
        if isinstance(within, float):
            return self._looked_up(log_odds, _shares_within(self, within))
        limits, grid = self._grid
        with np.errstate(divide="ignore"):
            column = (np.log2(within, dtype=np.float64) - limits[0]) * (_LIMITS - 1) / (limits[-1] - limits[0])
        row = (log_odds - self._points[0]) * (_POINTS - 1) / (self._points[-1] - self._points[0])
        at = (column.clip(0, _LIMITS - 1).astype(np.float32), row.clip(0, _POINTS - 1).astype(np.float32))
        return np.asarray(cv2.remap(grid, *at, cv2.INTER_LINEAR), np.float32)

    @cached_property
    def unbiased(self) -> ErrorTable:
        """The table at the log odds that its errors up to 1 have, so that it adds no margin to such a probability."""
        log_odds = _logit(self._shares(np.zeros(1), self.log_odds)[:, 0])
        log_odds[[0, -1]] += self.log_odds[[0, -1]] - self.log_odds[[1, -2]]  # far away, so that the order stays
        return replace(self, log_odds=log_odds)

    @cached_property
    def _points(self) -> Doubles:
        return np.linspace(self.log_odds[0], self.log_odds[-1], _POINTS)

    @cached_property
    def _grid(self) -> tuple[Doubles, Floats]:
        limits = np.linspace(self.log2_errors.min() - 2, self.log2_errors.max() + 2, _LIMITS)
        return limits, self._shares(limits, self._points).astype(np.float32)

    def _shares(self, limits: Doubles, at: Doubles) -> Doubles:
        """Return the shares of the errors up to 2 ** limit; rows are log odds, columns are limits."""
        rows = np.stack([np.interp(at, self.log_odds, column) for column in self.log2_errors.T], axis=1)
        places = _logit(self.levels)
        inside = 1 / (1 + np.exp(-np.array([np.interp(limits, row, places) for row in rows])))
        below = self.levels[0] * np.exp2(np.minimum(limits - rows[:, :1], 0))
        above = 1 - (1 - self.levels[-1]) * np.exp2(np.minimum(rows[:, -1:] - limits, 0))
        return np.asarray(np.where(limits < rows[:, :1], below, np.where(limits > rows[:, -1:], above, inside)))

    def _looked_up(self, log_odds: Floats, column: Doubles) -> Floats:
        # Interpolate a column, given at ``_points``, at log odds of any shape.
        found = np.empty(log_odds.shape, np.float32)
        flat = np.ascontiguousarray(log_odds, np.float32).reshape(-1)
        first, step = self._points[0], self._points[1] - self._points[0]
        run_bands(
            _interpolate, flat.size, flat, np.float32(first), np.float32(1 / step), column.astype(np.float32),
            found.reshape(-1),
        )  # fmt: skip
        return found


@lru_cache(16)
def _shares_within(table: ErrorTable, within: float) -> Doubles:
    return table._shares(np.array([math.log2(within)]), table._points)[:, 0]


def _logit(share: float | Doubles) -> Doubles:
    odds: Doubles = np.log(np.asarray(share) / (1 - np.asarray(share)))
    return odds


@jit
def _interpolate(begin, end, values, first, per_step, column, out):
    top = np.float32(column.size - 1)
    for i in range(begin, end):
        at = min(max((values[i] - first) * per_step, np.float32(0)), top)
        k = min(int(at), column.size - 2)
        out[i] = column[k] + (at - np.float32(k)) * (column[k + 1] - column[k])

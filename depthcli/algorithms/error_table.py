"""From the log odds that a value is right to a bound of its error, and back: one table, monotone both ways."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_POINTS = 1024  # of the log odds, between which probabilities are interpolated
_DOUBTFUL = 0.3  # mean probability of a map's values below which each is less likely than its own log odds say


@dataclass(frozen=True, eq=False)
class ErrorTable:
    """Quantiles of the errors of maps whose truth is known, by the log odds of an error up to 1 pixel.

    ``scripts/train_bounds.py`` makes it. It is interpolated in the log odds, the log odds of the level, and the
    logarithm of the error, so that a bound never shrinks as the level grows, nor grows with the odds, and a probability
    never shrinks as the limit grows.
    """

    log_odds: NDArray[np.float64]  # (R,) ascending
    levels: NDArray[np.float64]  # (L,) ascending, in 0 .. 1
    log2_errors: NDArray[np.float64]  # (R, L), pixels; columns fall, rows rise

    def bound(self, log_odds: NDArray[np.float32], level: float) -> NDArray[np.float32]:
        """Return the error, pixels, that a share ``level`` of the values with these log odds does not exceed."""
        at, places = _logit(level), _logit(self.levels)
        column = np.array([np.interp(at, places, row) for row in self.log2_errors])
        bound: NDArray[np.float32] = np.exp2(np.interp(log_odds, self.log_odds, column)).astype(np.float32)
        return bound

    def probability(self, log_odds: NDArray[np.float32], within: float) -> NDArray[np.float32]:
        """Return the share of the values with these log odds whose error is at most ``within`` pixels."""
        points = np.linspace(self.log_odds[0], self.log_odds[-1], _POINTS)
        rows = np.stack([np.interp(points, self.log_odds, column) for column in self.log2_errors.T], axis=1)
        limit, places = math.log2(within), _logit(self.levels)
        inside = 1 / (1 + np.exp(-np.array([np.interp(limit, row, places) for row in rows])))
        below = self.levels[0] * np.exp2(np.minimum(limit - rows[:, 0], 0))
        above = 1 - (1 - self.levels[-1]) * np.exp2(np.minimum(rows[:, -1] - limit, 0))
        shares = np.where(limit < rows[:, 0], below, np.where(limit > rows[:, -1], above, inside))
        found: NDArray[np.float32] = np.interp(log_odds, points, shares).astype(np.float32)
        return found


def doubted(log_odds: NDArray[np.float32], missing: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the log odds (H, W) of a map, lower where few of its values are likely right.

    Then it is most likely not a map of this pair, or has another scale, and values that seem right are so by chance.
    """
    known = log_odds[~missing]
    if not known.size:
        return log_odds
    mean = float(np.mean(1 / (1 + np.exp(-known.clip(-30, 30))), dtype=np.float64))
    return log_odds + np.float32(min(0.0, float(_logit(max(mean, 1e-6)) - _logit(_DOUBTFUL))))


def _logit(share: float | NDArray[np.float64]) -> NDArray[np.float64]:
    odds: NDArray[np.float64] = np.log(np.asarray(share) / (1 - np.asarray(share)))
    return odds

"""How much every measure counts at every pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.methods.fusion.votes import Ballot


def comparable(confidence: NDArray[np.float32], name: str) -> NDArray[np.float32]:
    """Confidences of several measures on one scale in [0, 1].

    ``lrc`` is in pixels for every measure and becomes 1 / (1 + |difference|). Any other becomes its rank
    among all measures and pixels together: ranks within a measure would lose which measure is better.

    Parameters
    ----------
    confidence : (M, H, W) float32
    """
    if name == "lrc":
        trust: NDArray[np.float32] = (1.0 / (1.0 - confidence)).astype(np.float32)
        return trust
    ordered = np.sort(confidence, axis=None)
    first = np.searchsorted(ordered, confidence, "left")
    last = np.searchsorted(ordered, confidence, "right")
    return ((first + last) / (2.0 * ordered.size)).astype(np.float32)


def measure_weights(mode: str, ballot: Ballot, exponent: float) -> NDArray[np.float32]:
    """(M, H, W) float32 weights that sum to 1 over the measures."""
    if mode in ("equal", "vote"):
        return np.full(ballot.weights.shape, 1.0 / ballot.weights.shape[0], np.float32)
    if mode == "select":
        best = ballot.weights.argmax(axis=0)
        chosen: NDArray[np.bool_] = np.arange(ballot.weights.shape[0])[:, None, None] == best
        return chosen.astype(np.float32)
    score = ballot.shares(ballot.disparities) if mode == "consensus" else ballot.weights
    # The floor keeps pixels without any support at equal weights.
    powered = np.maximum(score, np.float32(1e-4)) ** exponent
    weights: NDArray[np.float32] = (powered / powered.sum(axis=0, keepdims=True)).astype(np.float32, copy=False)
    return weights

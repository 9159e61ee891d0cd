"""Costs of several measures on one scale, the weights of the measures at every pixel, and their weighted mean."""

from __future__ import annotations

import numpy as np

from depthcli.core import memory
from depthcli.core.maps import Floats, Image8, Mask
from depthcli.kernels.exponential import exp_minus
from depthcli.kernels.jit import empty, jit, run_bands
from depthcli.methods.fusion.votes import Ballot
from depthcli.methods.stereo.volume import CostVolume, fill_outside

UNIT = 255
"""Stored value of the cost 1."""
_MIN_SCORE = np.float32(1e-4)  # changes no weight visibly, and gives pixels without any vote equal weights


def normalize_costs(volume: CostVolume, scale: float | None, outside: float | None = None) -> CostVolume:
    """Return the costs of any measure in [0, 1]: ``1 - exp(-C / scale)`` (as in Mei et al. 2011); uint8, scale 255.

    If any cost is below zero, all are shifted so that the smallest one is zero. ``scale`` is in units of the measure;
    None: the median cost. Cells outside the right image get the cost ``outside``; None: the mean of the cells inside.
    """
    costs = volume.costs
    out: Image8 = memory.empty(costs.shape, np.uint8)
    rows = costs.reshape(len(costs), -1)
    inside = np.arange(costs.shape[2])[None, :] <= np.arange(costs.shape[1])[:, None]
    if costs.dtype == np.float32:
        offset = min(0.0, float(costs.min()))
        sample = costs[::4][:, inside] - np.float32(offset)  # every fourth row: enough for a median
        middle = float(np.median(sample)) if scale is None else scale * volume.scale
        rate = 1.0 / middle if middle > 0 else 1.0
        run_bands(_squash, len(rows), rows, np.float32(offset), np.float32(rate), out.reshape(rows.shape))
        mean = 1.0 - float(np.mean(np.exp(-sample.astype(np.float64) * rate)))
    else:
        counts = np.zeros(256 if costs.dtype == np.uint8 else 65536, np.int64)
        if scale is None or outside is None:
            for row in costs[::4]:
                counts += np.bincount(row[inside], minlength=counts.size)
        total = np.cumsum(counts)
        middle = float(np.searchsorted(total, (total[-1] + 1) // 2)) if scale is None else scale * volume.scale
        squashed = 1.0 - np.exp(-np.arange(counts.size) / (middle if middle > 0 else 1.0))
        run_bands(_look_up, len(rows), rows, np.round(squashed * UNIT).astype(np.uint8), out.reshape(rows.shape))
        mean = float(squashed @ counts) / max(float(total[-1]), 1.0)
    fill_outside(out, np.uint8(round(UNIT * (mean if outside is None else outside))))
    return CostVolume(out, float(UNIT))


def normalize_confidences(confidence: Floats, name: str) -> Floats:
    """Return (M, H, W) confidences called ``name`` of M cost measures on one scale in [0, 1].

    ``lrc`` is in pixels for every measure and becomes 1 / (1 + |difference|). Any other becomes its rank
    among all measures and pixels together: ranks within a measure would lose which measure is better.
    """
    if name == "lrc":
        trust: Floats = (1.0 / (1.0 - confidence)).astype(np.float32)
        return trust
    ordered = np.sort(confidence, axis=None)
    first = np.searchsorted(ordered, confidence, "left")
    last = np.searchsorted(ordered, confidence, "right")
    return ((first + last) / (2.0 * ordered.size)).astype(np.float32)


def measure_weights(mode: str, ballot: Ballot | None, exponent: float, shape: tuple[int, int, int]) -> Floats:
    """Compute the weights of M measures at every pixel, ``shape`` (M, H, W) float32, sum 1 over the measures.

    The ballot, with one voter per measure, may be missing if all weights are equal. ``exponent`` is a power of the
    shares (mode ``consensus``) or of the vote weights (mode ``confidence``).
    """
    if mode in ("equal", "vote"):
        return np.full(shape, 1.0 / shape[0], np.float32)
    assert ballot is not None
    if mode == "select":
        best = ballot.vote_weights.argmax(axis=0)
        chosen: Mask = np.arange(ballot.vote_weights.shape[0])[:, None, None] == best
        return chosen.astype(np.float32)
    score = ballot.shares(ballot.disparities) if mode == "consensus" else ballot.vote_weights
    powered = np.maximum(score, _MIN_SCORE) ** exponent
    weights: Floats = (powered / powered.sum(axis=0, keepdims=True)).astype(np.float32, copy=False)
    return weights


def blend(volumes: list[CostVolume], weights: Floats) -> CostVolume:
    """Return the mean of M uint8 volumes of one scale, in that scale, by weights (M, H, W) whose sums are 1.

    Weights are rounded to 1/256; the largest one takes the remainder.
    """
    out: Image8 = memory.empty(volumes[0].costs.shape, np.uint8)
    run_bands(_blend, len(out), tuple(volume.costs for volume in volumes), weights, out)
    return CostVolume(out, volumes[0].scale)


def add_weighted(total: Floats, volume: CostVolume, weights: Floats) -> None:
    """Add ``weights`` (H, W) times the volume's costs, in units of the measure, to float32 ``total``."""
    run_bands(_add_weighted, len(volume.costs), volume.costs, weights * np.float32(1.0 / volume.scale), total)


@jit
def _look_up(begin, end, costs, table, out):
    for y in range(begin, end):
        source, cells = costs[y], out[y]
        for i in range(cells.size):
            cells[i] = table[source[i]]


@jit
def _squash(begin, end, costs, offset, rate, out):
    unit, one, half = np.float32(255.0), np.float32(1.0), np.float32(0.5)
    for y in range(begin, end):
        source, cells = costs[y], out[y]
        for i in range(cells.size):
            cells[i] = np.uint8(np.int32(unit * (one - exp_minus((source[i] - offset) * rate)) + half))


@jit
def _blend(begin, end, volumes, weights, out):
    _, width, n_disparities = out.shape
    for y in range(begin, end):
        total = empty(n_disparities, np.uint16)
        fixed = empty(len(volumes), np.int32)
        for x in range(width):
            largest = 0
            rest = np.int32(256)
            for m in range(len(volumes)):
                fixed[m] = np.int32(weights[m, y, x] * np.float32(256.0) + np.float32(0.5))
                rest -= fixed[m]
                if fixed[m] > fixed[largest]:
                    largest = m
            fixed[largest] += rest
            total[:] = 128
            for m in range(len(volumes)):
                w = np.uint16(fixed[m])
                source = volumes[m][y, x]
                for i in range(total.size):
                    total[i] = np.uint16(total[i] + np.uint16(np.uint16(source[i]) * w))
            cells = out[y, x]
            for i in range(cells.size):
                cells[i] = np.uint8(total[i] >> np.uint16(8))


@jit
def _add_weighted(begin, end, costs, weights, total):
    width = costs.shape[1]
    for y in range(begin, end):
        for x in range(width):
            w = weights[y, x]
            source = costs[y, x]
            cells = total[y, x]
            for i in range(cells.size):
                cells[i] += w * np.float32(source[i])

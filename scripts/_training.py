"""What the scripts that train share: networks, tables of errors by their log odds, and how well bounds hold."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from depthcli.algorithms.error_table import ErrorTable
from depthcli.algorithms.pixel_network import TrainedNetwork

LEVELS = np.array([0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98, 0.99])
BINS = np.array([0, 0.005, 0.01, 0.02, *np.linspace(0.04, 1, 25)])  # shares of the pixels, by their log odds
EPOCHS, RANKING = 4, 0.5  # passes over all samples; weight of the order of maps beside their chances
Arrays = dict[str, NDArray[Any]]
Map = NDArray[np.float32]
Batch = tuple[Map, Map, Map, NDArray[Any]]
"""Scaled inputs (P * N, F), what the first offsets are chosen by (P * N, K), wanted (P, N), weights (P, 1)."""


Pixels = tuple[NDArray[np.float16], NDArray[np.float16], Map]
"""Inputs (P, N, F), errors (P, N) pixels, weights (P,)."""


def some_pixels(rng: np.random.Generator, where: NDArray[np.bool_], most: int) -> NDArray[np.int64]:
    """Return the places of at most so many pixels, chosen at random."""
    known = np.flatnonzero(where)
    return rng.choice(known, min(known.size, most), replace=False)


def new_layers(rng: np.random.Generator, inputs: int, offsets: int, sizes: tuple[int, int]) -> list[Map]:
    """Return weights and offsets of two hidden layers and the output; the first has several rows of offsets."""
    shapes = [(inputs, sizes[0]), (offsets, sizes[0]), sizes, (sizes[1],), (sizes[1], 1), (1,)]
    return [(rng.normal(size=s) * np.sqrt(2 / s[0]) if k % 2 == 0 else np.zeros(s)).astype(np.float32)
            for k, s in enumerate(shapes)]  # fmt: skip


def fit(layers: list[Map], batches: Iterable[Batch], steps: int, ranking: float, decay: float = 1e-3) -> None:
    """Change layers by Adam, a step a batch, so that they give log odds of what is wanted.

    The loss of a pixel is the mean cross entropy of its N maps, and ``ranking`` times the negative logarithm of the
    share (softmax) of the wanted ones.
    """
    first, second = ([np.zeros_like(one) for one in layers] for _ in range(2))
    for done, (x, which, wanted, weights) in enumerate(batches, 1):
        h1 = np.maximum(x @ layers[0] + which @ layers[1], 0)
        h2 = np.maximum(h1 @ layers[2] + layers[3], 0)
        odds = (h2 @ layers[4] + layers[5]).reshape(wanted.shape)
        chance = 1 / (1 + np.exp(-np.clip(odds, -30, 30)))
        shares = np.exp(odds - odds.max(1, keepdims=True))
        shares /= shares.sum(1, keepdims=True)
        hit = (shares * wanted).sum(1, keepdims=True)
        pull = np.where(hit > 1e-4, shares - shares * wanted / np.maximum(hit, 1e-4), 0)
        gradient = (((chance - wanted) / wanted.shape[1] + ranking * pull) * weights / len(wanted)).reshape(-1, 1)
        back2 = (gradient @ layers[4].T) * (h2 > 0)
        back1 = (back2 @ layers[2].T) * (h1 > 0)
        slopes = [x.T @ back1, which.T @ back1, h1.T @ back2, back2.sum(0), h2.T @ gradient, gradient.sum(0)]
        speed = 3e-3 * 0.5 * (1 + np.cos(np.pi * done / steps))
        for j, slope in enumerate(slopes):
            slope = slope + (decay * layers[j] if j % 2 == 0 else 0)
            first[j] = 0.9 * first[j] + 0.1 * slope
            second[j] = 0.999 * second[j] + 0.001 * slope**2
            step = first[j] / (1 - 0.9**done) / (np.sqrt(second[j] / (1 - 0.999**done)) + 1e-8)
            layers[j] -= (speed * step).astype(np.float32)


def network(
    groups: dict[int, Pixels], thresholds: tuple[float, ...], maps: tuple[str, ...], inputs: tuple[str, ...],
    sizes: tuple[int, int], names: list[str],
) -> TrainedNetwork:  # fmt: skip
    """Return a network of the chance of each map to be right within a threshold, chosen at random at every pixel.

    In groups it also learns that the likeliest map is right.
    """
    rng = np.random.default_rng(0)
    some = [x.reshape(-1, x.shape[2])[:: max(1, x.shape[0] * n // 100_000)] for n, (x, *_) in groups.items()]
    spread = np.concatenate(some).astype(np.float32)
    mean, scale = spread.mean(0), 1 / (spread.std(0) + 1e-3)
    average = {n: float(w.mean()) for n, (_, _, w) in groups.items()}
    layers = new_layers(rng, mean.size, len(thresholds), sizes)
    parts = {n: len(x) * n // 2048 for n, (x, *_) in groups.items()}
    order = [n for n, count in parts.items() for _ in range(count)]

    def batches() -> Iterator[Batch]:
        for _ in range(EPOCHS):
            shuffled = {n: iter(np.array_split(rng.permutation(len(x)), max(1, parts[n])))
                        for n, (x, *_) in groups.items()}  # fmt: skip
            for n in rng.permutation(order):
                chosen = np.sort(next(shuffled[n]))
                x, errors, weights = (array[chosen] for array in groups[n])
                k = rng.integers(0, len(thresholds), len(chosen))
                wanted = errors.astype(np.float32) <= np.array(thresholds, np.float32)[k][:, None]
                scaled = np.clip((x.astype(np.float32) - mean) * scale, -4, 4).reshape(-1, mean.size)
                which = np.repeat(np.eye(len(thresholds), dtype=np.float32)[k], n, axis=0)
                yield scaled, which, wanted.astype(np.float32), np.minimum(weights / average[n], 8)[:, None]

    fit(layers, batches(), EPOCHS * len(order), RANKING)
    w1, b1, w2, b2, w3, b3 = layers
    return TrainedNetwork(maps, inputs, mean, scale, ((w1, b1), (w2, b2), (w3, b3)), tuple(names))


def log_odds(network: TrainedNetwork, inputs: NDArray[Any], row: int | slice = slice(None)) -> Map:
    """Return the log odds that a network gives for inputs (..., F), without the kernel; ``row``: which offsets."""
    (w1, b1), (w2, b2), (w3, b3) = network.layers
    scaled = np.clip((inputs.astype(np.float32) - network.mean) * network.scale, -4, 4)
    hidden = np.maximum(scaled @ w1 + b1[row], 0)
    return np.asarray((np.maximum(hidden @ w2 + b2, 0) @ w3 + b3)[..., 0])


def quantiles(
    values: NDArray[np.float64], weights: NDArray[np.float64], at: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return weighted quantiles."""
    ordered, below = ranked(values, weights)
    return np.interp(at, below, ordered)


def ranked(values: NDArray[Any], weights: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Return the values in order, and the share of the weights below each, half its own included."""
    order = np.argsort(values)
    below = np.cumsum(weights[order]) - weights[order] / 2
    return values[order], below / weights.sum()


def table(
    maps: Sequence[tuple[str, Map]],
    odds: str,
    shares: NDArray[np.float64] = BINS,
    min_samples: int = 200,
    worst_share: float = 0.25,
    noise: float = 0.0,
    reach: float = 0.0,
) -> ErrorTable:
    """Return the table of data sets and their maps; data sets weigh the same, and so do maps without a ``weight``.

    Parameters
    ----------
    shares : of the samples below the edges of the bins
    min_samples : of a data set in a bin, so that it counts there
    reach : share of the samples between the middle of a bin and the place where their weights in the bin, which fall
        linearly, are 0, for few samples; 0: samples between the edges count in full, others not at all
    worst_share : how far entries lie from the mean over data sets toward the worst one
    noise : standard deviation of an offset that errors of new data may have, too
    """
    key, error = (np.concatenate([one[name] for _, one in maps]) for name in (odds, "error"))
    weight = np.concatenate([np.full(one["error"].size, one.get("weight", 1) / one["error"].size) for _, one in maps])
    families, of = np.unique([family for family, _ in maps], return_inverse=True)
    of = np.repeat(of, [one["error"].size for _, one in maps])
    edges = quantiles(key, weight, shares)
    bins = np.searchsorted(edges[1:-1], key, side="right")
    below = np.interp(key, *ranked(key, weight)) if reach else key
    rows = np.full((len(families), len(shares) - 1, len(LEVELS)), np.nan)
    filled, centers = np.zeros((2, rows.shape[1]))
    for row, middle in enumerate((shares[1:] + shares[:-1]) / 2):
        inside = np.maximum(0, 1 - np.abs(below - middle) / reach) if reach else (bins == row).astype(np.float64)
        there = np.flatnonzero(inside)
        its_weight, its_family = (weight * inside)[there], of[there]
        errors = np.log2(np.maximum(error[there], 1 / 64))
        filled[row], centers[row] = its_weight.sum(), (its_weight * key[there]).sum()
        for k in range(len(families)):
            its = its_family == k
            if its.sum() >= min_samples:
                rows[k, row] = quantiles(errors[its], its_weight[its], LEVELS)
    enough = ~np.isnan(rows[:, :, 0]).all(axis=0)
    rows, filled = rows[:, enough], filled[enough]
    mean = np.nanmean(rows, axis=0)
    mixed = mean + worst_share * (np.nanmax(rows, axis=0) - mean)
    if noise:
        least = noise * np.array([NormalDist().inv_cdf((1 + level) / 2) for level in LEVELS])
        mixed = np.log2(np.hypot(np.exp2(mixed), least))
    rising = [-isotonic_regression(-column, weights=filled).x for column in mixed.T]
    log2 = np.maximum.accumulate(np.stack(rising, axis=1), axis=1)
    centers = centers[enough] / filled
    # Beyond the ends it goes on a little, so that the order of the pixels stays.
    ends = [log2[:1] + 0.5, log2, log2[-1:] - 0.5]
    return ErrorTable(np.array([centers[0] - 10, *centers, centers[-1] + 10]), LEVELS, np.concatenate(ends))


def write(path: Path, made: ErrorTable, what: str = "log odds", unit: str = "pixels") -> None:
    """Write a table of errors in ``unit`` by ``what``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.vstack([np.append(0, made.levels), np.column_stack([made.log_odds, made.log2_errors])])
    np.savetxt(path, rows, "%.4g", ",", header=f"{what}, then log2 of the errors' quantiles, {unit}; first row: levels")


class Held(NamedTuple):
    """How well bounds of errors hold, and how wide they are."""

    covered: float  # share of the errors
    median: float  # bound
    over_error: float  # median bound / median error
    over_constant: float  # mean bound / the constant one that covers as much
    surest: Map  # errors of the 80 % with the smallest bounds


def held(error: NDArray[Any], bound: NDArray[Any], least: float = 1e-6) -> Held:
    """Return how well bounds hold; ``least``: of the errors' median and of the constant bound."""
    covered, median = float(np.mean(error <= bound)), float(np.median(bound))
    constant = max(float(np.quantile(error, covered)), least)
    surest = error[np.argsort(bound, kind="stable")[: round(0.8 * bound.size)]]
    return Held(covered, median, median / max(float(np.median(error)), least), float(bound.mean()) / constant, surest)

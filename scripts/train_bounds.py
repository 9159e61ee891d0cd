#!/usr/bin/env python3
"""Make the tables by which the log odds of disparity maps become bounds of their errors, and check them.

    scripts/train_bounds.py DATA OUT [--samples DIR]

DATA is the folder with the test sets; OUT gets map_errors.csv and map_errors_one_view.csv. Maps of the methods are
judged on all tuning and validation scenes; --samples keeps the sampled pixels in a folder, and takes those that are
there. Printed is the coverage of nominal 90 % on each data set, by the table made of the other sets.
"""

import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import NormalDist

import _env  # first: continues in the checkout's environment
import numpy as np
from _experiments import generated_scenes, kept, matcher, real_scenes, show
from numpy.typing import NDArray
from train_choice import Loaded, generated

from depthcli.algorithms.error_table import ErrorTable
from depthcli.core.maps import Status
from depthcli.core.result import Clock
from depthcli.io.stereo_pairs import load_pair, true_disparity
from depthcli.methods.given_maps import FILLED_DOUBT, judged_maps, odds_of, odds_within
from depthcli.methods.given_maps._planes import ONE_VIEW, Evidence
from depthcli.methods.registration.pipeline.search import isotonic
from depthcli.problems.given_maps import networks

TAUGHT = ("fast", "accurate", "opencv-sgbm")
METHODS = (*TAUGHT, "segments")  # the last one only checks the tables
LEVELS = np.array([0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98, 0.99])
BINS = np.array([0, 0.005, 0.01, 0.02, *np.linspace(0.04, 1, 25)])  # shares of the pixels, by their log odds
NEW_DATA = {"worst_share": 0.15, "noise": 0.08}
"""How much worse than the mean new data may be, as :func:`table` has it; noise of truth and rectification, pixels."""
PIXELS = 20_000  # of a map
Map = dict[str, NDArray[np.float64]]


def scenes(data: Path) -> Iterator[tuple[str, str, Loaded]]:
    """Yield data set, name, and pair, range and truth of each scene."""
    for group in ("tuning", "validation"):
        for folder, scene in real_scenes(data, group):
            family = "middlebury_v2" if folder == "middlebury_2001" else folder
            yield family, f"{group}-{folder}-{scene.name}", lambda s=scene: (
                load_pair(s), s.max_disparity or 128, true_disparity(s).disparity, {},
            )  # fmt: skip
        for name, kind, seed, look in generated_scenes(group):
            yield (
                "generated",
                f"{group}-generated-{name}_{kind}_{seed}",
                lambda a=(kind, seed), b=look: generated(*a, **b),
            )


def sampled(method: str, name: str, loaded: Loaded) -> Map:
    """Return errors, log odds of an error up to 1 pixel, and what was filled, at some pixels of a method's map."""
    pair, largest, truth, _ = loaded
    found = matcher(method)(pair, largest).disparity
    judged = judged_maps(Evidence.of(pair, largest, Clock()), [found.values])[0]
    shape = np.stack([judged.plane(plane) for plane in ONE_VIEW])
    planes = {"right": odds_of(networks(), judged, 1.0), "error": np.abs(judged.values - truth)}
    planes["filled"] = (found.status & Status.FILLED) > 0
    planes["one_view"] = odds_within(networks().one_view, 1.0, shape, shape[:0])
    known = np.flatnonzero((np.isfinite(truth) & (truth > 0) & ~judged.missing).ravel())
    pixels = np.random.default_rng(zlib.crc32(name.encode())).choice(known, min(known.size, PIXELS), replace=False)
    return {plane: values.ravel()[pixels] for plane, values in planes.items()}


def quantiles(
    values: NDArray[np.float64], weights: NDArray[np.float64], at: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return weighted quantiles."""
    order = np.argsort(values)
    below = np.cumsum(weights[order]) - weights[order] / 2
    return np.interp(at, below / weights.sum(), values[order])


def table(
    maps: Sequence[tuple[str, Map]],
    odds: str,
    shares: NDArray[np.float64] = BINS,
    min_samples: int = 200,
    worst_share: float = 0.25,
    noise: float = 0.0,
) -> ErrorTable:
    """Return the table of data sets and their maps; data sets weigh the same, and so do maps without a ``weight``.

    Parameters
    ----------
    shares : of the samples below the edges of the bins
    min_samples : of a data set in a bin, so that it counts there
    worst_share : how far entries lie from the mean over data sets toward the worst one
    noise : standard deviation of an offset that errors of new data may have, too
    """
    key, error = (np.concatenate([one[name] for _, one in maps]) for name in (odds, "error"))
    weight = np.concatenate([np.full(one["error"].size, one.get("weight", 1) / one["error"].size) for _, one in maps])
    of = np.repeat([family for family, _ in maps], [one["error"].size for _, one in maps])
    edges = quantiles(key, weight, shares)
    bins = np.searchsorted(edges[1:-1], key, side="right")
    rows = np.full((len(set(of)), len(shares) - 1, len(LEVELS)), np.nan)
    for k, family in enumerate(sorted(set(of))):
        for row in range(rows.shape[1]):
            inside = (of == family) & (bins == row)
            if inside.sum() >= min_samples:
                rows[k, row] = quantiles(np.log2(np.maximum(error[inside], 1 / 64)), weight[inside], LEVELS)
    enough = ~np.isnan(rows[:, :, 0]).all(axis=0)
    rows, filled = rows[:, enough], np.bincount(bins, weight, rows.shape[1])[enough]
    mean = np.nanmean(rows, axis=0)
    mixed = mean + worst_share * (np.nanmax(rows, axis=0) - mean)
    if noise:
        least = noise * np.array([NormalDist().inv_cdf((1 + level) / 2) for level in LEVELS])
        mixed = np.log2(np.hypot(np.exp2(mixed), least))
    log2 = np.maximum.accumulate(np.stack([-isotonic(-column, filled) for column in mixed.T], axis=1), axis=1)
    centers = np.bincount(bins, weight * key, enough.size)[enough] / filled
    # Beyond the ends it goes on a little, so that the order of the pixels stays.
    ends = [log2[:1] + 0.5, log2, log2[-1:] - 0.5]
    return ErrorTable(np.array([centers[0] - 10, *centers, centers[-1] + 10]), LEVELS, np.concatenate(ends))


def write(path: Path, made: ErrorTable, what: str = "log odds", unit: str = "pixels") -> None:
    rows = np.vstack([np.append(0, made.levels), np.column_stack([made.log_odds, made.log2_errors])])
    np.savetxt(path, rows, "%.4g", ",", header=f"{what}, then log2 of the errors' quantiles, {unit}; first row: levels")


def main() -> None:
    options = _env.options(__doc__, "data", "out", samples=None)
    maps: list[tuple[str, str, bool, Map]] = []
    for family, name, load in scenes(options.data):
        for method in METHODS:
            found = kept(options.samples, f"{name}__{method}", lambda m=method, n=name, of=load: sampled(m, n, of()))
            maps.append((family, method, not name.startswith("tuning") or family == "middlebury_v2", found))
    options.out.mkdir(parents=True, exist_ok=True)
    for odds, name in (("right", "map_errors"), ("one_view", "map_errors_one_view")):
        taught = [(family, one) for family, method, _, one in maps if method in TAUGHT]
        write(options.out / f"{name}.csv", table(taught, odds, **NEW_DATA))
        rows = []
        for left_out in sorted({family for family, *_ in maps}):
            others = table([(family, one) for family, one in taught if family != left_out], odds, **NEW_DATA)
            for method in METHODS:
                judged = [one for family, m, checked, one in maps if checked and (family, m) == (left_out, method)]
                doubt = FILLED_DOUBT if odds == "right" else 0
                bounds = [others.bound(one[odds] - doubt * one["filled"], 0.9) for one in judged]
                inside = [np.mean(one["error"] <= b) for one, b in zip(judged, bounds, strict=True)]
                filled = [np.mean((one["error"] <= b)[one["filled"]]) for one, b in zip(judged, bounds, strict=True)
                          if one["filled"].any()]  # fmt: skip
                surest = [np.argsort(b, kind="stable")[: round(0.8 * b.size)] for b in bounds]
                bad = [np.mean(one["error"][i] > 2) for one, i in zip(judged, surest, strict=True)]
                figures = np.mean(inside), min(inside), np.mean(filled), np.mean(bad)
                width = np.mean([np.median(b) for b in bounds])
                rows.append([left_out, method, *(f"{100 * x:.1f}" for x in figures), f"{width:.2f}"])
        header = [
            "left out",
            "method",
            "covered %",
            "worst map %",
            "filled %",
            "bad 2 of the surest 80 %",
            "median bound, px",
        ]
        show(f"Coverage of nominal 90 %: {name}", header, rows)


if __name__ == "__main__":
    main()

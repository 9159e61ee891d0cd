#!/usr/bin/env python3
"""Make the tables by which the log odds of disparity maps become bounds of their errors, and check them.

    scripts/train_bounds.py DATA OUT [--samples DIR]

DATA is the folder with the test sets; OUT gets map_errors.csv, for maps of depthcli, and map_errors_given.csv and
map_errors_one_view.csv, for maps of any program. Maps of the methods are judged on all tuning and validation scenes, as
they are and as other programs make them (``KINDS``); --samples keeps the sampled pixels in a folder, and takes those
that are there. Printed is the coverage of nominal 90 % on each data set, by the table made of the other sets: of maps
of depthcli, whose filled values are known, and of given maps.
"""

import zlib
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import _env  # first: continues in the checkout's environment
import cv2
import numpy as np
from _experiments import generated_scenes, kept, matcher, mean_known, real_scenes, show
from _training import Arrays, Map, held, some_pixels, table, write
from train_choice import Loaded, generated

from depthcli.algorithms.error_table import ErrorTable
from depthcli.core.context import Clock
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.io.stereo_pairs import load_pair, true_disparity
from depthcli.methods.given_maps import FILLED_DOUBT, judged_maps, odds_of, odds_within, rounded, without_gaps
from depthcli.methods.given_maps._planes import ONE_VIEW, Evidence
from depthcli.problems.given_maps import networks

TAUGHT = ("fast", "accurate", "opencv-sgbm")
METHODS = (*TAUGHT, "segments")  # the last one only checks the tables
AS_IT_IS, ROUNDED = "as it is", "rounded"
KINDS = {AS_IT_IS: METHODS, "half size": ("fast", "opencv-sgbm"), "smoothed": ("fast",), ROUNDED: ("fast",)}
"""Kind of maps -> methods. Rounded maps only check the tables, to which given_maps.rounded adds what rounding adds."""
WEIGHTS = {AS_IT_IS: 1.0, "half size": 2.0, "smoothed": 1.0}
"""Weights of maps among those that teach the tables of given maps."""
TABLES = {"map_errors": ("right", 0.15), "map_errors_given": ("right", 0.3), "map_errors_one_view": ("one_view", 0.15)}
"""Tables -> log odds, and how much worse than the mean new data may be, as :func:`table` has it."""
NOISE = 0.08  # of truth and rectification, pixels
PIXELS = 20_000  # of a map


def scenes(data: Path) -> Iterator[tuple[str, str, Callable[[], Loaded]]]:
    """Yield data set, name, and what loads pair, range and truth of each scene."""
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


class Matched:
    """A scene, its evidence and its maps, each computed when it is first asked for."""

    def __init__(self, name: str, load: Callable[[], Loaded]):
        self.name, self.load = name, load
        self.maps: dict[str, DisparityMap] = {}

    @cached_property
    def loaded(self) -> Loaded:
        return self.load()

    @cached_property
    def evidence(self) -> Evidence:
        return Evidence.of(*self.loaded[:2], Clock())

    def map(self, method: str) -> DisparityMap:
        """Return a method's map."""
        if method not in self.maps:
            self.maps[method] = matcher(method)(*self.loaded[:2]).disparity
        return self.maps[method]

    def values(self, method: str, kind: str) -> Map:
        """Return a method's map, (H, W) float32, as it is or as other programs store it."""
        pair, largest, *_ = self.loaded
        height, width = pair.shape
        if kind == "half size":  # computed at half the size, enlarged
            size, half = (width // 2, height // 2), -(-largest // 2)
            small = StereoPair(*(cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in pair.color8))
            found = without_gaps(matcher(method)(small, half).disparity.values, half)[0]
            return np.asarray(cv2.resize(found * np.float32(2), (width, height), interpolation=cv2.INTER_LINEAR))
        values = self.map(method).values
        if kind == "smoothed":
            return np.asarray(cv2.GaussianBlur(without_gaps(values, largest)[0], (0, 0), 2))
        return np.rint(values) if kind == ROUNDED else values

    def sampled(self, method: str, kind: str) -> Arrays:
        """Return errors, log odds of an error up to 1 pixel, and what was filled, at some pixels of a method's map."""
        judged, truth = judged_maps(self.evidence, [self.values(method, kind)])[0], self.loaded[2]
        shape = np.stack([judged.plane(plane) for plane in ONE_VIEW])
        planes = {"right": odds_of(networks(), judged, 1.0), "error": np.abs(judged.values - truth)}
        planes["filled"] = (self.map(method).status & Status.FILLED) > 0 if kind == AS_IT_IS else judged.missing
        planes["one_view"] = odds_within(networks().one_view, 1.0, shape, shape[:0])
        known = np.isfinite(truth) & (truth > 0) & ~judged.missing
        pixels = some_pixels(np.random.default_rng(zlib.crc32(self.name.encode())), known, PIXELS)
        return {plane: values.ravel()[pixels] for plane, values in planes.items()}


class Sample(NamedTuple):
    """What was found of a method's map."""

    family: str
    method: str
    kind: str
    checked: bool  # no network was trained on the scene, or it is of v2
    found: Arrays


def sampled_maps(data: Path, folder: Path | None) -> Iterator[Sample]:
    """Yield what was found of all maps of all scenes."""
    for family, name, load in scenes(data):
        scene = Matched(name, load)
        checked = not name.startswith("tuning") or family == "middlebury_v2"
        for kind, methods in KINDS.items():
            for method in methods:
                if checked or (method in TAUGHT and kind != ROUNDED):
                    file = f"{name}__{method}__{kind}"
                    found = kept(folder, file, lambda s=scene, m=method, k=kind: s.sampled(m, k))
                    yield Sample(family, method, kind, checked, found)


def main() -> None:
    options = _env.options(__doc__, "data", "out", samples=None)
    maps = list(sampled_maps(options.data, options.samples))
    taught = [one for one in maps if one.method in TAUGHT]
    for name, (odds, worse) in TABLES.items():
        weights = {AS_IT_IS: 1.0} if name == "map_errors" else WEIGHTS

        def made(
            left_out: str = "", weights: dict[str, float] = weights, by: str = odds, e: float = worse
        ) -> ErrorTable:
            teachers = [one for one in taught if one.family != left_out and one.kind in weights]
            weighted = [(one.family, one.found | {"weight": weights[one.kind]}) for one in teachers]
            return table(weighted, by, worst_share=e, noise=NOISE)

        write(options.out / f"{name}.csv", made())
        rows = []
        for left_out in sorted({one.family for one in maps}):
            others = made(left_out)
            checked = [one for one in maps if one.checked and one.family == left_out]
            groups = {
                method: [one for one in checked if (one.method, one.kind) == (method, AS_IT_IS)] for method in METHODS
            }
            if name != "map_errors":
                groups = {kind: [one for one in checked if one.kind == kind and one.method in TAUGHT] for kind in KINDS}
            for label, group in [item for item in groups.items() if item[1]]:
                by = rounded(others, float(label == ROUNDED))
                doubt = FILLED_DOUBT if name == "map_errors" else 0
                judged = [(one.found, by.bound(one.found[odds] - doubt * one.found["filled"], 0.9)) for one in group]
                holds = [held(one["error"], bound) for one, bound in judged]
                inside, bad = [one.covered for one in holds], [np.mean(one.surest > 2) for one in holds]
                filled = [
                    np.mean((one["error"] <= bound)[one["filled"]]) for one, bound in judged if one["filled"].any()
                ]
                shares = np.mean(inside), min(inside), mean_known(filled), np.mean(bad)
                width = np.mean([one.median for one in holds])
                rows.append([left_out, label, str(len(group)), *(f"{100 * x:.1f}" for x in shares), f"{width:.2f}"])
        header = ["left out", "maps", "n", "covered %", "worst map %", "filled %", "bad 2 of the surest 80 %"]
        show(f"Coverage of nominal 90 %: {name}", [*header, "median bound, px"], rows)


if __name__ == "__main__":
    main()

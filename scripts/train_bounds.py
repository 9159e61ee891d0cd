#!/usr/bin/env python3
"""Make the table by which the log odds of disparity maps become bounds of their errors, and check it.

    scripts/train_bounds.py DATA OUT [--samples DIR]

DATA is the folder with the test sets; OUT gets map_errors.csv. Maps of the methods are judged on all tuning and
validation scenes, as they are and as other programs make them (``KINDS``); --samples keeps the sampled pixels in a
folder, and takes those that are there. Printed is what bounds of nominal 90 % cover on each data set, and the
calibration error of probabilities, by the table made of the other sets: of maps of depthcli, whose filled values are
known, of given maps, and of given maps without a right image.
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
from depthcli.evaluation.curves import reliability
from depthcli.io.stereo_pairs import load_pair, true_disparity
from depthcli.methods.given_maps import (
    FILLED_DOUBT,
    GIVEN_DOUBT,
    judged_maps,
    odds_of,
    odds_within,
    rounded,
    without_gaps,
)
from depthcli.methods.given_maps._planes import ONE_VIEW, Evidence
from depthcli.problems.map_checks import networks

TAUGHT = ("fast", "accurate", "opencv-sgbm")
METHODS = (*TAUGHT, "segments")  # the last one only checks the table
AS_IT_IS, ROUNDED = "as it is", "rounded"
KINDS = {AS_IT_IS: METHODS, "half size": ("fast", "opencv-sgbm"), "smoothed": ("fast",), ROUNDED: ("fast",)}
"""Kind of maps -> methods. Only maps as they are teach; given_maps.rounded adds to the table what rounding adds."""
WORST_SHARE = 0.15  # how much worse than the mean new data may be, as :func:`table` has it
NOISE = 0.08  # of truth and rectification, pixels
JUDGED = {
    "maps of depthcli": ("right", FILLED_DOUBT, np.float32(0)),
    "given maps": ("right", np.float32(0), GIVEN_DOUBT),
    "given maps without a right image": ("one_view", np.float32(0), GIVEN_DOUBT),
}
"""How maps are judged -> log odds, and doubts of filled values and of all."""
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
                if checked or (method in TAUGHT and kind == AS_IT_IS):
                    file = f"{name}__{method}__{kind}"
                    found = kept(folder, file, lambda s=scene, m=method, k=kind: s.sampled(m, k))
                    yield Sample(family, method, kind, checked, found)


def main() -> None:
    options = _env.options(__doc__, "data", "out", samples=None)
    maps = list(sampled_maps(options.data, options.samples))
    families = sorted({one.family for one in maps})

    def made(left_out: str = "") -> ErrorTable:
        taught = [one for one in maps if one.method in TAUGHT and one.kind == AS_IT_IS and one.family != left_out]
        return table([(one.family, one.found) for one in taught], "right", worst_share=WORST_SHARE, noise=NOISE)

    write(options.out / "map_errors.csv", made())
    tables = {family: made(family) for family in families}
    for judged, how in JUDGED.items():
        rows = []
        for left_out in families:
            checked = [one for one in maps if one.checked and one.family == left_out]
            groups: dict[str, list[Sample]] = {}
            for one in checked:
                if judged != "maps of depthcli":
                    groups.setdefault(one.kind + ", segments" * (one.method == "segments"), []).append(one)
                elif one.kind == AS_IT_IS:
                    groups.setdefault(one.method, []).append(one)
            for label, group in groups.items():
                by = rounded(tables[left_out], float(label == ROUNDED))
                figures = [measured(one.found, by, *how) for one in group]
                covered, filled, bad, error, width = (mean_known(column) for column in zip(*figures, strict=True))
                shares = (100 * share for share in (covered, min(f[0] for f in figures), filled, bad))
                numbers = [*(f"{share:.1f}" for share in shares), f"{error:.3f}", f"{width:.2f}"]
                rows.append([left_out, label, str(len(group)), *numbers])
        header = ["left out", "maps", "n", "covered %", "worst map %", "filled %", "bad 2 of the surest 80 %"]
        show(f"Nominal 90 %: {judged}", [*header, "calibration error", "median bound, px"], rows)


def measured(one: Arrays, by: ErrorTable, name: str, filled: np.float32, every: np.float32) -> tuple[float, ...]:
    """Return shares covered, of all and of filled values, share bad of the surest, calibration error, median bound."""
    odds, error = one[name] - filled * one["filled"] - every, one["error"]
    bound = by.bound(odds, 0.9)
    holds, right = held(error, bound), reliability(by.unbiased.probability(odds, 1.0), error <= 1)
    of_filled = float(np.mean((error <= bound)[one["filled"]])) if one["filled"].any() else np.nan
    return holds.covered, of_filled, float(np.mean(holds.surest > 2)), right.ece if right else np.nan, holds.median


if __name__ == "__main__":
    main()

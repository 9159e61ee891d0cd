#!/usr/bin/env python3
"""Make the tables by which the log odds of disparity maps become bounds of their errors, and check them.

    scripts/train_bounds.py DATA OUT [--samples DIR]

DATA is the folder with the test sets; OUT gets map_errors.csv and map_errors_one_view.csv. Maps of the methods are
judged on all tuning and validation scenes; --samples keeps the sampled pixels in a folder, and takes those that are
there. Printed is the coverage of nominal 90 % on each data set, by the table made of the other sets.
"""

import zlib
from collections.abc import Iterator
from pathlib import Path

import _env  # first: continues in the checkout's environment
import numpy as np
from _experiments import generated_scenes, kept, matcher, real_scenes, show
from _training import Arrays, held, some_pixels, table, write
from train_choice import Loaded, generated

from depthcli.core.context import Clock
from depthcli.core.maps import Status
from depthcli.io.stereo_pairs import load_pair, true_disparity
from depthcli.methods.given_maps import FILLED_DOUBT, judged_maps, odds_of, odds_within
from depthcli.methods.given_maps._planes import ONE_VIEW, Evidence
from depthcli.problems.given_maps import networks

TAUGHT = ("fast", "accurate", "opencv-sgbm")
METHODS = (*TAUGHT, "segments")  # the last one only checks the tables
NEW_DATA = {"worst_share": 0.15, "noise": 0.08}
"""How much worse than the mean new data may be, as :func:`table` has it; noise of truth and rectification, pixels."""
PIXELS = 20_000  # of a map


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


def sampled(method: str, name: str, loaded: Loaded) -> Arrays:
    """Return errors, log odds of an error up to 1 pixel, and what was filled, at some pixels of a method's map."""
    pair, largest, truth, _ = loaded
    found = matcher(method)(pair, largest).disparity
    judged = judged_maps(Evidence.of(pair, largest, Clock()), [found.values])[0]
    shape = np.stack([judged.plane(plane) for plane in ONE_VIEW])
    planes = {"right": odds_of(networks(), judged, 1.0), "error": np.abs(judged.values - truth)}
    planes["filled"] = (found.status & Status.FILLED) > 0
    planes["one_view"] = odds_within(networks().one_view, 1.0, shape, shape[:0])
    known = np.isfinite(truth) & (truth > 0) & ~judged.missing
    pixels = some_pixels(np.random.default_rng(zlib.crc32(name.encode())), known, PIXELS)
    return {plane: values.ravel()[pixels] for plane, values in planes.items()}


def main() -> None:
    options = _env.options(__doc__, "data", "out", samples=None)
    maps: list[tuple[str, str, bool, Arrays]] = []
    for family, name, load in scenes(options.data):
        for method in METHODS:
            found = kept(options.samples, f"{name}__{method}", lambda m=method, n=name, of=load: sampled(m, n, of()))
            maps.append((family, method, not name.startswith("tuning") or family == "middlebury_v2", found))
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
                holds = [held(one["error"], b) for one, b in zip(judged, bounds, strict=True)]
                inside, bad = [one.covered for one in holds], [np.mean(one.surest > 2) for one in holds]
                filled = [np.mean((one["error"] <= b)[one["filled"]]) for one, b in zip(judged, bounds, strict=True)
                          if one["filled"].any()]  # fmt: skip
                figures = np.mean(inside), min(inside), np.mean(filled), np.mean(bad)
                width = np.mean([one.median for one in holds])
                rows.append([left_out, method, *(f"{100 * x:.1f}" for x in figures), f"{width:.2f}"])
        header = ["left out", "method", "covered %", "worst map %", "filled %", "bad 2 of the surest 80 %"]
        show(f"Coverage of nominal 90 %: {name}", [*header, "median bound, px"], rows)


if __name__ == "__main__":
    main()

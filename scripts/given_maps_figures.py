#!/usr/bin/env python3
"""Measure how good the judgment and the fusion of given maps are: tables for docs/figures.md.

    scripts/given_maps_figures.py DATA [--group tuning|validation] [--maps DIR]

Maps of SGBM (filled), segments, ad-census and stereo fast and accurate of the group's real scenes are judged alone and
with those of fast and accurate as witnesses, and fused; --maps keeps the maps in a folder. Bad: more than 1 px of the
images' size, missing counts as bad; all, and nonocc in brackets. AUC / optimal: of the mean areas of a set.
"""

from collections.abc import Callable
from typing import Any

import _env  # first: continues in the checkout's environment
import cv2
import numpy as np
from _experiments import kept, matcher, mean_known, real_scenes, scenes_in, seconds_in_turns, show
from numpy.typing import NDArray

from depthcli.api.maps import networks
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Status
from depthcli.evaluation import protocols
from depthcli.evaluation.curves import HiddenPixels, reliability, sparsification
from depthcli.io.stereo_pairs import load_pair
from depthcli.methods.given_maps import judge
from depthcli.methods.given_maps.fusion import fuse

METHODS = ("opencv-sgbm", "segments", "ad-census", "fast", "accurate", "opencv-sgbm-wls")
JUDGED = ("opencv-sgbm", "ad-census", "segments")
WITNESSES = ("fast", "accurate")
FUSED = ("opencv-sgbm", "fast", "ad-census", "segments")
LABELS = [label for name in JUDGED for label in (name, f"{name}, witnesses")]
Map = NDArray[np.float32]


def jobs_of(pair: StereoPair, largest: int, maps: dict[str, Map]) -> dict[str, Callable[[], Any]]:
    """Return what is timed; OpenCV's SGBM, the first, is the measure."""
    views = [np.ascontiguousarray(image[..., ::-1]) for image in pair.color8]
    sgbm = cv2.StereoSGBM.create(0, -(-largest // 16) * 16, 5, 8 * 3 * 25, 32 * 3 * 25)
    four, alone = [maps[name] for name in FUSED], [maps["opencv-sgbm"]]
    return {
        "SGBM": lambda: sgbm.compute(*views),
        "confidence": lambda: judge(networks(), pair, alone, largest),
        "fusion of four": lambda: fuse(networks(), pair, four, largest),
        "with surfaces": lambda: fuse(networks(), pair, four, largest, surfaces=True),
        "one map refined": lambda: fuse(networks(), pair, alone, largest),
    }


class Sums:
    """Figures of a set's scenes."""

    def __init__(self) -> None:
        self.areas: dict[str, list[tuple[float, ...]]] = {}  # label -> area and optimal, all; the same, nonocc
        self.ece: dict[str, list[float]] = {}
        self.hidden: dict[str, list[HiddenPixels]] = {}
        self.bad: dict[str, list[tuple[float, float]]] = {}  # label -> percent of all, of visible pixels

    def add(self, pair: StereoPair, largest: int, truth: Any, maps: dict[str, Map]) -> None:
        """Judge and fuse the maps of a scene."""
        known = np.isfinite(truth.values) & (truth.values > 0)
        whole, visible = known & truth.masks.get("all", known), known & truth.masks["nonocc"]
        wrong = {name: ~(np.abs(values - truth.values) <= 1) for name, values in maps.items()}
        for label in LABELS:
            name, _, seen = label.partition(", ")
            others = [maps[other] for other in WITNESSES] if seen else []
            found = judge(networks(), pair, [maps[name], *others], largest)
            lines = [sparsification(found.probability[pixels], wrong[name][pixels]) for pixels in (whole, visible)]
            self.areas.setdefault(label, []).append(tuple(v for line in lines for v in (line.auc, line.optimal)))
            right = reliability(found.probability[whole], ~wrong[name][whole])
            self.ece.setdefault(label, []).append(right.ece if right else float("nan"))
            if not seen:
                said = (found.status & int(Status.OCCLUDED | Status.OUT_OF_RANGE)) != 0
                self.hidden.setdefault(name, []).append(HiddenPixels.of(said[whole], (whole & ~visible)[whole]))
        given = [maps[name] for name in FUSED]
        for name, (values, _) in {
            "fused": fuse(networks(), pair, given, largest),
            "fused, surfaces": fuse(networks(), pair, given, largest, surfaces=True),
            "SGBM refined": fuse(networks(), pair, given[:1], largest),
        }.items():
            wrong[name] = ~(np.abs(values.values - truth.values) <= 1)
        for name, pixels in wrong.items():
            self.bad.setdefault(name, []).append((100 * pixels[whole].mean(), 100 * pixels[visible].mean()))

    def judged(self) -> list[str]:
        """Return the cells of the set in the table of judgments."""
        cells = []
        for label in LABELS:
            area, optimal, visible, visible_optimal = np.mean(self.areas[label], axis=0)
            ratios = f"{area / optimal:.2f} ({visible / visible_optimal:.2f})"
            cells.append(f"{ratios}, {mean_known(self.ece[label]):.3f}")
        return cells + [f"{HiddenPixels.pooled(self.hidden[name]).shares()['F1']:.1f}" for name in JUDGED]

    def fused(self) -> list[str]:
        """Return the cells of the set in the table of fusions."""
        errors = {label: np.mean(found, axis=0) for label, found in self.bad.items()}
        best = min(errors[name][0] for name in FUSED)
        best_of = np.min([[bad for bad, _ in self.bad[name]] for name in FUSED], axis=0)
        both = ("fused", "fused, surfaces")
        labels = (*FUSED, *both, "opencv-sgbm-wls", "SGBM refined")
        worst = [max(np.array([bad for bad, _ in self.bad[label]]) / best_of) for label in both]
        return [
            *(f"{errors[label][0]:.2f} ({errors[label][1]:.2f})" for label in labels),
            ", ".join(f"{100 * (errors[label][0] / best - 1):+.0f} %" for label in both),
            ", ".join(f"{100 * (ratio - 1):+.0f} %" for ratio in worst),
        ]


def main() -> None:
    options = _env.options(__doc__, "data", group="validation", maps=None)
    networks()

    def maps(folder: str, scene: Any, pair: StereoPair) -> dict[str, Map]:
        def make() -> dict[str, Map]:
            return {name: matcher(name)(pair, scene.max_disparity).disparity.values for name in METHODS}

        return kept(options.maps, f"{folder}_{scene.name}", make)

    sums: dict[str, Sums] = {}
    for folder, scene in real_scenes(options.data, options.group):
        if folder != "kitti":
            protocol = protocols.load("middlebury_v3" if folder == "middlebury_v3" else "middlebury_v2")
            pair = load_pair(scene)
            of_set = sums.setdefault(folder, Sums())
            of_set.add(pair, scene.max_disparity, protocol().truth(scene), maps(folder, scene, pair))
    columns = [f"{label}: AUC / optimal all (nonocc), ECE" for label in LABELS]
    header = ["set", *columns, *(f"{name}: F1 hidden" for name in JUDGED)]
    show("Judgments", header, [[folder, *each.judged()] for folder, each in sums.items()])
    header = ["set", *FUSED, "fused", "fused, surfaces", "SGBM + WLS", "SGBM refined", "over the best", "worst scene"]
    show("Fusions", header, [[folder, *each.fused()] for folder, each in sums.items()])
    (scene,) = scenes_in(options.data / "middlebury_v2", "Teddy")
    pair = load_pair(scene)
    jobs = jobs_of(pair, scene.max_disparity, maps("middlebury_v2", scene, pair))
    taken = {name: float(np.median(found)) for name, found in seconds_in_turns(jobs, 7).items()}
    print("time, SGBM = 1: " + ", ".join(f"{name} {seconds / taken['SGBM']:.1f}" for name, seconds in taken.items()))


if __name__ == "__main__":
    main()

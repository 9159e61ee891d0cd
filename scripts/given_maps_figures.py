#!/usr/bin/env python3
"""Measure how good the judgment and the fusion of given maps are: tables for docs/figures.md.

    scripts/given_maps_figures.py DATA [--group tuning|validation] [--maps DIR]

Maps of SGBM (filled), segments, ad-census and stereo fast and accurate of the group's real scenes are judged alone and
with those of fast and accurate as witnesses, and fused; --maps keeps the maps in a folder. Bad: more than 1 px of the
images' size, missing counts as bad; all, and nonocc in brackets. AUC / optimal: of the mean areas of a set.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import _env  # noqa: F401  (first: continues in the checkout's environment)
import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from depthcli.api.maps import fusion_of, judge_of, networks
from depthcli.core.config_file import load_config
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Status
from depthcli.evaluation import protocols
from depthcli.evaluation.curves import HiddenPixels, Reliability, reliability, sparsification
from depthcli.evaluation.statistics import mean_of_known
from depthcli.io.walk import discover_scenes
from depthcli.methods.stereo.config import StereoConfig
from depthcli.run.presets import find_config

GROUPS = Path(__file__).resolve().parent / "stereo_groups.yaml"
METHODS = ("opencv-sgbm", "segments", "ad-census", "fast", "accurate", "opencv-sgbm-wls")
JUDGED = ("opencv-sgbm", "ad-census", "segments")
WITNESSES = ("fast", "accurate")
FUSED = ("opencv-sgbm", "fast", "ad-census", "segments")
Map = NDArray[np.float32]


def scenes(data: Path, group: str) -> Iterator[tuple[str, Any, StereoPair, Any]]:
    """Yield set, scene, pair and truth."""
    for folder, names in yaml.safe_load(GROUPS.read_text())[group].items():
        if folder not in ("generated", "kitti"):
            for scene in discover_scenes(data / folder, patterns=names):
                name = "middlebury_v3" if folder == "middlebury_v3" else "middlebury_v2"
                yield folder, scene, scene.load(), protocols.load(name)().truth(scene)


def maps_of(pair: StereoPair, largest: int, file: Path | None) -> dict[str, Map]:
    if file is not None and file.exists():
        return dict(np.load(file))
    configs = {name: load_config(StereoConfig, find_config("stereo", name)) for name in METHODS}
    maps = {name: config.pipeline(pair, largest).disparity.values for name, config in configs.items()}
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        np.savez(file, **maps)  # type: ignore[arg-type]
    return maps


def times(pair: StereoPair, largest: int, maps: dict[str, Map]) -> dict[str, float]:
    """Return the times of judging and fusing over that of OpenCV's SGBM: medians of seven, in turns."""
    views = [np.ascontiguousarray(image[..., ::-1]) for image in pair.color8]
    sgbm = cv2.StereoSGBM.create(0, -(-largest // 16) * 16, 5, 8 * 3 * 25, 32 * 3 * 25)
    four, alone = [maps[name] for name in FUSED], [maps["opencv-sgbm"]]
    jobs = {
        "SGBM": lambda: sgbm.compute(*views),
        "confidence": lambda: judge_of()(pair, alone, largest),
        "fusion of four": lambda: fusion_of()(pair, four, largest),
        "with surfaces": lambda: fusion_of(surfaces=True)(pair, four, largest),
        "one map refined": lambda: fusion_of()(pair, alone, largest),
    }
    taken: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(8):
        for name, job in jobs.items():
            begun = time.perf_counter()
            job()
            taken[name].append(time.perf_counter() - begun)
    medians = {name: float(np.median(found[1:])) for name, found in taken.items()}
    return {name: seconds / medians["SGBM"] for name, seconds in medians.items()}


class Sums:
    """Figures of a set's scenes."""

    def __init__(self) -> None:
        self.areas: dict[str, list[tuple[float, float]]] = {}
        self.reliable: dict[str, list[Reliability]] = {}
        self.hidden: dict[str, list[HiddenPixels]] = {}
        self.bad: dict[str, list[tuple[float, float]]] = {}

    def add(self, pair: StereoPair, largest: int, truth: Any, maps: dict[str, Map]) -> None:
        """Judge and fuse the maps of a scene."""
        known = np.isfinite(truth.disparity) & (truth.disparity > 0)
        whole, visible = known & truth.masks.get("all", known), known & truth.masks["nonocc"]
        wrong = {name: ~(np.abs(values - truth.disparity) <= 1) for name, values in maps.items()}
        for name in JUDGED:
            for label, others in ((name, ()), (f"{name}, witnesses", WITNESSES)):
                found = judge_of()(pair, [maps[name], *(maps[other] for other in others)], largest)
                for region, pixels in (("all", whole), ("nonocc", visible)):
                    line = sparsification(found.probability[pixels], wrong[name][pixels])
                    self.areas.setdefault(f"{label} {region}", []).append((line.auc, line.optimal))
                right = reliability(found.probability[whole], ~wrong[name][whole])
                assert right is not None
                self.reliable.setdefault(label, []).append(right)
                if not others:
                    said = (found.status & int(Status.OCCLUDED | Status.OUT_OF_RANGE)) != 0
                    self.hidden.setdefault(name, []).append(HiddenPixels.of(said[whole], (whole & ~visible)[whole]))
        given = [maps[name] for name in FUSED]
        fused = {
            "fused": fusion_of()(pair, given, largest),
            "fused, surfaces": fusion_of(surfaces=True)(pair, given, largest),
            "SGBM refined": fusion_of()(pair, given[:1], largest),
        }
        for name, (values, _) in fused.items():
            wrong[name] = ~(np.abs(values.values - truth.disparity) <= 1)
        for name, pixels in wrong.items():
            self.bad.setdefault(name, []).append((100 * pixels[whole].mean(), 100 * pixels[visible].mean()))

    def rows(self, name: str) -> tuple[str, str]:
        """Return the row of the set in the table of judgments and in that of fusions."""
        cells = []
        for label in (each for method in JUDGED for each in (method, f"{method}, witnesses")):
            ratios = []
            for region in ("all", "nonocc"):
                area, optimal = np.mean(self.areas[f"{label} {region}"], axis=0)
                ratios.append(area / optimal)
            ece = mean_of_known(one.ece for one in self.reliable[label])
            cells.append(f"{ratios[0]:.2f} ({ratios[1]:.2f}), {ece:.3f}")
        cells += [f"{HiddenPixels.pooled(self.hidden[method]).shares()['F1']:.1f}" for method in JUDGED]
        errors = {label: np.mean(found, axis=0) for label, found in self.bad.items()}
        best = min(errors[method][0] for method in FUSED)
        best_of = np.min([[bad for bad, _ in self.bad[method]] for method in FUSED], axis=0)
        labels = (*FUSED, "fused", "fused, surfaces", "opencv-sgbm-wls", "SGBM refined")
        shown = [f"{errors[label][0]:.2f} ({errors[label][1]:.2f})" for label in labels]
        both = ("fused", "fused, surfaces")
        worst = [max(np.array([bad for bad, _ in self.bad[label]]) / best_of) for label in both]
        shown.append(", ".join(f"{100 * (errors[label][0] / best - 1):+.0f} %" for label in both))
        shown.append(", ".join(f"{100 * (ratio - 1):+.0f} %" for ratio in worst))
        return f"| {name} | " + " | ".join(cells) + " |", f"| {name} | " + " | ".join(shown) + " |"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--group", choices=("tuning", "validation"), default="validation")
    parser.add_argument("--maps", type=Path)
    options = parser.parse_args()
    networks()
    sums: dict[str, Sums] = {}
    for folder, scene, pair, truth in scenes(options.data, options.group):
        file = None if options.maps is None else options.maps / f"{folder}_{scene.name}.npz"
        maps = maps_of(pair, scene.max_disparity, file)
        sums.setdefault(folder, Sums()).add(pair, scene.max_disparity, truth, maps)
        print(f"{folder} {scene.name}", file=sys.stderr)
    both = [name for method in JUDGED for name in (method, f"{method}, witnesses")]
    judged, fused = zip(*(each.rows(folder) for folder, each in sums.items()), strict=True)
    header = [
        "set",
        *(f"{name}: AUC / optimal all (nonocc), ECE" for name in both),
        *(f"{m}: F1 hidden" for m in JUDGED),
    ]
    print("\n".join(["| " + " | ".join(header) + " |", "| --- " * len(header) + "|", *judged, ""]))
    header = ["set", *FUSED, "fused", "fused, surfaces", "SGBM + WLS", "SGBM refined", "over the best", "worst scene"]
    print("\n".join(["| " + " | ".join(header) + " |", "| --- " * len(header) + "|", *fused, ""]))
    (scene,) = discover_scenes(options.data / "middlebury_v2", patterns=["Teddy"])
    pair = scene.load()
    file = None if options.maps is None else options.maps / "middlebury_v2_Teddy.npz"
    ratios = times(pair, scene.max_disparity, maps_of(pair, scene.max_disparity, file))
    print("time, SGBM = 1: " + ", ".join(f"{name} {ratio:.1f}" for name, ratio in ratios.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Chapter 6 of the thesis: fusion of similarity measures by confidence and consensus."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from _experiments import (
    Experiment,
    Rows,
    bad,
    config_of,
    matcher,
    middlebury_scenes,
    milliseconds,
    on_new_pair,
    scenes_in,
)
from _thesis_depth import infrared, infrared_pairs
from _thesis_stereo import errors

from depthcli.core.frames import StereoPair
from depthcli.evaluation.curves import sparsification
from depthcli.evaluation.protocols import headlines, load
from depthcli.io.stereo_pairs import load_pair
from depthcli.kernels.winners import winners
from depthcli.methods.confidence import confidence_maps, measures
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.transparent.cross_modal import GREY, mix_channels

MEASURES = {"AD": "absolute_difference", "gradient": "gradient", "rank": "rank", "census": "census"}
WINDOWS = (3, 7, 11, 15, 21, 31, 41)
BASES = {"CW": "ch6-cw", "CROSS": "ch6-cross", "AW": "ch6-aw", "global": "ch6-scanline"}
FUSIONS: dict[str, tuple[str, ...]] = {
    **{name: ("thesis/ch6-equal", f"measures=[{measure}]") for name, measure in MEASURES.items()},
    "equal": ("thesis/ch6-equal",),
    "all": ("thesis/ch6-all",),
    "confidence alone": ("thesis/ch6-all", "weights=confidence"),
    "consensus alone": ("thesis/ch6-all", "vote_confidence=null"),
    **{f"window {w}": ("thesis/ch6-consensus-window", f"consensus.window={w}") for w in WINDOWS},
    **{f"AD + {name}, {way}": (f"thesis/{preset}", f"measures=[absolute_difference, {name}]")
       for name in ("gradient", "rank", "census")
       for way, preset in (("equal", "ch6-equal"), ("fused", "ch6-ad-census"))},
    **{f"{base}, {way}": (f"thesis/{preset}", *settings) for base, preset in BASES.items() for way, settings in (
        ("census", ("weights=equal", "measures=[census]")), ("equal", ("weights=equal",)), ("fused", ()))},
    "ours": ("consensus",),
    "accurate": ("accurate",),
}  # fmt: skip
OTHER = {
    "kitti": {"census": ("thesis/ch6-kitti", "weights=equal", "measures=[census]"),
              "equal": ("thesis/ch6-kitti", "weights=equal"), "fused": ("thesis/ch6-kitti",),
              "accurate": ("accurate",)},
    "infrared": {**{name: FUSIONS[name] for name in ("AD", "census", "equal")}, "fused": ("thesis/ch6-cross-modal",)},
}  # fmt: skip


@cache
def fusion(preset: str, *settings: str) -> Any:
    """Return a preset of fuse with settings, ready to be called."""
    return matcher(f"fuse/{preset}", *settings)


def scenes(data: Path) -> Iterator[tuple[str, Any]]:
    """Yield the scenes of Middlebury 2001 to 2006."""
    yield from ((f"{scene.folder.parent.name[11:]} {scene.name}", scene) for scene in middlebury_scenes(data))


def fusions(scene: Any) -> Rows:
    """Return bad > 1 px, nonocc, %, of every way to fuse."""
    return {name: {"nonocc": errors(fusion(*words), scene)["nonocc"]} for name, words in FUSIONS.items()}


def streets(scene: Any) -> Rows:
    """Return D1 of the visible pixels where they are known apart, else of all, %."""
    pair, judge, rows = load_pair(scene), load("kitti_2015")(), {}
    for name, words in OTHER["kitti"].items():
        found = headlines(judge, fusion(*words)(pair, scene.max_disparity).disparity.values, judge.truth(scene))
        rows[name] = {"D1": found.get("noc", found.get("occ", float("nan")))}
    return rows


def between_sensors(files: Any) -> Rows:
    """Return bad > 1 px, nonocc, %, of a grey left view and an infrared right one."""
    scene, visible = infrared(files)
    pair, rows = StereoPair(mix_channels(scene.color, GREY), scene.infrared), {}
    for name, words in OTHER["infrared"].items():
        found = fusion(*words)(pair, files.max_disparity).disparity.values
        rows[name] = {"nonocc": bad(found, scene.disparity, visible)}
    return rows


def confidences(scene: Any) -> Rows:
    """Return the area under the sparsification curve of every confidence, by measure, all known pixels."""
    pair, truth, rows = load_pair(scene), load("middlebury_v2")().truth(scene).values, Rows()
    known = ~np.isnan(truth)
    for column, measure in MEASURES.items():
        cost = config_of("fuse", "thesis/ch6-equal", f"measures=[{measure}]").measures[0].cost
        costs = ConstantWindow(window=11)(cost(pair, scene.max_disparity + 1), pair).costs
        wrong = ~(np.abs(winners(costs)[0] - truth) <= 1)[known]
        for name, confidence in confidence_maps(costs, measures()).items():
            curve = sparsification(np.ascontiguousarray(confidence[known]), wrong)
            rows.setdefault(name, {})[column] = curve.auc
        rows.setdefault("optimal", {})[column] = curve.optimal
        rows.setdefault("random", {})[column] = curve.mean
    return rows


def times(scene: Any) -> Rows:
    """Return milliseconds of fusions and of their parts, in turn with OpenCV's SGBM."""
    runs = {name: fusion(*FUSIONS[name]) for name in ("census", "equal", "all")} | {"SGBM": matcher("opencv-sgbm")}
    return milliseconds({name: on_new_pair(run, scene) for name, run in runs.items()}, 15)


def two(data: Path) -> Iterator[tuple[str, Any]]:
    """Yield Teddy and Cones."""
    yield from ((scene.name, scene) for scene in scenes_in(data / "middlebury_v2", "Teddy", "Cones"))


def names(m: Any) -> dict[str, Any]:
    """Return what the templates of chapter 6 ask for."""

    def area(row: str) -> float:
        return sum(m.mean("confidences", row, column) for column in MEASURES)

    def gains(one: str, other: str) -> tuple[bool, bool]:  # on average, and on seven of ten scenes
        lower = [rows[one]["nonocc"] < rows[other]["nonocc"] for rows in m["fusions"].values()]
        return m.mean("fusions", one, "nonocc") < m.mean("fusions", other, "nonocc"), sum(lower) >= 0.7 * len(lower)

    return {
        "best_confidences": lambda: sorted(set(m.rows("confidences")) - {"optimal", "random"}, key=area)[:6],
        "fused": lambda bases: [gain for base in bases for gain in gains(f"{base}, fused", f"{base}, equal")],
    }


EXPERIMENTS = {
    "confidences": Experiment("6", two, confidences, 1),
    "fusions": Experiment("6", scenes, fusions, 1),
    "kitti": Experiment("6", lambda data: ((s.name, s) for s in scenes_in(data / "kitti")), streets),
    "fusion-infrared": Experiment("6", infrared_pairs, between_sensors, 1),
    "fusion-times": Experiment("6", lambda data: list(two(data))[-1:], times),
}

"""Chapters 2 and 3 of the thesis: stereo by segments, and local matching with its times."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
from _experiments import THESIS, Experiment, Rows, matcher, scenes_in
from _thesis_times import figure_3_2, frames, local
from PIL import Image

from depthcli.core.frames import StereoPair
from depthcli.evaluation.plots import Line, line_plot
from depthcli.evaluation.protocols import headlines, picture
from depthcli.evaluation.protocols.middlebury_v2 import MiddleburyV2Protocol
from depthcli.evaluation.statistics import average_ranks
from depthcli.io.stereo_pairs import load_pair
from depthcli.simulate.stereo_scenes import make_scene

SCENES = ("Tsukuba", "Venus", "Teddy", "Cones")
MASKS = ("nonocc", "all", "disc")
CH2 = {"baseline": "thesis/ch2-baseline", "KP": "thesis/ch2-kp", "DEDC": "thesis/ch2-dedc",
       "DEDC and KP": "thesis/ch2-kp-dedc"}  # fmt: skip
PICTURED = ("thesis/ch2-kp-dedc", "thesis/ch3-ad-census-cross")
OURS = ("segments", "fast", "accurate", "fuse/accurate")
COSTS = ("ad", "ad-gradient", "ad-rank", "ad-census")
WAYS = ("cw", "cross", "aw")
WINDOWS = tuple(range(3, 34, 2))


def of_v2(data: Path) -> Iterator[tuple[str, Any]]:
    """Yield the four scenes of Middlebury v2, the smallest first."""
    found = {scene.name: scene for scene in scenes_in(data / "middlebury_v2")}
    yield from ((name, found[name]) for name in SCENES if name in found)


def errors(run: Callable[[Any, int], Any], scene: Any) -> dict[str, float]:
    """Return bad > 1 px by region, %, missing counts as bad."""
    judge = MiddleburyV2Protocol()
    found = run(load_pair(scene), scene.max_disparity).disparity.values
    return {mask: rate for mask, rate in headlines(judge, found, judge.truth(scene)).items() if mask in MASKS}


def repetitive(_: Path) -> Iterator[tuple[str, Any]]:
    """Yield generated scenes with repetitive patterns."""
    yield from ((f"repetitive_{seed}", make_scene("repetitive", seed)) for seed in range(100, 104))


def repetition(made: Any) -> Rows:
    """Return bad > 1 px of the visible pixels, %, by preset."""
    rows = {}
    for name in (*CH2.values(), *OURS):
        found = matcher(name)(StereoPair(made.left, made.right), made.max_disparity).disparity.values
        rows[name] = {"nonocc": 100 * float(np.mean(~(np.abs(found - made.disparity_left) <= 1)[made.nonocc]))}
    return rows


def figure_3_3(scene: Any) -> Rows:
    """Return the errors of costs x aggregations, columns: region and window; and which cost is the first and last."""
    rows: Rows = {cost: {"first": 0, "last": 0} for cost in COSTS}
    for way in WAYS:
        fewest = {}
        for cost in COSTS:
            cells = {f"{mask} {w}": rate for w in (WINDOWS if way != "cross" else (0,))
                     for mask, rate in errors(local(cost, way, w), scene).items()}  # fmt: skip
            fewest[cost] = min(rate for column, rate in cells.items() if column.startswith("all"))
            rows[f"{cost} {way}"] = cells
        rows[min(fewest, key=fewest.__getitem__)]["first"] += 1
        rows[max(fewest, key=fewest.__getitem__)]["last"] += 1
    return rows


def figure(m: Any) -> str:
    """Draw figure 3.3."""
    lines = [Line(f"{cost} {way}", WINDOWS, [m.mean("fig-3.3", f"{cost} {way}", f"all {w if way != 'cross' else 0}")
             for w in WINDOWS]) for cost in COSTS for way in WAYS]  # fmt: skip
    return line_plot(lines, "Figure 3.3: winner takes all", "window side, px", "bad > 1 px, all, %")


def pictures(data: Path) -> Any:
    """Return the scenes of v2 as in figures 2.3 and 3.4: left image, truth, maps of both chapters and their errors."""
    rows = []
    for _, scene in of_v2(data):
        pair, judge = load_pair(scene), MiddleburyV2Protocol()
        truth = judge.truth(scene)
        maps = [matcher(name)(pair, scene.max_disparity).disparity.values for name in PICTURED]
        top = np.nanmax(truth.values)
        shown = [
            (255 * matplotlib.colormaps["gray"](each / top)[..., :3]).astype(np.uint8) for each in (truth.values, *maps)
        ]
        wrong = [picture(judge, each, truth) for each in maps]
        panels = (pair.color8[0], shown[0], shown[1], wrong[0], shown[2], wrong[1])
        rows.append(np.hstack([cv2.resize(each, (160, 128), interpolation=cv2.INTER_AREA) for each in panels]))
    return Image.fromarray(np.vstack(rows)).quantize(64) if rows else None


def names(m: Any) -> dict[str, Any]:
    """Return what the templates of chapters 2 and 3 ask for."""

    def of_12(name: str) -> list[float]:
        return [m.mean("v2", name, mask, scene) for scene in SCENES for mask in MASKS]

    def table_2_2() -> Iterator[tuple[str, list[float], float]]:
        rows = {"here, `thesis/ch2-kp-dedc`": of_12(CH2["DEDC and KP"]), **THESIS["table 2.2"]}
        rows |= {f"ours, `{name.replace('/', ' ')}`": of_12(name) for name in ("segments", "accurate", "fuse/accurate")}
        ranks = average_ranks(np.array(list(rows.values())))
        yield from ((name, list(row), rank) for (name, row), rank in zip(rows.items(), ranks, strict=True))

    def best(cost: str, way: str) -> str:
        return m.lowest("fig-3.3", f"{cost} {way}", "all ")

    return {
        "ch2": CH2 | {"ours": "segments", "ours, a fusion": "fuse/accurate"}, "of_12": of_12, "table_2_2": table_2_2,
        "costs": COSTS, "ways": WAYS, "machine": "a processor of two cores, which is no GPU",
        "windows": lambda way: [int(best(cost, way)[4:]) for cost in COSTS],
        "fewest": lambda: {f"{c} {w}": m.mean("fig-3.3", f"{c} {w}", best(c, w)) for c in COSTS for w in WAYS},
    }  # fmt: skip


EXPERIMENTS = {
    "v2": Experiment(
        "2", of_v2, lambda scene: {name: errors(matcher(name), scene) for name in (*CH2.values(), *OURS)}, 2
    ),
    "repetition": Experiment("2", repetitive, repetition, 1),
    "fig-3.3": Experiment("3", of_v2, figure_3_3, 1),
    "fig-3.2": Experiment("3", lambda data: list(of_v2(data))[2:3], figure_3_2),
    "frames": Experiment("3", lambda data: list(of_v2(data))[:3:2], frames),
}

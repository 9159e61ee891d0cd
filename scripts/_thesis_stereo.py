"""Chapters 2 and 3 of the thesis: stereo by segments, and local matching with its times."""

import io
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
from _experiments import THESIS, Experiment, Rows, bad, matcher, scenes_in
from _thesis_times import cross_times, figure_3_2, frames, local
from matplotlib.figure import Figure
from PIL import Image, ImageDraw, ImageFont

from depthcli.core.frames import StereoPair
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
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")  # of the costs
PANEL = (160, 128)  # width and height of a picture in figures 2.3 and 3.4


def of_v2(data: Path) -> Iterator[tuple[str, Any]]:
    """Yield the four scenes of Middlebury v2, the smallest first."""
    found = {scene.name: scene for scene in scenes_in(data / "middlebury_v2")}
    yield from ((name, found[name]) for name in SCENES if name in found)


def errors(run: Callable[[Any, int], Any], scene: Any) -> dict[str, float]:
    """Return bad > 1 px by region, %, missing counts as bad."""
    judge = MiddleburyV2Protocol()
    found = run(load_pair(scene), scene.max_disparity).disparity.values
    return {mask: rate for mask, rate in headlines(judge, found, judge.truth(scene)).items() if mask in MASKS}


def chapter_2(scene: Any) -> Rows:
    """Return the errors of the presets, and of those of chapter 2 with values that were searched on other scenes."""
    rows = {name: errors(matcher(name), scene) for name in (*CH2.values(), *OURS)}
    for name in CH2.values():
        points = [THESIS["key points searched elsewhere"]] if "kp" in name else []
        rows[f"{name}, elsewhere"] = errors(matcher(name, *THESIS["searched elsewhere"], *points), scene)
    return rows


def repetitive(_: Path) -> Iterator[tuple[str, Any]]:
    """Yield generated scenes with repetitive patterns."""
    yield from ((f"repetitive_{seed}", make_scene("repetitive", seed)) for seed in range(100, 104))


def repetition(made: Any) -> Rows:
    """Return bad > 1 px of the visible pixels, %, by preset."""
    rows = {}
    for name in (*CH2.values(), *OURS):
        found = matcher(name)(StereoPair(made.left, made.right), made.max_disparity).disparity.values
        rows[name] = {"nonocc": bad(found, made.disparity_left, made.nonocc)}
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
    """Draw figure 3.3 as SVG: a panel for each aggregation; of cross, whose windows are its own, points."""
    style: dict[str, Any] = {"svg.fonttype": "none", "svg.hashsalt": "depthcli", "font.size": 9}
    style |= {"axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.color": "#e4e4e4"}
    out = io.StringIO()
    with matplotlib.rc_context(style):
        drawn = Figure(figsize=(9, 3.2), layout="constrained")
        panels = dict(zip(WAYS, drawn.subplots(1, 3, sharey=True, width_ratios=(4, 3, 4)), strict=True))
        for way, axis in panels.items():
            axis.set_title({"cw": "constant window (CW)", "aw": "adaptive weights (AW)"}.get(way, "CROSS"), fontsize=10)
            axis.set_xlabel("its own window" if way == "cross" else "window side, px")
            for k, (cost, color, marker) in enumerate(zip(COSTS, COLORS, "osD^", strict=True)):
                windows = (0,) if way == "cross" else WINDOWS
                rates = [m.mean("fig-3.3", f"{cost} {way}", f"all {w}") for w in windows]
                places = (k,) if way == "cross" else windows
                axis.plot(places, rates, color=color, marker=marker, ms=4, lw=1.4, label=cost.upper())
                if way == "cross":
                    axis.annotate(f"{rates[0]:.1f}", (k, rates[0]), (0, 6), textcoords="offset points", ha="center")
        panels["cross"].set_xticks(range(len(COSTS)), [cost.upper().replace("-", "-\n") for cost in COSTS], fontsize=8)
        panels["cross"].set_xlim(-0.6, len(COSTS) - 0.4)
        panels["cw"].set(ylabel="bad > 1 px, all, %", ylim=(0, None))
        panels["aw"].legend(frameon=False)
        drawn.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    # Names by number: matplotlib's are digests of positions, whose last digits differ between machines.
    ids = dict.fromkeys(re.findall(r'id="([mp][0-9a-f]{10})"', out.getvalue()))
    names = {name: f"{name[0]}{number}" for number, name in enumerate(ids)}
    return re.sub(r"\b[mp][0-9a-f]{10}\b", lambda found: names[found[0]], out.getvalue())


def indexed(image: Any) -> Any:
    """Return (H, W, 3) levels of at most 256 colors as an image with a palette, without loss."""
    colors, index = np.unique(image.reshape(-1, 3), axis=0, return_inverse=True)
    found = Image.fromarray(index.reshape(image.shape[:2]).astype(np.uint8))
    found.putpalette(colors.tobytes())
    return found


def pictures(data: Path) -> Any:
    """Return the maps of both chapters of the scenes of v2, as in figures 2.3 and 3.4, each with its errors."""
    columns: list[list[Any]] = [[] for _ in range(4)]
    for _, scene in of_v2(data):
        pair, judge = load_pair(scene), MiddleburyV2Protocol()
        truth = judge.truth(scene)
        for k, name in enumerate(PICTURED):
            found = matcher(name)(pair, scene.max_disparity).disparity.values
            grey = np.nan_to_num(found / np.nanmax(truth.values)).clip(0, 1)
            columns[2 * k].append(in_64_greys(255 * cv2.resize(grey, PANEL, interpolation=cv2.INTER_AREA)))
            wrong = picture(judge, found, truth)
            columns[2 * k + 1].append(cv2.resize(wrong, PANEL, interpolation=cv2.INTER_NEAREST))  # keeps the colors
    if not columns[0]:
        return None
    titles = Image.new("L", (4 * PANEL[0], 16), 255)
    for k, title in enumerate((PICTURED[0], "its errors", PICTURED[1], "its errors")):
        place = ((k + 0.5) * PANEL[0], 8)
        ImageDraw.Draw(titles).text(place, title, 0, ImageFont.load_default(11), anchor="mm")
    return indexed(np.vstack([in_64_greys(np.asarray(titles)), np.hstack([*map(np.vstack, columns)])]))


def in_64_greys(levels: Any) -> Any:
    """Return (H, W) levels as RGB, in steps of four."""
    return np.dstack([(levels / 4).astype(np.uint8) * 4 + 3] * 3)


def names(m: Any) -> dict[str, Any]:
    """Return what the templates of chapters 2 and 3 ask for."""

    def of_12(name: str) -> list[float]:
        return [m.mean("v2", name, mask, scene) for scene in SCENES for mask in MASKS]

    def table_2_2() -> Iterator[tuple[str, list[float], float]]:
        both = CH2["DEDC and KP"]
        rows = {f"fitted, `{both}`": of_12(both), "elsewhere": of_12(f"{both}, elsewhere"), **THESIS["table 2.2"]}
        rows |= {f"ours, `{name.replace('/', ' ')}`": of_12(name) for name in ("segments", "accurate", "fuse/accurate")}
        ranks = average_ranks(np.array(list(rows.values())))
        yield from ((name, list(row), rank) for (name, row), rank in zip(rows.items(), ranks, strict=True))

    def best(cost: str, way: str) -> str:
        return m.lowest("fig-3.3", f"{cost} {way}", "all ")

    return {
        "ch2": CH2 | {"ours": "segments", "ours, a fusion": "fuse/accurate"}, "of_12": of_12, "table_2_2": table_2_2,
        "costs": COSTS, "ways": WAYS, "machine": "a CPU with two cores",
        "windows": lambda way: [int(best(cost, way)[4:]) for cost in COSTS],
        "fewest": lambda: {f"{c} {w}": m.mean("fig-3.3", f"{c} {w}", best(c, w)) for c in COSTS for w in WAYS},
    }  # fmt: skip


EXPERIMENTS = {
    "v2": Experiment("2", of_v2, chapter_2, 2),
    "repetition": Experiment("2", repetitive, repetition, 1),
    "fig-3.3": Experiment("3", of_v2, figure_3_3, 1),
    "fig-3.2": Experiment("3", lambda data: list(of_v2(data))[2:3], figure_3_2),
    "cross-times": Experiment("3", lambda data: list(of_v2(data))[2:3], cross_times),
    "frames": Experiment("3", lambda data: list(of_v2(data))[:3:2], frames),
}

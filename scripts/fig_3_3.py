#!/usr/bin/env python3
"""Figure 3.3 of the thesis: four similarity choices x three aggregations x windows 3..33.

    python scripts/fig_3_3.py DATA OUT [--windows 3,11,33]

DATA is a folder of scenes with ground truth (the four of Middlebury v2); OUT receives ``fig_3_3.md``,
``fig_3_3.csv`` and ``fig_3_3.png``. Every error rate is that of plain winner-takes-all: no left-right
check, no refinement; bad > 1 px, mean over the scenes.

The parameters are the same for all scenes. Similarities are summed as 1 - exp(-cost / lambda), each
lambda the best of a scan with constant and cross windows (census 15, 30, 60; rank 8, 15, 30, 60;
gradient 2, 4, 8, 16). CROSS chooses its own support: one value, drawn as a line.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import _env  # (first: continues in the checkout's environment)
import numpy as np

from depthcli.evaluation.protocols import headlines
from depthcli.evaluation.protocols.middlebury_v2 import MiddleburyV2Protocol
from depthcli.evaluation.render import Number, Table
from depthcli.io.walk import discover_scenes
from depthcli.kernels.winners import winners
from depthcli.methods.stereo.aggregation import Aggregator
from depthcli.methods.stereo.aggregation.adaptive_weight import AdaptiveWeight
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.aggregation.cross import Cross
from depthcli.methods.stereo.cost import CostMeasure
from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.cost.combined import Combined

MASKS = ("nonocc", "all", "disc")
LAMBDAS = {"gradient": 2.0, "rank": 30.0, "census": 30.0}


def similarities() -> dict[str, CostMeasure]:
    base = {"cost": "absolute_difference", "lambda": 10.0}
    choices: dict[str, CostMeasure] = {"AD": AbsoluteDifference()}
    for name, value in LAMBDAS.items():
        choices[f"AD+{name}"] = Combined.model_validate({"parts": [base, {"cost": name, "lambda": value}]})
    return choices


def aggregations(windows: list[int]) -> list[tuple[str, int | None, Aggregator]]:
    """Return (name, window or None, method); CROSS in one pass over the intersected supports, as in eq. 3.8-3.9."""
    rows: list[tuple[str, int | None, Aggregator]] = [("CW", w, ConstantWindow(window=w)) for w in windows]
    rows.append(("CROSS", None, Cross(iterations=1, support="intersection")))
    rows += [("AW", w, AdaptiveWeight(window=w)) for w in windows]
    return rows


def measure(data: Path, windows: list[int]) -> list[dict[str, object]]:
    """Return a row for each similarity, aggregation, window and scene, with the error in every mask."""
    rows: list[dict[str, object]] = []
    for scene in discover_scenes(data):
        pair, truth = scene.load(), MiddleburyV2Protocol().truth(scene)
        if scene.max_disparity is None or not set(MASKS) <= set(truth.masks):
            raise SystemExit(f"scene {scene.name}: want max_disparity and the masks {', '.join(MASKS)}")
        for similarity, cost in similarities().items():
            volume = cost(pair, scene.max_disparity + 1)
            for name, window, aggregate in aggregations(windows):
                start = time.perf_counter()
                disparity = winners(aggregate(volume, pair).costs)[0].astype(np.float32)
                seconds = time.perf_counter() - start
                rates = headlines(MiddleburyV2Protocol(), disparity, truth)
                bad = {mask: round(rates[mask], 3) for mask in MASKS}
                rows.append({"similarity": similarity, "aggregation": name, "window": window, "scene": scene.name,
                             **bad, "seconds": round(seconds, 4)})  # fmt: skip
    return rows


def means(rows: list[dict[str, object]], mask: str = "nonocc") -> dict[tuple[str, str], dict[int | None, float]]:
    """Return (similarity, aggregation) -> window -> mean error over the scenes."""
    collected: dict[tuple[str, str], dict[int | None, list[float]]] = {}
    for row in rows:
        by_window = collected.setdefault((str(row["similarity"]), str(row["aggregation"])), {})
        by_window.setdefault(row["window"], []).append(float(row[mask]))  # type: ignore[arg-type]
    return {key: {w: float(np.mean(v)) for w, v in by_window.items()} for key, by_window in collected.items()}


def findings(table: dict[tuple[str, str], dict[int | None, float]], windows: list[int]) -> list[str]:
    """Return a line for each conclusion of the thesis, checked against this figure."""
    best = {key: min(values.values()) for key, values in table.items()}
    names = list(similarities())
    lines = []
    for aggregation in ("CW", "AW", "CROSS"):
        order = sorted(names, key=lambda name: best[name, aggregation])
        ranking = ", ".join(f"{name} {best[name, aggregation]:.2f}" for name in order)
        lines.append(f"{aggregation}, best window of each similarity: {ranking}.")
    worst = all(best["AD", a] == max(best[name, a] for name in names) for a in ("CW", "AW", "CROSS"))
    lines.append(f"AD alone is the worst everywhere: {'yes' if worst else 'NO'}.")
    for name in names:
        cw, aw = table[name, "CW"], table[name, "AW"]
        at = min(cw, key=lambda w: cw[w])
        aw_at = min(aw, key=lambda w: aw[w])
        lines.append(
            f"{name}: CW is best at {at} ({cw[at]:.2f}); AW goes from {aw[windows[0]]:.2f} at {windows[0]} to "
            f"{aw[windows[-1]]:.2f} at {windows[-1]}, best at {aw_at} ({aw[aw_at]:.2f}); "
            f"CROSS {best[name, 'CROSS']:.2f}."
        )
    return lines


def markdown(rows: list[dict[str, object]], windows: list[int]) -> str:
    table = means(rows)
    columns = [(name, aggregation) for aggregation in ("CW", "AW") for name in similarities()]
    scenes = ", ".join(sorted({str(row["scene"]) for row in rows}))
    note = f"Winner-takes-all without refinement; bad > 1 px in non-occluded regions, %, mean over {scenes}."
    body = [(str(window), *(Number(table[column][window]) for column in columns)) for window in windows]
    header = ("window", *(f"{name} {aggregation}" for name, aggregation in columns))
    tables = [Table("Error by similarity, aggregation and window", header, tuple(body), note)]
    by_mask = {mask: means(rows, mask) for mask in MASKS}
    body = [(mask, *(Number(by_mask[mask][name, "CROSS"][None]) for name in similarities())) for mask in MASKS]
    tables.append(Table("CROSS, which chooses its own support", ("mask", *similarities()), tuple(body)))
    return "\n".join([*(each.markdown() for each in tables), *(f"- {line}" for line in findings(table, windows)), ""])


def plot(rows: list[dict[str, object]], windows: list[int], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    table = means(rows)
    figure, axes = pyplot.subplots(figsize=(9, 5.5), layout="constrained")
    styles = {"CW": "--", "CROSS": ":", "AW": "-"}
    for color, name in zip(("black", "tab:green", "tab:blue", "tab:red"), similarities(), strict=True):
        for aggregation, style in styles.items():
            values = table[name, aggregation]
            heights = [values[w] if aggregation != "CROSS" else values[None] for w in windows]
            marker = "" if aggregation == "CROSS" else "o"
            axes.plot(windows, heights, style, color=color, marker=marker, ms=3, label=f"{name} {aggregation}")
    axes.set(xlabel="window side, pixels", ylabel="bad > 1 px, non-occluded, %", xticks=windows, ylim=(0, 25))
    axes.set_title("Winner-takes-all without refinement, mean of the scenes")
    axes.grid(alpha=0.3)
    axes.legend(ncols=4, fontsize=8)
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, help="folder of scenes with ground truth")
    parser.add_argument("out", type=Path, help="folder for the table, the numbers and the plot")
    _env.add_list(parser, "--windows", list(range(3, 34, 2)), kind=int, help="sides, pixels")
    arguments = parser.parse_args()
    rows = measure(arguments.data, arguments.windows)
    arguments.out.mkdir(parents=True, exist_ok=True)
    with (arguments.out / "fig_3_3.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    text = markdown(rows, arguments.windows)
    (arguments.out / "fig_3_3.md").write_text(text)
    plot(rows, arguments.windows, arguments.out / "fig_3_3.png")
    print(text)


if __name__ == "__main__":
    main()

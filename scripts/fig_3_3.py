#!/usr/bin/env python3
"""Figure 3.3 of the thesis: four similarity choices x three aggregations x windows 3..33.

    python scripts/fig_3_3.py DATA OUT [--windows 3,11,33]

DATA is a folder of scenes with ground truth (the four of Middlebury v2); OUT receives ``fig_3_3.md`` and
``fig_3_3.svg``. Every error rate is that of plain winner-takes-all: no left-right check, no refinement; bad > 1 px,
mean over the scenes.

The parameters are the same for all scenes. Similarities are summed as 1 - exp(-cost / lambda), each
lambda the best of a scan with constant and cross windows (census 15, 30, 60; rank 8, 15, 30, 60;
gradient 2, 4, 8, 16). CROSS chooses its own support, in one pass over the intersected ones as in eq. 3.8-3.9: one
value, drawn as a line.
"""

import _env  # first: continues in the checkout's environment
import numpy as np
from _experiments import scenes_in

from depthcli.evaluation.plots import Line, line_plot
from depthcli.evaluation.protocols import headlines
from depthcli.evaluation.protocols.middlebury_v2 import MiddleburyV2Protocol
from depthcli.evaluation.render import Number, Table
from depthcli.io.stereo_pairs import load_pair
from depthcli.kernels.winners import winners
from depthcli.methods.stereo.aggregation.adaptive_weight import AdaptiveWeight
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.aggregation.cross import Cross
from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.cost.combined import Combined

MASKS = ("nonocc", "all", "disc")
LAMBDAS = {"gradient": 2.0, "rank": 30.0, "census": 30.0}


def main() -> None:
    options = _env.options(__doc__, "data", "out", windows=list(range(3, 34, 2)))
    windows, base = options.windows, {"cost": "absolute_difference", "lambda": 10.0}
    costs = {f"AD+{name}": Combined.model_validate({"parts": [base, {"cost": name, "lambda": value}]})
             for name, value in LAMBDAS.items()}  # fmt: skip
    costs = {"AD": AbsoluteDifference(), **costs}
    # (aggregation, window), and "CROSS", 0
    ways = {
        **{("CW", w): ConstantWindow(window=w) for w in windows},
        ("CROSS", 0): Cross(iterations=1, support="intersection"),
        **{("AW", w): AdaptiveWeight(window=w) for w in windows},
    }
    rates: dict[tuple[str, str, int, str], list[float]] = {}
    scenes, judge = scenes_in(options.data), MiddleburyV2Protocol()
    for scene in scenes:
        pair, truth = load_pair(scene), judge.truth(scene)
        for similarity, cost in costs.items():
            volume = cost(pair, scene.max_disparity + 1)
            for way, aggregate in ways.items():
                disparity = winners(aggregate(volume, pair).costs)[0].astype(np.float32)
                for mask, rate in headlines(judge, disparity, truth).items():
                    rates.setdefault((similarity, *way, mask), []).append(rate)
    means = {key: float(np.mean(found)) for key, found in rates.items()}

    columns = [(name, way) for way in ("CW", "AW") for name in costs]
    rows = [(str(w), *(Number(means[name, way, w, "nonocc"]) for name, way in columns)) for w in windows]
    names = ", ".join(scene.name for scene in scenes)
    note = f"Winner-takes-all without refinement; bad > 1 px in non-occluded regions, %, mean over {names}."
    header = ("window", *(f"{name} {way}" for name, way in columns))
    first = Table("Error by similarity, aggregation and window", header, tuple(rows), note)
    rows = [(mask, *(Number(means[name, "CROSS", 0, mask]) for name in costs)) for mask in MASKS]
    second = Table("CROSS, which chooses its own support", ("mask", *costs), tuple(rows))
    lines = [
        Line(f"{name} {way}", windows, [means[name, way, w * (way != "CROSS"), "nonocc"] for w in windows])
        for name in costs
        for way in ("CW", "CROSS", "AW")
    ]
    text = f"{first.markdown()}\n{second.markdown()}\n"
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "fig_3_3.md").write_text(text)
    plot = line_plot(lines, "Winner-takes-all without refinement", "window side, pixels", "bad > 1 px, non-occluded, %")
    (options.out / "fig_3_3.svg").write_text(plot, "utf-8")
    print(text)


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""The experiments of chapter 6: confidences, consensus windows, fusion of measures, what it changes later on.

    python scripts/fusion_experiments.py DATA OUT [--only windows,fusion] [--quick]

DATA holds the folders ``middlebury_v2``, ``_2001``, ``_2005``, ``_2006`` and ``kitti``. OUT receives one Markdown
table an experiment, ``fusion.md`` with all of them, and plots (SVG).
``--quick`` takes four scenes only. Error rates: bad > 1 px in non-occluded regions, %, missing counts as
bad; KITTI: Out-Noc > 3 px. "wins": scenes better than equal weights; "worst": largest ratio to equal weights.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import _env  # first: continues in the checkout's environment
import numpy as np
from _experiments import config_of, matcher, seconds_in_turns

from depthcli.api.stereo import with_network
from depthcli.core.frames import StereoPair
from depthcli.evaluation.curves import sparsification
from depthcli.evaluation.plots import Line, line_plot
from depthcli.evaluation.protocols import headlines, load
from depthcli.evaluation.render import Number, Table
from depthcli.evaluation.statistics import compare
from depthcli.io.scenes.stereo import StereoScene
from depthcli.io.walk import discover_scenes
from depthcli.kernels.winners import winners
from depthcli.methods.confidence import confidence_maps, measures
from depthcli.methods.fusion import Fusion
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.simulate.transparent_scenes import cross_modal_pair

V2 = "middlebury_v2"
SETS = (V2, "middlebury_2001", "middlebury_2005", "middlebury_2006")
QUICK = ("Teddy", "Cones", "Lampshade1", "Baby2")
ALL = ("absolute_difference", "gradient", "rank", "census")
EQUAL: dict[str, Any] = {"weights": "equal", "consensus": {"vote_cost": 0}}
SHORT = {"absolute_difference": "AD", "gradient": "GRAD", "rank": "RANK", "census": "CENSUS"}


def preset(name: str, **fields: Any) -> dict[str, Any]:
    """A preset of fuse with every field, some of them replaced."""
    config = config_of("fuse", name).model_dump(mode="json", by_alias=True)
    return {**{key: value for key, value in config.items() if key in Fusion.model_fields}, **fields}


def fusion_of(config: dict[str, Any]) -> Fusion:
    return with_network(Fusion.model_validate(config))


def equal_of(config: dict[str, Any]) -> dict[str, Any]:
    """The same pipeline with equal weights and without votes."""
    return {**config, **EQUAL, "vote_aggregation": "constant_window", "vote_optimization": "winner_takes_all"}


class Experiments:
    """Runs configs over scenes and keeps every figure."""

    def __init__(self, data: Path, quick: bool) -> None:
        self.scenes = [s for name in SETS for s in discover_scenes(data / name, [StereoScene])]
        if quick:
            self.scenes = [s for s in self.scenes if s.name.rpartition("/")[2] in QUICK]
        self.kitti = discover_scenes(data / "kitti", [StereoScene]) if (data / "kitti").is_dir() else []
        self.plots: dict[str, str] = {}

    def bad(self, scenes: list[StereoScene], match: Callable[[StereoPair, int], np.ndarray], protocol: str = V2,
            change: Callable[[StereoPair], StereoPair] = lambda pair: pair) -> list[float]:  # fmt: skip
        rates = []
        for scene in scenes:
            judge = load(protocol)()
            by_region = headlines(judge, match(change(scene.load()), scene.max_disparity or 255), judge.truth(scene))
            rates.append(next(iter(by_region.values())))
        return rates

    def table(self, title: str, configs: dict[str, dict[str, Any]], base: str = "equal", **how: Any) -> Table:
        """A row a config: mean, and against ``base`` wins, mean difference, worst ratio and p."""
        scenes = how.pop("scenes", self.scenes)
        rates_of: dict[str, list[float]] = {}
        for name, config in configs.items():
            model = fusion_of(config)
            rates_of[name] = self.bad(scenes, lambda pair, top, model=model: model(pair, top).disparity.values, **how)
        rows = []
        for name, rates in rates_of.items():
            against = compare(rates_of[base], rates)
            figures = Number(against.mean_difference), Number(against.worst_ratio, 3), Number(against.p_value, 4)
            rows.append((name, Number(float(np.mean(rates))), f"{against.wins}/{against.scenes}", *figures))
        header = ("config", "mean bad", "wins", "difference", "worst", "p (Wilcoxon)")
        return Table(title, header, tuple(rows), f"{len(scenes)} scenes; against {base}")


def confidences(bench: Experiments) -> list[Table]:
    """6.4.1: AUC of every measure for each similarity, CW 11, all known pixels; also of the final map's."""
    tables = []
    chosen = [s for s in bench.scenes if s.name.rpartition("/")[2] in ("Teddy", "Cones")]
    for scene in chosen:
        pair, truth = scene.load(), load(V2)().truth(scene)
        known = ~np.isnan(truth.disparity)
        columns: dict[str, dict[str, float]] = {}
        for cost in ALL:
            volume = Fusion.model_validate({"measures": [cost], **EQUAL, "aggregation": None}).measures[0].cost
            assert volume is not None
            costs = ConstantWindow(window=11)(volume(pair, (scene.max_disparity or 0) + 1), pair).costs
            wrong = ~(np.abs(winners(costs)[0] - truth.disparity) <= 1)[known]
            columns[cost], lines = _areas(confidence_maps(costs, measures()), known, wrong)
            if cost == "census":
                title = f"Sparsification, {scene.name}, census CW 11"
                name = f"sparsification_{scene.name.rpartition('/')[2]}.svg"
                bench.plots[name] = line_plot(lines, title, "most confident pixels, %", "bad > 1 px, %")
        final = fusion_of(preset("accurate", confidence=[*measures(), "consensus"]))
        result = final(pair, scene.max_disparity or 0)
        wrong = ~(np.abs(result.disparity.values - truth.disparity) <= 1)[known]
        columns["accurate"], _ = _areas(result.confidence, known, wrong)
        names = [*measures(), "consensus", "optimal", "random"]
        body = tuple((n, *(Number(columns[c].get(n, float("nan")), 4) for c in columns)) for n in names)
        tables.append(Table(f"AUC of confidences, {scene.name}", ("measure", *columns), body, "all known pixels"))
    return tables


def _areas(maps: dict[str, Any], known: np.ndarray, wrong: np.ndarray) -> tuple[dict[str, float], list[Line]]:
    areas: dict[str, float] = {}
    lines = []
    for name, values in maps.items():
        curve = sparsification(np.ascontiguousarray(values[known]), wrong)
        areas |= {name: curve.auc, "optimal": curve.optimal, "random": curve.mean}
        if name in ("msm", "pkr", "mlm", "lrd", "da", "apkr", "dap"):
            lines.append(Line(name, curve.percentages, [100 * rate for rate in curve.errors]))
    return areas, lines


def windows(bench: Experiments) -> list[Table]:
    """6.4.2: sizes of the consensus window, for both kinds of support."""
    tables, lines = [], []
    for support in ("window", "color"):
        configs = {"equal": preset("equal")}
        sizes = (3, 7, 11, 21, 33, 65, 129)
        for size in sizes:
            consensus = {"support": support, "window": size, "softness": 15, "vote_cost": 0}
            configs[f"{support} {size}"] = preset("window", consensus=consensus)
        table = bench.table(f"Consensus windows, {support}, weights only", configs)
        tables.append(table)
        lines.append(Line(support, sizes, [float(row[1]) for row in table.rows[1:]]))
    plot = line_plot(lines, "Consensus windows", "window, px", "bad > 1 px, %, mean")
    bench.plots["windows.svg"] = plot
    return tables


def fusion(bench: Experiments) -> list[Table]:
    """6.4.3: all measures; what comes from confidence, consensus and votes."""
    configs = {SHORT[cost]: {"measures": [cost], **EQUAL} for cost in ALL}
    configs["equal"] = preset("equal")
    for confidence in ("pkr", "mlm", "lrc"):
        configs[f"confidence {confidence}"] = {
            "measures": ALL, "weights": "confidence", "vote_confidence": confidence,
            "blend": "after", "consensus": {"vote_cost": 0},
        }  # fmt: skip
    configs["select"] = {"measures": ALL, "weights": "select", "blend": "after", "consensus": {"vote_cost": 0}}
    configs["vote"] = {"measures": ALL, "weights": "vote"}
    configs["window 21, unit confidence"] = preset("window", vote_confidence=None)
    configs["window 21, LRC"] = preset("window")
    configs["color, weights only"] = preset("weights-only")
    configs["consensus"] = preset("consensus")
    configs["consensus, 1 more round"] = preset("consensus", consensus={"rounds": 1, "map_vote_cost": 0.4})
    return [bench.table("Fusion of all measures, CW 11", configs)]


def pairs(bench: Experiments) -> list[Table]:
    """6.4.4: AD fused with each other measure."""
    tables = []
    for cost in ALL[1:]:
        both = ["absolute_difference", cost]
        configs = {SHORT[m]: {"measures": [m], **EQUAL} for m in both}
        configs |= {"equal": {"measures": both, **EQUAL}, "consensus": preset("consensus", measures=both)}
        tables.append(bench.table(f"AD fused with {SHORT[cost]}", configs))
    return tables


def later_stages(bench: Experiments) -> list[Table]:
    """6.4.5 and 6.4.7: does the gain survive other aggregations, optimizers, refinement, segments?"""
    tables = []
    for name in ("consensus", "cross", "adaptive-weight", "scanline", "accurate"):
        config = preset(name)
        tables.append(bench.table(f"After {name}", {"equal": equal_of(config), "fused": config}))
    config = after_segments()
    tables.append(bench.table("After segments", {"equal": equal_of(config), "fused": config}))
    both = {"stereo accurate": matcher("accurate"), "fuse accurate": matcher("fuse/accurate")}
    rates = {name: bench.bad(bench.scenes, lambda pair, top, run=run: run(pair, top).disparity.values)
             for name, run in both.items()}  # fmt: skip
    wins = f"{compare(*rates.values()).wins}/{len(bench.scenes)}"
    body = tuple((name, Number(float(np.mean(found))), wins) for name, found in rates.items())
    return [*tables, Table("The two accurate presets", ("config", "mean bad", "wins of fuse"), body)]


def after_segments() -> dict[str, Any]:
    """The measures of the segments preset, fused; its penalties hold for the sum of its parts, ours for the mean."""
    fields = config_of("stereo", "segments").pipeline.model_dump(mode="json", by_alias=True, exclude={"pipeline"})
    parts = fields.pop("cost")["parts"]
    fields["optimization"] |= {name: fields["optimization"][name] / len(parts) for name in ("p1", "p2")}
    fields["energy"]["cost_weight"] *= len(parts)
    measures_ = [{"cost": part["cost"], "scale": part["lambda"]} for part in parts]
    return preset("accurate", measures=measures_, optimization="winner_takes_all", refinement=[], segments=fields,
                  consensus={"softness": 8, "vote_cost": 0.2})  # fmt: skip


def kitti(bench: Experiments) -> list[Table]:
    """6.4.8: driving scenes, 3 px."""
    configs = {"equal": equal_of(preset("consensus")), "consensus": preset("consensus")}
    tables = [bench.table("KITTI, CW 11", configs, scenes=bench.kitti, protocol="kitti_2012")]
    configs = {"equal": equal_of(preset("kitti")), "kitti": preset("kitti")}
    return [*tables, bench.table("KITTI, preset kitti", configs, scenes=bench.kitti, protocol="kitti_2012")]


def cross_modal(bench: Experiments) -> list[Table]:
    """6.4.9: the right view as another sensor would see it; AD misleads."""

    def infrared(pair: StereoPair) -> StereoPair:
        return StereoPair(*cross_modal_pair(pair.left, pair.right, seed=0))

    configs = {SHORT[cost]: {"measures": [cost], **EQUAL} for cost in ALL}
    configs |= {"equal": preset("equal"), "weights only": preset("weights-only", exponent=6)}
    configs |= {"consensus": preset("consensus"), "cross-modal": preset("cross-modal")}
    return [bench.table("Cross-modal pairs", configs, change=infrared)]


def seconds(bench: Experiments) -> list[Table]:
    """6.4.6: time by stage on Cones, best of nine."""
    scene = next(s for s in bench.scenes if s.name.rpartition("/")[2] == "Cones")
    pair, top = scene.load(), scene.max_disparity or 0
    rows = []
    for name in ("equal", "consensus", "weights-only", "accurate"):
        model, runs = fusion_of(preset(name)), []
        (taken,) = seconds_in_turns({name: lambda m=model, r=runs: r.append(m(pair, top).seconds)}, 9).values()
        stages = min(runs[1:], key=lambda stages: sum(stages.values()))
        rows.append((name, Number(1e3 * taken[0], 0), ", ".join(f"{k} {1e3 * v:.0f}" for k, v in stages.items())))
    return [Table("Time on Cones, ms", ("preset", "total", "by stage"), tuple(rows))]


EXPERIMENTS = {
    "confidences": confidences, "windows": windows, "fusion": fusion, "pairs": pairs, "later": later_stages,
    "kitti": kitti, "cross-modal": cross_modal, "seconds": seconds,
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    _env.add_list(parser, "--only", list(EXPERIMENTS), choices=list(EXPERIMENTS))
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    bench = Experiments(arguments.data, arguments.quick)
    document = []
    for name in arguments.only:
        text = "\n".join(table.markdown() for table in EXPERIMENTS[name](bench))
        document.append(text)
        (arguments.out / f"{name}.md").write_text(text, "utf-8")
        print(text, flush=True)
    (arguments.out / "fusion.md").write_text("# Fusion of similarity measures\n\n" + "\n".join(document), "utf-8")
    for name, picture in bench.plots.items():
        (arguments.out / name).write_text(picture, "utf-8")


if __name__ == "__main__":
    main()

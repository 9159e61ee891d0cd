#!/usr/bin/env python3
"""Chapter 6: what confidences, consensus and votes bring to the fusion of four measures.

    scripts/fusion_experiments.py DATA [--only confidences,fusion]

DATA holds the folders ``middlebury_v2``, ``_2001``, ``_2005`` and ``_2006``. ``confidences``: the area under the
sparsification curve of every measure for each cost in a window of 11 x 11, and for ``fuse accurate``, all known pixels
of Teddy and Cones. ``fusion``: bad > 1 px in non-occluded regions, %, missing counts as bad, winner takes all; "wins":
scenes better than equal weights; "worst": largest ratio to them.
"""

from typing import Any

import _env  # first: continues in the checkout's environment
import numpy as np
from _experiments import config_of, middlebury_scenes, show

from depthcli.api.stereo import with_network
from depthcli.evaluation.curves import sparsification
from depthcli.evaluation.protocols import headlines, load
from depthcli.evaluation.render import Number
from depthcli.evaluation.statistics import compare
from depthcli.io.scenes import StereoScene
from depthcli.io.stereo_pairs import load_pair
from depthcli.kernels.winners import winners
from depthcli.methods.confidence import confidence_maps, measures
from depthcli.methods.fusion import Fusion
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow

V2 = "middlebury_v2"
ALL = ("absolute_difference", "gradient", "rank", "census")
NO_VOTES: dict[str, Any] = {"vote_cost": 0}
EQUAL: dict[str, Any] = {"weights": "equal", "consensus": NO_VOTES}


def preset(name: str, **fields: Any) -> dict[str, Any]:
    """Return a preset of fuse with every field, some of them replaced."""
    config = config_of("fuse", name).model_dump(mode="json", by_alias=True)
    return {**{key: value for key, value in config.items() if key in Fusion.model_fields}, **fields}


def confidences(scenes: list[StereoScene]) -> None:
    """Print a table a scene: a row a measure, a column a cost."""
    for scene in (scene for scene in scenes if scene.name.rpartition("/")[2] in ("Teddy", "Cones")):
        pair, truth, top = load_pair(scene), load(V2)().truth(scene).values, scene.max_disparity or 0
        found: dict[str, tuple[Any, dict[str, Any]]] = {}  # column -> disparities, and confidences by name
        for cost in ALL:
            volume = Fusion.model_validate({"measures": [cost], **EQUAL, "aggregation": None}).measures[0].cost
            costs = ConstantWindow(window=11)(volume(pair, top + 1), pair).costs
            found[cost] = winners(costs)[0], confidence_maps(costs, measures())
        final = with_network(Fusion.model_validate(preset("accurate", confidence=[*measures(), "consensus"])))
        result = final(pair, top)
        found["accurate"] = result.disparity.values, result.confidence
        known, areas = ~np.isnan(truth), dict[tuple[str, str], float]()
        for column, (values, maps) in found.items():
            wrong = ~(np.abs(values - truth) <= 1)[known]
            for name, confidence in maps.items():
                curve = sparsification(np.ascontiguousarray(confidence[known]), wrong)
                areas |= {(name, column): curve.auc, ("optimal", column): curve.optimal, ("random", column): curve.mean}
        names = [*measures(), "consensus", "optimal", "random"]
        rows = [(n, *(Number(areas.get((n, c), float("nan")), 4) for c in found)) for n in names]
        show(f"AUC of confidences, {scene.name}", ("measure", *found), rows)


def fusion(scenes: list[StereoScene]) -> None:
    """Print what comes from confidence, consensus and votes, a row a config."""
    configs = {cost: {"measures": [cost], **EQUAL} for cost in ALL}
    configs["equal"] = preset("ch6-equal")
    for confidence in ("pkr", "mlm", "lrc"):
        configs[f"confidence {confidence}"] = {"measures": ALL, "weights": "confidence", "vote_confidence": confidence,
                                               "blend": "after", "consensus": NO_VOTES}  # fmt: skip
    configs["select"] = {"measures": ALL, "weights": "select", "blend": "after", "consensus": NO_VOTES}
    configs["vote"] = {"measures": ALL, "weights": "vote"}
    configs["window 21"] = preset("ch6-consensus-window")
    configs["color, weights only"] = preset("consensus", blend="after", consensus={"vote_cost": 0})
    configs["consensus"] = preset("consensus")
    configs["consensus, 1 more round"] = preset("consensus", consensus={"rounds": 1, "map_vote_cost": 0.4})
    rates: dict[str, list[float]] = {name: [] for name in configs}
    models = {name: with_network(Fusion.model_validate(config)) for name, config in configs.items()}
    judge = load(V2)()
    for scene in scenes:
        pair, truth = load_pair(scene), judge.truth(scene)
        for name, model in models.items():
            values = model(pair, scene.max_disparity or 255).disparity.values
            rates[name].append(headlines(judge, values, truth)["nonocc"])
    rows = []
    for name, found in rates.items():
        against = compare(rates["equal"], found)
        figures = Number(against.mean_difference), Number(against.worst_ratio, 3), Number(against.p_value, 4)
        rows.append((name, Number(float(np.mean(found))), f"{against.wins}/{against.scenes}", *figures))
    header = ("config", "mean bad", "wins", "difference", "worst", "p (Wilcoxon)")
    show(f"Fusion of all measures, {len(scenes)} scenes", header, rows)


def main() -> None:
    parts = {"confidences": confidences, "fusion": fusion}
    options = _env.options(__doc__, "data", only=tuple(parts))
    for name in options.only:
        parts[name](middlebury_scenes(options.data))


if __name__ == "__main__":
    main()

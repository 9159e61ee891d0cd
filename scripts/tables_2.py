#!/usr/bin/env python3
"""Tables 2.1 and 2.2 of the thesis as Markdown, its figures beside ours.

    python scripts/tables_2.py DATA > tables_2.md

DATA is the folder with the four scenes of Middlebury v2 (Tsukuba, Venus, Teddy, Cones). Every figure is the
percentage of pixels whose disparity is off by more than 1 px, missing ones included. The presets
``segments``, ``segments-dedc``, ``segments-kp`` and ``segments-baseline`` are run as they ship, with
the same parameters for all scenes.
"""

import _env  # first: continues in the checkout's environment
import numpy as np
from _experiments import matcher, scenes_in, show

from depthcli.evaluation.protocols import headlines
from depthcli.evaluation.protocols.middlebury_v2 import MiddleburyV2Protocol
from depthcli.evaluation.render import Number
from depthcli.evaluation.statistics import average_ranks
from depthcli.io.stereo_pairs import load_pair

SCENES = ("Tsukuba", "Venus", "Teddy", "Cones")
MASKS = ("nonocc", "all", "disc")
ROWS = {"baseline": "segments-baseline", "KP": "segments-kp", "DEDC": "segments-dedc", "DEDC and KP": "segments"}
THESIS_2_1 = {
    "baseline": (2.64, 3.26, 11.8),
    "KP": (1.56, 2.23, 7.42),
    "DEDC": (1.25, 1.75, 6.28),
    "DEDC and KP": (1.08, 1.59, 5.82),
}
THESIS_2_2 = {
    "thesis": (1.08, 1.59, 5.82, 0.08, 0.16, 1.11, 4.49, 8.06, 12.2, 3.59, 9.40, 11.0),
    "ADCensus": (1.07, 1.48, 5.73, 0.09, 0.25, 1.15, 4.10, 6.22, 10.9, 2.42, 7.25, 6.95),
    "AdaptingBP": (1.11, 1.37, 5.79, 0.10, 0.21, 1.44, 4.22, 7.06, 11.8, 2.48, 7.92, 7.32),
    "CoopRegion": (0.87, 1.16, 4.61, 0.11, 0.21, 1.54, 5.16, 8.31, 13.0, 2.79, 7.18, 8.01),
    "DoubleBP": (0.88, 1.29, 4.76, 0.13, 0.45, 1.87, 3.53, 8.30, 9.63, 2.90, 8.78, 7.79),
}


def main() -> None:
    scenes = {scene.name: scene for scene in scenes_in(_env.options(__doc__, "data").data)}
    judge = MiddleburyV2Protocol()
    ours: dict[str, list[float]] = {}
    for row, name in ROWS.items():
        for scene in (scenes[name] for name in SCENES):
            values = matcher(name)(load_pair(scene), scene.max_disparity).disparity.values
            rates = headlines(judge, values, judge.truth(scene))
            ours.setdefault(row, []).extend(rates[mask] for mask in MASKS)
    rows = [
        (row, *(f"{t:.2f} / {o:.2f}" for t, o in zip(thesis, ours[row], strict=False)), Number(np.mean(ours[row])))
        for row, thesis in THESIS_2_1.items()
    ]
    show("Table 2.1: Tsukuba, bad > 1 px (thesis / ours)", ("", *MASKS, "ours, mean of 4 scenes"), rows)
    table = {"ours": tuple(ours["DEDC and KP"]), **THESIS_2_2}
    rows = []
    for (name, figures), rank in zip(table.items(), average_ranks(np.array(list(table.values()))), strict=True):
        cells = [" / ".join(Number(v) for v in figures[3 * k : 3 * k + 3]) for k in range(4)]
        rows.append((name, Number(rank), *cells, Number(np.mean(figures))))
    header = ("method", "average rank", *SCENES, "mean of 12")
    show("Table 2.2: bad > 1 px, nonocc / all / disc", header, rows)


if __name__ == "__main__":
    main()

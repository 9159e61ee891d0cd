"""How good the judgment and the fusion of given maps are, for docs/figures.md: no part of the thesis.

Maps of SGBM (filled), segments, ad-census are judged alone and with those of fast and accurate as witnesses, and fused.
Bad: more than 1 px of the images' size, missing counts as bad; all and nonocc pixels.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from _experiments import GROUPS, Experiment, Rows, bad, matcher, real_scenes

from depthcli.evaluation import protocols
from depthcli.evaluation.curves import reliability, sparsification
from depthcli.io.stereo_pairs import load_pair
from depthcli.methods.given_maps import judge
from depthcli.methods.given_maps.fusion import fuse
from depthcli.problems.map_checks import networks

METHODS = ("opencv-sgbm", "segments", "ad-census", "fast", "accurate")
FUSED = ("opencv-sgbm", "fast", "ad-census", "segments")


def scenes(data: Path) -> Iterator[tuple[str, Any]]:
    """Yield the real scenes of both groups, but for KITTI."""
    for group in GROUPS:
        for folder, scene in real_scenes(data, group):
            if folder != "kitti":
                yield f"{folder} {scene.name}", (f"{group} {folder.removeprefix('middlebury_')}", folder, scene)


def given_maps(item: tuple[str, str, Any]) -> Rows:
    """Return areas of judgments, their optima and calibration errors, and bad pixels, %; columns by group and set."""
    column, folder, scene = item
    truth = protocols.load("middlebury_v3" if folder == "middlebury_v3" else "middlebury_v2")().truth(scene)
    pair, largest = load_pair(scene), scene.max_disparity
    maps = {name: matcher(name)(pair, largest).disparity.values for name in METHODS}
    known = np.isfinite(truth.values) & (truth.values > 0)
    regions = {"all": known & truth.masks.get("all", known), "nonocc": known & truth.masks["nonocc"]}
    rows: Rows = {}
    for name in ("opencv-sgbm", "ad-census", "segments"):
        for label, others in ((name, []), (f"{name}, witnesses", [maps["fast"], maps["accurate"]])):
            found = judge(networks(), pair, [maps[name], *others], largest).probability
            wrong, cells = ~(np.abs(maps[name] - truth.values) <= 1), rows.setdefault(label, {})
            for region, pixels in regions.items():
                line = sparsification(found[pixels], wrong[pixels])
                cells |= {f"{column} {region} area": line.auc, f"{column} {region} optimal": line.optimal}
            right = reliability(found[regions["all"]], ~wrong[regions["all"]])
            cells[f"{column} ECE"] = right.ece if right else float("nan")
    given = [maps[name] for name in FUSED]
    maps |= {"fused": fuse(networks(), pair, given, largest)[0].values,
             "with --surfaces": fuse(networks(), pair, given, largest, surfaces=True)[0].values,
             "SGBM refined": fuse(networks(), pair, given[:1], largest)[0].values}  # fmt: skip
    for name, values in maps.items():
        rates = {f"{column} {region} bad": bad(values, truth.values, pixels) for region, pixels in regions.items()}
        rows.setdefault(name, {}).update(rates)
    return rows


EXPERIMENTS = {"given-maps": Experiment("6", scenes, given_maps, on_page=False)}

"""Tables of ``transparent``: real scenes of ClearGrasp with emulated sparse stereo.

    python scripts/transparent_experiments.py ../shared/data/transparent/real_d435 [PRESET ...]

The sensor's depth is real, with glass in place; the truth is the depth of the same objects, painted. The sparse
stereo is emulated from the truth: a share of the pixels, 8 mm of noise, outliers. Scenes are halved in size (nearest
for depth). Settings were chosen on scene_080 alone.

ClearGrasp and TransCG report the same measures, but on other scenes and without a second depth map as input: the
figures say how far methods here differ from each other, not from theirs.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.batch.presets import find_config
from depthcli.core.config_file import load_config
from depthcli.core.frames import SparseFrame
from depthcli.io.items.rgbd import RgbdItem
from depthcli.io.walk import find_items
from depthcli.synthetic.sparse_depth import sparse_samples
from depthcli.transparent.config import TransparentConfig

PRESETS = ("nearest", "joint-bilateral", "textbook", "crf", "sparse")
CASES: dict[str, dict[str, Any]] = {
    "2 %": {"share": 0.02},
    "10 %": {"share": 0.10},
    "2 % at edges": {"share": 0.02, "clustered": True},
    "10 % at edges": {"share": 0.10, "clustered": True},
    "2 %, 30 % wrong": {"share": 0.02, "outliers": 0.3},
    "10 %, 30 % wrong": {"share": 0.10, "outliers": 0.3},
}
Map = NDArray[np.float32]
Scene = tuple[NDArray[np.uint8], Map, Map, NDArray[np.bool_]]


def halved(item: RgbdItem) -> Scene:
    """Color, sensor, truth and mask at half size."""
    frame, truth = item.load(), item.truth()
    height, width = frame.shape
    color = cv2.resize(frame.color, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    cut = slice(0, height // 2 * 2, 2), slice(0, width // 2 * 2, 2)
    sensor, depth, mask = frame.depth[cut], truth.depth[cut], truth.masks["transparent"][cut]
    return np.asarray(color, np.uint8), *(np.ascontiguousarray(part) for part in (sensor, depth, mask))


def measures(found: Map, scene: Scene) -> dict[str, float]:
    """MAE and RMSE in mm, REL and deltas in the mask; MAE outside over the sensor's; MAE beside the outline."""
    _, sensor, truth, mask = scene
    known = np.isfinite(truth) & np.isfinite(found)
    inside, outside = known & mask, known & ~mask & np.isfinite(sensor)
    error = 1000 * np.abs(found.astype(np.float64) - truth)
    ratio = np.maximum(found / truth, truth / found)[inside]
    square = np.ones((11, 11), np.uint8)
    plane = mask.astype(np.uint8)
    outline = known & (cv2.dilate(plane, square) > cv2.erode(plane, square))
    return {
        "MAE": float(error[inside].mean()),
        "RMSE": float(np.sqrt((error[inside] ** 2).mean())),
        "REL": float((error / 1000 / truth)[inside].mean()),
        **{f"d{limit:.2f}": float(100 * np.mean(ratio < limit)) for limit in (1.05, 1.10, 1.25)},
        "outside": float(error[outside].mean() / (1000 * np.abs(sensor - truth)[outside].mean())),
        "outline": float(error[outline].mean()),
        "coverage": float(100 * np.isfinite(found)[np.isfinite(truth) & mask].mean()),
    }


def main(arguments: list[str]) -> None:
    """Print a line a preset and kind of samples: the mean over the scenes, then MAE by scene."""
    items = [item for item in find_items(Path(arguments[0]), (RgbdItem,)) if isinstance(item, RgbdItem)]
    scenes = {item.name: halved(item) for item in items}
    for preset in arguments[1:] or PRESETS:
        config = load_config(TransparentConfig, find_config("transparent", preset), [])
        for case, settings in CASES.items():
            rows = []
            for scene in scenes.values():
                color, sensor, truth, _ = scene
                sparse = sparse_samples(truth, color, **settings)
                rows.append(measures(config.pipeline(SparseFrame(color, sensor, sparse=sparse)).depth.values, scene))
            mean = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
            digits = {"REL": 4, "outside": 3}
            line = "  ".join(f"{key} {value:.{digits.get(key, 1 if key[0] == 'd' else 2)}f}"
                             for key, value in mean.items())  # fmt: skip
            each = " ".join(f"{row['MAE']:.2f}" for row in rows)
            print(f"{preset:16} {case:17} {line}  by scene {each}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])

#!/usr/bin/env python3
"""Train a random forest that turns the measures of a registration into millimeters.

    scripts/registration_forest.py PAIRS OUTPUT.npz [--config self] [--set KEY=VALUE ...] [--pairs GLOB ...]
                                   [--seed N] [--jobs N]

PAIRS is a folder of registered pairs with landmarks of both volumes or dense true errors (layout `registration`). Of a
dense truth 2000 voxels are taken. The measures are those of the config; use the forest with the same one:

    depthcli register-confidence self --set calibration=forest --set model=OUTPUT.npz --input ...

Wants scikit-learn (`pip install 'depthcli[forest]'`), which using a forest does not. The same seed gives the same bytes
at any number of jobs. How good such forests are on pairs that they have not seen: `registration_experiments.py PAIRS
--only forest`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.batch.presets import find_config
from depthcli.core.config_file import load_config
from depthcli.core.errors import DepthcliError, InputError
from depthcli.data.formats.forests import write_forest
from depthcli.data.formats.volumes import linear
from depthcli.data.scenes.volume_pair import VolumePairScene
from depthcli.data.walk import discover_scenes
from depthcli.methods.registration.config import RegisterConfidenceConfig
from depthcli.methods.registration.forest import train

VOXELS = 2000

Columns = tuple[dict[str, NDArray[np.float32]], NDArray[np.float32]]


def columns(scene: VolumePairScene, config: RegisterConfidenceConfig, seed: int = 0) -> Columns:
    """Measures and true errors (mm) at the landmarks of a pair, or at random voxels of its dense truth."""
    loaded, truth = scene.load(config.field, config.max_voxels), scene.truth(config.field)
    maps, step, start = config.evidence(loaded.pair)
    if truth.error.ndim == 1:
        places, error = loaded.grid.to_index(truth.points), truth.error
    else:
        known = np.argwhere(np.isfinite(truth.error))
        rng = np.random.default_rng(seed)
        some = known[np.sort(rng.choice(len(known), min(VOXELS, len(known)), replace=False))]
        places, error = some.astype(np.float64), truth.error[tuple(some.T)]
    starts, steps = loaded.on_grid(start, step)
    own = (places - np.array(starts)) / np.array(steps)
    return {name: linear(values, own) for name, values in maps.items()}, error


def joined(tables: list[Columns]) -> Columns:
    """One table of those of several pairs."""
    names = tables[0][0]
    return {name: np.concatenate([t[name] for t, _ in tables]) for name in names}, np.concatenate(
        [error for _, error in tables]
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", metavar="PAIRS", type=Path)
    parser.add_argument("output", metavar="OUTPUT.npz", type=Path)
    parser.add_argument("--config", default="self", help="preset or file (its calibration does not matter)")
    parser.add_argument("--set", nargs="+", default=[], metavar="KEY=VALUE", dest="settings")
    parser.add_argument("--pairs", nargs="+", default=["*"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    try:
        config = load_config(
            RegisterConfidenceConfig, find_config("register-confidence", options.config), options.settings
        )
        found = discover_scenes(options.folder, (VolumePairScene,), None, tuple(options.pairs))
        scenes = [scene for scene in found if isinstance(scene, VolumePairScene) and scene.has_truth]
        if not scenes:
            raise InputError(f"{options.folder}: no pair with true errors")
        table, error = joined([columns(scene, config, options.seed) for scene in scenes])
        names = [scene.name for scene in scenes]
        forest = train(table, error, config.settings, names, options.seed, options.jobs)
        write_forest(options.output, forest)
    except DepthcliError as problem:
        print(f"registration_forest: {problem}", file=sys.stderr)
        return 3
    print(f"{options.output}: {len(error)} points of {len(scenes)} pairs, {len(forest.feature)} nodes")
    return 0


if __name__ == "__main__":
    sys.exit(main())

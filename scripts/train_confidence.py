#!/usr/bin/env python3
"""Train the networks that judge disparity maps (confidence, fuse maps): on tuning scenes and generated ones.

    scripts/train_confidence.py DATA OUT [--samples DIR] [--jobs N]

DATA is the folder with the test sets; OUT gets map_right.json, map_hidden.json and map_one_view.json. --samples keeps
the training pixels in a folder, and takes those that are there.

What is judged are maps of several methods and maps that are made wrong on purpose: planes of segments, maps of half
the size, true maps with shifted regions and blurred edges, segments moved off their surface. Each is judged alone, and
in groups of two to five.
"""

import zlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import _env  # first: continues in the checkout's environment
import cv2
import numpy as np
from _experiments import kept, matcher
from _training import Arrays, Map, Pixels, network
from numpy.typing import NDArray
from train_choice import Loaded, TrainingScene, scenes

from depthcli.algorithms.pixel_network import TrainedNetwork
from depthcli.algorithms.plane_fitting.segment_planes import SegmentPlaneFit
from depthcli.algorithms.regions import RegionPixels
from depthcli.algorithms.segmentation.felzenszwalb import Felzenszwalb
from depthcli.core.context import Clock
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap
from depthcli.io.formats.networks import write_network
from depthcli.methods.given_maps import HIDDEN, RIGHT_NAMES, THRESHOLDS, Judged, judged_maps, without_gaps
from depthcli.methods.given_maps._planes import ALONE, INPUTS, ONE_VIEW, OTHERS, Evidence

METHODS = (
    "opencv-sgbm", "ad-census", "opencv-bm", "cross", "opencv-sgbm-wls", "fast", "accurate", "fuse/accurate",
)  # fmt: skip
GROUPS = ((2, False), (3, False), (4, False), (1, True), (2, True), (4, True), (4, True))
"""Sizes of the groups that are judged, and whether the map of stereo fast and the median are added, as in a fusion."""
ZOOM = 1.5
_NO_VALUE = 1000.0  # error of a pixel without a value, pixels


def zoomed(scene: TrainingScene) -> TrainingScene:
    """Return the scene enlarged: larger disparities, blurred edges."""

    def load() -> Loaded:
        pair, largest, truth, masks = scene.load()
        height, width = pair.shape
        size = round(width * ZOOM), round(height * ZOOM)

        def nearest(image: NDArray[Any]) -> NDArray[Any]:
            return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST))

        left, right = (cv2.resize(image, size, interpolation=cv2.INTER_CUBIC) for image in pair.color8)
        scale = np.float32(size[0] / width)
        known = {name: nearest(mask.astype(np.uint8)) > 0 for name, mask in masks.items()}
        return StereoPair(left, right), round(largest * ZOOM) + 1, nearest(truth) * scale, known

    return replace(scene, name=f"{scene.name}zoomed", weight=0.5, pixel_step=4 * scene.pixel_step, load=load)


def training_scenes(data: Path) -> list[TrainingScene]:
    """Return the tuning scenes of the networks that choose, and the real ones enlarged."""
    found = list(scenes(data, ("tuning",)))
    return found + [zoomed(scene) for scene in found if scene.name.startswith("middlebury") and scene.name[-1] == "_"]


def noise(rng: np.random.Generator, shape: tuple[int, ...], sigma: float) -> Map:
    """Return smooth noise of variance 1."""
    field = cv2.GaussianBlur(rng.normal(size=shape).astype(np.float32), (0, 0), sigma)
    return np.asarray(field / field.std(), np.float32)


def made_wrong(
    pair: StereoPair, largest: int, truth: Map, maps: dict[str, DisparityMap], rng: np.random.Generator
) -> dict[str, Map]:
    """Return maps whose errors are those of other kinds of methods."""
    image = pair.color8[0]
    height, width = truth.shape
    fit = SegmentPlaneFit(tolerance=1.0, trials=100, flatness=0.9)

    def planes(source: DisparityMap, scale: float, size: int, measured: bool) -> Map:
        labels = Felzenszwalb(scale=scale, min_size=size)(image)
        count = int(labels.max()) + 1
        used = source.measured.ravel() if measured else np.ones(labels.size, np.bool_)
        values = np.nan_to_num(source.values).clip(0, largest)
        return fit(values, RegionPixels.of(labels, used, count), np.arange(count)).at(labels, largest)

    made = {
        "planes": planes(maps[rng.choice(["opencv-sgbm", "fast"])], rng.choice([100, 300, 600]), 50, False),
        "planes_measured": planes(maps[rng.choice(["accurate", "fast"])], rng.choice([30, 100, 300]), 20, True),
    }
    size = (width // 2, height // 2)
    small = (cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in pair.color8)
    half = matcher("fast")(StereoPair(*small), max(largest // 2 + 1, 8)).disparity.values
    made["half"] = cv2.resize(np.nan_to_num(half) * 2, (width, height), interpolation=cv2.INTER_LINEAR)
    changed, _ = without_gaps(np.where(truth > 0, truth, np.float32(np.nan)), largest)
    blur = rng.uniform(0, 3)
    if blur > 0.5:
        changed = cv2.GaussianBlur(changed, (0, 0), blur)
    changed = changed + noise(rng, changed.shape, rng.uniform(2, 12)) * np.float32(rng.uniform(0.1, 0.5))
    for _ in range(3):
        region = noise(rng, changed.shape, rng.uniform(4, 25)) > rng.uniform(1.6, 2.4)
        shift = rng.choice([-1, 1]) * rng.uniform(1.2, 8) + noise(rng, changed.shape, 15) * rng.uniform(0, 1)
        changed = np.where(region, changed + shift, changed)
    made["true_shifted"] = changed
    labels = Felzenszwalb(scale=100.0, min_size=40)(image)
    count = int(labels.max()) + 1
    shifts = np.where(rng.random(count) < 0.12, rng.choice([-1, 1], count) * rng.uniform(1, 10, count), 0)
    made["segments_shifted"] = np.nan_to_num(maps["accurate"].values) + shifts[labels]
    return {name: values.astype(np.float32) for name, values in made.items()}


def samples_of(scene: TrainingScene) -> Arrays:
    """Match the pair of a scene in all ways, and take one of ``2 pixel_step`` pixels.

    ``alone`` (M, P, len(ALONE)) of M maps, ``errors`` (M, P), pixels, of these maps, ``hidden`` (P,) in the right view;
    of each group k ``of_k`` (N,), which maps, and ``others_k`` (N, P, len(OTHERS)), its planes.
    """
    pair, largest, truth, masks = scene.load()
    rng = np.random.default_rng(zlib.crc32(scene.name.encode()))
    maps = {name: matcher(name)(pair, largest).disparity for name in METHODS}
    values = {name: one.values for name, one in maps.items()} | made_wrong(pair, largest, truth, maps, rng)
    known = np.flatnonzero((np.isfinite(truth) & (truth > 0)).ravel())
    pixels = np.sort(rng.choice(known, known.size // (2 * scene.pixel_step), replace=False))
    evidence = Evidence.of(pair, largest, Clock())
    names, alone, errors = list(values), [], []
    found: Arrays = {"hidden": (masks["all"] & ~masks["nonocc"]).ravel()[pixels]}

    def keep(judged: Judged) -> int:
        alone.append(judged.alone.reshape(len(ALONE), -1)[:, pixels].T.astype(np.float16))
        error = np.where(judged.missing, _NO_VALUE, np.abs(judged.values - truth)).ravel()[pixels]
        errors.append(np.minimum(error, _NO_VALUE).astype(np.float16))
        return len(alone) - 1

    for one in [*values.values(), evidence.reference.values]:
        keep(judged_maps(evidence, [one])[0])
    for group, (size, completed) in enumerate(GROUPS):
        members = [int(k) for k in rng.choice(len(names), size, replace=False)]
        given = [values[names[k]] for k in members]
        if completed:
            given.append(evidence.reference.values)
            members.append(len(names))
        count = len(given)
        if completed and count > 2:  # one more that agrees with most: of an even number the lower one in the middle
            whole = np.stack([without_gaps(one, largest)[0] for one in given])
            given.append(np.partition(whole, (count - 1) // 2, axis=0)[(count - 1) // 2])
        judged = judged_maps(evidence, given)
        others = np.stack([one.others.reshape(len(OTHERS), -1)[:, pixels].T for one in judged])
        found[f"of_{group}"] = np.array(members + [keep(one) for one in judged[count:]])
        found[f"others_{group}"] = others.astype(np.float16)
    return {**found, "alone": np.stack(alone), "errors": np.stack(errors)}


def pixels_of(samples: list[tuple[float, Arrays]]) -> dict[int, Pixels]:
    """Return number of maps in a group -> all its pixels; 1: maps that are judged alone."""
    parts: dict[int, list[Pixels]] = {}
    for weight, one in samples:
        alone, errors = one["alone"], one["errors"]
        count, pixels, _ = alone.shape
        share = np.full(pixels, weight / pixels, np.float32)
        zero = np.zeros((pixels, len(OTHERS)), np.float16)
        for k in range(count):
            inputs = np.concatenate([alone[k], zero], axis=1)[:, None]
            parts.setdefault(1, []).append((inputs, errors[k][:, None], share))
        for group in range(len(GROUPS)):
            members = one[f"of_{group}"]
            inputs = np.concatenate([alone[members], one[f"others_{group}"]], axis=2).transpose(1, 0, 2)
            parts.setdefault(len(members), []).append((inputs, errors[members].T, share))
    return {n: tuple(np.concatenate(arrays) for arrays in zip(*found, strict=True)) for n, found in parts.items()}


def trained(samples: list[tuple[float, Arrays]], names: list[str]) -> dict[str, TrainedNetwork]:
    """Return the networks ``map_right``, ``map_hidden`` and ``map_one_view``."""
    groups = pixels_of(samples)
    right = network(groups, THRESHOLDS, RIGHT_NAMES, INPUTS, (64, 32), names)
    x, errors, weights = groups[1]
    visible = [np.where(one["hidden"], 0, 1).astype(np.float16) for _, one in samples for _ in one["alone"]]
    alone = np.ascontiguousarray(x[:, :, : len(ALONE)]), np.concatenate(visible)[:, None], weights
    shape = np.ascontiguousarray(x[:, :, [ALONE.index(name) for name in ONE_VIEW]]), errors, weights
    return {
        "map_right": right,
        "map_hidden": network({1: alone}, (0.5,), (HIDDEN,), ALONE, (32, 16), names),
        "map_one_view": network({1: shape}, THRESHOLDS, RIGHT_NAMES, ONE_VIEW, (32, 16), names),
    }


def main() -> None:
    options = _env.options(__doc__, "data", "out", samples=None, jobs=1)
    found = training_scenes(options.data)
    with ProcessPoolExecutor(options.jobs) as pool:
        collected = list(pool.map(partial(_collect, options.data, options.samples), range(len(found))))
    networks = trained([(s.weight, c) for s, c in zip(found, collected, strict=True)], [s.name for s in found])
    options.out.mkdir(parents=True, exist_ok=True)
    for name, one in networks.items():
        write_network(options.out / f"{name}.json", one)


def _collect(data: Path, folder: Path | None, number: int) -> Arrays:
    scene = training_scenes(data)[number]
    return kept(folder, scene.name, lambda: samples_of(scene))


if __name__ == "__main__":
    main()

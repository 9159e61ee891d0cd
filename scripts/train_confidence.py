#!/usr/bin/env python3
"""Train the networks that judge disparity maps (confidence, fuse maps): on tuning scenes and generated ones.

    scripts/train_confidence.py DATA OUT [--samples DIR] [--jobs N] [--epochs N] [--seed N] [--held-out]

DATA is the folder with the test sets; OUT gets map_right.json, map_hidden.json and map_one_view.json. --samples keeps
the training pixels in a folder, and takes those that are there. --held-out trains on either half of the tuning scenes
and prints, for the other one, the area under the sparsification curve over the best one.

What is judged are maps of several methods and maps that are made wrong on purpose: planes of segments, maps of half
the size, true maps with shifted regions and blurred edges, segments moved off their surface. Each is judged alone, and
in groups of two to five.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import _env  # noqa: F401  (first: continues in the checkout's environment)
import cv2
import numpy as np
from numpy.typing import NDArray
from train_choice import TrainingScene, scenes

from depthcli.algorithms.plane_fitting.segment_planes import SegmentPlaneFit
from depthcli.algorithms.regions import RegionPixels
from depthcli.algorithms.segmentation.felzenszwalb import Felzenszwalb
from depthcli.api.stereo import with_network
from depthcli.core.config_file import load_config
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap
from depthcli.core.networks import TrainedNetwork
from depthcli.core.result import Clock
from depthcli.evaluation.curves import sparsification
from depthcli.io.formats.networks import write_network
from depthcli.methods.fusion.config import FuseConfig
from depthcli.methods.given_maps import HIDDEN, RIGHT_NAMES, THRESHOLDS, Judged, judged_maps
from depthcli.methods.given_maps._planes import ALONE, INPUTS, ONE_VIEW, OTHERS, Evidence
from depthcli.methods.stereo.config import StereoConfig
from depthcli.methods.stereo.refinement.background_fill import fill_background
from depthcli.run.presets import find_config

METHODS = (
    "opencv-sgbm", "ad-census", "opencv-bm", "thesis/cross", "opencv-sgbm-wls", "fast", "accurate", "fuse accurate",
)  # fmt: skip
GROUPS = ((2, False), (3, False), (4, False), (1, True), (2, True), (4, True), (4, True))
"""Sizes of the groups that are judged, and whether the map of stereo fast and the median are added, as in a fusion."""
ZOOM = 1.5
_RANKING = 0.5  # weight of the order of maps beside their chances
_NO_VALUE = 1000.0  # error of a pixel without a value, pixels

Map = NDArray[np.float32]


def zoomed(scene: TrainingScene) -> TrainingScene:
    """Return the scene enlarged: larger disparities, blurred edges."""

    def load() -> tuple[StereoPair, int, Map, dict[str, NDArray[np.bool_]]]:
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
    """Return the scenes of the networks that choose, and the real ones enlarged."""
    found = list(scenes(data))
    return found + [zoomed(scene) for scene in found if scene.name.startswith("middlebury") and scene.name[-1] == "_"]


def noise(rng: np.random.Generator, shape: tuple[int, ...], sigma: float) -> Map:
    """Return smooth noise of variance 1."""
    field = cv2.GaussianBlur(rng.normal(size=shape).astype(np.float32), (0, 0), sigma)
    return np.asarray(field / field.std(), np.float32)


def without_gaps(values: Map, largest: int) -> Map:
    holed = DisparityMap(np.where(np.isfinite(values), values, np.float32(np.nan)), np.zeros(values.shape, np.uint8))
    return np.nan_to_num(fill_background(holed).values).clip(0, largest)


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
    small = StereoPair(
        *(cv2.resize(one, (width // 2, height // 2), interpolation=cv2.INTER_AREA) for one in pair.color8)
    )
    half = matched("fast", small, max(largest // 2 + 1, 8)).values
    made["half"] = cv2.resize(np.nan_to_num(half) * 2, (width, height), interpolation=cv2.INTER_LINEAR)
    changed = without_gaps(np.where(truth > 0, truth, np.float32(np.nan)), largest)
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


def matched(name: str, pair: StereoPair, largest: int) -> DisparityMap:
    """Return the map of a preset of stereo, or of ``fuse NAME``."""
    if name.startswith("fuse "):
        fusion = with_network(load_config(FuseConfig, find_config("fuse", name.removeprefix("fuse "))))
        return fusion(pair, largest).disparity
    return load_config(StereoConfig, find_config("stereo", name)).pipeline(pair, largest).disparity


@dataclass(frozen=True)
class Samples:
    """Pixels of a scene.

    Attributes
    ----------
    alone : (M, P, len(ALONE)) float16, of M maps
    errors : (M, P) float16, pixels, of these maps
    hidden : (P,) bool, hidden in the right view
    groups : index of maps in a group (N,), and its planes (N, P, len(OTHERS)) float16
    """

    alone: NDArray[np.float16]
    errors: NDArray[np.float16]
    hidden: NDArray[np.bool_]
    groups: list[tuple[NDArray[np.int64], NDArray[np.float16]]]

    @classmethod
    def of(cls, scene: TrainingScene) -> Samples:
        """Match the pair of a scene in all ways, and take one of ``2 pixel_step`` pixels."""
        pair, largest, truth, masks = scene.load()
        rng = np.random.default_rng(zlib.crc32(scene.name.encode()))
        maps = {name: matched(name, pair, largest) for name in METHODS}
        values = {name: one.values for name, one in maps.items()} | made_wrong(pair, largest, truth, maps, rng)
        known = np.flatnonzero((np.isfinite(truth) & (truth > 0)).ravel())
        pixels = np.sort(rng.choice(known, known.size // (2 * scene.pixel_step), replace=False))
        evidence = Evidence.of(pair, largest, Clock())
        names, groups = list(values), list[tuple[NDArray[np.int64], NDArray[np.float16]]]()
        alone, errors = [], []

        def keep(judged: Judged) -> int:
            alone.append(judged.alone.reshape(len(ALONE), -1)[:, pixels].T.astype(np.float16))
            error = np.where(judged.missing, _NO_VALUE, np.abs(judged.values - truth)).ravel()[pixels]
            errors.append(np.minimum(error, _NO_VALUE).astype(np.float16))
            return len(alone) - 1

        for one in [*values.values(), evidence.reference.values]:
            keep(judged_maps(evidence, [one])[0])
        for size, completed in GROUPS:
            members = [int(k) for k in rng.choice(len(names), size, replace=False)]
            given = [values[names[k]] for k in members]
            if completed:
                given.append(evidence.reference.values)
                members.append(len(names))
            count = len(given)
            if completed and count > 2:  # one more that agrees with most: of an even number the lower one in the middle
                whole = np.stack([without_gaps(one, largest) for one in given])
                given.append(np.partition(whole, (count - 1) // 2, axis=0)[(count - 1) // 2])
            judged = judged_maps(evidence, given)
            members += [keep(one) for one in judged[count:]]
            others = np.stack([one.others.reshape(len(OTHERS), -1)[:, pixels].T for one in judged])
            groups.append((np.array(members), others.astype(np.float16)))
        hidden = (masks["all"] & ~masks["nonocc"]).ravel()[pixels]
        return cls(np.stack(alone), np.stack(errors), hidden, groups)

    def write(self, file: Path) -> None:
        """Write what :meth:`read` reads."""
        file.parent.mkdir(parents=True, exist_ok=True)
        more = {
            f"{kind}_{k}": part
            for k, group in enumerate(self.groups)
            for kind, part in zip(("of", "others"), group, strict=True)
        }
        np.savez(file, alone=self.alone, errors=self.errors, hidden=self.hidden, **more)

    @classmethod
    def read(cls, file: Path) -> Samples:
        stored = np.load(file)
        count = sum(name.startswith("of_") for name in stored.files)
        groups = [(stored[f"of_{k}"], stored[f"others_{k}"]) for k in range(count)]
        return cls(stored["alone"], stored["errors"], stored["hidden"], groups)


Batch = tuple[NDArray[np.float16], NDArray[np.float16], NDArray[np.float32]]
"""Inputs (P, N, F), errors (P, N) pixels, weights (P,)."""


def batches_of(samples: list[tuple[float, Samples]]) -> dict[int, Batch]:
    """Return number of maps in a group -> all its pixels; 1: maps that are judged alone."""
    parts: dict[int, list[Batch]] = {}
    for weight, one in samples:
        count, pixels, _ = one.alone.shape
        share = np.full(pixels, weight / pixels, np.float32)
        zero = np.zeros((pixels, len(OTHERS)), np.float16)
        for k in range(count):
            inputs = np.concatenate([one.alone[k], zero], axis=1)[:, None]
            parts.setdefault(1, []).append((inputs, one.errors[k][:, None], share))
        for members, others in one.groups:
            inputs = np.concatenate([one.alone[members], others], axis=2).transpose(1, 0, 2)
            parts.setdefault(len(members), []).append((inputs, one.errors[members].T, share))
    return {n: tuple(np.concatenate(arrays) for arrays in zip(*found, strict=True)) for n, found in parts.items()}  # type: ignore[misc]


def fit(
    batches: dict[int, Batch],
    thresholds: tuple[float, ...],
    sizes: tuple[int, int],
    epochs: int,
    seed: int,
    decay: float = 1e-3,
) -> tuple[NDArray[np.float32], NDArray[np.float32], list[NDArray[np.float32]]]:
    """Return mean and scale of the inputs and the layers, by gradient descent (Adam).

    Of every pixel the chance of each map to be right within a threshold chosen at random is learned; in groups also
    that the likeliest map is right.
    """
    rng = np.random.default_rng(seed)
    some = np.concatenate(
        [x.reshape(-1, x.shape[2])[:: max(1, x.shape[0] * x.shape[1] // 100_000)] for x, *_ in batches.values()]
    )
    mean, scale = some.astype(np.float32).mean(0), 1 / (some.astype(np.float32).std(0) + 1e-3)
    features = mean.size
    average = {n: float(w.mean()) for n, (_, _, w) in batches.items()}
    shapes = [(features, sizes[0]), (len(thresholds), sizes[0]), sizes, (sizes[1],), (sizes[1], 1), (1,)]
    layers = [
        (rng.normal(size=s) * np.sqrt(2 / s[0]) if k % 2 == 0 else np.zeros(s)).astype(np.float32)
        for k, s in enumerate(shapes)
    ]
    first, second = ([np.zeros_like(one) for one in layers] for _ in range(2))
    rows = 2048
    order = [n for n, (x, *_) in batches.items() for _ in range(x.shape[0] * n // rows)]
    done, steps = 0, epochs * len(order)
    for _ in range(epochs):
        shuffled = {
            n: iter(np.array_split(rng.permutation(x.shape[0]), max(1, x.shape[0] * n // rows)))
            for n, (x, *_) in batches.items()
        }
        for n in rng.permutation(order):
            chosen = np.sort(next(shuffled[n]))
            x, errors, weights = (array[chosen] for array in batches[n])
            weights = np.minimum(weights / average[n], 8)[:, None]
            pixels = len(chosen)
            k = rng.integers(0, len(thresholds), pixels)
            wanted = (errors.astype(np.float32) <= np.array(thresholds, np.float32)[k][:, None]).astype(np.float32)
            scaled = np.clip((x.astype(np.float32) - mean) * scale, -4, 4).reshape(pixels * n, features)
            which = np.repeat(np.eye(len(thresholds), dtype=np.float32)[k], n, axis=0)
            h1 = np.maximum(scaled @ layers[0] + which @ layers[1], 0)
            h2 = np.maximum(h1 @ layers[2] + layers[3], 0)
            odds = (h2 @ layers[4] + layers[5]).reshape(pixels, n)
            change = 1 / (1 + np.exp(-np.clip(odds, -30, 30))) - wanted
            if n > 1:
                shares = np.exp(odds - odds.max(1, keepdims=True))
                shares /= shares.sum(1, keepdims=True)
                hit = (shares * wanted).sum(1, keepdims=True)
                change += _RANKING * n * np.where(hit > 1e-4, shares - shares * wanted / np.maximum(hit, 1e-4), 0)
            gradient = (change * weights / (pixels * n)).reshape(-1, 1)
            back2 = (gradient @ layers[4].T) * (h2 > 0)
            back1 = (back2 @ layers[2].T) * (h1 > 0)
            changes = [scaled.T @ back1, which.T @ back1, h1.T @ back2, back2.sum(0), h2.T @ gradient, gradient.sum(0)]
            done += 1
            speed = 3e-3 * 0.5 * (1 + np.cos(np.pi * done / steps))
            for j, slope in enumerate(changes):
                slope = slope + (decay * layers[j] if j % 2 == 0 else 0)
                first[j] = 0.9 * first[j] + 0.1 * slope
                second[j] = 0.999 * second[j] + 0.001 * slope**2
                step = first[j] / (1 - 0.9**done) / (np.sqrt(second[j] / (1 - 0.999**done)) + 1e-8)
                layers[j] -= (speed * step).astype(np.float32)
    return mean, scale, layers


def trained(
    samples: list[tuple[float, Samples]], names: list[str], epochs: int, seed: int
) -> dict[str, TrainedNetwork]:
    """Return the networks ``map_right``, ``map_hidden`` and ``map_one_view``."""

    def network(fitted: Any, maps: tuple[str, ...], inputs: tuple[str, ...]) -> TrainedNetwork:
        mean, scale, (w1, b1, w2, b2, w3, b3) = fitted
        return TrainedNetwork(maps, inputs, mean, scale, ((w1, b1), (w2, b2), (w3, b3)), tuple(names))

    batches = batches_of(samples)
    right = network(fit(batches, THRESHOLDS, (64, 32), epochs, seed), RIGHT_NAMES, INPUTS)
    x, _, weights = batches.pop(1)
    hidden = np.concatenate([np.where(one.hidden, 0, 1).astype(np.float16) for _, one in samples for _ in one.alone])
    alone = np.ascontiguousarray(x[:, :, : len(ALONE)])
    columns = [ALONE.index(name) for name in ONE_VIEW]
    shape = np.ascontiguousarray(x[:, :, columns])
    errors = np.concatenate([each[:, None] for _, one in samples for each in one.errors])
    one_view = fit({1: (shape, errors, weights)}, THRESHOLDS, (32, 16), epochs, seed)
    return {
        "map_one_view": network(one_view, RIGHT_NAMES, ONE_VIEW),
        "map_right": right,
        "map_hidden": network(
            fit({1: (alone, hidden[:, None], weights)}, (0.5,), (32, 16), epochs, seed), (HIDDEN,), ALONE
        ),
    }


def odds_of(network: TrainedNetwork, inputs: NDArray[Any], row: int) -> Map:
    """Return the log odds (P,) of inputs (P, F), without the kernel."""
    (w1, b1), (w2, b2), (w3, b3) = network.layers
    parts = []
    for start in range(0, len(inputs), 200_000):
        scaled = np.clip((inputs[start : start + 200_000].astype(np.float32) - network.mean) * network.scale, -4, 4)
        parts.append((np.maximum(np.maximum(scaled @ w1 + b1[row], 0) @ w2 + b2, 0) @ w3 + b3)[:, 0])
    return np.concatenate(parts)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--samples", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--held-out", action="store_true")
    options = parser.parse_args()
    found = training_scenes(options.data)
    with ProcessPoolExecutor(options.jobs) as pool:
        parts = range(len(found))
        collected = list(pool.map(_collect, [options.data] * len(found), parts, [options.samples] * len(found)))
    if options.held_out:
        for half in (0, 1):
            learned = trained(
                [(s.weight, c) for s, c in zip(found, collected, strict=True) if s.half != half],
                [],
                options.epochs,
                options.seed,
            )
            for scene, one in zip(found, collected, strict=True):
                if scene.half == half and scene.weight == 1:
                    _print_figures(scene.name, one, learned["map_right"])
        return 0
    networks = trained(
        [(s.weight, c) for s, c in zip(found, collected, strict=True)],
        [s.name for s in found],
        options.epochs,
        options.seed,
    )
    options.out.mkdir(parents=True, exist_ok=True)
    for name, network in networks.items():
        write_network(options.out / f"{name}.json", network)
    return 0


def _collect(data: Path, number: int, folder: Path | None) -> Samples:
    scene = training_scenes(data)[number]
    file = None if folder is None else folder / f"{scene.name}.npz"
    if file is not None and file.exists():
        return Samples.read(file)
    samples = Samples.of(scene)
    if file is not None:
        samples.write(file)
    print(f"{scene.name}: {samples.errors.shape[1]} pixels of {samples.errors.shape[0]} maps", file=sys.stderr)
    return samples


def _print_figures(name: str, samples: Samples, network: TrainedNetwork) -> None:
    zero = np.zeros((samples.errors.shape[1], len(OTHERS)), np.float16)
    for map_name, alone, errors in zip(METHODS, samples.alone, samples.errors, strict=False):
        odds = odds_of(network, np.concatenate([alone, zero], axis=1), THRESHOLDS.index(1.0))
        line = sparsification(odds, errors > 1)
        print(f"{name} {map_name}: AUC / optimal {line.ratio:.2f}")


if __name__ == "__main__":
    sys.exit(main())

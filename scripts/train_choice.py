#!/usr/bin/env python3
"""Train the network by which `fuse` chooses among maps.

    python scripts/train_choice.py DATA OUT.json [--config accurate] [--samples FOLDER] [--left-out]

DATA is the folder of data sets. Used are the Middlebury scenes of both groups of `stereo_groups.yaml`, each of them
also from the other side (both images mirrored and swapped) where the right view's truth is known, with the right image
lit in another way, in the dark, and cut where something near touches the left border; with them generated scenes,
streets and bare rooms above all, and two scenes of twice the size.
CONFIG is a preset or config of fuse whose `maps` are to be chosen among; its present choice plays no part. FOLDER
keeps the training samples of every scene for another run. ``--left-out`` trains once without each data set, prints the
errors of the choice on that set, and writes the networks beside OUT.json.

The shipped network `accurate` is what the defaults give.

Two hidden layers of rectified units, Adam, loss per pixel: the mean over the maps of the cross entropy of
being right, and 2.5 times the negative logarithm of the share (softmax) of the maps that are right. A map within 1 px
is right, within .5 px it counts twice as much. Pixels are weighted so that nonocc, all and disc count alike, scenes so
that all data sets do.
"""

import sys
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import _env  # first: continues in the checkout's environment
import cv2
import numpy as np
from _experiments import config_of, generated_scenes, kept, real_scenes, scenes_in, show
from _training import Arrays, Batch, Map, fit, log_odds, new_layers
from numpy.typing import NDArray

from depthcli.algorithms.filters import discontinuity_mask, local_moments
from depthcli.algorithms.pixel_network import TrainedNetwork
from depthcli.core.frames import StereoPair
from depthcli.evaluation import protocols
from depthcli.evaluation.protocols.middlebury_v2 import derive_masks
from depthcli.io.formats.networks import write_network
from depthcli.io.stereo_pairs import load_pair, true_disparity
from depthcli.methods.fusion.choice import ChoiceMethod, ChosenMap, Proposals
from depthcli.methods.fusion.choice.network import AGREEING, NetworkInputs, input_names, likeliest
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.fusion.votes import WindowSupport
from depthcli.simulate.stereo_scenes import KINDS, Radiometry, make_scene

VARIANTS = {"": 1.0, "mirrored": 0.7, "lit": 0.5, "dark": 0.3, "cut": 0.5}
"""Versions of a real scene, and what each counts."""
GENERATED = 0.3
"""What a generated scene counts."""
LOOKS = ((1, 0, 0), (0.3, 2, 0), (0.1, 1, 0), (1, 2, 1), (0.3, 0, 0.5), (0.05, 2, 0.5))
"""Contrast of the walls, noise and strength of another light of the generated scenes."""
UNITS, EPOCHS = (32, 16), 6
"""Units of the two hidden layers, and passes over all samples."""
Loaded = tuple[StereoPair, int, Map, dict[str, NDArray[np.bool_]]]
"""A pair, the largest disparity, true disparities (H, W), and masks by region."""


@dataclass(frozen=True)
class TrainingScene:
    """A pair with truth, and how it is used."""

    name: str
    data_set: str  # 2001 counts as v2; generated scenes are one
    unchanged: bool  # judged when its set is left out
    weight: float  # what it counts beside the others
    pixel_step: int  # one pixel of so many is taken, chosen at random
    load: Callable[[], Loaded]


def scenes(data: Path, groups: tuple[str, ...] = ("tuning", "validation")) -> Iterator[TrainingScene]:
    """Yield the scenes to train on: real ones of these groups, and generated ones."""
    for group in groups:
        for folder, scene in real_scenes(data, group):
            data_set = folder.removeprefix("middlebury_").replace("2001", "v2")
            unused = data_set == "kitti" or (data_set, scene.name) == ("v3", "Teddy")  # which is in v2, too
            for variant, weight in () if unused else VARIANTS.items():
                if variant != "mirrored" or true_disparity(scene).right is not None:
                    name, step = f"{folder}_{scene.name}_{variant}", 40 if variant else 20
                    yield TrainingScene(name, data_set, not variant, weight, step, partial(real, scene, variant))
    for data_set, half in (("2006", "Cloth3"), ("2005", "Reindeer")):
        for scene in scenes_in(data / "middlebury_half", half):
            yield TrainingScene(f"half_{half}", data_set, False, 0.7, 40, partial(real, scene, ""))
    for name, load in generated_loaders():
        yield TrainingScene(name, "generated", True, GENERATED, 20, load)


def generated_loaders() -> Iterator[tuple[str, Callable[[], Loaded]]]:
    """Yield names of generated scenes, and what makes them."""
    for name, kind, seed, look in generated_scenes("tuning"):
        yield f"{name}_{kind}_{seed}", partial(generated, kind, seed, **look)
    for k, kind in enumerate(KINDS):
        for look, (contrast, noise, light) in enumerate(LOOKS):
            for more in (0, 100, 200, 300) if kind == "street" else (0,):
                seed = 200 + len(LOOKS) * k + look + more
                load = partial(generated, kind, seed, wall_contrast=contrast, noise=noise, light=light)
                yield f"{kind}_{seed}", load
        for seed in range(400 + 2 * k, 402 + 2 * k):
            load = partial(generated, kind, seed, wall_contrast=(0.6, 0.2)[seed % 2], dark=True)
            yield f"{kind}_{seed}_dark", load
    for seed in range(600, 612):
        look = {"wall_contrast": (0.03, 0.05, 0.1)[seed % 3], "noise": float(seed % 4 > 1)}
        yield f"room_{seed}", partial(bare_room, ("planes", "foreground")[seed % 2], seed, look)


def real(scene: Any, variant: str) -> Loaded:
    pair, truth = load_pair(scene), protocols.load("middlebury_v2")().truth(scene)
    disparity, masks = truth.values, dict(truth.masks)
    if "disc" not in masks:
        masks["disc"] = discontinuity_mask(np.nan_to_num(disparity, posinf=0), masks["nonocc"])
    if variant == "mirrored":
        stored = true_disparity(scene)
        disparity, other = (np.ascontiguousarray(one[:, ::-1]) for one in (stored.right, stored.disparity))
        masks = derive_masks(disparity, other)
        left, right = (np.ascontiguousarray(one[:, ::-1]) for one in pair.color8)
        pair = StereoPair(right, left)
    elif variant == "cut":
        return cut((pair, scene.max_disparity, disparity, masks), zlib.crc32(scene.name.encode()))
    elif variant:
        change = lit if variant == "lit" else darkened
        pair = change(pair, zlib.crc32(f"{scene.name} {variant}".encode()))
    return pair, scene.max_disparity, disparity, masks


def lit(pair: StereoPair, seed: int) -> StereoPair:
    """Return the pair with noise, the right image under slowly changing light and at another exposure."""
    rng = np.random.default_rng(seed)
    left, right = pair.color8
    height, width = pair.shape
    field = rng.uniform(0.6, 1.25, (3, 4)) if seed % 2 else np.full((3, 4), rng.uniform(0.65, 1.2))
    field = cv2.resize(field.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)[:, :, None]
    field = field * rng.uniform(0.95, 1.05, 3)
    changed = 255 * (right / 255.0) ** rng.uniform(0.8, 1.25) * field + rng.uniform(-6, 6)
    levels = ((left, (0, 1.5)), (changed, (0, 1.5, 3)))
    noisy = [image + rng.normal(0, rng.choice(some), image.shape) for image, some in levels]
    first, second = (np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in noisy)
    return StereoPair(first, second)


def darkened(pair: StereoPair, seed: int) -> StereoPair:
    """Return the pair as two cameras see it in the dark: few grey levels, noise that grows with them."""
    rng = np.random.default_rng(seed)
    top, constant, growth = rng.uniform(12, 60), rng.uniform(0.3, 2.5), rng.uniform(0, 0.4)

    def taken(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        level = image * (top / 255)
        level = level + rng.normal(size=image.shape) * np.sqrt(constant**2 + growth**2 * level)
        return np.clip(np.rint(level), 0, 255).astype(np.uint8)

    left, right = pair.color8
    return StereoPair(taken(left), taken(right))


def generated(kind: Any, seed: int, light: float = 0, dark: bool = False, **look: float) -> Loaded:
    radiometry = Radiometry.of_strength(light) if light else None
    size = (800, 250, 96) if kind == "street" else (400, 300, 48)
    made = make_scene(kind, seed, *size, radiometry=radiometry, **look)
    masks = {"nonocc": made.nonocc, "all": np.ones_like(made.nonocc), "disc": made.disc}
    left, right = made.left, made.right
    if kind == "street":  # what the sun falls on is saturated, and there is not much color
        burnt = np.random.default_rng(seed).uniform(1, 1.8)
        pale = (burnt * (0.6 * one.mean(2, keepdims=True) + 0.4 * one) for one in (left, right))
        left, right = (np.clip(one, 0, 255).astype(np.uint8) for one in pale)
    pair = StereoPair(left, right)
    return darkened(pair, seed) if dark else pair, made.max_disparity, made.disparity_left, masks


def bare_room(kind: Any, seed: int, look: dict[str, float]) -> Loaded:
    return cut(generated(kind, seed, **look), seed)


def cut(loaded: Loaded, seed: int) -> Loaded:
    """Return the scene without what is left of a column, one of those where much is near."""
    pair, max_disparity, truth, masks = loaded
    known = np.where(np.isfinite(truth) & (truth > 0), truth, np.nan)
    columns = np.arange(int(0.08 * pair.shape[1]), int(0.45 * pair.shape[1]))
    nearest = columns[np.argsort(-np.nanmean(known[:, columns], axis=0))][: len(columns) // 4]
    first = int(np.random.default_rng(seed).choice(nearest))
    left, right, values = (np.ascontiguousarray(one[:, first:]) for one in (*pair.color8, truth))
    seen = np.arange(values.shape[1]) - np.nan_to_num(values, posinf=0) >= -0.5
    rest = {name: np.ascontiguousarray(mask[:, first:]) & (seen | (name == "all")) for name, mask in masks.items()}
    return StereoPair(left, right), max_disparity, values, rest


def propose(fusion: Fusion, pair: StereoPair, max_disparity: int) -> Proposals:
    """Return the proposals of a fusion, by running it with a choice that records them."""
    recorded: list[Proposals] = []

    class Recorder(ChoiceMethod):
        def __call__(self, proposals: Proposals) -> ChosenMap:
            recorded.append(proposals)
            return ChosenMap(proposals.values[0])

    maps = fusion.maps.model_copy(update={"choice": Recorder(), "refinement": ()})
    fusion.model_copy(update={"maps": maps})(pair, max_disparity)
    return recorded[0]


def pixel_weights(truth: NDArray[np.float32], masks: dict[str, NDArray[np.bool_]]) -> NDArray[np.float64]:
    """Return (H, W) weights of sum 1 by which nonocc, all and disc count alike, and each pixel of a region alike."""
    total = np.zeros(truth.shape)
    for name in ("nonocc", "all", "disc"):
        region = masks[name] & np.isfinite(truth) & (truth > 0)
        total += region / (3 * max(1, region.sum()))
    return total


Samples = Arrays
"""Pixels of a scene: ``inputs`` (P, N, F), ``errors`` (P, N) with sign, pixels, ``weights`` and ``regions`` (P,)."""
REGIONS = ("bare", "textured", "occluded")
"""Visible pixels whose 13 x 13 window deviates by less than 3 grey levels; other visible ones; all others."""


def samples_of(scene: TrainingScene, fusion: Fusion) -> Arrays:
    """Return one pixel of ``pixel_step`` known ones, chosen at random."""
    pair, max_disparity, truth, masks = scene.load()
    proposals, weights = propose(fusion, pair, max_disparity), pixel_weights(truth, masks).ravel()
    known = np.flatnonzero(weights > 0)
    pixels = np.sort(np.random.default_rng(5).choice(known, known.size // scene.pixel_step, replace=False))
    errors = (proposals.values.reshape(len(proposals.values), -1)[:, pixels] - truth.ravel()[pixels]).T
    rows = NetworkInputs.of(proposals).rows(pixels).astype(np.float16)
    regions = np.where(local_moments(pair.grey8[0].astype(np.float32), 13)[1] < 9, 0, 1)
    regions[~masks["nonocc"]] = 2
    arrays = {"weights": weights, "regions": regions.ravel()}
    return {"inputs": rows, "errors": errors.astype(np.float32)} | {name: a[pixels] for name, a in arrays.items()}


def train(samples: list[tuple[float, Arrays]], maps: tuple[str, ...], trained_on: list[str]) -> TrainedNetwork:
    """Fit a network to samples of scenes, each with its weight."""
    inputs, errors = (np.concatenate([one[key] for _, one in samples]) for key in ("inputs", "errors"))
    errors = np.abs(errors)
    counts = np.concatenate([scale * one["weights"] / one["weights"].sum() for scale, one in samples])
    counts = np.minimum(counts / counts.mean(), 8).astype(np.float32)[:, None]
    right = ((errors <= 1) + (errors <= 0.5).astype(np.float32)) / 2
    mean, scale = inputs.mean((0, 1), np.float32), 1 / (inputs.astype(np.float32).std((0, 1)) + 1e-3)
    number, count, size = inputs.shape
    rng = np.random.default_rng(0)
    layers = new_layers(rng, size + count, 1, UNITS)
    batch = 1024
    which, one = np.tile(np.eye(count, dtype=np.float32), (batch, 1)), np.ones((batch * count, 1), np.float32)

    def batches() -> Iterator[Batch]:
        for _ in range(EPOCHS):
            order = rng.permutation(number)
            for start in range(0, number - batch + 1, batch):
                chosen = np.sort(order[start : start + batch])
                scaled = np.clip((inputs[chosen].astype(np.float32) - mean) * scale, -4, 4).reshape(-1, size)
                yield np.concatenate([scaled, which], axis=1), one, right[chosen], counts[chosen]

    fit(layers, batches(), EPOCHS * (number // batch), ranking=2.5, decay=2.5e-3)
    w1, b1, w2, b2, w3, b3 = layers
    fitted = ((w1[:size], w1[size:] + b1), (w2, b2), (w3, b3))
    return TrainedNetwork(maps, input_names(maps), mean, scale, fitted, tuple(trained_on))


def left_out(both: list[tuple[TrainingScene, Arrays]], data_set: str, trained: TrainedNetwork) -> list[str]:
    """Return a row of how a network does on a set: mean and median scene, and regions; choice, own map, best map.

    The choice is made as :class:`NetworkChoice` does it, without the averaging over neighbors.
    """
    shares: list[list[list[float]]] = []  # of every scene, of the set and of regions, of those three and the median
    for scene, one in both:
        if scene.data_set == data_set and scene.unchanged:
            errors, odds = one["errors"], log_odds(trained, one["inputs"])
            columns = (np.ascontiguousarray(one.T)[:, :, None] for one in (errors, odds))  # images one pixel wide
            taken, _ = likeliest(*columns, WindowSupport((len(errors), 1), 1), AGREEING)
            errors = np.abs(errors)
            wrong = np.stack([np.abs(taken[:, 0]), errors[:, 1], errors.min(1), errors[:, 0]], 1) > 1
            parts = [np.ones(len(wrong), bool), *(one["regions"] == k for k in range(len(REGIONS)))]
            shares.append(
                [100 * np.average(wrong[p], 0, one["weights"][p] + 1e-12) if p.any() else [np.nan] * 4 for p in parts]
            )
    table = np.array(shares)
    mean, middle = np.nanmean(table, axis=0), np.nanmedian(table[:, 0], axis=0)
    closed = 100 * (mean[0, 3] - mean[0, 0]) / (mean[0, 3] - mean[0, 2])
    cells = [" / ".join(f"{value:.2f}" for value in row[:3]) for row in (mean[0], middle, *mean[1:])]
    return [data_set, *cells, f"{closed:.0f} %"]


def main() -> None:
    options = _env.options(__doc__, "data", "out", config="accurate", samples=None, left_out=False)
    fusion = config_of("fuse", options.config, "maps.choice=energy", "confidence=[]")
    both = []
    for scene in scenes(options.data):
        both.append((scene, kept(options.samples, scene.name, partial(samples_of, scene, fusion))))
        print(scene.name, file=sys.stderr)
    kinds = fusion.maps.kinds
    rows = []
    for without in dict.fromkeys(scene.data_set for scene, _ in both) if options.left_out else ("",):
        others = [(scene, one) for scene, one in both if scene.data_set != without]
        totals = {one: sum(s.weight for s, _ in others if s.data_set == one) for one in {s.data_set for s, _ in others}}
        samples = [(s.weight / totals[s.data_set], one) for s, one in others]
        trained = train(samples, kinds, [s.name for s, _ in others])
        out = Path(options.out)
        write_network(out.with_stem(f"{out.stem}_without_{without}") if without else out, trained)
        rows += [left_out(both, without, trained)] if without else []
    if rows:
        header = ("left out", "mean", "median scene", *REGIONS, "closed")
        show("Wrong (> 1 px), %: choice / own map / best of the maps", header, rows)


if __name__ == "__main__":
    main()

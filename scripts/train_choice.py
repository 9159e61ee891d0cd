#!/usr/bin/env python3
"""Train the network by which `fuse` chooses among maps.

    python scripts/train_choice.py DATA OUT.json [--config accurate] [--samples FOLDER] [--held-out] [--seed 0]
        [--units 32 16] [--epochs 12]

DATA is the folder of data sets. Only the tuning scenes of `stereo_groups.yaml` are used, each of them also from the
other side (both images mirrored and swapped) where the right view's truth is known, and with the right image lit in
another way; with them generated scenes, streets above all, and two tuning scenes of twice the size.
CONFIG is a preset or config of fuse whose `maps` are to be chosen among; its present choice plays no part. FOLDER
keeps the training samples of every scene for another run. ``--held-out`` trains on each half of the tuning scenes and
prints the error of the likeliest maps of the other half, shares not averaged; nothing is written.

The shipped network `accurate` is what the defaults give.

Two hidden layers of rectified units, Adam, loss per pixel: the mean over the maps of the cross entropy of
being right, and the negative logarithm of the share (softmax) of the maps that are right. A map within 1 px is right,
within .5 px it counts twice as much. Pixels are weighted so that nonocc, all and disc count alike.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import _env  # noqa: F401  (first: continues in the checkout's environment)
import numpy as np
import yaml
from numpy.typing import NDArray

from depthcli.core.config_file import load_config
from depthcli.core.frames import StereoPair
from depthcli.core.networks import TrainedNetwork
from depthcli.evaluation import protocols
from depthcli.evaluation.protocols.middlebury_v2 import derive_masks
from depthcli.io.formats.networks import write_network
from depthcli.io.walk import discover_scenes
from depthcli.methods.fusion.choice import ChoiceMethod, ChosenMap, Proposals
from depthcli.methods.fusion.choice.network import NetworkInputs, input_names
from depthcli.methods.fusion.config import FuseConfig
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.run.presets import find_config
from depthcli.simulate.stereo_scenes import KINDS, Radiometry, make_scene

GROUPS = Path(__file__).resolve().parent / "stereo_groups.yaml"
VARIANTS = {"": 1.0, "mirrored": 0.7, "lit": 0.5, "dark": 0.3}
"""Versions of a real scene, and what each counts."""
GENERATED = 0.3
"""What a generated scene counts."""
LOOKS = ((1, 0, 0), (0.3, 2, 0), (0.1, 1, 0), (1, 2, 1), (0.3, 0, 0.5), (0.05, 2, 0.5))
"""Contrast of the walls, noise and strength of another light of the generated scenes."""


@dataclass(frozen=True)
class TrainingScene:
    """A pair with truth, and how it is used.

    Attributes
    ----------
    half : 0 or 1, the half of the tuning scenes that it belongs to; related scenes are together
    weight : what it counts beside the others
    pixel_step : one pixel of so many is taken, chosen at random
    load : gives the pair, the largest disparity, true disparities (H, W), and masks by region
    """

    name: str
    half: int
    weight: float
    pixel_step: int
    load: Callable[[], tuple[StereoPair, int, NDArray[np.float32], dict[str, NDArray[np.bool_]]]]


def scenes(data: Path) -> Iterator[TrainingScene]:
    """Yield all scenes to train on."""
    half = 0
    for folder, names in yaml.safe_load(GROUPS.read_text())["tuning"].items():
        if folder == "generated":
            for name, how in names.items():
                look = how.get("wall_contrast", 1), how.get("noise", 0), 0, how.get("brightness", 1)
                for kind in how["kinds"]:
                    for seed in how["seeds"]:
                        load = generated(kind, seed, *look)
                        yield TrainingScene(f"{name}_{kind}_{seed}", seed // 2 % 2, GENERATED, 20, load)
            continue
        for scene in discover_scenes(data / folder, patterns=names):
            half = 1 - half
            for variant, weight in VARIANTS.items():
                if variant != "mirrored" or scene.truth().right is not None:
                    name, step = f"{folder}_{scene.name}_{variant}", 20 if variant else 10
                    yield TrainingScene(name, half, weight, step, real(scene, variant))
    for scene in discover_scenes(data / "middlebury_half", patterns=["Cloth3", "Reindeer"]):
        yield TrainingScene(f"half_{scene.name}", 1, 0.7, 20, real(scene, ""))
    for k, kind in enumerate(KINDS):
        for look, (contrast, noise, light) in enumerate(LOOKS):
            seed = 200 + len(LOOKS) * k + look
            for more in (0, 100, 200, 300) if kind == "street" else (0,):
                load = generated(kind, seed + more, contrast, noise, light)
                yield TrainingScene(f"{kind}_{seed + more}", seed % 2, GENERATED, 20, load)
        for seed in range(400 + 2 * k, 402 + 2 * k):
            load = generated(kind, seed, (0.6, 0.2)[seed % 2], dark=True)
            yield TrainingScene(f"{kind}_{seed}_dark", seed % 2, GENERATED, 20, load)


def real(scene: Any, variant: str) -> Callable[[], Any]:
    def load() -> tuple[StereoPair, int, NDArray[np.float32], dict[str, NDArray[np.bool_]]]:
        pair, truth = scene.load(), protocols.load("middlebury_v2")().truth(scene)
        disparity, masks = truth.disparity, dict(truth.masks)
        if variant == "mirrored":
            stored = scene.truth()
            disparity, other = (np.ascontiguousarray(one[:, ::-1]) for one in (stored.right, stored.disparity))
            masks = derive_masks(disparity, other)
            left, right = (np.ascontiguousarray(one[:, ::-1]) for one in pair.color8)
            pair = StereoPair(right, left)
        if variant == "lit":
            pair = lit(pair, zlib.crc32(f"{scene.name} {variant}".encode()))
        if variant == "dark":
            pair = darkened(pair, zlib.crc32(f"{scene.name} {variant}".encode()))
        return pair, scene.max_disparity, disparity, masks

    return load


def lit(pair: StereoPair, seed: int) -> StereoPair:
    """Return the pair with noise, the right image under slowly changing light and at another exposure."""
    import cv2

    rng = np.random.default_rng(seed)
    left, right = pair.color8
    height, width = pair.shape
    field = rng.uniform(0.6, 1.25, (3, 4)) if seed % 2 else np.full((3, 4), rng.uniform(0.65, 1.2))
    field = cv2.resize(field.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)[:, :, None]
    field = field * rng.uniform(0.95, 1.05, 3)
    changed = 255 * (right / 255.0) ** rng.uniform(0.8, 1.25) * field + rng.uniform(-6, 6)
    noisy = [
        image + rng.normal(0, rng.choice(levels), image.shape)
        for image, levels in ((left, (0, 1.5)), (changed, (0, 1.5, 3)))
    ]
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


def generated(
    kind: Any, seed: int, contrast: float, noise: float = 0, light: float = 0, brightness: float = 1, dark: bool = False
) -> Callable[[], Any]:
    def load() -> tuple[StereoPair, int, NDArray[np.float32], dict[str, NDArray[np.bool_]]]:
        radiometry = Radiometry.of_strength(light) if light else None
        size = (800, 250, 96) if kind == "street" else (400, 300, 48)
        look = {"wall_contrast": contrast, "noise": noise, "brightness": brightness}
        made = make_scene(kind, seed, *size, radiometry=radiometry, **look)  # type: ignore[arg-type]
        masks = {"nonocc": made.nonocc, "all": np.ones_like(made.nonocc), "disc": made.disc}
        left, right = made.left, made.right
        if kind == "street":  # what the sun falls on is saturated, and there is not much color
            burnt = np.random.default_rng(seed).uniform(1, 1.8)
            left, right = (
                np.clip(burnt * (0.6 * one.mean(2, keepdims=True) + 0.4 * one), 0, 255).astype(np.uint8)
                for one in (left, right)
            )
        pair = StereoPair(left, right)
        return darkened(pair, seed) if dark else pair, made.max_disparity, made.disparity_left, masks

    return load


def propose(fusion: Fusion, pair: StereoPair, max_disparity: int) -> Proposals:
    """Return the proposals of a fusion, by running it with a choice that records them."""
    recorded: list[Proposals] = []

    class Recorder(ChoiceMethod):
        def __call__(self, proposals: Proposals) -> ChosenMap:
            recorded.append(proposals)
            return ChosenMap(proposals.values[0])

    assert fusion.maps is not None
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


@dataclass(frozen=True)
class TrainingSamples:
    """Pixels of a scene: inputs (P, N, F) float16, errors (P, N) float32 pixels, weights (P,)."""

    inputs: NDArray[np.float16]
    errors: NDArray[np.float32]
    weights: NDArray[np.float64]

    @classmethod
    def of(
        cls, proposals: Proposals, truth: NDArray[np.float32], weights: NDArray[np.float64], pixel_step: int
    ) -> TrainingSamples:
        """Return one pixel of ``pixel_step`` known ones, chosen at random."""
        known = np.flatnonzero(weights.ravel() > 0)
        pixels = np.sort(np.random.default_rng(5).choice(known, known.size // pixel_step, replace=False))
        errors = np.abs(proposals.values.reshape(len(proposals.values), -1)[:, pixels] - truth.ravel()[pixels]).T
        rows = NetworkInputs.of(proposals).rows(pixels).astype(np.float16)
        return cls(rows, errors.astype(np.float32), weights.ravel()[pixels])


def train(
    samples: list[tuple[float, TrainingSamples]],
    maps: tuple[str, ...],
    trained_on: list[str],
    seed: int,
    epochs: int,
    sizes: tuple[int, int],
    decay: float = 1e-3,
) -> TrainedNetwork:
    """Fit a network to samples of scenes, each with its weight."""
    inputs = np.concatenate([one.inputs for _, one in samples])
    errors = np.concatenate([one.errors for _, one in samples])
    counts = np.concatenate([scale * one.weights / one.weights.sum() for scale, one in samples])
    counts = np.minimum(counts / counts.mean(), 8).astype(np.float32)
    right = ((errors <= 1) + (errors <= 0.5).astype(np.float32)) / 2
    wide = inputs.astype(np.float32)
    mean, scale = wide.mean((0, 1)), 1 / (wide.std((0, 1)) + 1e-3)
    del wide
    number, count, size = inputs.shape
    rng = np.random.default_rng(seed)
    shapes = [(size + count, sizes[0]), sizes, (sizes[1], 1)]
    layers = [[rng.normal(size=s) * np.sqrt(2 / s[0]), np.zeros(s[1])] for s in shapes]
    layers = [[array.astype(np.float32) for array in layer] for layer in layers]
    first = [[np.zeros_like(array) for array in layer] for layer in layers]
    second = [[np.zeros_like(array) for array in layer] for layer in layers]
    batch, fastest = 1024, 3e-3
    steps, done = epochs * (number // batch), 0
    which = np.tile(np.eye(count, dtype=np.float32), (batch, 1))
    for _ in range(epochs):
        order = rng.permutation(number)
        for start in range(0, number - batch + 1, batch):
            chosen = np.sort(order[start : start + batch])
            scaled = np.clip((inputs[chosen].astype(np.float32) - mean) * scale, -4, 4).reshape(batch * count, size)
            outputs = [np.concatenate([scaled, which], axis=1)]
            for weights, offsets in layers[:-1]:
                outputs.append(np.maximum(outputs[-1] @ weights + offsets, 0))
            predicted = (outputs[-1] @ layers[-1][0] + layers[-1][1]).reshape(batch, count)
            wanted = right[chosen]
            chance = 1 / (1 + np.exp(-np.clip(predicted, -30, 30)))
            shares = np.exp(predicted - predicted.max(1, keepdims=True))
            shares /= shares.sum(1, keepdims=True)
            hit = (shares * wanted).sum(1, keepdims=True)
            pull = np.where(hit > 1e-4, shares - shares * wanted / np.maximum(hit, 1e-4), 0)
            gradient = (((chance - wanted) / count + pull) * counts[chosen][:, None] / batch).reshape(-1, 1)
            done += 1
            speed = fastest * 0.5 * (1 + np.cos(np.pi * done / steps))
            for k in (2, 1, 0):
                weights = layers[k][0]
                changes = (outputs[k].T @ gradient + decay * weights, gradient.sum(0))
                if k:
                    gradient = (gradient @ weights.T) * (outputs[k] > 0)
                for j, change in enumerate(changes):
                    first[k][j] = 0.9 * first[k][j] + 0.1 * change
                    second[k][j] = 0.999 * second[k][j] + 0.001 * change**2
                    step = (first[k][j] / (1 - 0.9**done)) / (np.sqrt(second[k][j] / (1 - 0.999**done)) + 1e-8)
                    layers[k][j] -= (speed * step).astype(np.float32)
    (w1, b1), (w2, b2), (w3, b3) = layers
    fitted = ((w1[:size], w1[size:] + b1), (w2, b2), (w3, b3))
    return TrainedNetwork(maps, input_names(maps), mean, scale, fitted, tuple(trained_on))


def log_odds(trained: TrainedNetwork, inputs: NDArray[Any]) -> NDArray[np.float32]:
    """Return the log odds (P, N) float32 that a network gives for (P, N, F) inputs, computed without the kernel."""
    (w1, b1), (w2, b2), (w3, b3) = trained.layers
    scaled = np.clip((inputs.astype(np.float32) - trained.mean) * trained.scale, -4, 4)
    hidden = np.maximum(scaled @ w1 + b1, 0)
    return (np.maximum(hidden @ w2 + b2, 0) @ w3 + b3)[:, :, 0]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--config", default="accurate")
    parser.add_argument("--samples", type=Path)
    parser.add_argument("--held-out", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--units", type=int, nargs=2, default=(32, 16), help="of the two hidden layers, multiples of 4")
    parser.add_argument("--epochs", type=int, default=12)
    options = parser.parse_args()
    fusion = load_config(FuseConfig, find_config("fuse", options.config), ("maps.choice=energy", "confidence=[]"))
    assert fusion.maps is not None
    all_samples: list[tuple[int, float, TrainingSamples]] = []
    trained_on = []
    for scene in scenes(options.data):
        file = options.samples / f"{scene.name}.npz" if options.samples else None
        if file is not None and file.exists():
            stored = np.load(file)
            samples = TrainingSamples(stored["inputs"], stored["errors"], stored["weights"])
        else:
            pair, max_disparity, truth, masks = scene.load()
            proposals = propose(fusion, pair, max_disparity)
            samples = TrainingSamples.of(proposals, truth, pixel_weights(truth, masks), scene.pixel_step)
            if file is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
                np.savez(file, inputs=samples.inputs, errors=samples.errors, weights=samples.weights)
        all_samples.append((scene.half, scene.weight, samples))
        trained_on.append(scene.name)
        print(f"{scene.name}: {100 * (samples.errors.min(1) > 1).mean():.2f} % out of reach", file=sys.stderr)
    kinds = fusion.maps.kinds

    def network_of(samples: list[tuple[float, TrainingSamples]]) -> TrainedNetwork:
        return train(samples, kinds, trained_on, options.seed, options.epochs, tuple(options.units))

    if options.held_out:
        for half in (0, 1):
            trained = network_of([(w, one) for h, w, one in all_samples if h != half])
            for name, (h, w, one) in zip(trained_on, all_samples, strict=True):
                if h == half and w == 1:
                    errors = np.take_along_axis(one.errors, log_odds(trained, one.inputs).argmax(1)[:, None], axis=1)
                    wrong = 100 * float((one.weights * (errors[:, 0] > 1)).sum() / one.weights.sum())
                    print(f"{name}: {wrong:.2f} % wrong")
        return 0
    write_network(options.out, network_of([(w, one) for _, w, one in all_samples]))
    return 0


if __name__ == "__main__":
    sys.exit(main())

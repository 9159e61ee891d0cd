#!/usr/bin/env python3
"""Chapter 7: how well confidence and expected error of registrations say where they are wrong, in tables.

    scripts/registration_experiments.py PAIRS [--only real,synthetic,baselines,speed] [--presets NAME,NAME]

PAIRS is what ``scripts/register_pairs.py`` wrote. ``real``: every measure at the landmarks of registered pairs,
Spearman, AUC above 3 mm, mean absolute error of expected against true; ``synthetic``: the fixed volumes moved by
random B-splines of at most 3, 6 and 10 mm, with noise (25 HU, or 3 % of the range of a magnetic resonance image), at
every voxel of interest; ``baselines``: local variance and the Jacobian's determinant; ``speed``: seconds for 3.2
million voxels. Everything is seeded.
"""

from collections.abc import Iterable
from functools import partial
from typing import Any

import _env  # (first: continues in the checkout's environment)
import numpy as np
from _experiments import config_of, seconds_in_turns, show
from numpy.typing import NDArray
from register_pairs import displacement_field

from depthcli.algorithms.resampling import gaussian, trilinear
from depthcli.core.volumes import RegisteredPair
from depthcli.evaluation.render import Number
from depthcli.evaluation.statistics import correlation, ranks, roc_area
from depthcli.io.formats.fields import in_millimeters, read_field
from depthcli.io.formats.volumes import simple_itk
from depthcli.io.layouts.registration import VOLUMES
from depthcli.io.scenes import VolumePairScene
from depthcli.io.volume_pairs import load_volumes, true_errors
from depthcli.io.walk import discover_scenes
from depthcli.methods.registration.feature.mind import Mind
from depthcli.methods.registration.pipeline import RegistrationResult
from depthcli.methods.registration.pipeline.search import RegistrationSearch
from depthcli.methods.registration.search import SURER_IF_LARGER, search
from depthcli.simulate.deformed_volumes import smooth_noise

Values = NDArray[np.floating[Any]]

SEED = 11
HEAD = ("pair", "what", "Spearman", "AUC > 3 mm", "MAE mm", "expected mm", "true mm", "points")


def pipeline(preset: str, *settings: str) -> RegistrationSearch:
    return config_of("register-confidence", preset, *settings).pipeline


def row(pair: str, what: str, score: Values, true: Values, in_mm: bool = True) -> tuple[str, ...]:
    expected = np.asarray(score, np.float64)
    millimeters = (float(np.abs(expected - true).mean()), float(expected.mean())) if in_mm else (np.nan, np.nan)
    spearman = correlation(ranks(expected), ranks(np.asarray(true, np.float64)))
    figures = (spearman, roc_area(expected, true > 3), *millimeters, float(true.mean()))
    return pair, what, *(Number(v, 3 if k < 2 else 2) for k, v in enumerate(figures)), str(len(true))


def at_points(result: RegistrationResult, values: NDArray[np.float32], places: NDArray[np.float64]) -> Values:
    """Values of a map at places (z, y, x) in voxels of the fixed volume."""
    return trilinear(values, (places - np.array(result.start)) / np.array(result.step))


def real(scenes: list[VolumePairScene], presets: Iterable[str]) -> None:
    rows = []
    for scene in scenes:
        loaded, truth = load_volumes(scene), true_errors(scene)
        places = loaded.grid.to_index(truth.points)
        for preset in presets:
            result = pipeline(preset)(loaded.pair)
            rows.append(row(scene.name, preset, at_points(result, result.expected_error, places), truth.error))
            if preset == "mind":
                for name, values in result.measures.items():  # larger: less sure
                    score = (-1 if name in SURER_IF_LARGER else 1) * at_points(result, values, places)
                    rows.append(row(scene.name, f"mind {name}", score, truth.error, name.endswith("shift")))
            rows.append((scene.name, f"{preset}: border", f"{100 * result.figures['border']:.0f} %", *[""] * 5))
    show("Real registrations, at landmarks", HEAD, rows)


def spline_error(pair: RegisteredPair, largest: float, seed: int) -> NDArray[np.float32]:
    """(3, Z, Y, X) displacement z, y, x in mm of a random cubic B-spline with knots every 30 mm."""
    sitk = simple_itk()
    image = sitk.Image([int(n) for n in pair.shape[::-1]], sitk.sitkUInt8)
    image.SetSpacing([float(s) for s in pair.spacing[::-1]])
    mesh = [max(1, round(n * s / 30)) for n, s in zip(pair.shape[::-1], pair.spacing[::-1], strict=True)]
    spline = sitk.BSplineTransformInitializer(image, mesh, 3)
    rng = np.random.default_rng([SEED, seed])
    spline.SetParameters(rng.standard_normal(len(spline.GetParameters())).tolist())
    vectors = np.moveaxis(sitk.GetArrayFromImage(displacement_field(spline, image)), -1, 0)[::-1]
    length = np.linalg.norm(vectors, axis=0)
    inside = np.ones(pair.shape, np.bool_) if pair.mask is None else pair.mask
    return np.asarray(vectors * (largest / length[inside].max()), np.float32)


def moved(volume: NDArray[np.float32], field: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return trilinear samples at x + field(x), (3, Z, Y, X) voxels; borders are repeated."""
    places = np.indices(volume.shape) + field
    return trilinear(volume, places.reshape(3, -1).T.astype(np.float64)).reshape(volume.shape)


def misregistered(pair: RegisteredPair, largest: float, seed: int) -> tuple[RegisteredPair, NDArray[np.float32]]:
    """The fixed volume moved by a random B-spline, with noise in both, and the exact error, mm."""
    spacing = np.array(pair.spacing, np.float32).reshape(3, 1, 1, 1)
    field = spline_error(pair, largest, seed) / spacing
    fixed = np.maximum(pair.fixed, -1000) if pair.fixed.min() < -500 else pair.fixed
    noise = 25.0 if pair.fixed.min() < -500 else 0.03 * float(np.ptp(np.percentile(fixed, [1, 99])))
    rng = np.random.default_rng([SEED, seed, 1])
    residual = -field
    for _ in range(6):
        residual = -np.stack([moved(part, residual) for part in field])
    both = ((v + noise * rng.standard_normal(v.shape)).astype(np.float32) for v in (fixed, moved(fixed, field)))
    error = np.linalg.norm(residual * spacing, axis=0).astype(np.float32)
    return RegisteredPair(*both, pair.spacing, pair.mask), error


def synthetic(scenes: list[VolumePairScene], _: object) -> None:
    rows = []
    methods = {"mind": pipeline("mind"), "intensity": pipeline("intensity"), "cost0": pipeline("mind", "measure=cost0")}
    by_volume = {scene.name.rsplit("_", 1)[0].split("_cyc")[0]: scene for scene in reversed(scenes)}
    for base, scene in by_volume.items():
        pair = load_volumes(scene).pair
        inside = np.ones(pair.shape, np.bool_) if pair.mask is None else pair.mask
        places = np.argwhere(inside)[:: max(1, int(inside.sum()) // 20_000)].astype(np.float64)
        for k, largest in enumerate((3.0, 6.0, 10.0)):
            made, error = misregistered(pair, largest, k)
            true = trilinear(error, places)
            for name, method in methods.items():
                result = method(made)
                rows.append(row(f"{base} {largest:g} mm", name, at_points(result, result.expected_error, places), true))
    show("Synthetic B-spline errors, dense truth", HEAD, rows)


def baselines(scenes: list[VolumePairScene], _: object) -> None:
    rows = []
    for scene in scenes:
        loaded, truth = load_volumes(scene), true_errors(scene)
        places = loaded.grid.to_index(truth.points)
        fixed = loaded.pair.fixed
        mean = gaussian(fixed, 3.0)
        variance = gaussian(fixed * fixed, 3.0) - mean * mean
        rows.append(row(scene.name, "minus local variance", -trilinear(variance, places), truth.error, False))
        if scene.displacement is not None:
            field = read_field(scene.displacement, loaded.grid)
            vectors = in_millimeters(field, field.named)
            slopes = np.stack([np.stack(np.gradient(vectors[..., c], *loaded.pair.spacing), -1)[..., ::-1]
                               for c in range(3)], -2)  # fmt: skip
            determinant = np.linalg.det(slopes + np.eye(3)).astype(np.float32)
            change = trilinear(np.abs(1 - determinant), places)
            rows.append(row(scene.name, "|1 - Jacobian|", change, truth.error, False))
    show("Baselines without a search", HEAD, rows)


def speed(*_: object) -> None:
    rng = np.random.default_rng(SEED)
    volume = smooth_noise(rng, (147, 148, 148), 1.5)
    other = np.ascontiguousarray(np.roll(volume, 2, axis=2))
    channels = Mind()(volume, other)
    small = tuple(np.ascontiguousarray(c[:, :16, :16, :16]) for c in channels)
    search(*small, 1.0, stride=2)
    spans = ("cube", "planes", "axes")
    jobs = {span: partial(search, *channels, 1.0, span=span, stride=2) for span in spans}
    rows = [(f"search: {span}", Number(taken[0])) for span, taken in seconds_in_turns(jobs, 3, warm=0).items()]
    show(f"{volume.size / 1e6:.1f} million voxels, R 5, h 3", ("step", "seconds"), rows)


def main() -> None:
    parts = {part.__name__: part for part in (real, synthetic, baselines, speed)}
    options = _env.options(__doc__, "pairs", only=tuple(parts), presets=["mind", "cost0", "intensity", "coarse"])
    scenes = [scene for scene in discover_scenes(options.pairs, VOLUMES) if scene.has_truth]
    for name in options.only:
        parts[name](scenes, options.presets)


if __name__ == "__main__":
    main()

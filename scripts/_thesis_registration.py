"""Chapter 7 of the thesis: confidence of registrations."""

from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import _env
import numpy as np
from _experiments import Experiment, Rows, config_of, seconds_in_turns
from numpy.typing import NDArray
from register_pairs import EARLY, LATE, displacement_field, pairs, register, write

from depthcli.algorithms.resampling import gaussian, trilinear
from depthcli.core.errors import InputError
from depthcli.core.volumes import RegisteredPair
from depthcli.evaluation.statistics import correlation, ranks, roc_area
from depthcli.io.formats.fields import in_millimeters, read_field
from depthcli.io.formats.volumes import simple_itk
from depthcli.io.layouts.registration import VOLUMES
from depthcli.io.volume_pairs import load_volumes, true_errors
from depthcli.io.walk import discover_scenes
from depthcli.methods.registration.feature.mind import Mind
from depthcli.methods.registration.search import SURER_IF_LARGER, search
from depthcli.simulate.deformed_volumes import smooth_noise

REGISTERED = _env.ROOT / "build" / "thesis" / "registered"
PRESETS = {"cost0": "cost0", "thesis/ch7": "thesis/ch7", "mind": "mind", "intensity": "intensity", "coarse": "coarse"}
AMPLITUDES = (3.0, 6.0, 10.0)
SEED = 11


@cache
def pipeline(preset: str, *settings: str) -> Any:
    """Return a preset of register-confidence."""
    return config_of("register-confidence", preset, *settings).pipeline


def registered(data: Path) -> Iterator[tuple[str, Any]]:
    """Yield the registered pairs; those that are not in build/thesis are registered first, a minute each at most."""
    try:
        simple_itk().ProcessObject.SetGlobalDefaultNumberOfThreads(2)  # sums of the metric depend on it
    except InputError:
        return
    for pair in pairs(data):
        for kind, settings in (("a", EARLY), ("b", LATE)):
            name = f"{pair.name}_{kind}"
            if not (REGISTERED / name / "displacement.mha").exists():
                write(pair, register(pair, **settings), REGISTERED / name)
            (scene,) = (scene for scene in discover_scenes(REGISTERED, VOLUMES) if scene.name == name)
            yield name, scene


def scored(score: NDArray[Any], true: NDArray[Any], in_mm: bool = True) -> dict[str, float]:
    """Return Spearman's and Pearson's correlation, AUC of errors above 3 mm, and means in mm."""
    expected, error = np.asarray(score, np.float64), np.asarray(true, np.float64)
    cells = {"Spearman": correlation(ranks(expected), ranks(error)), "AUC": roc_area(expected, error > 3),
             "true": float(error.mean())}  # fmt: skip
    if in_mm:
        cells |= {"Pearson": correlation(expected, error), "MAE": float(np.abs(expected - error).mean())}
        classes = [np.digitize(values, (3, 6)) for values in (expected, error)]
        cells["class"] = 100 * float(np.mean(classes[0] == classes[1]))
    return cells


def at_points(result: Any, values: NDArray[np.float32], places: NDArray[np.float64]) -> NDArray[Any]:
    """Return values of a map at places (z, y, x) in voxels of the fixed volume."""
    return trilinear(values, (places - np.array(result.start)) / np.array(result.step))


def at_landmarks(scene: Any) -> Rows:
    """Return how presets, single measures and baselines without a search agree with the errors at landmarks."""
    loaded, truth = load_volumes(scene), true_errors(scene)
    places = loaded.grid.to_index(truth.points)
    rows = {}
    for preset, name in PRESETS.items():
        result = pipeline(name)(loaded.pair)
        rows[preset] = scored(at_points(result, result.expected_error, places), truth.error)
        rows[preset]["border"] = 100 * result.figures["border"]
        if preset == "mind":
            for measure, values in result.measures.items():
                score = (-1 if measure in SURER_IF_LARGER else 1) * at_points(result, values, places)
                rows[f"mind {measure}"] = scored(score, truth.error, measure.endswith("shift"))
    fixed = loaded.pair.fixed
    mean = gaussian(fixed, 3.0)
    rows["minus local variance"] = scored(
        -trilinear(gaussian(fixed * fixed, 3.0) - mean * mean, places), truth.error, False
    )
    field = read_field(scene.displacement, loaded.grid)
    vectors = in_millimeters(field, field.named)
    slopes = [np.stack(np.gradient(vectors[..., c], *loaded.pair.spacing), -1)[..., ::-1] for c in range(3)]
    determinant = np.linalg.det(np.stack(slopes, -2) + np.eye(3)).astype(np.float32)
    rows["Jacobian"] = scored(trilinear(np.abs(1 - determinant), places), truth.error, False)
    return rows


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


def volumes(data: Path) -> Iterator[tuple[str, Any]]:
    """Yield the fixed volumes: the lung, two livers."""
    found: dict[str, Any] = {}
    for name, scene in registered(data):
        base = name.rsplit("_", 1)[0].split("_cyc")[0]
        if base not in found:
            found[base] = scene
            yield base, scene


def synthetic(scene: Any) -> Rows:
    """Return how presets agree with errors made by random B-splines, at voxels of interest; rows: preset, largest."""
    pair, rows = load_volumes(scene).pair, {}
    inside = np.ones(pair.shape, np.bool_) if pair.mask is None else pair.mask
    places = np.argwhere(inside)[:: max(1, int(inside.sum()) // 20_000)].astype(np.float64)
    for k, largest in enumerate(AMPLITUDES):
        made, error = misregistered(pair, largest, k)
        true = trilinear(error, places)
        for preset in ("thesis/ch7", "mind", "intensity", "cost0"):
            result = pipeline(PRESETS[preset])(made)
            rows[f"{preset}, {largest:g} mm"] = scored(at_points(result, result.expected_error, places), true)
    return rows


def times(_: object) -> Rows:
    """Return seconds of the search in 3.2 million voxels, radius 5, half window 3."""
    volume = smooth_noise(np.random.default_rng(SEED), (147, 148, 148), 1.5)
    channels = Mind()(volume, np.ascontiguousarray(np.roll(volume, 2, axis=2)))
    jobs = {span: partial(search, *channels, 1.0, span=span, stride=2) for span in ("cube", "planes", "axes")}
    return {span: {"s": found[0]} for span, found in seconds_in_turns(jobs, 3).items()}


EXPERIMENTS = {
    "landmarks": Experiment("7", registered, at_landmarks, 1),
    "synthetic": Experiment("7", volumes, synthetic),
    "search-times": Experiment("7", lambda _: [("3.2 million voxels", None)], times),
}

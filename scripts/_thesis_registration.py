"""Chapter 7 of the thesis: confidence of registrations.

SimpleITK registers the shared lung and liver pairs by B-splines on mutual information: `a` stopped early on one coarse
grid, `b` carried on to finer ones; build/thesis/registered keeps them. Everything is seeded, and the number of threads
is fixed, because sums of the metric depend on it. dataset18/cyc_1_10.mha says 5 mm slices in its header; its landmarks
and the other volumes of the set say 4 mm, with which its slices agree: a moving volume of the fixed one's size is given
the fixed one's spacing.
"""

from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import _env
import numpy as np
from _experiments import Experiment, Rows, config_of, seconds_in_turns
from numpy.typing import NDArray

from depthcli.algorithms.resampling import gaussian, trilinear
from depthcli.core.errors import InputError
from depthcli.core.volumes import RegisteredPair
from depthcli.evaluation.statistics import correlation, ranks, roc_area
from depthcli.io.formats.fields import in_millimeters, read_field
from depthcli.io.formats.volumes import simple_itk
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.volumes import VOLUMES
from depthcli.io.volume_pairs import load_volumes, true_errors
from depthcli.methods.registration.feature.mind import Mind
from depthcli.methods.registration.search import search
from depthcli.simulate.deformed_volumes import smooth_noise

REGISTERED = _env.ROOT / "build" / "thesis" / "registered"
AMPLITUDES = (3.0, 6.0, 10.0)
SEED = 11
LIVER = (("dataset18", "cyc_1_10"), ("dataset18", "cyc_3_10"), ("dataset19", "cyc_1_6"), ("dataset19", "cyc_1_9"))
THREADS = 2
# Distance of the B-spline's knots (mm), shrink factor, smoothing sigma (voxels) of every level.
EARLY: dict[str, Any] = {"levels": [(60, 4, 2)], "iterations": 6, "samples": 20_000}
LATE: dict[str, Any] = {"levels": [(60, 4, 2), (40, 2, 1), (25, 1, 0)], "iterations": 20, "samples": 20_000}


class Pair(NamedTuple):
    name: str
    fixed: Any
    moving: Any
    masks: tuple[Any, Any] | None
    points: np.ndarray
    matches: np.ndarray


def pairs(data: Path) -> Iterator[Pair]:
    sitk = simple_itk()

    def read(file: Path) -> Any:
        return sitk.ReadImage(str(file), sitk.sitkFloat32)

    def landmarks(file: Path) -> np.ndarray:
        return np.genfromtxt(file, delimiter=",", skip_header=1)

    lung = data / "medical" / "lung_ct_pair"
    if lung.is_dir():
        table = landmarks(lung / "landmarks_part1.csv")
        masks = tuple(read(lung / f"{name}_mask.mha") > 0 for name in ("baseline", "followup"))
        scans = (read(lung / f"{name}.mha") for name in ("baseline", "followup"))
        fixed, moving = (sitk.Clamp(scan, sitk.sitkFloat32, -1000, 400) for scan in scans)
        yield Pair("lung", fixed, moving, (masks[0], masks[1]), table[:, 1:4], table[:, 4:7])
    for name, cycle in LIVER:
        folder = data / "medical" / "liver_4dmri" / name
        if not folder.is_dir():
            continue
        fixed, moving = read(folder / "exhale_master.mha"), read(folder / f"{cycle}.mha")
        if moving.GetSize() == fixed.GetSize() and moving.GetSpacing() != fixed.GetSpacing():
            moving.SetSpacing(fixed.GetSpacing())
        points = (landmarks(folder / f"{volume}_landmarks_liver.csv") for volume in ("exhale_master", cycle))
        yield Pair(f"{name}_{cycle}", fixed, moving, None, *points)


def register(pair: Pair, levels: list[tuple[float, int, float]], iterations: int, samples: int) -> Any:
    """Return the transform that maps points of the fixed volume to the moving one."""
    sitk = simple_itk()
    chain = [sitk.TranslationTransform(3)]
    if pair.masks is not None:
        centers = []
        for mask in pair.masks:
            shape = sitk.LabelShapeStatisticsImageFilter()
            shape.Execute(sitk.Cast(mask, sitk.sitkUInt8))
            centers.append(np.array(shape.GetCentroid(1)))
        chain = [sitk.TranslationTransform(3, list(centers[1] - centers[0]))]
    low = float(sitk.GetArrayViewFromImage(pair.moving).min())
    for distance, shrink, sigma in levels:
        sides = zip(pair.fixed.GetSize(), pair.fixed.GetSpacing(), strict=True)
        mesh = [max(1, round(count * spacing / distance)) for count, spacing in sides]
        spline = sitk.BSplineTransformInitializer(pair.fixed, mesh, 3)
        warped = sitk.Resample(pair.moving, pair.fixed, sitk.CompositeTransform(chain), sitk.sitkLinear, low)
        method = sitk.ImageRegistrationMethod()
        method.SetMetricAsMattesMutualInformation(32)
        voxels = np.prod([n // shrink for n in pair.fixed.GetSize()])
        method.SetMetricSamplingStrategy(method.RANDOM)
        method.SetMetricSamplingPercentage(min(1.0, samples / float(voxels)), 7)
        if pair.masks is not None:
            method.SetMetricFixedMask(sitk.Cast(pair.masks[0], sitk.sitkUInt8))
        method.SetInterpolator(sitk.sitkLinear)
        method.SetInitialTransform(spline, inPlace=True)
        method.SetShrinkFactorsPerLevel([shrink])
        method.SetSmoothingSigmasPerLevel([sigma])
        method.SetOptimizerAsLBFGSB(
            gradientConvergenceTolerance=1e-7, numberOfIterations=iterations,
            maximumNumberOfFunctionEvaluations=int(1.5 * iterations),
        )  # fmt: skip
        method.Execute(pair.fixed, warped)
        chain.append(spline)
    return sitk.CompositeTransform(chain)


def displacement_field(transform: Any, image: Any) -> Any:
    """Return the field of a transform, SimpleITK's, on the grid of an image."""
    kind, grid = simple_itk().sitkVectorFloat64, (image.GetOrigin(), image.GetSpacing(), image.GetDirection())
    return simple_itk().TransformToDisplacementField(transform, kind, image.GetSize(), *grid)


def write(pair: Pair, transform: Any, folder: Path) -> None:
    sitk = simple_itk()
    folder.mkdir(parents=True, exist_ok=True)
    fixed = pair.fixed
    low = float(sitk.GetArrayViewFromImage(pair.moving).min())
    files = {
        "fixed": fixed,
        "moving": pair.moving,
        "moving_warped": sitk.Resample(pair.moving, fixed, transform, sitk.sitkLinear, low),
        "displacement": sitk.Cast(displacement_field(transform, fixed), sitk.sitkVectorFloat32),
    }
    if pair.masks is not None:
        files["mask"] = sitk.Cast(pair.masks[0], sitk.sitkUInt8)
    for name, image in files.items():
        sitk.WriteImage(image, str(folder / f"{name}.mha"))
    for name, points in (("landmarks_fixed", pair.points), ("landmarks_moving", pair.matches)):
        np.savetxt(folder / f"{name}.csv", points, "%.4f", ",", header="x,y,z", comments="")


@cache
def pipeline(preset: str, *settings: str) -> Any:
    """Return a preset of register-confidence."""
    return config_of("register-confidence", preset, *settings).pipeline


def registered(data: Path) -> Iterator[tuple[str, Any]]:
    """Yield the registered pairs; those that are not in build/thesis are registered first, a minute each at most."""
    try:
        simple_itk().ProcessObject.SetGlobalDefaultNumberOfThreads(THREADS)
    except InputError:
        return
    for pair in pairs(data):
        for kind, settings in (("a", EARLY), ("b", LATE)):
            name = f"{pair.name}_{kind}"
            if not (REGISTERED / name / "displacement.mha").exists():
                write(pair, register(pair, **settings), REGISTERED / name)
            (scene,) = (scene for scene in discover_scenes(REGISTERED, VOLUMES) if scene.name == name)
            yield name, scene


def scored(score: NDArray[Any], true: NDArray[Any]) -> dict[str, float]:
    """Return Spearman's correlation, the AUC of errors above 3 mm, the mean error, and that of the score, mm."""
    expected, error = np.asarray(score, np.float64), np.asarray(true, np.float64)
    cells = {"Spearman": correlation(ranks(expected), ranks(error)), "AUC": roc_area(expected, error > 3)}
    return cells | {"true": float(error.mean()), "MAE": float(np.abs(expected - error).mean())}


def at_points(result: Any, values: NDArray[np.float32], places: NDArray[np.float64]) -> NDArray[Any]:
    """Return values of a map at places (z, y, x) in voxels of the fixed volume."""
    return trilinear(values, (places - np.array(result.start)) / np.array(result.step))


def at_landmarks(scene: Any) -> Rows:
    """Return how presets and baselines without a search agree with the errors at landmarks."""
    loaded, truth = load_volumes(scene), true_errors(scene)
    places = loaded.grid.to_index(truth.points)
    rows = {}
    for preset in ("cost0", "thesis/ch7", "mind"):
        result = pipeline(preset)(loaded.pair)
        rows[preset] = scored(at_points(result, result.expected_error, places), truth.error)
    fixed = loaded.pair.fixed
    mean = gaussian(fixed, 3.0)
    rows["minus local variance"] = scored(-trilinear(gaussian(fixed * fixed, 3.0) - mean * mean, places), truth.error)
    field = read_field(scene.displacement, loaded.grid)
    vectors = in_millimeters(field, field.named)
    slopes = [np.stack(np.gradient(vectors[..., c], *loaded.pair.spacing), -1)[..., ::-1] for c in range(3)]
    determinant = np.linalg.det(np.stack(slopes, -2) + np.eye(3)).astype(np.float32)
    rows["Jacobian"] = scored(trilinear(np.abs(1 - determinant), places), truth.error)
    for baseline in ("minus local variance", "Jacobian"):  # no lengths
        del rows[baseline]["MAE"]
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
    """Yield two fixed volumes: the lung, a liver."""
    yield from ((name[:-2], scene) for name, scene in registered(data) if name in ("lung_a", "dataset19_cyc_1_6_a"))


def synthetic(scene: Any) -> Rows:
    """Return how presets agree with errors made by random B-splines, at voxels of interest; rows: preset, largest."""
    pair, rows = load_volumes(scene).pair, {}
    inside = np.ones(pair.shape, np.bool_) if pair.mask is None else pair.mask
    places = np.argwhere(inside)[:: max(1, int(inside.sum()) // 20_000)].astype(np.float64)
    for k, largest in enumerate(AMPLITUDES):
        made, error = misregistered(pair, largest, k)
        true = trilinear(error, places)
        for preset in ("thesis/ch7", "mind", "intensity", "cost0"):
            result = pipeline(preset)(made)
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

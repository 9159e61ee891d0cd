#!/usr/bin/env python3
"""Register the shared lung and liver pairs with SimpleITK and write them in the layout `registration`.

    python scripts/register_pairs.py OUTPUT [DATA]

DATA is the folder of data sets (default: ../shared/data). Every pair is registered twice by B-splines on mutual
information: `a` stopped early on one coarse grid, `b` carried on to finer ones. Everything is seeded, and the number of
threads is fixed, because the metric's sums depend on it. What is written: fixed, moving, moving_warped, the
displacement field, the mask where there is one, and the landmarks.

dataset18/cyc_1_10.mha says 5 mm slices in its header; its landmarks and the other volumes of the set say 4 mm, with
which its slices agree. Where a moving volume has the fixed one's size and another spacing, it is given the fixed one's.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import _env  # (first: continues in the checkout's environment)
import numpy as np

from depthcli.io.formats.volumes import simple_itk

LIVER = (("dataset18", "cyc_1_10"), ("dataset18", "cyc_3_10"), ("dataset19", "cyc_1_6"), ("dataset19", "cyc_1_9"))
SEED = 7
THREADS = 2
# Distance of the B-spline's knots (mm), shrink factor, smoothing sigma (voxels) of every level.
EARLY: dict[str, Any] = {"levels": [(60, 4, 2)], "iterations": 6, "samples": 20_000}
LATE: dict[str, Any] = {"levels": [(60, 4, 2), (40, 2, 1), (25, 1, 0)], "iterations": 20, "samples": 20_000}


@dataclass
class Pair:
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

    lung = data / "medical" / "lung_ct_pair"
    if lung.is_dir():
        table = np.genfromtxt(lung / "landmarks_part1.csv", delimiter=",", skip_header=1)
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
            print(f"{name}/{cycle}: spacing {moving.GetSpacing()} taken as {fixed.GetSpacing()}")
            moving.SetSpacing(fixed.GetSpacing())
        points, matches = (
            np.genfromtxt(folder / f"{volume}_landmarks_liver.csv", delimiter=",", skip_header=1)
            for volume in ("exhale_master", cycle)
        )
        yield Pair(f"{name}_{cycle}", fixed, moving, None, points, matches)


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
        method.SetMetricSamplingPercentage(min(1.0, samples / float(voxels)), SEED)
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


def main() -> None:
    arguments = _env.options(__doc__, "output", "[data]")
    sitk = simple_itk()
    sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(THREADS)
    for pair in pairs(arguments.data):
        for kind, settings in (("a", EARLY), ("b", LATE)):
            transform = register(pair, **settings)
            write(pair, transform, arguments.output / f"{pair.name}_{kind}")
            print(f"{pair.name}_{kind}", flush=True)


if __name__ == "__main__":
    main()

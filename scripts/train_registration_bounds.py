#!/usr/bin/env python3
"""Make the tables by which expected errors of registrations become bounds, and check them at landmarks.

    scripts/train_registration_bounds.py DATA OUT [--samples DIR]

DATA is the folder with the test sets; OUT gets a table for each shape of the search. The registrations are those of
scripts/thesis, as they are and spoiled in known ways; --samples keeps what is measured at landmarks in a folder, and
takes what is there. Printed is what bounds of nominal 90 % cover on each patient and pair, by the table of the other
patients: of the landmarks whose bounds are finite, and beside it the share whose bounds are open.
"""

import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import _env  # first: continues in the checkout's environment
import numpy as np
from _experiments import kept, show
from _thesis_registration import at_points, pipeline, registered, spline_error
from _training import Arrays, table, write
from numpy.typing import NDArray

from depthcli.algorithms.error_table import ErrorTable
from depthcli.algorithms.resampling import trilinear
from depthcli.core.bound import VolumeBound
from depthcli.core.volumes import RegisteredPair
from depthcli.evaluation.bounds import bound_scores
from depthcli.evaluation.scores import Tally
from depthcli.io.formats.fields import in_millimeters, read_field, read_landmarks
from depthcli.io.formats.volumes import simple_itk
from depthcli.io.volume_pairs import load_volumes
from depthcli.problems.registration import bounds_of

# Share of the registration's displacement that is done, but for its mean; largest error that is added to it, mm.
STATES = {
    "": (1.0, 0.0), "moved 5": (1.0, 5.0), "moved 15": (1.0, 15.0), "half": (0.5, 0.0), "undone": (0.0, 0.0),
    "reversed": (-1.0, 0.0),
}  # fmt: skip
TAUGHT = {"cube": "mind", "planes": "planes", "axes": "axes"}  # shape of the search -> preset that its table is made of
CHECKED = {"intensity": "cube", "coarse": "cube"} | {name: shape for shape, name in TAUGHT.items()}
SHARES, REACH = np.linspace(0, 1, 17), 0.15  # of the landmarks, by their scores; bins overlap: they are few


@lru_cache(1)
def spoiled(scene: Any, state: str) -> tuple[RegisteredPair, NDArray[Any], NDArray[Any]]:
    """Return a registration in one of the states, its landmarks (z, y, x) in voxels, and their errors, mm."""
    sitk, loaded = simple_itk(), load_volumes(scene)
    fixed, moving = (sitk.ReadImage(str(file), sitk.sitkFloat32) for file in (scene.fixed, scene.moving))
    points, matches = (
        read_landmarks(file, loaded.grid, False) for file in (scene.landmarks_fixed, scene.landmarks_moving)
    )
    field = read_field(scene.displacement, loaded.grid)
    vectors, (done, largest) = in_millimeters(field, field.named), STATES[state]
    mean = vectors.mean(axis=(0, 1, 2))
    vectors = mean + done * (vectors - mean)
    if largest:
        vectors += np.moveaxis(spline_error(loaded.pair, largest, zlib.crc32(scene.name.encode()))[::-1], 0, -1)
    image = sitk.GetImageFromArray(vectors.astype(np.float64), isVector=True)
    image.CopyInformation(fixed)
    low, places = float(sitk.GetArrayViewFromImage(moving).min()), loaded.grid.to_index(points)
    warped = sitk.Resample(moving, fixed, sitk.DisplacementFieldTransform(image), sitk.sitkLinear, low)
    moved = points + np.stack([trilinear(np.float32(vectors[..., axis]), places) for axis in range(3)], -1)
    return (
        replace(loaded.pair, warped=sitk.GetArrayFromImage(warped)), places, np.linalg.norm(moved - matches, axis=1)
    )  # fmt: skip


def sampled(scene: Any, state: str, preset: str) -> Arrays:
    """Return scores, expected and true errors at the landmarks."""
    pair, places, true = spoiled(scene, state)
    result = pipeline(preset)(pair)
    found = {"score": at_points(result, result.score, places)}
    figures = {name: np.array(result.figures[name]) for name in ("iso", "reach")}
    expected = at_points(result, result.expected_error, places)
    return found | figures | {"true": true, "error": true / figures["iso"], "expected": expected}


def measured(of: Arrays, by: ErrorTable) -> tuple[float, ...]:
    """Return coverage of finite bounds, share of open ones, median bound, median error, mean bound / constant."""
    bound = bounds_of(of["score"], of["expected"], float(of["iso"]), by, VolumeBound())["bound"].astype(np.float64)
    bound[bound >= of["reach"]] = np.inf
    found = bound_scores(Tally("", of["true"]), bound, of["true"] > 3, 0.9, "mm")
    by_name = {score.metric.name: score.value for score in found}
    return (
        by_name["bound coverage"], 100 - by_name["bound finite"], by_name.get("bound median", np.nan),
        float(np.median(of["true"])), by_name.get("bound / constant", np.nan),
    )  # fmt: skip


def registrations(options: Any) -> Iterator[tuple[str, str, str, str, Arrays]]:
    """Yield data set, pair, state, preset, and what was found at the landmarks."""
    for name, scene in registered(options.data):
        for state in STATES if name.endswith("_b") else [""]:
            for preset in CHECKED:
                if preset in TAUGHT.values() or state in ("", "reversed"):
                    file = f"{name}__{state}__{preset}".replace("/", "_")
                    found = kept(options.samples, file, lambda s=scene, t=state, p=preset: sampled(s, t, p))
                    yield name.split("_")[0], name, state, preset, found


def main() -> None:
    options = _env.options(__doc__, "data", "out", samples=None)
    found = list(registrations(options))
    families = sorted({family for family, *_ in found})

    def made(preset: str, *left_out: str) -> ErrorTable:
        maps = [(f, state == "", of) for f, _, state, p, of in found if p == preset and f not in left_out]
        several = Counter((f, real) for f, real, _ in maps)  # all spoiled maps weigh as much as all real ones
        taught = [(f, of | {"weight": 1 / several[f, real]}) for f, real, of in maps]
        return table(taught, "score", SHARES, 20, reach=REACH)

    for shape, preset in TAUGHT.items():
        write(options.out / f"registration_{shape}.csv", made(preset), "minus log2 of the expected error", "voxels")
    tables = {(shape, f): made(preset, f) for shape, preset in TAUGHT.items() for f in families}
    rows = []
    for preset, shape in CHECKED.items():
        for patient in families:
            whole = [of for f, _, state, p, of in found if (f, state, p) == (patient, "", preset)]
            joined = {
                key: np.concatenate([np.atleast_1d(of[key]) for of in whole]) for key in ("true", "expected", "score")
            }
            coverage, is_open, *_ = measured({**whole[0], **joined}, tables[shape, patient])
            rows.append([preset, patient, f"{coverage:.1f}", f"{is_open:.0f}", str(joined["true"].size)])
    show("Bounds of nominal 90 %, by patient", ["preset", "left out", "covered %", "open %", "landmarks"], rows)
    for preset, shape in CHECKED.items():
        groups: dict[str, list[list[float]]] = {}  # pairs, or what data sets become in one of the states
        for family, name, state, used, of in found:
            if used == preset:
                means = [of["true"].mean(), of["expected"].mean() / of["true"].mean()]
                values = [*means, *measured(of, tables[shape, family])]
                groups.setdefault(f"{family}, {state}" if state else name, []).append(values)
        rows = [[label, *(f"{v:.2f}" for v in np.mean(values, axis=0))] for label, values in groups.items()]
        header = ["left out", "mean error, mm", "expected / true", "covered %", "open %", "median bound, mm",
                  "median error, mm", "bound / constant"]  # fmt: skip
        show(f"Bounds of nominal 90 %: {preset}", header, rows)


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Make the curves and tables by which completed depth maps of glass get bounds of their errors, and check them.

    scripts/train_glass_bounds.py DATA OUT [--samples DIR]

DATA is the folder with the test sets; OUT gets glass_curves.csv and a table glass_KIND.csv of each kind of pixel.
Frames are real (ClearGrasp), rendered, generated, or made of pairs; sparse depth is emulated from the truth, in some
cases with none inside the glass, or matched between color and infrared. --samples keeps the sampled pixels in a folder,
and takes those that are there. Printed is the coverage of nominal 90 % on each data set, by what the others teach.
"""

import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import _env  # first: continues in the checkout's environment
import numpy as np
from _experiments import config_of, kept, middlebury_scenes, scenes_in, show
from _thesis_depth import glass_frames, halved
from _training import Arrays, held, some_pixels, table, write
from numpy.typing import NDArray

from depthcli.core.cameras.triangulation import depth_of_disparity
from depthcli.core.color_and_infrared import RgbIrFrame
from depthcli.core.context import Clock
from depthcli.core.frames import SparseFrame, color8
from depthcli.io.formats.depth import read_depth
from depthcli.io.formats.images import read_image
from depthcli.io.rgbd_frames import load_frame, true_depth
from depthcli.io.stereo_pairs import load_pair, true_disparity
from depthcli.methods.transparent.bounds import EVIDENCE, KINDS, GlassErrors, evidence, kinds_of, score, units
from depthcli.simulate.depth_sensor import simulate_kinect
from depthcli.simulate.transparent_scenes import glass_of_pair, make_transparent_scene, sensor_through, sparse_samples

ALWAYS: dict[str, dict[str, Any]] = {"2 %": {"share": 0.02}, "10 %": {"share": 0.1}}
ALWAYS |= {f"{name}, none inside": case for name, case in ALWAYS.items()}
OTHER: dict[str, dict[str, Any]] = {
    "2 % at edges": {"share": 0.02, "clustered": True},
    "10 % at edges": {"share": 0.1, "clustered": True},
    "2 %, 30 % wrong": {"share": 0.02, "outliers": 0.3},
    "0.5 %": {"share": 0.005},
    "2 %, 2 mm": {"share": 0.02, "noise": 0.002},
    "5 %, 20 mm": {"share": 0.05, "noise": 0.02},
    "2 % at edges, none inside": {"share": 0.02, "clustered": True},
}
"""Sparse depth of all frames; and of a third of them each."""
TAUGHT = ("sparse", "crf", "kinect", "sensor", "thesis/ch5")
PRESETS = ("sparse", "crf", "nearest", "joint-bilateral", "thesis/ch5")
FB = 24.0  # focal length times baseline, pixels x meters
PIXELS = 1500  # inside the glass and outside, of a map
PIXELS_OF_CURVES = 100_000  # that curves are fitted to
INSIDE_WEIGHT = 0.3  # of the glass, beside that of the rest of a map, for pixels that were kept
TARGET = (0.95, 0.8, 0.8)  # quantile of the errors that curves follow, by kind: glass that is missed is rare
WORST = (0.5, 0.75, 0.75)  # how far tables lie from the mean over data sets toward the worst one, by kind
POINTS = {
    "residual": (-9, -7, -6, -5, -4, -3, -2), "gap": (-1, 0, 0.5, 1, 1.5, 2, 3, 4), "gap_width": range(-8, -1),
    "distance": range(-9, -1), "edge": (-9, -7, -5, -3, -1), "noise": (-14, -4),
    "border": (-9, -8, -7, -6, -5, -4, -2), "relief": (-8, -5, -3, -2, -1, 0),
}  # fmt: skip
"""Of the curves."""
Frame = tuple[Any, ...]  # color, infrared or None, sensor, truth, mask, largest disparity; (H, W), meters


def frames(data: Path) -> Iterator[tuple[str, str, Callable[[], Frame]]]:
    """Yield data set, name, and the frame."""
    for name, files in glass_frames(data):
        yield "ClearGrasp, real", name, lambda f=files: real(f)
    for folder in sorted((data / "transparent" / "synthetic").iterdir()):
        yield "ClearGrasp, rendered", folder.name, lambda f=folder: rendered(f)
    for seed in range(100, 106):
        size = ((320, 240), (480, 360))[seed % 2]
        yield "generated", f"room_{seed}", lambda s=seed, a=size: of_scene(make_transparent_scene(s, *a, a[0] // 8), s)
    for files in (*middlebury_scenes(data), *scenes_in(data / "middlebury_v3")):
        yield files.folder.parent.name, files.name, lambda f=files: of_pair(f)


def real(files: Any) -> Frame:
    truth = true_depth(files)
    frame = load_frame(files)
    color, *maps = halved(frame.color, frame.depth, truth.depth, truth.masks["transparent"])
    return color, None, *maps, None


def rendered(folder: Path) -> Frame:
    """Return a rendered frame; behind its objects the surroundings go on."""
    masked = read_image(folder / "mask_transparent.png")
    masked = masked if masked.ndim == 2 else masked[..., 0]
    color, truth, mask = halved(
        read_image(folder / "rgb.jpg"), read_depth(folder / "depth_gt_mm.png", 1000.0), masked > 127
    )
    nothing = np.full_like(truth, np.nan)
    behind = config_of("transparent", "sensor").pipeline(SparseFrame(color, truth, sparse=nothing, objects=mask))
    disparity = (2 * FB / truth, 2 * FB / behind.depth.values)
    sensor = sensor_through(*disparity, mask, 0)
    return color, None, holed(color, 2 * FB / sensor, disparity[0], mask, 0), truth, mask, None


def of_pair(files: Any) -> Frame:
    pair = load_pair(files)
    made = glass_of_pair(pair.left, pair.right, true_disparity(files).disparity)
    return (*of_scene(made, 0)[:-1], files.max_disparity)


def of_scene(made: Any, seed: int) -> Frame:
    sensor, truth = (depth_of_disparity(part, FB) for part in (made.sensor, made.disparity))
    sensor = holed(made.color, sensor, made.disparity, made.mask, seed)
    return made.color, made.infrared, sensor, truth, made.mask, made.color.shape[1] // 8


def holed(color: Any, sensor: Any, disparity: Any, mask: Any, seed: int) -> NDArray[np.float32]:
    """Return a sensor's depth with shadows and specular spots, which real sensors have outside of glass, too."""
    width = color.shape[1]
    shadows = {"fattening": 0, "noise": 0, "baseline": 0.3, "disc_radius": (0.005 * width, 0.03 * width)}
    gaps = np.isnan(simulate_kinect(color8(color), disparity, seed, **shadows).disparity)
    return np.where(gaps & ~mask, np.nan, sensor).astype(np.float32)


def maps_of(number: int, name: str, given: Frame) -> Iterator[tuple[str, SparseFrame, Any]]:
    """Yield preset and case, frame, and the completed map, of all presets."""
    color, infrared, sensor, truth, mask, top = given
    run = {preset: config_of("transparent", preset).pipeline for preset in (*PRESETS, "kinect", "sensor")}
    cases = ALWAYS | {case: how for k, (case, how) in enumerate(OTHER.items()) if (k + number) % 3 == 0}
    for case, how in cases.items():
        sparse = sparse_samples(truth, color, seed=zlib.crc32(name.encode()) % 1000, **how)
        sparse = np.where(mask & ("none inside" in case), np.nan, sparse).astype(np.float32)
        frame = SparseFrame(color, sensor, sparse=sparse)
        for preset in PRESETS if case in ("2 %", "10 %, none inside") else PRESETS[:1]:
            yield f"{preset}|{case}", frame, run[preset](frame).depth
    frame = SparseFrame(color, sensor, sparse=np.full_like(sensor, np.nan), objects=mask)
    yield "sensor|mask", frame, run["sensor"](frame).depth
    if infrared is not None:
        stereo = config_of("transparent", "kinect").stereo.model_copy(update={"max_disparity": top})
        frame, _ = stereo(RgbIrFrame(color, infrared, sensor, None, FB), Clock())
        for preset in ("kinect", "sparse"):
            yield f"{preset}|stereo", frame, run[preset](frame).depth


def sampled(number: int, name: str, given: Frame) -> Arrays:
    """Return evidence, errors, their unit and kind, at pixels inside and outside of the glass, of each map."""
    truth, mask, found = given[3], given[4], {}
    for key, frame, depth in maps_of(number, name, given):
        planes, error = evidence(frame, depth), np.abs(depth.values - truth)
        kinds, unit = kinds_of(frame, depth), units(planes, depth)
        rng = np.random.default_rng(zlib.crc32(f"{name} {key}".encode()))
        for place, where in (("inside", mask), ("outside", ~mask)):
            pixels = some_pixels(rng, where & np.isfinite(error), PIXELS)
            found[f"{key}|{place}|planes"] = planes.reshape(len(planes), -1)[:, pixels].astype(np.float16)
            for plane, values in (("error", error / unit), ("unit", unit), ("kind", kinds)):
                found[f"{key}|{place}|{plane}"] = values.ravel()[pixels].astype(np.float32)
    return found


def curves(kind: int, maps: list[tuple[str, Arrays]]) -> NDArray[np.float64]:
    """Return what the points of the curves add: they follow a quantile of the errors' binary logarithms."""
    planes = np.concatenate([one["planes"] for _, one in maps], axis=1).astype(np.float64)
    weight = np.concatenate([np.full(one["error"].size, one["weight"] / one["error"].size) for _, one in maps])
    of = np.repeat([family for family, _ in maps], [one["error"].size for _, one in maps])
    for family in set(of):
        weight[of == family] /= weight[of == family].sum()
    error = np.log2(np.maximum(np.concatenate([one["error"] for _, one in maps]), 1 / 64))
    columns = [np.ones_like(error)]
    for plane, points in zip(planes, POINTS.values(), strict=True):
        columns += [np.interp(plane, points, unit) for unit in np.eye(len(points))[1:]]
    few = slice(None, None, error.size // PIXELS_OF_CURVES + 1)
    x, error, weight = np.stack([column[few] for column in columns], axis=1), error[few], weight[few]
    keep = np.diag([0.0] + [2e-3 * weight.sum()] * (x.shape[1] - 1))
    found = np.zeros(x.shape[1])
    for turn in range(25):  # reweighted least squares
        off = error - x @ found
        side = np.where(off > 0, TARGET[kind], 1 - TARGET[kind])
        pull = weight * (side / np.maximum(np.abs(off), 0.2) if turn else 1)
        found = np.linalg.solve((x.T * pull) @ x + keep, (x.T * pull) @ error)
    rest, made = list(found[1:]), []
    for points in POINTS.values():
        made += [0.0, *rest[: len(points) - 1]]
        del rest[: len(points) - 1]
    return np.array(made)


def fitted(maps: list[tuple[str, Arrays]]) -> GlassErrors:
    """Return curves and tables of data sets and their maps."""
    points = [(number, value) for number, name in enumerate(EVIDENCE) for value in POINTS[name]]
    parts = [[(family, of_kind(one, kind)) for family, one in maps] for kind in range(len(KINDS))]
    parts = [[(family, one) for family, one in part if one["error"].size >= 30] for part in parts]
    columns = [curves(kind, part) for kind, part in enumerate(parts)]
    made = np.round(np.column_stack([points, *columns]), 3)
    tables = []
    for kind, part in enumerate(parts):
        scored = [(family, one | {"odds": score(made, kind, one["planes"].astype(np.float32))}) for family, one in part]
        tables.append(table(scored, "odds", min_samples=60, worst_share=WORST[kind]))
    return GlassErrors(made, tuple(tables))


def of_kind(one: Arrays, kind: int) -> Arrays:
    """Return the pixels of a kind, with the weight of their map."""
    here, inside = one["kind"] == kind, bool(one["inside"])
    arrays = {name: one[name][..., here] for name in ("planes", "error", "unit")}
    share = here.mean() if here.size else 0.0
    return arrays | {"weight": share * (INSIDE_WEIGHT if inside and kind == 0 else 1)}


def bound_of(given: GlassErrors, one: Arrays) -> NDArray[np.float64]:
    """Return the bounds of 90 %, in the unit of the errors."""
    found = np.zeros(one["error"].size)
    for kind, made in enumerate(given.tables):
        here = one["kind"] == kind
        found[here] = made.bound(score(given.curves, kind, one["planes"][:, here].astype(np.float32)), 0.9)
    return found


def figures(maps: list[tuple[str, Arrays, NDArray[np.float64]]]) -> list[str]:
    """Return coverage, that of the worst map, and how wide bounds are; means over maps."""
    rows = []
    for _, one, bound in maps:
        error = one["error"] * one["unit"]
        holds = held(error, bound * one["unit"])
        share = holds.surest.mean() / error.mean()
        rows.append((holds.covered, 1000 * holds.median, holds.over_error, holds.over_constant, share))
    found = np.array(rows)
    middle = np.median(found, axis=0)
    return [f"{100 * found[:, 0].mean():.1f}", f"{100 * found[:, 0].min():.1f}", f"{middle[1]:.0f}",
            *(f"{value:.2f}" for value in middle[2:])]  # fmt: skip


def main() -> None:
    options = _env.options(__doc__, "data", "out", samples=None)
    maps: list[tuple[str, tuple[str, ...], Arrays]] = []
    for number, (family, name, load) in enumerate(frames(options.data)):
        place = f"{family}_{name}".replace(" ", "_")
        found = kept(options.samples, place, lambda k=number, n=name, f=load: sampled(k, n, f()))
        for key in sorted({key.rpartition("|")[0] for key in found}):
            one = {plane: found[f"{key}|{plane}"] for plane in ("planes", "error", "unit", "kind")}
            if one["error"].size >= 100:
                maps.append((family, tuple(key.split("|")), one | {"inside": np.array(key.endswith("|inside"))}))
    taught = [(family, one) for family, (preset, *_), one in maps if preset in TAUGHT]
    made = fitted(taught)
    for kind, errors in zip(KINDS, made.tables, strict=True):
        unit = "noise of the sensor" if kind == "kept" else "2**-10 of the depth"
        write(options.out / f"glass_{kind}.csv", errors, "score", unit)
    header = f"number of the plane, its value, what it adds to kinds of pixels: {', '.join(KINDS)}"
    np.savetxt(options.out / "glass_curves.csv", made.curves, "%.4g", ",", header=header)
    groups: dict[tuple[str, ...], list[tuple[str, Arrays, NDArray[np.float64]]]] = {}
    for left_out in sorted({family for family, *_ in maps}):
        others = fitted([(family, one) for family, one in taught if family != left_out])
        for family, (preset, case, place), one in maps:
            if family == left_out:
                bound = bound_of(others, one)
                samples = "none" if "none" in case else "some" if "%" in case else case
                groups.setdefault((preset, samples, place, "all"), []).append((family, one, bound))
                groups.setdefault((preset, samples, place, family), []).append((family, one, bound))
                for kind, title in enumerate(KINDS):
                    if np.sum(here := one["kind"] == kind) >= 30:
                        part = {name: one[name][..., here] for name in ("error", "unit")}
                        groups.setdefault((preset, samples, place, title), []).append((family, part, bound[here]))
    titles = ["preset", "samples inside", "place", "of", "covered %", "worst map %", "median bound, mm"]
    titles += ["over median error", "mean / constant", "error of surest 80 % / all"]
    show("Coverage of nominal 90 %", titles, [[*group, *figures(some)] for group, some in sorted(groups.items())])


if __name__ == "__main__":
    main()

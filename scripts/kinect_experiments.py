#!/usr/bin/env python3
"""Chapter 4: what refinements of a Kinect's depth maps are worth, in tables.

    scripts/kinect_experiments.py DATA [--only simulated,real] [--presets dsrm,fast]

DATA holds the Middlebury sets and the folders ``rgbd_*``. ``simulated``: Kinect-like measurements of every scene with
a true disparity (``depthcli sample --kinect``), mean absolute error in pixels of disparity in gaps, at mismatched edges
and on measured pixels; ``variants``: simulated sensors that differ in what a Kinect does, the settings chosen on one
half of sensors and scenes, on the other half not; ``real``: 10 % of the known pixels of real frames taken out in blocks
of 20 to 40 pixels, and bands of 6 pixels on the near or the far side of depth edges, mean absolute error there, mm,
with and without the color image; ``speed``: seconds at 640 x 480, paired with ``cv2.inpaint`` (Telea) in the same
process; ``sequence``: generated sequences, along them and frame by frame.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import _env  # first: continues in the checkout's environment
import cv2
import numpy as np
from _experiments import config_of, mean_known, scenes_in, seconds_in_turns, show
from numpy.typing import NDArray

from depthcli.core.cameras.triangulation import disparity_of_depth
from depthcli.core.frames import RgbdFrame, color8
from depthcli.evaluation.render import Number
from depthcli.io.formats.images import read_image
from depthcli.io.layouts.depth import FRAMES
from depthcli.io.rgbd_frames import load_frame
from depthcli.io.stereo_pairs import true_disparity
from depthcli.io.walk import discover_scenes
from depthcli.run.presets import list_presets
from depthcli.simulate.depth_sensor import KinectSample, Sensor, simulate_kinect
from depthcli.simulate.kinect_scenes import SEQUENCE_KINDS, make_kinect_scene, make_kinect_sequence

SETS = ("middlebury_v2", "middlebury_2005", "middlebury_2006")
PATTERNS = 5
FATTENING = 4
REGIONS = ("gap", "occluded", "specular", "mismatch", "measured")
CHOSEN_ON = ("Teddy", "Cones", "Art", "Baby1", "Lampshade1", "Cloth3")
VARIANTS: dict[str, dict[str, Sensor]] = {
    "tuning": {
        "a Kinect": Sensor(),
        "shadow partly covered": Sensor(covered=True, fattening=4),
        "widened on the right": Sensor(sides="right", fattening=5),
        "widened by 8, correlated noise": Sensor(fattening=8, correlation=1.0),
        "time of flight": Sensor(fattening=0, shadows="none", mixed=1, noise=0.2, correlation=0.7),
        "color moved by (2, -1)": Sensor(fattening=2, color_shift=(2, -1)),
        "projector on the left, steps of 1/8": Sensor(shadows="right", fattening=3, step=0.125),
        "baseline .67, correlated noise": Sensor(baseline=0.67, fattening=3, noise=0.5, correlation=1.5, discs=16),
    },
    "validation": {
        "widened by 2": Sensor(fattening=2, noise=0.2),
        "shadow covered by 6, steps of 1/8": Sensor(covered=True, fattening=6, step=0.125),
        "widened on the left": Sensor(sides="left", fattening=4),
        "not widened": Sensor(fattening=0, noise=0.4),
        "time of flight, mixed by 2": Sensor(fattening=2, shadows="none", mixed=2, discs=14),
        "color moved by (-3, 1)": Sensor(fattening=4, color_shift=(-3, 1), correlation=1.0),
        "projector on the left, baseline 1.3": Sensor(shadows="right", fattening=6, baseline=1.3),
        "baseline 1.4, far range missing": Sensor(
            baseline=1.4, fattening=4, noise=0.4, correlation=0.8, step=0.25, farthest=0.25
        ),
    },
}
Refine = Callable[[RgbdFrame], Any]
Map = NDArray[np.float32]


def images(data: Path, folder: str) -> Iterator[tuple[str, NDArray[np.uint8], Map]]:
    """Yield name, color image and true disparity of the scenes of a set."""
    for scene in scenes_in(data / folder):
        if scene.has_truth:
            yield scene.name, color8(read_image(scene.left)), true_disparity(scene).disparity


def errors_of(run: Refine | None, made: KinectSample) -> Map:
    """Return the absolute errors of a refined map, or of the sensor's own, in pixels of disparity."""
    frame = made.frame()
    found = frame.disparity if run is None else disparity_of_depth(run(frame).depth.values, frame.fb)
    return np.abs(found - made.truth)


def simulated(data: Path, refinements: Mapping[str, Refine]) -> None:
    """Print a row a method: MAE by set and region, means over scenes."""
    methods: dict[str, Refine | None] = {"raw": None, **refinements}
    cells: dict[tuple[str, str, str], list[float]] = {}
    for folder in SETS:
        for _, color, truth in images(data, folder):
            made = simulate_kinect(color, truth, 0, fattening=FATTENING)
            for name, run in methods.items():
                error = errors_of(run, made)
                for region in REGIONS:
                    cells.setdefault((name, folder, region), []).append(mean_known(error[getattr(made, region)]))
    columns = [(folder, region) for folder in SETS for region in REGIONS]
    rows = [(name, *(Number(mean_known(cells[name, *column]), 3) for column in columns)) for name in methods]
    header = ("method", *(f"{folder.removeprefix('middlebury_')} {region}" for folder, region in columns))
    show(f"Simulated Kinect, fattening {FATTENING} px: MAE, px, of estimated pixels", header, rows)


def variants(data: Path, methods: dict[str, Refine]) -> None:
    """Print a row a sensor: MAE, px, in gaps / at wrong edges, means over scenes; and the means of both halves."""
    for half, sensors in VARIANTS.items():
        chosen = [s for folder in SETS for s in images(data, folder) if (s[0] in CHOSEN_ON) == (half == "tuning")]
        means: dict[tuple[str, str], tuple[float, float]] = {}
        for title, sensor in sensors.items():
            samples = [simulate_kinect(color, truth, k, sensor=sensor) for k, (_, color, truth) in enumerate(chosen)]
            for name, run in methods.items():
                errors = [(errors_of(run, made), made) for made in samples]
                gaps, edges = ([mean_known(e[mask(made)]) for e, made in errors]
                               for mask in (lambda made: made.gap, lambda made: made.mismatch))  # fmt: skip
                means[title, name] = mean_known(gaps), mean_known(edges)
        for name in methods:
            own = [means[title, name] for title in sensors]
            means["mean", name] = mean_known(gap for gap, _ in own), mean_known(edge for _, edge in own)
        shown = {key: f"{gap:.2f} / {edge:.2f}" for key, (gap, edge) in means.items()}
        rows = [(title, *(shown[title, name] for name in methods)) for title in (*sensors, "mean")]
        show(f"Simulated sensors, {half}: MAE, px, gaps / wrong edges", ("sensor", *methods), rows)


def real(data: Path, methods: dict[str, Refine]) -> None:
    """Print tables of MAE, mm, at pixels that were taken out of real frames: blocks, bands, blocks without color."""
    frames = _real_frames(data)
    blocks = f"Blocks of 20 to 40 px taken out of real frames: MAE, mm, mean of {PATTERNS} patterns"
    bands = "Bands of 6 px on the near and on the far side of depth edges taken out: MAE, mm, mean of both"
    for title, patterns, color in ((blocks, PATTERNS, 1), (bands, 2, 1), (f"{blocks}, no color", PATTERNS, 0)):
        rows, ratios = [], []
        for number, (scene, frame) in enumerate(frames):
            errors: dict[str, list[float]] = {name: [] for name in methods}
            for pattern in range(patterns):
                holes = _bands(frame, pattern) if title == bands else _blocks(frame, PATTERNS * number + pattern)
                depth = np.where(holes, np.float32(np.nan), frame.depth)
                holed = RgbdFrame(frame.color, depth, frame.fb, frame.intrinsics)
                if not color:
                    holed = RgbdFrame.without_color(depth, frame.fb, frame.intrinsics)
                for name, run in methods.items():
                    errors[name].append(mean_known(1000 * np.abs(run(holed).depth.values[holes] - frame.depth[holes])))
            means = {name: mean_known(errors[name]) for name in methods}
            rows.append((scene, *(Number(value, 1) for value in means.values())))
            if means.get("nearest", 0) > 1:  # a board alone is a plane
                ratios.append([value / means["nearest"] for value in means.values()])
        if ratios:
            rows.append(("mean of ratios to nearest", *(Number(value, 3) for value in np.mean(ratios, axis=0))))
            rows.append(("largest ratio", *map(Number, np.max(ratios, axis=0))))
        show(title, ("frame", *methods), rows)


def _real_frames(data: Path) -> list[tuple[str, RgbdFrame]]:
    frames = []
    for folder in sorted([*data.glob("rgbd_*"), data / "kinect_v1_raw"]):
        for scene in discover_scenes(folder, FRAMES, "sun-rgbd" if folder.name == "rgbd_sun" else None):
            if folder.name == "rgbd_tum":
                scene = replace(scene, depth_scale=5000.0)
            frames.append((f"{scene.folder.parent.name}/{scene.name}", load_frame(scene)))
    return frames


def _bands(frame: RgbdFrame, side: int) -> NDArray[np.bool_]:
    """Return known pixels within 6 pixels of a step of over a pixel, on its near (0) or far (1) side."""
    out = np.zeros(frame.shape, bool)
    for values, taken in ((frame.disparity, out), (frame.disparity.T, out.T)):
        step = np.diff(values, axis=1)
        with np.errstate(invalid="ignore"):
            rising, falling = (step > 1, step < -1) if side == 0 else (step < -1, step > 1)
        last = values.shape[1] - 1
        for k in range(min(6, last)):
            taken[:, 1 + k :] |= rising[:, : last - k]
            taken[:, : last - k] |= falling[:, k:]
    return out & np.isfinite(frame.depth)


def _blocks(frame: RgbdFrame, seed: int) -> NDArray[np.bool_]:
    """Return known pixels in random blocks, 10 % of all known ones."""
    known = np.isfinite(frame.depth)
    rng = np.random.Generator(np.random.PCG64([seed, 0xB10C]))
    taken = np.zeros_like(known)
    wanted = 0.1 * np.count_nonzero(known)
    while np.count_nonzero(taken & known) < wanted:
        height, width = rng.integers(20, 41, 2)
        y, x = rng.integers(0, known.shape[0] - height), rng.integers(0, known.shape[1] - width)
        taken[y : y + height, x : x + width] = True
    return taken & known


def speed(_: Path, methods: dict[str, Refine]) -> None:
    """Print a row a method: median seconds, and the ratio to Telea's inpainting run in turn with it."""
    frame = simulate_kinect(*make_kinect_scene("foreground", 0, 640, 480), 0).frame()
    hole = np.isnan(frame.depth).astype(np.uint8)
    codes = np.nan_to_num(1000 * frame.depth).astype(np.uint16)
    rows = []
    for name, run in methods.items():
        jobs = {"own": lambda run=run: run(frame), "peer": lambda: cv2.inpaint(codes, hole, 3, cv2.INPAINT_TELEA)}
        own, peer = seconds_in_turns(jobs, 6, warm=2).values()
        ratios = median(own) / median(peer), own[0] / peer[0]
        rows.append((name, Number(median(own), 3), *map(Number, ratios)))
    show("640 x 480, one process, warm", ("method", "seconds", "Telea = 1", "fastest runs"), rows)


def sequence(*_: Any, seeds: int = 5) -> None:
    """Print a row a kind of sequence: MAE and temporal noise, along it and frame by frame, and MAE of what was hidden.

    The temporal noise is the standard deviation over the frames of the error at one surface point, mean of the points
    that all frames see.
    """
    pipeline = config_of("refine-kinect", "sequence").pipeline
    rows = []
    for kind in (*SEQUENCE_KINDS, "camera, no poses"):
        names = ("along", "single", "along noise", "single noise", "along left", "single left")
        found: dict[str, list[float]] = {name: [] for name in names}
        for seed in range(seeds):
            samples = make_kinect_sequence(kind.partition(",")[0], 10, seed, 320, 240, 40)  # type: ignore[arg-type]
            state = None
            errors: dict[str, list[NDArray[np.float32]]] = {"along": [], "single": []}
            for k, made in enumerate(samples):
                frame = replace(made.frame(), pose=None) if kind == "camera, no poses" else made.frame()
                results = {"single": pipeline(frame)}  # type: ignore[operator]
                results["along"], state = pipeline.step(frame, state)  # type: ignore[attr-defined]
                left = samples[k - 1].truth - made.truth > 3
                at = same_points(samples[0], made)
                for name, result in results.items():
                    error = disparity_of_depth(result.depth.values, RgbdFrame.fb) - made.truth
                    errors[name].append(np.where(at >= 0, error.ravel()[np.maximum(at, 0)], np.float32(np.nan)))
                    if k:
                        found[name].append(float(np.nanmean(np.abs(error))))
                    if k and made.pose is None and left.any():
                        found[f"{name} left"].append(float(np.nanmean(np.abs(error[left]))))
            for name, maps in errors.items():
                found[f"{name} noise"].append(float(np.nanmean(np.std(maps, axis=0))))
        rows.append((kind, *(Number(mean_known(values), 3) for values in found.values())))
    ways = ("sequence", "frame by frame")
    header = ("kind", *(f"{way}{what}" for what in ("", ", temporal noise", ", just left") for way in ways))
    show(f"Sequences of 10 frames, {seeds} seeds: MAE, px", header, rows)


def same_points(first: KinectSample, other: KinectSample) -> NDArray[np.int64]:
    """Return the index in the other frame of what each pixel of the first one shows, (H, W); -1 where it is hidden."""
    height, width = first.truth.shape
    places = np.arange(height * width).reshape(height, width)
    if first.pose is None or other.pose is None or first.intrinsics is None:
        return np.where(np.abs(first.truth - other.truth) < 0.5, places, -1)
    depth = first.depth_true()
    points = first.intrinsics.points(depth, np.isfinite(depth))
    motion = np.linalg.inv(other.pose) @ first.pose
    moved = points @ motion[:3, :3].T + motion[:3, 3]
    x, y, w = first.intrinsics.matrix @ moved.T
    columns, rows = np.rint(x / w).astype(np.int64), np.rint(y / w).astype(np.int64)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    index = np.where(inside, rows * width + columns, 0)
    seen = inside & (np.abs(other.truth.ravel()[index] - RgbdFrame.fb / moved[:, 2]) < 0.5)
    result = np.full((height, width), -1)
    result[np.isfinite(depth)] = np.where(seen, index, -1)
    return result


def main() -> None:
    presets = [name for _, name, _ in list_presets("refine-kinect") if name != "sequence"]
    parts = {part.__name__: part for part in (simulated, variants, real, speed, sequence)}
    options = _env.options(__doc__, "data", only=tuple(parts), presets=presets)
    methods = {name: config_of("refine-kinect", name).pipeline for name in options.presets}
    for name in options.only:
        parts[name](options.data, methods)


if __name__ == "__main__":
    main()

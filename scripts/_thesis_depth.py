"""Chapters 4 and 5 of the thesis: depth of a Kinect, and of glass."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from _experiments import (
    THESIS,
    Experiment,
    Rows,
    bad,
    config_of,
    matcher,
    mean_known,
    middlebury_scenes,
    scenes_in,
    seconds_in_turns,
)
from numpy.typing import NDArray

from depthcli.core.cameras.triangulation import depth_of_disparity, disparity_of_depth
from depthcli.core.color_and_infrared import RgbIrFrame
from depthcli.core.context import Clock
from depthcli.core.frames import RgbdFrame, SparseFrame, StereoPair, color8
from depthcli.io.formats.images import read_image
from depthcli.io.rgbd_frames import load_frame, true_depth
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.frames import FRAMES
from depthcli.io.stereo_pairs import load_pair, true_disparity
from depthcli.methods.transparent.cross_modal import GREY, learned_weights, mix_channels
from depthcli.simulate.depth_sensor import KinectSample, simulate_kinect
from depthcli.simulate.kinect_scenes import SEQUENCE_KINDS, make_kinect_scene, make_kinect_sequence
from depthcli.simulate.transparent_scenes import glass_of_pair, sparse_samples

SETS = ("v2", "2005", "2006")
KINECT = (
    "joint-bilateral", "inpaint", "nearest", "fgs", "realsense", "thesis/ch4", "fast", "dsrm", "accurate",
)  # fmt: skip
REGIONS = ("gap", "occluded", "specular", "mismatch", "measured")
PATTERNS = 5
CHOSEN_ON = ("Teddy", "Cones", "Art", "Baby1", "Lampshade1", "Cloth3")
Refine = Callable[[RgbdFrame], Any]
Map = NDArray[np.float32]


@cache
def methods() -> dict[str, Refine | None]:
    """Return the refinements by preset; the sensor's own map: None."""
    return {"sensor": None, **{name: config_of("refine-kinect", name).pipeline for name in KINECT}}


def with_truth(data: Path) -> Iterator[tuple[str, Any]]:
    """Yield the scenes of Middlebury that have a true disparity: set and name, and number, set, scene."""
    for folder in SETS:
        scenes = [scene for scene in scenes_in(data / f"middlebury_{folder}") if scene.has_truth]
        yield from ((f"{folder} {scene.name}", (k, folder, scene)) for k, scene in enumerate(scenes))


def disparity_by(run: Refine | None, made: KinectSample) -> Map:
    """Return a refined map, or the sensor's own, in pixels of disparity."""
    frame = made.frame()
    return frame.disparity if run is None else disparity_of_depth(run(frame).depth.values, frame.fb)


def simulated(item: tuple[int, str, Any]) -> Rows:
    """Return MAE in pixels by region, share of wrong pixels in gaps, and PSNR of the virtual right view."""
    _, folder, scene = item
    color, right = (color8(read_image(file)) for file in (scene.left, scene.right))
    made = simulate_kinect(color, true_disparity(scene).disparity, 0, fattening=4)
    rows = {}
    for name, run in methods().items():
        found = disparity_by(run, made)
        error = np.abs(found - made.truth)
        regions = {region: getattr(made, region) for region in REGIONS}
        cells = {region: mean_known(error[mask]) for region, mask in regions.items()}
        cells["gap bad"] = bad(found, made.truth, made.gap)
        cells["view"], cells["filled"] = virtual_view(color, found, right)
        rows[name] = {f"{folder} {column}": value for column, value in cells.items()}
    return rows


def virtual_view(left: NDArray[np.uint8], disparity: Map, right: NDArray[np.uint8]) -> tuple[float, float]:
    """Return the PSNR (dB) of the right view drawn from the left one, where it is drawn, and how much is drawn, %."""
    y, x = np.nonzero(np.isfinite(disparity))
    near_last = np.argsort(disparity[y, x], kind="stable")
    y, x = y[near_last], x[near_last]
    to = np.rint(x - disparity[y, x]).astype(np.int64)
    y, x, to = y[to >= 0], x[to >= 0], to[to >= 0]
    view = np.full(right.shape, np.nan)
    view[y, to] = left[y, x]
    drawn = np.isfinite(view)
    return float(10 * np.log10(255**2 / np.mean((view - right)[drawn] ** 2))), 100 * float(drawn.mean())


def by_sensor(item: tuple[int, str, Any]) -> Rows:
    """Return MAE, px, in gaps and at wrong edges, of the sensors that are measured on a scene."""
    rows, (count, _, scene) = Rows(), item
    color, truth = color8(read_image(scene.left)), true_disparity(scene).disparity
    for title, sensor in THESIS["sensors" if scene.name in CHOSEN_ON else "unseen sensors"].items():
        made = simulate_kinect(color, truth, count, **sensor)
        errors = {name: np.abs(disparity_by(run, made) - made.truth) for name, run in methods().items()}
        rows[title] = {f"{name} {region}": mean_known(error[getattr(made, region)].ravel())
                       for name, error in errors.items() for region in ("gap", "mismatch")}  # fmt: skip
    return rows


def real_frames(data: Path) -> Iterator[tuple[str, Any]]:
    """Yield the real frames: folder and name, and number, frame."""
    count = 0
    for folder in sorted([*data.glob("rgbd_*"), data / "kinect_v1_raw"]):
        for scene in discover_scenes(folder, FRAMES, "sun-rgbd" if folder.name == "rgbd_sun" else None):
            if folder.name == "rgbd_tum":
                scene = replace(scene, depth_scale=5000.0)
            yield f"{scene.folder.parent.name}/{scene.name}", (count, load_frame(scene))
            count += 1


def real(item: tuple[int, RgbdFrame]) -> Rows:
    """Return MAE, mm, at pixels taken out of a frame: blocks, and bands beside edges."""
    count, frame = item
    rows: Rows = {}
    for column, patterns in (("blocks", PATTERNS), ("bands", 2)):
        found: dict[str, list[float]] = {}
        for pattern in range(patterns):
            if column == "bands":
                holes = _bands(frame, pattern)
            else:
                seed = [PATTERNS * count + pattern, 0xB10C]
                holes = blocks(np.isfinite(frame.depth), seed, lambda rng: rng.integers(20, 41, 2))
            holed = RgbdFrame(frame.color, np.where(holes, np.float32(np.nan), frame.depth), frame.fb, frame.intrinsics)
            for name, run in methods().items():
                if run is not None and name not in ("inpaint", "realsense"):
                    error = 1000 * np.abs(run(holed).depth.values[holes] - frame.depth[holes])
                    found.setdefault(name, []).append(mean_known(error))
        for name, values in found.items():
            rows.setdefault(name, {})[column] = mean_known(values)
            if mean_known(found["nearest"]) > 1:  # a board alone is a plane
                rows[name][f"{column} ratio"] = mean_known(values) / mean_known(found["nearest"])
    return rows


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


def blocks(known: NDArray[np.bool_], seed: Any, size: Callable[[np.random.Generator], Any]) -> NDArray[np.bool_]:
    """Return known pixels in random blocks of a size (height, width), 10 % of all known ones."""
    rng, taken = np.random.default_rng(seed), np.zeros_like(known)
    while np.count_nonzero(taken & known) < 0.1 * np.count_nonzero(known):
        height, width = size(rng)
        y, x = rng.integers(0, known.shape[0] - height), rng.integers(0, known.shape[1] - width)
        taken[y : y + height, x : x + width] = True
    return taken & known


def kinect_times(made: tuple[Any, Any]) -> Rows:
    """Return milliseconds at 640 x 480, and the ratio to Telea's inpainting in turn with it."""
    frame, pipeline = simulate_kinect(*made, 0).frame(), config_of("refine-kinect", "sequence").pipeline
    hole = np.isnan(frame.depth).astype(np.uint8)
    codes = np.nan_to_num(1000 * frame.depth).astype(np.uint16)
    state = pipeline.step(frame, None)[1]
    jobs = {name: partial(run, frame) for name, run in methods().items() if run is not None}
    jobs |= {"frame by frame": partial(pipeline, frame), "along a sequence": lambda: pipeline.step(frame, state)}
    rows = {}
    for name, run in jobs.items():
        both = {"own": run, "peer": lambda: cv2.inpaint(codes, hole, 3, cv2.INPAINT_TELEA)}
        own, peer = seconds_in_turns(both, 6, warm=2).values()
        rows[name] = {"ms": 1e3 * own[0], "Telea = 1": own[0] / peer[0]}
    return rows


def sequences(_: Path) -> Iterator[tuple[str, Any]]:
    """Yield kinds of generated sequences and seeds."""
    yield from ((f"{kind} {seed}", (kind, seed)) for seed in range(5) for kind in (*SEQUENCE_KINDS, "camera, no poses"))


def sequence(item: tuple[str, int]) -> Rows:
    """Return MAE along a sequence of ten frames and frame by frame, and temporal noise.

    The temporal noise is the standard deviation over the frames of the error at one surface point, mean of the points
    that all frames see.
    """
    kind, seed = item
    samples = make_kinect_sequence(kind.partition(",")[0], 10, seed, 320, 240, 40)  # type: ignore[arg-type]
    pipeline, state = config_of("refine-kinect", "sequence").pipeline, None
    maps: dict[str, list[Map]] = {"along": [], "frame by frame": []}
    means: dict[str, list[float]] = {way: [] for way in maps}  # of all frames but the first
    for made in samples:
        frame = replace(made.frame(), pose=None) if kind == "camera, no poses" else made.frame()
        along, state = pipeline.step(frame, state)
        at = same_points(samples[0], made)
        for way, result in {"along": along, "frame by frame": pipeline(frame)}.items():
            error = disparity_of_depth(result.depth.values, RgbdFrame.fb) - made.truth
            maps[way].append(np.where(at >= 0, error.ravel()[np.maximum(at, 0)], np.float32(np.nan)))
            if made is not samples[0]:
                means[way].append(mean_known(np.abs(error)))
    rows = {}
    for way, errors in maps.items():
        mean = mean_known(means[way])
        rows[way] = {f"{kind} MAE": mean, f"{kind} noise": mean_known(np.std(errors, axis=0)), "MAE": mean}
    return rows


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


# Chapter 5. The sensor's depth of ClearGrasp is real, with glass in place; the truth is the depth of the same objects,
# painted. Sparse depth is emulated from the truth: a share of the pixels, 8 mm of noise, outliers. Images are halved.

GLASS = ("nearest", "joint-bilateral", "thesis/ch5", "crf", "sparse")
MIXED = ("nearest", "joint-bilateral", "thesis/ch5", "kinect")
_FB = 24.0  # focal length times baseline of the emulated camera, pixels x meters


def glass_frames(data: Path) -> Iterator[tuple[str, Any]]:
    """Yield frames of real glass."""
    yield from ((files.name, files) for files in discover_scenes(data / "transparent" / "real_d435", FRAMES))


def halved(color: Any, *maps: NDArray[Any]) -> Iterator[Any]:
    """Yield a color image and maps at half their size."""
    height, width = color.shape[:2]
    yield np.asarray(cv2.resize(color, (width // 2, height // 2), interpolation=cv2.INTER_AREA), np.uint8)
    yield from (np.ascontiguousarray(part[: height // 2 * 2 : 2, : width // 2 * 2 : 2]) for part in maps)


def glass(files: Any) -> Rows:
    """Return errors of presets and kinds of samples: mm in the object and at its outline; outside, sensor = 1."""
    frame, truth = load_frame(files), true_depth(files)
    color, sensor, depth, mask = halved(frame.color, frame.depth, truth.depth, truth.masks["transparent"])
    rows = {}
    for preset in GLASS:
        run = config_of("transparent", preset).pipeline
        for case, settings in THESIS["samples"].items():
            sparse = sparse_samples(depth, color, **settings)
            estimate = run(SparseFrame(color, sensor, sparse=sparse)).depth.values
            known = np.isfinite(depth) & np.isfinite(estimate)
            inside, outside = known & mask, known & ~mask & np.isfinite(sensor)
            error = 1000 * np.abs(estimate.astype(np.float64) - depth)
            rows[f"{preset}, {case}"] = {
                "MAE": float(error[inside].mean()),
                "d1.05": float(100 * np.mean(np.maximum(estimate / depth, depth / estimate)[inside] < 1.05)),
                "outside": float(error[outside].mean() / (1000 * np.abs(sensor - depth)[outside].mean())),
                "outline": float(error[known & _near_outline(mask)].mean()),
            }
    return rows


def infrared_pairs(data: Path) -> Iterator[tuple[str, Any]]:
    """Yield Middlebury pairs, whose right view is made infrared, with a glass surface in front."""
    for files in middlebury_scenes(data):
        yield f"{files.folder.parent.name[11:]} {files.name}", files


def infrared(files: Any) -> tuple[Any, Any]:
    """Return the simulated scene of a pair and its visible pixels."""
    pair, truth = load_pair(files), true_disparity(files)
    scene = glass_of_pair(pair.left, pair.right, truth.disparity)
    known = np.isfinite(scene.disparity)
    return scene, truth.masks.get("nonocc", known) & known


def cross_modal(files: Any) -> Rows:
    """Return errors of the matching between color and infrared, %, and of presets, px."""
    scene, visible = infrared(files)
    known = np.isfinite(scene.disparity)
    stereo = config_of("transparent", "kinect").stereo.model_copy(update={"max_disparity": files.max_disparity})
    maps, single = {}, matcher("fuse/thesis/ch6-equal", "measures=[absolute_difference]")
    learned = learned_weights(scene.color, scene.infrared, scene.sensor)
    for name, weights in (("AD grey", GREY), ("AD learned", learned)):
        mixed = StereoPair(mix_channels(scene.color, weights), scene.infrared)
        maps[name] = single(mixed, files.max_disparity).disparity.values
    for name, own in (("grey", stereo.model_copy(update={"channels": "grey"})), ("fused", stereo)):
        matches = own.match(scene.color, scene.infrared, scene.sensor)
        maps[name] = matches.dense
    kept = np.isfinite(matches.sparse)
    rows = {"matching": {name: bad(values, scene.disparity, visible) for name, values in maps.items()}}
    rows["matching"]["kept"] = 100 * float(kept.mean())
    rows["matching"]["kept bad"] = bad(matches.sparse, scene.disparity, kept & known)
    depth = depth_of_disparity(scene.sensor, _FB)
    frame, _ = stereo(RgbIrFrame(scene.color, scene.infrared, depth, None, _FB), Clock())
    regions = {"in": scene.mask, "outline": _near_outline(scene.mask), "out": ~scene.mask & np.isfinite(scene.sensor)}
    results = {name: config_of("transparent", name).pipeline(frame).depth.values for name in MIXED}
    for name, values in {**results, "sensor": depth}.items():
        error = np.abs(disparity_of_depth(values, _FB) - scene.disparity)
        rows[name] = {region: mean_known(error[known & pixels]) for region, pixels in regions.items()}
    return rows


def _near_outline(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels within 5 of the mask's outline."""
    square, plane = np.ones((11, 11), np.uint8), mask.astype(np.uint8)
    return np.asarray(cv2.dilate(plane, square) > cv2.erode(plane, square), np.bool_)


def names(_: Any) -> dict[str, Any]:
    """Return what the templates ask for."""
    return {"kinect_sequences": (*SEQUENCE_KINDS, "camera, no poses")}


EXPERIMENTS = {
    "kinect": Experiment("4", with_truth, simulated, 2),
    "kinect-sequences": Experiment("4", sequences, sequence, 1),
    "kinect-times": Experiment("4", lambda _: [("640 x 480", make_kinect_scene("foreground", 0, 640, 480))],
                               kinect_times),
    "kinect-real": Experiment("4", real_frames, real),
    "kinect-sensors": Experiment("4", with_truth, by_sensor, on_page=False),
    "glass": Experiment("5", glass_frames, glass, 1),
    "infrared": Experiment("5", infrared_pairs, cross_modal, 1),
}  # fmt: skip

#!/usr/bin/env python3
"""Make the network and the table by which refined depth maps get bounds of their errors, and check them.

    scripts/train_depth_bounds.py DATA OUT [--samples DIR]

DATA is the folder with the test sets; OUT gets depth_error.json and depth_errors.csv. They learn from simulated sensors
and from blocks cut out of the real frames of two sensors, refined by all presets; --samples keeps the sampled pixels in
a folder, and takes those that are there. Printed is the coverage of nominal 90 % on other sensors, scenes and frames.
"""

import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import _env  # first: continues in the checkout's environment
import cv2
import numpy as np
from _experiments import THESIS, config_of, kept, middlebury_scenes, show
from _thesis_depth import CHOSEN_ON, KINECT, blocks, real_frames
from _training import Arrays, held, log_odds, network, some_pixels, table, write
from numpy.typing import NDArray

from depthcli.algorithms.error_table import ErrorTable
from depthcli.core.frames import RgbdFrame, color8
from depthcli.io.formats.images import read_image
from depthcli.io.formats.networks import write_network
from depthcli.io.stereo_pairs import true_disparity
from depthcli.methods.kinect.bounds import INPUTS, THRESHOLDS, error_planes
from depthcli.methods.kinect.disparity import nearest_fill
from depthcli.simulate.depth_sensor import KinectSample, simulate_kinect
from depthcli.simulate.kinect_scenes import make_kinect_scene

SENSORS = THESIS["sensors"] | THESIS["more sensors"]
UNSEEN = THESIS["unseen sensors"] | THESIS["more unseen sensors"]
REAL_TAUGHT = ("kinect_v1_raw", "rgbd_tum")
REAL_PRESETS = ("nearest", "fast", "accurate", "dsrm", "joint-bilateral")
BLOCKS = (10, 20, 40, 80)  # pixels
STATUS = ("kept", "corrected", "filled")
WEIGHTS = {"accurate": 3.0, "dsrm": 1.5, "fast": 1.5}  # of presets, as far as they are used more; others 1
REAL_WEIGHT = 4.0  # of a real frame, of which there are few
PIXELS = 400  # of a map and status
Truth = tuple[RgbdFrame, NDArray[np.float32], NDArray[np.bool_]]
"""A frame, its true disparity, and where that counts."""


class Item(NamedTuple):
    """A frame with truth."""

    name: str
    family: str  # sensor, or data set
    taught: bool
    real: bool
    load: Callable[[], Truth]


def items(data: Path) -> Iterator[Item]:
    """Yield simulated frames, each of a scene and a sensor of one group, and real frames with blocks cut out."""
    pairs = [scene for scene in middlebury_scenes(data) if scene.has_truth]
    for taught, sensors in ((True, SENSORS), (False, UNSEEN)):
        some = [scene for scene in pairs if (scene.name in CHOSEN_ON) == taught]
        loads: list[Callable[[], Any]] = [
            lambda s=scene: (color8(read_image(s.left)), unrounded(true_disparity(s).disparity))
            for scene in (some if taught else some[::2])
        ]
        loads += [
            lambda k=kind, s=seed: make_kinect_scene(k, s)
            for kind in ("planes", "foreground", "curved", "camouflage")
            for seed in (range(4) if taught else (100, 101))
        ]
        for turn in range(4 if taught else 2):
            for k, load in enumerate(loads):
                title = list(sensors)[(7 * k + 5 * turn) % len(sensors)]
                name = f"{'taught' if taught else 'unseen'}-{turn}-{k}"
                yield Item(name, title, taught, False, lambda a=load, b=k, c=sensors[title]: measured(a, b, c))
    for name, (count, frame) in real_frames(data):
        family, place = name.partition("/")[0], name.replace("/", "_")
        for size in BLOCKS:
            load = lambda a=frame, b=size, c=count: cut_out(a, b, 100 * c + b)  # noqa: E731
            yield Item(f"real-{place}-{size}", family, family in REAL_TAUGHT, True, load)


def unrounded(truth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return true disparities without the steps, of up to half a pixel, to which they are rounded in files."""
    known = np.isfinite(truth)
    smooth = nearest_fill(np.where(known, truth, np.float32(np.nan)).astype(np.float32))
    for _ in range(2):
        smooth = cv2.bilateralFilter(smooth, 9, 1.0, 3.0)
    return np.where(known, smooth, truth).astype(np.float32)


def measured(load: Callable[[], Any], seed: int, sensor: dict[str, Any]) -> Truth:
    """Return what a sensor measures of a scene: of another size or contrast, or with pixels left out, where it says."""
    given = {key: tuple(value) if isinstance(value, list) else value for key, value in sensor.items()}
    scale, contrast, dropout = (given.pop(key, none) for key, none in (("scale", 1), ("contrast", 1), ("dropout", 0)))
    color, truth = load()
    if scale != 1:
        size = int(truth.shape[1] * scale), int(truth.shape[0] * scale)
        color = cv2.resize(color, size, interpolation=cv2.INTER_AREA)
        truth = cv2.resize(truth.astype(np.float32), size, interpolation=cv2.INTER_NEAREST) * np.float32(scale)
    rng = np.random.default_rng(seed)
    if contrast != 1:
        grain = 2 * rng.standard_normal(color.shape)
        color = np.clip(128 * contrast + (color - 128.0) * contrast + grain, 0, 255).astype(np.uint8)
    made: KinectSample = simulate_kinect(np.ascontiguousarray(color), truth, seed, **given)
    if dropout:
        lost = rng.random(made.disparity.shape) < dropout
        made = replace(made, disparity=np.where(lost, np.float32(np.nan), made.disparity))
    return made.frame(), made.truth, np.isfinite(made.truth)


def cut_out(frame: RgbdFrame, size: int, seed: int) -> Truth:
    """Return a frame without random blocks of a size, a tenth of its known pixels."""
    taken = blocks(np.isfinite(frame.depth), seed, lambda _: (size, size))
    holed = replace(frame, depth=np.where(taken, np.float32(np.nan), frame.depth))
    return holed, frame.disparity, taken


def sampled(item: Item) -> Arrays:
    """Return planes and errors, multiples of the noise, at some pixels of each status, of the map of each preset."""
    frame, truth, counts = item.load()
    found: Arrays = {}
    for preset in REAL_PRESETS if item.real else (*KINECT, "guided"):
        depth = config_of("refine-kinect", preset).pipeline(frame).depth
        planes, noise = error_planes(frame, depth)
        error = np.abs(frame.fb / depth.values - truth) / noise
        status = np.where(planes[1] > 0, 2, planes[0]).astype(int)
        rng = np.random.default_rng(zlib.crc32(f"{item.name} {preset}".encode()))
        for k, name in enumerate(STATUS):
            pixels = counts & np.isfinite(error) & (status == k)
            if pixels.sum() >= 30:
                chosen = some_pixels(rng, pixels, PIXELS)
                found[f"{preset}|{name}|planes"] = planes.reshape(len(planes), -1)[:, chosen].T.astype(np.float16)
                found[f"{preset}|{name}|error"] = error.ravel()[chosen].astype(np.float32)
    return found


def figures(maps: list[tuple[str, Arrays]], errors: ErrorTable) -> list[str]:
    """Return the columns of a table: coverage, sharpness, and wrong values before and after choosing by the bound."""
    bounds = [errors.bound(one["odds"], 0.9) for _, one in maps]
    covered: dict[str, list[float]] = {}
    for (family, one), bound in zip(maps, bounds, strict=True):
        covered.setdefault(family, []).append(100 * float(np.mean(one["error"] <= bound)))
    error = np.concatenate([one["error"] for _, one in maps])
    whole, means = held(error, np.concatenate(bounds), least=0.01), [np.mean(x) for x in covered.values()]
    numbers = np.mean(means), min(means), whole.median, whole.over_error
    wrong = 100 * np.mean(error > 6), 100 * np.mean(whole.surest > 6)
    return [*(f"{x:.1f}" for x in numbers), f"{whole.over_constant:.2f}", *(f"{x:.1f}" for x in wrong)]


def main() -> None:
    options = _env.options(__doc__, "data", "out", samples=None)
    found = [(item, kept(options.samples, item.name, lambda i=item: sampled(i))) for item in items(options.data)]
    maps: list[tuple[Item, str, str, Arrays]] = []
    for item, arrays in found:
        for preset, status in sorted({tuple(key.split("|")[:2]) for key in arrays}):
            one = {name: arrays[f"{preset}|{status}|{name}"] for name in ("planes", "error")}
            one["weight"] = np.array(WEIGHTS.get(preset, 1.0) * (REAL_WEIGHT if item.real else 1))
            maps.append((item, preset, status, one))
    taught = [(item, one) for item, _, _, one in maps if item.taught]
    x, errors = (np.concatenate([one[name] for _, one in taught])[:, None] for name in ("planes", "error"))
    weights = np.concatenate([np.full(len(one["error"]), one["weight"] / len(one["error"])) for _, one in taught])
    names = tuple(f"within {threshold:g} of the noise" for threshold in THRESHOLDS)
    seen = list(dict.fromkeys(item.family for item, _ in taught))
    trained = network({1: (x, errors, weights.astype(np.float32))}, THRESHOLDS, names, INPUTS, (32, 16), seen)
    for *_, one in maps:
        one["odds"] = log_odds(trained, one["planes"], THRESHOLDS.index(2.0))
    made = table([(item.family, one) for item, one in taught], "odds", worst_share=0.0)
    write(options.out / "depth_errors.csv", made, unit="multiples of the noise")
    write_network(options.out / "depth_error.json", trained)
    for real, title in ((False, "Sensors and scenes not taught"), (True, "Blocks cut out of frames not taught")):
        groups: dict[tuple[str, str], list[tuple[str, Arrays]]] = {}
        for item, preset, status, one in maps:
            if not item.taught and item.real == real:
                groups.setdefault((preset, item.family if real else status), []).append((item.family, one))
        rows = [[*group, *figures(some, made)] for group, some in sorted(groups.items())]
        header = ["preset", "of", "covered %", "worst sensor %", "median bound, noise", "over median error"]
        show(f"{title}: nominal 90 %", [*header, "mean / constant", "off by 6 %", "of the surest 80 %"], rows)


if __name__ == "__main__":
    main()

"""Pictures of the tutorial, of the pages on tasks and of docs/my_map_is_wrong.md."""

import functools
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import cv2
import numpy as np
from pictures import SCRATCH, Shown, command, panels, picture, read, sample, wrong

import depthcli

SMALL = ("--width", "240", "--height", "180", "--max-disparity", "32")


def with_errors(preset: str, other: str, *words: str) -> Any:
    """Return image and truth, then map and errors of two presets, of a generated scene."""
    (folder,) = (each for each in sample("-n", "1", *words).iterdir() if each.is_dir())
    left, right = read(folder / "left.png"), read(folder / "right.png")
    truth, truth_right = read(folder / "disp_left.pfm"), read(folder / "disp_right.pfm")
    columns = [("image and truth", left, colored(truth, truth))]
    for name in (preset, other):
        found = depthcli.stereo(left, right, int(np.nanmax(truth)) + 2, name)
        scores = depthcli.evaluate(found, truth, truth_right=truth_right)
        columns.append((f"{name}: map and errors", colored(found.values, truth), scores.picture))
    return panels(columns, [(0, 255, "gray")] * 2, 7.5)


def colored(values: Shown, truth: Shown) -> Shown:
    """Return a map in the colors of ``preview.png``."""
    low, high = np.nanpercentile(truth, (0.5, 99.5))
    levels = (255 * np.clip((np.nan_to_num(values, nan=low) - low) / (high - low), 0, 1)).astype(np.uint8)
    shown = cv2.applyColorMap(levels, cv2.COLORMAP_TURBO)[..., ::-1].copy()
    shown[~np.isfinite(values)] = 0
    return shown


@picture
def tutorial() -> Any:
    """The scene of the tutorial by both of its methods."""
    return with_errors("accurate", "opencv-sgbm", "--kind", "foreground", "--noise", "2", "--radiometric", "0.1")


@picture
def evaluate() -> Any:
    """Maps of two methods and their errors."""
    return with_errors("fast", "opencv-bm", "--kind", "curved", *SMALL, "--noise", "4")


@picture
def rig() -> Any:
    """A rectified image and its depth."""
    (folder,) = (each for each in sample("-n", "1", "--kind", "foreground").iterdir() if each.is_dir())
    left, right = read(folder / "left.png"), read(folder / "right.png")
    depth = depthcli.stereo(left, right, 48, "accurate").to_depth(focal=420.0, baseline=0.12).values
    near = 1 / depth
    return panels([("left image", left), ("depth: red near, blue far", colored(near, near))], width=5.5)


@picture
def kinect() -> Any:
    """Color, sensor and result of ``refine-kinect accurate``."""
    folder = sample("--kinect", *SMALL[:4], "--frames", "0", "--seed", "6") / "foreground"
    color, depth = read(folder / "color.png"), read(folder / "depth.pfm")
    near = 1 / depthcli.refine_depth(color, depth, "accurate").values
    columns = [("color", color), ("depth of the sensor", colored(1 / depth, near)), ("refined", colored(near, near))]
    return panels(columns, width=7.5)


@picture
def glass() -> Any:
    """Color, sensor, result of ``transparent sparse``, and truth."""
    scenes = sample("--transparent", *SMALL[:4], "--seed", "21")
    folder, run = scenes / "glass_21", Path(mkdtemp(dir=SCRATCH.name))
    command("transparent", "sparse", "--input", scenes, "--scenes", "glass_21", "--output", run)
    truth = 1 / read(folder / "depth_true.pfm")
    files = {"sensor": folder / "depth.pfm", "completed": run / "glass_21" / "depth.pfm"}
    found = {name: colored(1 / read(file), truth) for name, file in files.items()}
    return panels([("color", read(folder / "color.png")), *found.items(), ("truth", colored(truth, truth))])


def pair(*words: str) -> tuple[Shown, Shown, Shown]:
    """Return both views and the true disparities of a small scene."""
    (folder,) = (each for each in sample("-n", "1", *SMALL, *words).iterdir() if each.is_dir())
    return read(folder / "left.png"), read(folder / "right.png"), read(folder / "disp_left.pfm")


def planes() -> tuple[Shown, Shown, Shown]:
    return pair("--kind", "planes")


def match(left: Shown, right: Shown, maximum: int = 32, preset: str = "fast", **overrides: Any) -> Shown:
    """Return the disparities of a pair."""
    return depthcli.stereo(left, right, maximum, preset, overrides).values


@functools.cache
def good() -> Shown:
    left, right, _ = planes()
    return match(left, right)


def fault(wrong_map: Shown, right_map: Shown, titles: tuple[str, str], truth: Shown | None, *images: Any) -> Any:
    """Return a figure of images, the map with the fault and the map without it; with a truth, how much is wrong."""
    columns = list(images)
    for title, values in zip(titles, (wrong_map, right_map), strict=True):
        share = "" if truth is None else f": {wrong(values, truth, np.isfinite(truth)):.1f} % wrong"
        columns.append((title + share, values))
    return panels(columns, [(0, 32, "turbo")], 2.8 * len(columns))


@picture
def wrong_streaks() -> Any:
    """A pair that is not rectified."""
    left, right, truth = planes()
    turned = cv2.getRotationMatrix2D((120, 90), 2.5, 1)
    turned[1, 2] += 6
    tilted = cv2.warpAffine(right, turned, (240, 180), borderMode=cv2.BORDER_REPLICATE)
    return fault(match(left, tilted), good(), ("not rectified", "rectified"), truth)


@picture
def wrong_flipped() -> Any:
    """Swapped views, searched from -32 to 0."""
    left, right, _ = planes()
    flipped = depthcli.stereo(right, left, 0, "fast", min_disparity=-32).values
    return fault(flipped + 32, good(), ("views swapped", "right order"), None)


@picture
def wrong_one_color() -> Any:
    """Colors spread over a range that is too large."""
    shown = [(255 * np.clip(good() / top, 0, 1)).astype(np.uint8) for top in (200, 32)]
    titles = ("searched 0 to 200", "searched 0 to 32")
    columns = [
        (title, cv2.applyColorMap(each, cv2.COLORMAP_TURBO)[..., ::-1])
        for title, each in zip(titles, shown, strict=True)
    ]
    return panels(columns, width=5.6)


@picture
def wrong_near() -> Any:
    """A search range that ends too early."""
    left, right, truth = planes()
    return fault(match(left, right, 16), good(), ("0 to 16", "0 to 32"), truth)


@picture
def wrong_flat() -> Any:
    """A search range that begins too late."""
    left, right, truth = planes()
    found = depthcli.stereo(left, right, 32, "fast", min_disparity=12).values
    return fault(found, good(), ("12 to 32", "0 to 32"), truth)


@picture
def wrong_infinity() -> Any:
    """Saturated images."""
    left, right, truth = planes()
    bright = [np.clip(image * 2.5, 0, 255).astype(np.uint8) for image in (left, right)]
    return fault(match(*bright), good(), ("saturated", "exposed well"), truth, ("left image, saturated", bright[0]))


@picture
def wrong_dark() -> Any:
    """Dark images with noise, and the mean of some."""
    left, right, truth = planes()
    rng = np.random.default_rng(0)

    def night(frames: int) -> list[Shown]:  # 12 times brighter
        taken = [np.round(0.03 * np.array([left, right]) + rng.normal(0, 1.5, (2, *left.shape))) for _ in range(frames)]
        return [*np.clip(12 * np.mean(np.maximum(taken, 0), axis=0), 0, 255).astype(np.uint8)]

    one, mean = night(1), night(16)
    found = {
        "adjust: []": match(*one, adjust=[]), "adjust: [noise]": match(*one), "and the mean of 16 frames": match(*mean)
    }  # fmt: skip
    columns = [(f"{name}\n{wrong(values, truth, truth > 0):.1f} % wrong", values) for name, values in found.items()]
    return panels([("left image,\n12 times brighter", one[0]), *columns], [(0, 32, "turbo")])


@picture
def wrong_bare() -> Any:
    """Walls without texture."""
    left, right, _ = pair("--kind", "planes", "--wall-contrast", "0", "--noise", "3")
    found = depthcli.stereo(left, right, 32, "fast")
    kept = np.where(found.measured, found.values, np.nan)
    return fault(found.values, kept, ("all pixels", "measured pixels"), None, ("left image", left))


@picture
def wrong_repetitive() -> Any:
    """A texture that repeats."""
    left, right, truth = pair("--kind", "repetitive")
    fused = depthcli.fuse(left, right, 32, "accurate").values
    return fault(match(left, right), fused, ("stereo fast", "fuse accurate"), truth, ("left image", left))


@picture
def wrong_light() -> Any:
    """Views of different brightness."""
    left, right, truth = planes()
    darker = np.round(0.92 * right).astype(np.uint8)
    levels = {"cost": {"method": "absolute_difference"}, "optimization.p1": 5, "optimization.p2": 30}
    return fault(match(left, darker, **levels), match(left, darker), ("absolute_difference", "census"), truth)


@picture
def wrong_speckles() -> Any:
    """No smoothing and no refinement."""
    left, right, truth = planes()
    alone = match(left, right, optimization={"method": "winner_takes_all"}, refinement=[])
    return fault(alone, good(), ("winner_takes_all", "fast"), truth)


@picture
def wrong_fattened() -> Any:
    """A large window."""
    left, right, truth = planes()
    window = {
        "aggregation": {"method": "constant_window", "window": 31},
        "optimization": {"method": "winner_takes_all"},
    }
    accurate = match(left, right, preset="accurate")
    return fault(match(left, right, **window), accurate, ("window 31 x 31", "accurate"), truth)


@picture
def wrong_steps() -> Any:
    """Whole pixels on a slanted floor."""
    left, right, _ = planes()
    floor = np.s_[135:180, 60:150]
    whole = match(left, right, refinement=["left_right_check", "background_fill"])
    columns = [("whole pixels", whole[floor]), ("subpixel", good()[floor])]
    return panels(columns, [(17, 27, "turbo")], 5.6)


@picture
def wrong_holes() -> Any:
    """No filling."""
    left, right, truth = planes()
    holes = match(left, right, refinement=["left_right_check", "subpixel"])
    return fault(holes, good(), ("without a fill", "filled"), truth)

"""Pictures of the tutorial, of the pages on tasks and of docs/my_map_is_wrong.md."""

import functools
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import cv2
import numpy as np
from pictures import SCRATCH, Shown, command, error_legend, panels, picture, read, real_pair, sample, wrong

import depthcli

FILES = ("left.png", "right.png", "disp_left.pfm", "disp_right.pfm")
SMALL = ("--width", "240", "--height", "180", "--max-disparity", "32")


def with_errors(left: Shown, right: Shown, truth: Shown, presets: tuple[str, str], other: Shown | None = None) -> Any:
    """Return image and truth, then map and errors of two presets."""
    columns = [("image and ground truth", left, truth)]
    for name in presets:
        found = depthcli.stereo(left, right, int(np.nanmax(truth)) + 2, name)
        scores = depthcli.evaluate(found, truth, truth_right=other)
        share = wrong(found.values, truth, np.isfinite(truth))
        columns.append((f"{name}: {share:.1f} % incorrect", found.values, scores.picture))
    # The truth is in the second row, with the errors of the others: two ranges of the same map.
    span = (*np.nanpercentile(truth, (0.5, 99.5)), "turbo")
    figure = panels(columns, [span, span], 9.0, ["disparity, px", "disparity, px"])
    error_legend(figure)
    return figure


@picture
def tutorial() -> Any:
    """The real pair by both methods of the tutorial."""
    return with_errors(*real_pair(), ("accurate", "opencv-sgbm"))


@picture
def evaluate() -> Any:
    """Maps of two methods and their errors."""
    (folder,) = (
        each for each in sample("-n", "1", "--kind", "curved", *SMALL, "--noise", "4").iterdir() if each.is_dir()
    )
    left, right, truth, other = (read(folder / name) for name in FILES)
    return with_errors(left, right, truth, ("fast", "opencv-bm"), other)


def depths(color: Shown, found: dict[str, Shown], truth: Shown, width: float) -> Any:
    """Return a figure of a color image and depth maps, near values red."""
    span = (*np.nanpercentile(truth, (0.5, 99.5)), "turbo_r")
    return panels([("color", color), *found.items()], [span], width, ["depth, m"])


@picture
def rig() -> Any:
    """A rectified image and its depth."""
    (folder,) = (each for each in sample("-n", "1", "--kind", "foreground").iterdir() if each.is_dir())
    left, right = read(folder / "left.png"), read(folder / "right.png")
    depth = depthcli.stereo(left, right, 48, "accurate").to_depth(focal=420.0, baseline=0.12).values
    return depths(left, {"depth": depth}, depth, 6.5)


@picture
def kinect() -> Any:
    """Color, sensor and result of ``refine-kinect accurate``."""
    folder = sample("--kinect", *SMALL[:4], "--frames", "0", "--seed", "6") / "foreground"
    color, depth = read(folder / "color.png"), read(folder / "depth.pfm")
    refined = depthcli.refine_depth(color, depth, "accurate").values
    return depths(color, {"depth of the sensor": depth, "refined": refined}, refined, 8.5)


@picture
def glass() -> Any:
    """Color, sensor, result of ``transparent sparse``, and truth."""
    scenes = sample("--transparent", *SMALL[:4], "--seed", "21")
    folder, run = scenes / "glass_21", Path(mkdtemp(dir=SCRATCH.name))
    command("transparent", "sparse", "--input", scenes, "--scenes", "glass_21", "--output", run)
    truth = read(folder / "depth_true.pfm")
    found = {"depth of the sensor": read(folder / "depth.pfm"), "completed": read(run / "glass_21" / "depth.pfm")}
    return depths(read(folder / "color.png"), found | {"ground truth": truth}, truth, 10.0)


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
        share = "" if truth is None else f"\n{wrong(values, truth, np.isfinite(truth)):.1f} % incorrect"
        columns.append((title + share, values))
    return panels(columns, [(0, 32, "turbo")], 2.8 * len(columns) + 0.5, ["disparity, px"])


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
    return fault(flipped + 32, good(), ("views swapped", "views in order"), None)


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
    return fault(match(*bright), good(), ("saturated", "well exposed"), truth, ("left image, saturated", bright[0]))


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
    columns = [(f"{name}\n{wrong(values, truth, truth > 0):.1f} % incorrect", values) for name, values in found.items()]
    shown = [("left image,\n12 times brighter", one[0]), *columns]
    return panels(shown, [(0, 32, "turbo")], 10.0, ["disparity, px"])


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
    return panels(columns, [(17, 27, "turbo")], 6.1, ["disparity, px"])


@picture
def wrong_holes() -> Any:
    """No filling."""
    left, right, truth = planes()
    holes = match(left, right, refinement=["left_right_check", "subpixel"])
    return fault(holes, good(), ("without a fill", "filled"), truth)

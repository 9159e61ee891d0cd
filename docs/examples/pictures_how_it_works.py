"""Pictures of how the methods work."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import matplotlib.pyplot as plt
import numpy as np
import SimpleITK
from matplotlib.colors import LogNorm, Normalize
from pictures import command, error_legend, maps, panels, picture, read, sample, scene

import depthcli

PLANES, FOREGROUND = ("--kind", "planes"), ("--kind", "foreground")
OTHER_LIGHT = (*PLANES, "--radiometric", "0.3")
WINDOW = {"aggregation": {"method": "constant_window", "window": 11}, "optimization": "winner_takes_all"}
N_DISPARITIES = 32


def stereo(pair: Sequence[Any], preset: str, overrides: dict[str, Any]) -> Any:
    return depthcli.stereo(*pair, N_DISPARITIES, preset, overrides).values


@picture
def costs() -> Any:
    """Three costs, if the views differ in brightness."""
    left, right, truth, visible = scene(*OTHER_LIGHT)
    bare = {**WINDOW, "adjust": [], "refinement": []}
    names = ("absolute_difference", "gradient", "census")
    return maps({name: stereo((left, right), "fast", {**bare, "cost": name}) for name in names}, truth, visible)


@picture
def penalty() -> Any:
    """Three penalties of a jump."""
    left, right, truth, visible = scene(*PLANES)
    found = {
        f"p2 = {n}": stereo((left, right), "fast", {"optimization.p1": min(25, n), "optimization.p2": n})
        for n in (5, 120, 1000)
    }
    return maps(found, truth, visible)


@picture
def fill() -> Any:
    """A map without filling and with two."""
    left, right, truth, _ = scene(*PLANES)
    checked = ["left_right_check", {"method": "speckle_filter", "size": 50}, "subpixel"]
    ways = {
        "no filling": [],
        "background_fill": ["background_fill"],
        "surface_fill": ["surface_fill", "background_fill"],
    }
    found = {
        name: stereo((left, right), "accurate", {"refinement": [*checked, *steps]}) for name, steps in ways.items()
    }
    return maps(found, truth, np.isfinite(truth))


@picture
def smoothness() -> Any:
    """Planes of segments with three weights of the smoothness."""
    left, right, truth, _ = scene(*FOREGROUND)
    found = {f"smoothness = {n}": stereo((left, right), "segments", {"energy.smoothness": n}) for n in (0, 25, 2000)}
    return maps(found, truth, np.isfinite(truth))


@picture
def rows() -> Any:
    """A pair whose right view is two rows lower, as it is and adjusted."""
    left, right, truth, visible = scene(*PLANES)
    lower = np.roll(right, 2, axis=0)
    ways: dict[str, list[str]] = {"not adjusted": [], "adjust: [light]": ["light"], "adjust: [rows]": ["rows"]}
    found = {name: stereo((left, lower), "accurate", {"adjust": how}) for name, how in ways.items()}
    return maps(found, truth, visible)


FB = 43.5  # focal length x baseline of a first Kinect, pixel meters


def kinect(kind: str) -> tuple[Any, Any, Any, list[Any]]:
    folder = sample("--kinect", "--width", "240", "--height", "180", "--frames", "0") / kind
    masks = [read(folder / f"mask_{name}.png") > 0 for name in ("gap", "mismatch", "measured")]
    return read(folder / "color.png"), read(folder / "depth.pfm"), read(folder / "depth_true.pfm"), masks


def comparison(
    values: Sequence[Any], compute: Callable[[Any], Any], key: str, form: str, masks: Mapping[str, Any]
) -> list[Any]:
    """Columns of (title, map, error) for the values of a parameter; ``compute`` returns map and error."""
    columns = []
    for value in values:
        found, error = compute(value)
        means = ", ".join(f"{name} {format(np.nanmean(error[mask]), form)}" for name, mask in masks.items())
        columns.append((f"{key} = {value}\n{means}", found, error))
    return columns


@picture
def kinect_faults() -> Any:
    """A measurement of a Kinect and the kinds of fault."""
    color, depth, truth, masks = kinect("foreground")
    kinds = np.full((*depth.shape, 3), 60, np.uint8)
    for mask, shade in zip(masks, ((70, 130, 230), (230, 90, 40), (190, 190, 190)), strict=True):
        kinds[mask] = shade
    columns = [("color", color), ("true disparity", FB / truth), ("measured", FB / depth), ("kinds of fault", kinds)]
    return panels(columns, [(0, 48, "turbo")], 10.0, ["disparity, px"])


@picture
def kinect_probability() -> Any:
    """Three values of min_probability of `refine-kinect accurate`."""
    color, depth, truth, masks = kinect("camouflage")

    def compute(value: float) -> tuple[Any, Any]:
        refined = depthcli.refine_depth(color, depth, "accurate", {"min_probability": value}, fb=FB).values
        return FB / refined, np.abs(FB / refined - FB / truth)

    columns = comparison(
        (0.1, 0.5, 0.8),
        compute,
        "min_probability",
        ".2f",
        dict(zip(("gaps", "edges", "rest"), masks, strict=True)),
    )
    spans = [(*np.nanpercentile(FB / truth, (1, 99)), "turbo"), (0, 5, "magma")]
    return panels(columns, spans, 9.0, ["disparity, px", "error, px"])


def glass() -> tuple[Any, ...]:
    folder = sample("--transparent", "--width", "280", "--height", "210", "--share", "0.03") / "glass_1"
    maps = [read(folder / f"{name}.pfm") for name in ("depth", "sparse", "depth_true")]
    return read(folder / "color.png"), *maps, read(folder / "mask_transparent.png") > 0


@picture
def glass_input() -> Any:
    """Color, sensor, samples and truth."""
    color, sensor, sparse, truth, _ = glass()
    dots = cv2.dilate(np.nan_to_num(sparse), np.ones((2, 2)))
    dots[dots == 0] = np.nan
    columns = [("color", color), ("sensor", sensor), ("sparse samples (enlarged)", dots), ("ground truth", truth)]
    return panels(columns, [(*np.nanpercentile(truth, (1, 99)), "turbo_r")], 10.0, ["depth, m"])


@picture
def glass_outline() -> Any:
    """Two costs of the outline of a region."""
    color, sensor, sparse, truth, inside = glass()

    def compute(value: float) -> tuple[Any, Any]:
        settings = {"unreliable.outline": value}
        depth = depthcli.complete_transparent(color, sensor, sparse, "sparse", settings, fb=24.0).values
        return depth, 1000 * np.abs(depth - truth)

    masks = {"glass": inside, "elsewhere": ~inside & np.isfinite(sensor)}
    columns = comparison((5, 50), compute, "outline", ".0f", masks)
    spans = [(*np.nanpercentile(truth, (1, 99)), "turbo_r"), (0, 200, "magma")]
    return panels(columns, spans, 6.4, ["depth, m", "error, mm"])


@picture
def fusion_weights() -> Any:
    """Three weights of two measures."""
    left, right, truth, visible = scene(*OTHER_LIGHT)
    two = {"measures": ["absolute_difference", "census"], "blend": "after", "consensus.vote_cost": 0}
    found = {
        f"weights: {name}": depthcli.fuse(left, right, N_DISPARITIES, "consensus", {**two, "weights": name}).values
        for name in ("equal", "select", "consensus")
    }
    return maps(found, truth, visible)


@picture
def fusion_choice() -> Any:
    """Nearly bare walls: one pipeline, and the two choices among maps."""
    left, right, truth, visible = scene(*PLANES, "--wall-contrast", "0.05")
    found = {"stereo accurate": stereo((left, right), "accurate", {})}
    for name in ("energy", "network"):
        settings = {"maps.choice": name, "confidence": []}
        found[f"fuse accurate, {name}"] = depthcli.fuse(left, right, N_DISPARITIES, "accurate", settings).values
    return maps(found, truth, visible)


@picture
def bound() -> Any:
    """A map, its bound, and the true error in the colors of the bound."""
    left, right, truth, _ = scene("--kind", "repetitive")
    found = depthcli.stereo(left, right, N_DISPARITIES, "accurate", bound=True)
    low, high = np.nanpercentile(found.bound, (1, 99))
    shown = [
        ("map", found.values, Normalize(truth.min() - 3, truth.max()), "turbo", "disparity, px"),
        ("error bound", found.bound, LogNorm(low, high), "viridis", "bound, px"),
        ("true error", np.maximum(np.abs(found.values - truth), low), LogNorm(low, high), "viridis", "error, px"),
    ]
    figure, axes = plt.subplots(1, 3, figsize=(11, 2.6), layout="constrained")
    for axis, (title, values, scale, colors, unit) in zip(axes, shown, strict=True):
        drawn = axis.imshow(values, colors, norm=scale)
        axis.set_title(title, fontsize=9)
        axis.set_axis_off()
        figure.colorbar(drawn, ax=axis, label=unit, shrink=0.9)
    return figure


@picture
def confidence_order() -> Any:
    """Wrong pixels, and pixels in the order of three measures."""
    left, right, truth, _ = scene(*PLANES)
    names = ["pkr", "lrc", "da"]
    found = depthcli.stereo(left, right, N_DISPARITIES, "fast", {**WINDOW, "refinement": []}, confidence=names)
    right_pixels = np.abs(found.values - truth) <= 1
    columns: list[Any] = [("incorrect (black)", right_pixels.astype(float))]
    for name in names:
        ordered = np.sort(found.confidence[name], axis=None)
        ends = (np.searchsorted(ordered, found.confidence[name], side) for side in ("left", "right"))
        columns.append((name, sum(ends) / (2 * ordered.size)))
    return panels(columns, [(0, 1, "gray")], 10.0, ["rank; 1: most certain"])


@picture
def confidence_kept() -> Any:
    """The surest pixels of a map of `fuse accurate`."""
    left, right, truth, _ = scene(*PLANES)
    found = depthcli.fuse(left, right, N_DISPARITIES)
    sure, bad = found.confidence["probability"], np.abs(found.values - truth) > 1
    columns = []
    for share in (100, 90, 70):
        kept = sure >= np.percentile(sure, 100 - share)
        shown = np.where(kept, found.values, np.nan)
        columns.append((f"most certain {share} %\n{100 * bad[kept].mean():.2f} % of them incorrect", shown))
    return panels(columns, [(truth.min() - 3, truth.max(), "turbo")], 9.5, ["disparity, px"])


def volumes() -> tuple[Any, Any, Any, Any, Any]:
    folder = sample("--registration", "-n", "1") / "pair_0"
    images = [
        SimpleITK.ReadImage(str(folder / f"{n}.nii.gz")) for n in ("fixed", "moving_warped", "mask", "error_true")
    ]
    return *(SimpleITK.GetArrayFromImage(image).astype(np.float32) for image in images), images[0].GetSpacing()[::-1]


def slices(columns: Sequence[tuple[str, Any, str, float]]) -> Any:
    """A figure of slices, each with its colors and highest value; the last ones in mm."""
    figure, axes = plt.subplots(1, len(columns), figsize=(9, 9 / len(columns) - 0.05), layout="constrained")
    for axis, (title, values, colors, top) in zip(axes, columns, strict=True):
        shown = axis.imshow(values, colors, vmin=0, vmax=top)
        axis.set_title(title, fontsize=9)
        axis.set_facecolor("black")
        axis.set(xticks=[], yticks=[])
    figure.colorbar(shown, ax=axes, shrink=0.75, label="mm")
    return figure


@picture
def registration() -> Any:
    """A slice of both volumes, the expected and the true error."""
    fixed, warped, mask, truth, spacing = volumes()
    k, found = len(fixed) // 2, depthcli.registration_confidence(fixed, warped, spacing, mask=mask)
    errors = [np.where(mask[k] > 0, values[k], np.nan) for values in (found.values, truth)]
    grey = [("fixed", fixed[k], "gray", 600.0), ("warped", warped[k], "gray", 600.0)]
    return slices([*grey, ("expected error", errors[0], "turbo", 6.0), ("true error", errors[1], "turbo", 6.0)])


@picture
def registration_features() -> Any:
    """Three features, if the contrast of one volume is inverted."""
    fixed, warped, mask, truth, spacing = volumes()
    inverted = (600 * np.exp(-np.maximum(warped, 0) / 250)).astype(np.float32)
    k, columns = len(fixed) // 2, []
    for name in ("intensity", "local_ncc", "mind"):
        found = depthcli.registration_confidence(fixed, inverted, spacing, "mind", {"features": [name]}, mask=mask)
        off = np.abs(found.values - truth)[mask > 0].mean()
        columns.append((f"{name}\noff by {off:.1f} mm", np.where(mask[k] > 0, found.values[k], np.nan), "turbo", 6.0))
    return slices([*columns, ("true error", np.where(mask[k] > 0, truth[k], np.nan), "turbo", 6.0)])


@picture
def rectified_rows() -> Any:
    """Photos of two turned cameras with distorting lenses, before and after the rectification."""
    (folder,) = sample("-n", "1", "--width", "400", "--height", "300", "--max-disparity", "40", *PLANES).glob(
        "planes_*"
    )
    matrix, distortion = np.array([[300, 0, 199.5], [0, 300, 149.5], [0, 0, 1.0]]), np.array([-0.25, 0.06, 0, 0, 0])
    turns = [cv2.Rodrigues(np.radians(angles))[0] for angles in ((0.6, -1.2, 0.8), (-1.0, 1.0, -1.5))]
    place, photos = Path(folder) / "photos", []
    place.mkdir(exist_ok=True)
    grid = np.stack(np.meshgrid(np.arange(400), np.arange(300)), -1).reshape(-1, 1, 2).astype(np.float64)
    for name, turn in zip(("left", "right"), turns, strict=True):
        source = (
            cv2.undistortPoints(grid, matrix, distortion, R=turn.T, P=matrix).reshape(300, 400, 2).astype(np.float32)
        )
        photo = cv2.remap(cv2.imread(str(folder / f"{name}.png")), source[..., 0], source[..., 1], cv2.INTER_LINEAR)
        cv2.imwrite(str(place / f"{name}.png"), photo)
        photos.append(photo[..., ::-1])
    storage = cv2.FileStorage(str(place / "stereo.yml"), cv2.FILE_STORAGE_WRITE)
    left, right = turns
    values = {"R": right @ left.T, "T": -right @ np.array([[0.1], [0], [0]])}
    for key, value in {"K1": matrix, "D1": distortion, "K2": matrix, "D2": distortion, **values}.items():
        storage.write(key, value)
    storage.release()
    files = ("--left", place / "left.png", "--right", place / "right.png", "--calibration", place / "stereo.yml")
    command("rectify", *files, "--name", "pair", "--output", place / "rectified")
    after = [read(place / "rectified" / "pair" / f"{name}.png") for name in ("left", "right")]
    figure, axes = plt.subplots(1, 2, figsize=(9, 2.3), layout="constrained")
    for axis, title, views in zip(axes, ("photos", "rectified"), (photos, after), strict=True):
        axis.imshow(np.hstack(views))
        for row in range(25, 300, 50):
            axis.axhline(row, color="yellow", lw=0.7)
        axis.set_title(title, fontsize=9)
        axis.set_axis_off()
    return figure


@picture
def thresholds() -> Any:
    """Errors of a map at three thresholds."""
    (folder,) = sample("-n", "1", "--width", "240", "--height", "180", "--max-disparity", "32", *PLANES).glob(
        "planes_*"
    )
    views, truth, other = (read(folder / f"{n}") for n in ("left.png", "disp_left.pfm", "disp_right.pfm"))
    found = depthcli.stereo(views, read(folder / "right.png"), N_DISPARITIES, "fast")
    columns = []
    for threshold in (0.5, 1, 4):
        scores = depthcli.evaluate(found, truth, threshold=threshold, truth_right=other)
        shares = ", ".join(f"{name} {value:.1f}" for name, value in scores.headline.items())
        columns.append((f"threshold {threshold} px\n{shares} %", scores.picture))
    figure = panels(columns)
    error_legend(figure)
    return figure


@picture
def sparsification() -> Any:
    """Sparsification curves of three measures of one map."""
    left, right, truth, _ = scene(*PLANES)
    names = ("pkr", "msm", "lrd")
    found = depthcli.stereo(left, right, N_DISPARITIES, "fast", confidence=names, refinement=[])
    bad = np.sort(np.abs(found.values - truth).ravel() > 1)  # the best order
    e, share = bad.mean(), np.arange(1, bad.size + 1) / bad.size
    figure, axis = plt.subplots(figsize=(6.5, 3.2), layout="constrained")
    for name in names:
        order = np.argsort(-found.confidence[name].ravel(), kind="stable")
        curve = np.cumsum((np.abs(found.values - truth).ravel() > 1)[order]) / np.arange(1, bad.size + 1)
        axis.plot(share, 100 * curve, label=f"{name}: AUC {100 * curve.mean():.1f} %")
    best = e + (1 - e) * np.log(1 - e)
    axis.plot(share, 100 * np.cumsum(bad) / np.arange(1, bad.size + 1), "k--", lw=1, label=f"best: {100 * best:.1f} %")
    axis.axhline(100 * e, color="gray", ls=":", lw=1, label=f"random: {100 * e:.1f} %")
    axis.set(
        xlabel="share of the pixels kept, the most certain first",
        ylabel="bad pixels, %",
        xlim=(0, 1),
        ylim=(0, 130 * e),
    )
    axis.legend(fontsize=8)
    return figure

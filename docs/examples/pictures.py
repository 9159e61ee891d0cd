#!/usr/bin/env python3
"""Draw the pictures of the documentation, docs/static/*.webp, from a real pair and generated scenes.

    docs/examples/pictures.py [--check] [--only NAME,NAME]

Each function marked by ``@picture``, here and in pictures_*.py, draws the file of its name. ``--check`` draws into
memory and fails where a committed picture differs by more than 3 of 255 levels on average, is missing, or is drawn by
no function.
"""

import functools
import importlib
import io
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))
import _env  # first: continues in the checkout's environment
import cv2
import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image

mpl.use("agg")
import matplotlib.pyplot as plt
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgb
from matplotlib.patches import Patch

import depthcli
from depthcli.cli import main as run
from depthcli.show.view import KIND_COLORS

FOLDER = _env.ROOT / "docs" / "static"
SCRATCH = tempfile.TemporaryDirectory()
DPI = 180
TOLERANCE = 3.0  # levels of 255, mean: fonts and rounding of other machines
PICTURES: dict[str, Callable[[], Any]] = {}  # name of the file -> function that returns a figure or RGB levels
Shown = NDArray[Any]


def picture(draw: Callable[[], Any]) -> Callable[[], Any]:
    """Register a function that returns a figure, or an (H, W, 3) uint8 RGB array."""
    assert draw.__name__ not in PICTURES, draw.__name__
    PICTURES[draw.__name__] = draw
    return draw


@functools.cache
def sample(*words: str) -> Path:
    """Return the folder that ``depthcli sample`` fills with these options; it is made once."""
    folder = Path(tempfile.mkdtemp(dir=SCRATCH.name))
    command("sample", "--output", folder, *words)
    return folder


def command(*words: object) -> None:
    """Run a command of depthcli, quietly."""
    if code := run([*map(str, words), "--quiet"]):
        sys.exit(f"depthcli {' '.join(map(str, words))}: exit code {code}")


def read(file: Path) -> Shown:
    """Return an image in RGB, or a map with NaN where it has no value."""
    values = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if values.dtype == np.float32:
        return np.where(np.isfinite(values), values, np.nan)
    return values[..., ::-1].copy() if values.ndim == 3 else values


def panels(
    columns: Sequence[tuple[Any, ...]],
    ranges: Sequence[tuple[Any, Any, str]] = (),
    width: float = 9.0,
    units: Sequence[str] = (),
) -> Any:
    """Return a figure with a column for each (title, image or map, ...), and a row for each (low, high, colors).

    Rows with a unit have a color bar. Pixels without a value are black.
    """
    rows, lines = len(columns[0]) - 1, max(title.count("\n") + 1 for title, *_ in columns)
    height, wide = columns[0][1].shape[:2]
    size = (width, rows * ((width / len(columns) - 0.083) * height / wide + 0.083) + 0.14 + 0.15 * lines)
    figure, axes = plt.subplots(rows, len(columns), figsize=size, squeeze=False, layout="constrained")
    for k, (title, *shown) in enumerate(columns):
        axes[0, k].set_title(title, fontsize=9)
        for axis, values, (low, high, colors) in zip(axes[:, k], shown, ranges or [(0, 255, "gray")], strict=True):
            scale = plt.get_cmap(colors).with_extremes(bad="black")
            axis.imshow(values if values.ndim == 3 else np.ma.masked_invalid(values), scale, vmin=low, vmax=high)
            axis.set_axis_off()
            axis.set_anchor("S")  # room that is left over is above the title
    for row, unit, (low, high, colors) in zip(axes, units, ranges, strict=False):
        if unit:
            colored = ScalarMappable(Normalize(low, high), colors)
            figure.colorbar(colored, ax=list(row), label=unit, shrink=0.9, pad=0.01, aspect=16)
    return figure


def error_legend(figure: Any) -> None:
    """Add the colors of error pictures below a figure."""
    names = {"correct": "blue", "incorrect": "orange", "occluded, correct": "grey", "occluded, incorrect": "purple",
             "no value": "black", "no ground truth": "white"}  # fmt: skip
    colors = {name: 0.75 * np.array(to_rgb(light)) + 0.25 * np.array(to_rgb(dark)) for name, light, dark in KIND_COLORS}
    patches = [
        Patch(facecolor=colors[color], edgecolor="black", linewidth=0.4, label=name) for name, color in names.items()
    ]
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + 0.3)
    figure.legend(handles=patches, loc="outside lower center", ncols=len(patches), fontsize=7, frameon=False)


def scene(*words: str) -> tuple[Shown, Shown, Shown, Shown]:
    """Return both views, the true disparities and the visible pixels of a generated stereo scene."""
    size = ("--width", "240", "--height", "180", "--max-disparity", "32", "--noise", "3")
    (folder,) = (each for each in sample("-n", "1", *size, *words).iterdir() if each.is_dir())
    left, right, truth, visible = (
        read(folder / f"{n}") for n in ("left.png", "right.png", "disp_left.pfm", "mask_nonocc.png")
    )
    return left, right, truth, visible > 0


def maps(found: dict[str, Shown], truth: Shown, pixels: Shown) -> Any:
    """Return a figure of disparity maps, with the percentage of these pixels that are wrong."""
    columns = [(f"{title}\n{wrong(values, truth, pixels):.1f} % incorrect", values) for title, values in found.items()]
    return panels(columns, [(truth.min() - 3, truth.max(), "turbo")], 3.1 * len(columns), ["disparity, px"])


def wrong(values: Shown, truth: Shown, pixels: Shown) -> float:
    """Return the percentage of pixels that are off by more than 1 pixel, or have no value."""
    return float(100 * np.mean(~(np.abs(values - truth) <= 1)[pixels]))


def encoded(drawn: Any) -> bytes:
    """Return a figure or an array as a WebP of high quality, a fifth of a PNG."""
    small = io.BytesIO()
    if isinstance(drawn, np.ndarray):
        image = Image.fromarray(drawn)
    else:
        file = io.BytesIO()
        drawn.savefig(file, dpi=DPI)
        plt.close(drawn)
        image = Image.open(file).convert("RGB")
    image.save(small, "WEBP", quality=88, method=6)
    return small.getvalue()


def problem(file: Path, drawn: bytes) -> str:
    """Return how a committed picture differs from the one drawn now; empty if it does not."""
    if not file.is_file():
        return "missing"
    old, new = (np.asarray(Image.open(source).convert("RGB"), np.float32) for source in (file, io.BytesIO(drawn)))
    if old.shape != new.shape:
        return f"{old.shape[1]} x {old.shape[0]} pixels, not {new.shape[1]} x {new.shape[0]}"
    off = float(np.abs(old - new).mean())
    return f"differs by {off:.1f} levels" if off > TOLERANCE else ""


def main() -> None:
    options = _env.options(__doc__, check=False, only=[""])
    sys.modules["pictures"] = sys.modules["__main__"]  # this module, for those that draw
    for file in sorted(Path(__file__).parent.glob("pictures_*.py")):
        importlib.import_module(file.stem)
    names = [name for name in PICTURES if options.only in ([""], []) or name in options.only]
    problems = [f"{file.name}: no function draws it" for file in FOLDER.glob("*.webp") if file.stem not in PICTURES]
    for name in names:
        file, drawn = FOLDER / f"{name}.webp", encoded(PICTURES[name]())
        if options.check and (found := problem(file, drawn)):
            problems.append(f"{file.name}: {found}")
        elif not options.check:
            file.write_bytes(drawn)
        print(f"{file.relative_to(_env.ROOT)}: {len(drawn) / 1000:.0f} kB", flush=True)
    if options.check and problems:
        sys.exit("\n".join([*problems, "docs/examples/pictures.py draws them again"]))


@functools.cache
def real_pair() -> tuple[Shown, Shown, Shown]:
    """Return both views and the true disparities of the real pair of ``depthcli sample --real``."""
    folder = sample("--real") / "Motorcycle"
    return read(folder / "left.png"), read(folder / "right.png"), read(folder / "disp_left.pfm")


@picture
def overview() -> Any:
    """The real pair: left image, map of ``accurate``, its errors, and those of OpenCV's SGBM."""
    left, right, truth = real_pair()
    known, errors = np.isfinite(truth), []
    for preset in ("accurate", "opencv-sgbm"):
        found = depthcli.stereo(left, right, 70, preset)
        scores = depthcli.evaluate(found, truth)
        title = "OpenCV's SGBM" if preset == "opencv-sgbm" else f"stereo {preset}"
        errors.append((f"{title}: {wrong(found.values, truth, known):.1f} % incorrect", scores.picture))
        if preset == "accurate":
            columns = [("left image", left), ("disparities of stereo accurate", found.values)]
    return panels([*columns, *errors], [(np.nanmin(truth), np.nanmax(truth), "turbo")], 13.0, ["disparity, px"])


if __name__ == "__main__":
    main()

"""Files that results write, which are those of the commands, and choices of the pixels in them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import ConfigError, InputError, OutputError
from depthcli.core.maps import DepthMap, MatchedMap
from depthcli.core.result import Result
from depthcli.io.formats.depth import write_depth_png
from depthcli.io.formats.disparity import write_disparity_png, write_pfm
from depthcli.io.formats.files import write_text
from depthcli.io.formats.images import write_png
from depthcli.io.formats.status import write_status
from depthcli.show.draw import draw
from depthcli.show.table import to_csv
from depthcli.show.view import DEPTH_STATUS_PALETTE, STATUS_PALETTE, View

Pixels = str | NDArray[np.bool_]
"""Name of a choice of pixels, or (H, W) bool."""


def made(folder: Path | str) -> Path:
    """Return the folder, created where it is missing; OutputError where that cannot be."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from error
    return Path(folder)


def write_depth(
    depth: MatchedMap | DepthMap,
    folder: Path,
    scale: float,
    rotate: int = 0,
    bound: NDArray[np.float32] | None = None,
) -> None:
    """Write ``depth.pfm``, ``depth.png``, ``status.png``, ``preview.png``, and ``bound.pfm`` of a map in meters."""
    write_pfm(folder / "depth.pfm", depth.values)
    write_depth_png(folder / "depth.png", depth.values, scale, rotate)
    palette = DEPTH_STATUS_PALETTE if isinstance(depth, DepthMap) else STATUS_PALETTE
    write_status(folder / "status.png", depth.status, palette)
    _write_preview(folder, View.of_depth(depth.values, bound))


def write_disparity(
    view: View, status: NDArray[np.uint8], folder: Path, probability: NDArray[np.float32] | None = None
) -> None:
    """Write ``disp_left.pfm``, ``disp_left.png``, ``status.png`` and ``preview.png``.

    And ``bound.pfm`` and ``probability.pfm``, where they are given.
    """
    write_pfm(folder / "disp_left.pfm", view.values)
    # The PNG has no code for what is negative: those pixels have no value there.
    write_disparity_png(folder / "disp_left.png", np.where(view.values < 0, np.float32(np.nan), view.values))
    write_status(folder / "status.png", status, STATUS_PALETTE)
    _write_preview(folder, view)
    if probability is not None:
        write_pfm(folder / "probability.pfm", probability)


def _write_preview(folder: Path, view: View) -> None:
    if view.bound is not None:
        write_pfm(folder / "bound.pfm", view.bound)
    write_png(folder / "preview.png", draw(view, "preview"))


def write_details(result: Result, folder: Path) -> None:
    """Write ``confidence_NAME.pfm`` and a picture of each confidence; tables as CSV, and pictures."""
    for name, confidence in result.confidence.items():
        write_pfm(folder / f"confidence_{name}.pfm", confidence)
        write_png(folder / f"confidence_{name}.png", draw(View(confidence), "confidence"))
    for name, rows in result.tables.items():
        write_text(folder / f"{name}.csv", to_csv(rows))
    for name, picture in result.pictures.items():
        write_png(folder / f"{name}.png", picture)


def parse_mask(text: str) -> tuple[str, float, str]:
    """Return kind, share and name of a mask as :func:`chosen_pixels` takes it; ConfigError for other texts."""
    kind, _, rest = text.partition(":")
    share, _, name = rest.partition(":")
    try:
        number = float(share or "nan")
    except ValueError:
        number = -1.0
    if (kind in ("measured", "all") and not rest) or (kind == "confident" and 0 < number <= 1):
        return kind, number, name
    raise ConfigError(f"mask: must be measured, all, or confident:0.8 (got {text!r})")


def chosen_pixels(
    found: MatchedMap | DepthMap, mask: Pixels, confidence: Mapping[str, NDArray[np.float32]] | None = None
) -> NDArray[np.bool_]:
    """Return the pixels of a map that a mask chooses, (H, W) bool.

    ``confident:0.8:NAME`` chooses those of the measured ones at and above the quantile of a confidence; the name may be
    left out where there is one only. ConfigError for other texts; InputError for an array of another shape or dtype,
    and where no confidence has that name, or none is named and there are several.
    """
    if not isinstance(mask, str):
        if np.shape(mask) != found.values.shape or np.asarray(mask).dtype != np.bool_:
            raise InputError(f"mask: expected bool of shape {found.values.shape}, got {np.shape(mask)}")
        return mask
    kind, share, name = parse_mask(mask)
    measured = found.valid & ~found.filled
    if kind != "confident":
        return measured if kind == "measured" else found.valid
    maps = confidence or {}
    name = name or (next(iter(maps)) if len(maps) == 1 else "")
    if name not in maps:
        raise InputError(f"mask {mask}: which confidence map? there are: {', '.join(maps) or 'none'}")
    measured &= np.isfinite(maps[name])
    if measured.any():
        measured &= maps[name] >= np.quantile(maps[name][measured], 1 - share, method="higher")
    return measured


def check_limits(near: float, far: float | None) -> None:
    """Raise ConfigError where no depth lies between ``--near`` and ``--far``, meters; ``far`` None: no limit."""
    if far is not None and near >= far:
        raise ConfigError(f"--near {near:g}, --far {far:g}: no depth lies between them")


def empty_cloud(depth: NDArray[np.float32], cloud: NDArray[np.bool_]) -> list[str]:
    """Return a warning where none of the pixels ``cloud`` has a depth, else no line."""
    known = np.isfinite(depth)
    if np.any(known & cloud):
        return []
    if not known.any():
        return ["points.ply has no points: no depth is known"]
    low, high = float(depth[known].min()), float(depth[known].max())
    return [
        f"points.ply has no points, the depths are {low:.3g} to {high:.3g} m; see --near, --far, --mask, --max-bound"
    ]

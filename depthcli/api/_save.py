"""Results as files, one writer per kind of result."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.errors import OutputError
from depthcli.core.result import DepthResult, Result
from depthcli.io.formats.depth import write_depth_png, write_ply
from depthcli.io.formats.disparity import write_disparity_png, write_pfm
from depthcli.io.formats.files import write_text
from depthcli.io.formats.images import write_png
from depthcli.io.formats.pictures import (
    DEPTH_STATUS_PALETTE,
    STATUS_PALETTE,
    Palette,
    confidence_picture,
    preview,
    preview_depth,
    write_status,
)
from depthcli.methods.stereo.volume import StereoResult
from depthcli.run.json_csv import to_csv


def share(pixels: NDArray[np.bool_]) -> float:
    """Return the share of pixels that are True, as reports hold it."""
    return round(float(np.mean(pixels)), 6)


def made(folder: Path | str) -> Path:
    """Return the folder, created where it is missing; OutputError where that cannot be."""
    path = Path(folder)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error
    return path


def stereo_preview(values: NDArray[np.float32], min_disparity: int, max_disparity: int) -> NDArray[np.uint8]:
    """Return the (H, W, 3) RGB picture of disparities between the bounds, black = no value."""
    return preview(values - np.float32(min_disparity), max_disparity - min_disparity)


def save_stereo(result: StereoResult, folder: Path, min_disparity: int, max_disparity: int) -> None:
    """Write everything a stereo pipeline gave for disparities between the bounds into the existing ``folder``.

    The PNG has no code for what is negative: those pixels have no value there.
    """
    values = result.disparity.values
    write_pfm(folder / "disp_left.pfm", values)
    shown = np.where(values < 0, np.float32(np.nan), values) if min_disparity < 0 else values
    write_disparity_png(folder / "disp_left.png", shown)
    write_status(folder / "status.png", result.disparity.status, STATUS_PALETTE)
    write_png(folder / "preview.png", stereo_preview(values, min_disparity, max_disparity))
    _save_rest(result, folder)


def probability_picture(probability: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return probabilities as (H, W) uint8, 0 = black to 1 = white."""
    return np.asarray(np.rint(probability * np.float32(255)), np.uint8)


def save_map_confidence(
    probability: NDArray[np.float32],
    status: NDArray[np.uint8],
    values: NDArray[np.float32],
    measures: Mapping[str, NDArray[np.float32]],
    folder: Path,
    max_disparity: int,
) -> None:
    """Write the judgment of a disparity map, and the map (H, W) without its doubtful pixels, into ``folder``."""
    write_pfm(folder / "confidence.pfm", probability)
    write_png(folder / "confidence.png", probability_picture(probability))
    write_status(folder / "status.png", status, STATUS_PALETTE)
    write_pfm(folder / "disp_left.pfm", values)
    write_disparity_png(folder / "disp_left.png", values)
    write_png(folder / "preview.png", preview(values, max_disparity))
    _save_confidence(measures, folder)


def save_depth(
    result: DepthResult,
    folder: Path,
    scale: float,
    rotate: int = 0,
    cloud: tuple[Intrinsics, NDArray[np.uint8], NDArray[np.bool_]] | None = None,
) -> None:
    """Write everything a refinement of depth gave into the existing ``folder``.

    Parameters
    ----------
    scale : codes a meter of ``depth.png``
    rotate : bits that the codes are rotated left by (SUN RGB-D: 3)
    cloud : camera, (H, W, 3) color and (H, W) bool of the pixels of a point cloud, or None for none
    """
    write_pfm(folder / "sigma.pfm", result.sigma)
    _save_depth_map(result.depth.values, result.depth.status, DEPTH_STATUS_PALETTE, folder, scale, rotate)
    if cloud is not None:
        write_ply(folder / "points.ply", result.depth.values, *cloud)
    _save_rest(result, folder)


def save_metric_depth(
    depth: NDArray[np.float32],
    status: NDArray[np.uint8],
    folder: Path,
    scale: float,
    cloud: tuple[Intrinsics, NDArray[np.uint8], NDArray[np.bool_]] | None = None,
) -> None:
    """Write the depth of a disparity map into the existing ``folder``.

    Parameters
    ----------
    depth : (H, W) float32, meters, NaN = unknown
    status : (H, W) uint8, bits of the disparity map
    scale : codes a meter of ``depth.png``
    cloud : camera, (H, W, 3) color and (H, W) bool of the pixels of a point cloud, or None for none
    """
    _save_depth_map(depth, status, STATUS_PALETTE, folder, scale)
    if cloud is not None:
        write_ply(folder / "points.ply", depth, *cloud)


def _save_depth_map(
    depth: NDArray[np.float32], status: NDArray[np.uint8], palette: Palette, folder: Path, scale: float, rotate: int = 0
) -> None:
    write_pfm(folder / "depth.pfm", depth)
    write_depth_png(folder / "depth.png", depth, scale, rotate)
    write_status(folder / "status.png", status, palette)
    write_png(folder / "preview.png", preview_depth(depth))


def _save_confidence(maps: Mapping[str, NDArray[np.float32]], folder: Path) -> None:
    for name, confidence in maps.items():
        write_pfm(folder / f"confidence_{name}.pfm", confidence)
        write_png(folder / f"confidence_{name}.png", confidence_picture(confidence))


def _save_rest(result: Result, folder: Path) -> None:
    _save_confidence(result.confidence, folder)
    for name, rows in result.tables.items():
        write_text(folder / f"{name}.csv", to_csv(rows))
    for name, picture in result.pictures.items():
        write_png(folder / f"{name}.png", picture)

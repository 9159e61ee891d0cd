"""Files that results write, which are those of the commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import OutputError
from depthcli.core.maps import DepthMap, MatchedMap
from depthcli.core.result import Result
from depthcli.io.formats.depth import write_depth_png
from depthcli.io.formats.disparity import write_disparity_png, write_pfm
from depthcli.io.formats.files import write_text
from depthcli.io.formats.images import write_png
from depthcli.io.formats.pictures import (
    DEPTH_STATUS_PALETTE,
    STATUS_PALETTE,
    confidence_picture,
    preview_depth,
    write_status,
)
from depthcli.run.json_csv import to_csv


def made(folder: Path | str) -> Path:
    """Return the folder, created where it is missing; OutputError where that cannot be."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from error
    return Path(folder)


def write_depth(depth: MatchedMap | DepthMap, folder: Path, scale: float, rotate: int = 0) -> None:
    """Write ``depth.pfm``, ``depth.png``, ``status.png`` and ``preview.png`` of a map in meters."""
    write_pfm(folder / "depth.pfm", depth.values)
    write_depth_png(folder / "depth.png", depth.values, scale, rotate)
    palette = DEPTH_STATUS_PALETTE if isinstance(depth, DepthMap) else STATUS_PALETTE
    write_status(folder / "status.png", depth.status, palette)
    write_png(folder / "preview.png", preview_depth(depth.values))


def write_disparity(
    values: NDArray[np.float32], status: NDArray[np.uint8], picture: NDArray[np.uint8], folder: Path
) -> None:
    """Write ``disp_left.pfm``, ``disp_left.png``, ``status.png``, and ``picture`` as ``preview.png``."""
    write_pfm(folder / "disp_left.pfm", values)
    # The PNG has no code for what is negative: those pixels have no value there.
    write_disparity_png(folder / "disp_left.png", np.where(values < 0, np.float32(np.nan), values))
    write_status(folder / "status.png", status, STATUS_PALETTE)
    write_png(folder / "preview.png", picture)


def write_details(result: Result, folder: Path) -> None:
    """Write ``confidence_NAME.pfm`` and a picture of each confidence; tables as CSV, and pictures."""
    for name, confidence in result.confidence.items():
        write_pfm(folder / f"confidence_{name}.pfm", confidence)
        write_png(folder / f"confidence_{name}.png", confidence_picture(confidence))
    for name, rows in result.tables.items():
        write_text(folder / f"{name}.csv", to_csv(rows))
    for name, picture in result.pictures.items():
        write_png(folder / f"{name}.png", picture)

"""Results as files, one writer a kind of result."""

from __future__ import annotations

from pathlib import Path

from depthcli.batch.record import to_csv
from depthcli.core.result import Result
from depthcli.io.atomic import write_text
from depthcli.io.disparity import write_disparity_png, write_pfm
from depthcli.io.images import write_png
from depthcli.io.pictures import STATUS_PALETTE, confidence_picture, preview, write_status
from depthcli.stereo.volume import StereoResult


def save_stereo(result: StereoResult, folder: Path, max_disparity: int) -> None:
    """Write everything a stereo pipeline gave into the existing ``folder``."""
    values = result.disparity.values
    write_pfm(folder / "disp_left.pfm", values)
    write_disparity_png(folder / "disp_left.png", values)
    write_status(folder / "status.png", result.disparity.status, STATUS_PALETTE)
    write_png(folder / "preview.png", preview(values, max_disparity))
    _save_rest(result, folder)


def _save_rest(result: Result, folder: Path) -> None:
    for name, confidence in result.confidence.items():
        write_pfm(folder / f"confidence_{name}.pfm", confidence)
        write_png(folder / f"confidence_{name}.png", confidence_picture(confidence))
    for name, rows in result.tables.items():
        write_text(folder / f"{name}.csv", to_csv(rows))
    for name, picture in result.pictures.items():
        write_png(folder / f"{name}.png", picture)

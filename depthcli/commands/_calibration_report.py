"""What ``calibrate`` says of its result: a table, a JSON document, and a picture of where the corners were."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.calibration.boards import Board, CharucoBoard
from depthcli.algorithms.calibration.solver import CameraFit
from depthcli.commands._calibration import SIDES, Calibration
from depthcli.io.formats.pictures import draw_text
from depthcli.run.console import aligned
from depthcli.run.json_csv import Row

_WIDTH = 640  # of a camera's picture
_TITLE = 24
_RED_PX = 1.0  # error of a corner that is drawn red


def document(board: Board, found: Calibration, unnamed: list[str]) -> Row:
    """Return the report as JSON holds it: pixels, meters, degrees."""
    described: Row = {
        "kind": "charuco" if isinstance(board, CharucoBoard) else "chessboard",
        "inner_corners": [board.columns, board.rows],
        "square": board.square,
    }
    if isinstance(board, CharucoBoard):
        described |= {"marker": board.marker, "dictionary": board.dictionary}
    report: Row = {
        "board": described,
        "cameras": [
            {
                "side": SIDES[k],
                "size": list(camera.size or ()),
                "fx": camera.matrix[0, 0], "fy": camera.matrix[1, 1],
                "cx": camera.matrix[0, 2], "cy": camera.matrix[1, 2],
                "distortion": list(camera.distortion),
                "fisheye": camera.fisheye,
                "focal_deviations": None if fit.focal_deviations is None else list(fit.focal_deviations),
                "reprojection_error": fit.error,
                "photos": len(fit.errors),
                "coverage": found.coverage(k),
                "tilt": fit.tilt,
            }
            for k, (fit, camera) in enumerate(zip(found.cameras, found.final, strict=True))
        ],
        "photos": [_photo(found, each.name) for each in found.photos],
        "unnamed": unnamed,
        "warnings": found.warnings,
    }  # fmt: skip
    if found.rig is not None:
        rig = found.rig.rig
        turn = np.degrees(np.linalg.norm(cv2.Rodrigues(rig.rotation)[0]))
        report["rig"] = {"baseline": rig.baseline, "turn": float(turn), "pairs": len(found.rig.errors),
                         "row_error": _row_error(found)}  # fmt: skip
    return report


def table(found: Calibration) -> str:
    """Return a line for every photo or pair: reprojection errors, rows, and why it does not count."""
    two = len(found.cameras) == 2
    lines: list[tuple[str, ...]] = [("photo", "used", *(("left", "right", "rows") if two else ("error",)))]
    for each in found.photos:
        row = _photo(found, each.name)
        figures = [row["errors"].get(side) for side in SIDES[: len(found.cameras)]]
        figures += [row["row_error"]] if two else []
        used = "yes" if not row["left_out"] else "no: " + _words(row["left_out"], two)
        lines.append((each.name, used, *("-" if x is None else f"{x:.3f} px" for x in figures)))
    return aligned(lines)


def left_out(found: Calibration) -> list[str]:
    """Return lines that name the outliers and the photos without a board."""
    lines = []
    for kind, text in (("outlier", "left out, since they do not fit the others"), ("board not found", "no board")):
        names = [name for name, why in found.reasons.items() if kind in why.values()]
        if names:
            lines.append(f"{text}: {', '.join(names)}")
    return lines


def summary(found: Calibration) -> list[str]:
    """Return a line a camera, and one of the rig."""
    lines = []
    for k, (fit, camera) in enumerate(zip(found.cameras, found.final, strict=True)):
        spread = "" if fit.focal_deviations is None else f" +- {max(fit.focal_deviations):.2f}"
        which = f"{SIDES[k]} camera" if len(found.cameras) == 2 else "camera"
        lines.append(f"{which}: focal length {camera.matrix[0, 0]:.2f}{spread} px, error {fit.error:.3f} px, "
                     f"{len(fit.errors)} photos, corners in {100 * found.coverage(k):.0f} % of the image")  # fmt: skip
    if found.rig is not None:
        rows = _row_error(found)
        text = "" if rows is None else f", rows {rows:.3f} px apart after rectification"
        lines.append(f"baseline {1000 * found.rig.rig.baseline:.2f} mm from {len(found.rig.errors)} pairs{text}")
    return lines


def coverage(found: Calibration) -> NDArray[np.uint8]:
    """Return the picture (H, W, 3): the corners in every camera's image, green where they fit, red where by a pixel."""
    pictures = [_coverage(found, k, fit) for k, fit in enumerate(found.cameras)]
    height = max(picture.shape[0] for picture in pictures)
    padded = [np.pad(each, ((0, height - each.shape[0]), (0, 8), (0, 0)), constant_values=255) for each in pictures]
    return np.ascontiguousarray(np.hstack(padded)[:, :-8])


def _coverage(found: Calibration, side: int, fit: CameraFit) -> NDArray[np.uint8]:
    width, height = fit.camera.size or (1, 1)
    scale = _WIDTH / width
    picture = np.full((max(round(height * scale), 1) + _TITLE, _WIDTH, 3), 255, np.uint8)
    picture[_TITLE:] = 236
    which = f"{SIDES[side]} camera" if len(found.cameras) == 2 else "camera"
    title = f"{which}: {len(fit.errors)} photos, corners in {100 * found.coverage(side):.0f} % of the image"
    draw_text(picture, title, (6, _TITLE // 2), (0, 0, 0), max_width=_WIDTH - 12)
    for name, residuals in fit.residuals.items():
        shares = np.minimum(np.linalg.norm(residuals, axis=1) / _RED_PX, 1)
        for (x, y), share in zip((found.corners[side][name].pixels + 0.5) * scale - 0.5, shares, strict=True):
            color = (round(220 * share), round(150 * (1 - share)), 40)
            cv2.circle(picture, (round(x), round(y) + _TITLE), 2, color, cv2.FILLED, cv2.LINE_AA)
    return picture


def _photo(found: Calibration, name: str) -> Row:
    errors = {
        SIDES[k]: fit.errors.get(name, fit.outliers.get(name))
        for k, fit in enumerate(found.cameras)
        if name in fit.errors or name in fit.outliers
    }  # fmt: skip
    row: Row = {"name": name, "errors": errors, "left_out": found.reasons[name]}
    if found.rig is not None:
        row["pair_error"] = found.rig.errors.get(name, found.rig.outliers.get(name))
        row["row_error"] = found.row_errors.get(name)
    return row


def _row_error(found: Calibration) -> float | None:
    values = list(found.row_errors.values())
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def _words(reasons: dict[str, str], two: bool) -> str:
    """Return why a photo does not count, with the side where that differs."""
    if not two or (len(set(reasons.values())) == 1 and len(reasons) == 2):
        return next(iter(reasons.values()))
    return ", ".join(why if side == "pair" else f"{side} {why}" for side, why in reasons.items())

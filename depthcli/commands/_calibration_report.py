"""Report of ``calibrate`` on the cameras that it found: figures, table, doubts, and a picture of the corners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.calibration import MIN_TILT, Board, CharucoBoard, RigFit
from depthcli.commands._board_photos import NOT_FOUND, OUTLIER, CameraPhotos
from depthcli.core.cameras.camera import Camera
from depthcli.run.console import Reporter
from depthcli.run.json_csv import Row
from depthcli.show.draw import draw_text
from depthcli.show.table import aligned

_MAX_DEVIATION = 0.005  # of the focal length
_MAX_ERROR = 1.0  # pixels, root mean square
_MIN_COVERAGE = 0.5  # of the cells of an image
_WIDTH, _TITLE = 640, 24  # of a camera's picture, and the height of its title, pixels
_RED_PX = 1.0  # error of a corner that is drawn red


@dataclass
class Calibrated:
    """One camera or two, as their photos give them."""

    views: Sequence[CameraPhotos]
    rig: RigFit | None = None
    row_errors: dict[str, float] = field(default_factory=dict)  # of each pair once rectified, pixels
    warnings: list[str] = field(default_factory=list)

    @property
    def cameras(self) -> list[Camera]:
        """The cameras of the rig, or the one that there is."""
        return [view.fit.camera for view in self.views] if self.rig is None else [self.rig.rig.left, self.rig.rig.right]


def report_of(found: Calibrated, board: Board, photos: Sequence[str], unnamed: Sequence[Path]) -> Row:
    """Return the report: board, cameras, rig, photos or pairs, warnings."""
    views, rig = found.views, found.rig
    kind = "charuco" if isinstance(board, CharucoBoard) else "chessboard"
    report: Row = {
        "board": {"kind": kind, "inner_corners": [board.columns, board.rows], "square": board.square},
        "cameras": [_camera(*each) for each in zip(views, found.cameras, strict=True)],
        "photos": [_photo(name, found) for name in photos],
        "unnamed": [str(file) for file in unnamed],
        "warnings": found.warnings + [line for view in views for line in _doubts(view)],
    }
    if isinstance(board, CharucoBoard):
        report["board"] |= {"marker": board.marker, "dictionary": board.dictionary}
    if rig is not None:
        turn = float(np.degrees(np.linalg.norm(cv2.Rodrigues(rig.rig.rotation)[0])))
        rows = float(np.sqrt(np.mean(np.square(list(found.row_errors.values()))))) if found.row_errors else None
        report["rig"] = {"baseline": rig.rig.baseline, "turn": turn, "pairs": len(rig.errors)}
        report["rig"] |= {"reprojection_error": rig.error, "row_error": rows}
    return report


def _doubts(view: CameraPhotos) -> list[str]:
    """Return why a camera is doubtful."""
    fit, which = view.fit, "" if view.name == "camera" else f"{view.name}: "
    lines, why, focal = [], "", float(fit.camera.matrix[0, 0])
    if fit.focal_deviations is not None and max(fit.focal_deviations) > _MAX_DEVIATION * focal:
        why = f"{focal:.1f} px with a standard deviation of {max(fit.focal_deviations):.1f}"
    elif fit.tilt < MIN_TILT:
        why = f"between photos the board is tilted by {fit.tilt:.0f} degrees at most"
    if why:
        more = "add photos with the board tilted by 30 degrees or more"
        lines.append(f"{which}the focal length is not determined: {why}; {more}")
    if fit.error > _MAX_ERROR:
        lines.append(f"{which}an error of {fit.error:.2f} px; is the board flat, and are the photos sharp?")
    if view.coverage < _MIN_COVERAGE:
        share = f"{100 * view.coverage:.0f} % of the image"
        lines.append(f"{which}corners are in {share}; lenses are known only there: see the picture")
    return lines


def _camera(view: CameraPhotos, camera: Camera) -> Row:
    """Return the entry of a camera in the report: pixels, degrees; errors belong to the fit to its own photos."""
    fit, (fx, fy), (cx, cy) = view.fit, np.diag(camera.matrix)[:2], camera.matrix[:2, 2]
    row: Row = {"side": view.side, "size": list(view.size), "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    row |= {"focal_lengths_alone": np.diag(fit.camera.matrix)[:2].tolist()} if camera is not fit.camera else {}
    row |= {"distortion": list(camera.distortion), "fisheye": camera.fisheye}
    row["focal_deviations"] = None if fit.focal_deviations is None else list(fit.focal_deviations)
    row |= {"reprojection_error": fit.error, "photos": len(fit.errors), "coverage": view.coverage}
    return row | {"tilt": fit.tilt}


def _photo(name: str, found: Calibrated) -> Row:
    """Return the entry of a photo or pair in the report: errors in pixels, and why it does not count."""
    views, rig, row_errors = found.views, found.rig, found.row_errors
    errors = {view.side: view.fit.outliers | view.fit.errors for view in views}
    row: Row = {
        "name": name,
        "errors": {side: each[name] for side, each in errors.items() if name in each},
        "left_out": {view.side: view.left_out[name] for view in views if name in view.left_out},
    }
    if rig is not None:
        row["left_out"] |= {"pair": OUTLIER} if name in rig.outliers else {}
        row |= {"pair_error": (rig.outliers | rig.errors).get(name), "row_error": row_errors.get(name)}
    return row


def table_of(report: Row) -> str:
    """Return a line for every photo or pair: reprojection errors, rows, and why it does not count."""
    sides = [camera["side"] for camera in report["cameras"]]
    two = len(sides) == 2
    lines: list[tuple[str, ...]] = [("photo", "used", *((*sides, "rows") if two else ("error",)))]
    for row in report["photos"]:
        errors = [row["errors"].get(side) for side in sides] + ([row["row_error"]] if two else [])
        reasons = [f"{side} {why}" if two and side != "pair" else why for side, why in row["left_out"].items()]
        used = f"no: {', '.join(reasons)}" if reasons else "yes"
        lines.append((row["name"], used, *("-" if error is None else f"{error:.3f} px" for error in errors)))
    return aligned(lines)


def print_summary(report: Row, views: Sequence[CameraPhotos], reporter: Reporter) -> None:
    """Name the photos that are left out, warn, and print a line a camera, and one of the rig."""
    for reason, text in ((OUTLIER, "left out, since they do not fit the others"), (NOT_FOUND, "no board")):
        if names := [row["name"] for row in report["photos"] if reason in row["left_out"].values()]:
            reporter.info(f"{text}: {', '.join(names)}")
    for line in report["warnings"]:
        reporter.error(f"warning: {line}")
    for view, row in zip(views, report["cameras"], strict=True):
        spread = "" if row["focal_deviations"] is None else f" +- {max(row['focal_deviations']):.2f}"
        focal = f"focal length {row['fx']:.2f}{spread} px"
        if alone := row.get("focal_lengths_alone"):
            focal = f"focal length {row['fx']:.2f} px, alone {alone[0]:.2f}{spread} px"
        reporter.info(
            f"{view.name}: {focal}, error {row['reprojection_error']:.3f} px, "
            f"{row['photos']} photos, corners in {100 * row['coverage']:.0f} % of the image"
        )
    if rig := report.get("rig"):
        rows = "" if rig["row_error"] is None else f", rows {rig['row_error']:.3f} px apart after rectification"
        fit = f"{rig['pairs']} pairs, error {rig['reprojection_error']:.3f} px{rows}"
        reporter.info(f"baseline {1000 * rig['baseline']:.2f} mm from {fit}")


def picture_of(views: Sequence[CameraPhotos]) -> NDArray[np.uint8]:
    """Return (H, W, 3): the corners in every camera's image, green where they fit, red where off by a pixel."""
    pictures = []
    for view in views:
        scale = _WIDTH / view.size[0]
        picture = np.full((max(round(view.size[1] * scale), 1) + _TITLE, _WIDTH, 3), 255, np.uint8)
        picture[_TITLE:] = 236
        title = f"{view.name}: {len(view.fit.errors)} photos, corners in {100 * view.coverage:.0f} % of the image"
        draw_text(picture, title, (6, _TITLE // 2), (0, 0, 0), max_width=_WIDTH - 12)
        for name, residuals in view.fit.residuals.items():
            errors = np.minimum(np.linalg.norm(residuals, axis=1) / _RED_PX, 1)
            for (x, y), error in zip((view.corners[name].pixels + 0.5) * scale - 0.5, errors, strict=True):
                color = (round(220 * error), round(150 * (1 - error)), 40)
                cv2.circle(picture, (round(x), round(y) + _TITLE), 2, color, cv2.FILLED, cv2.LINE_AA)
        pictures.append(np.pad(picture, ((0, 0), (0, 8), (0, 0)), constant_values=255))
    return np.ascontiguousarray(np.hstack(pictures)[:, :-8])

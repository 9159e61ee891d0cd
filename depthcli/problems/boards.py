"""Calibrate one or two cameras from photos of a board; write a report and a picture of the corners."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.calibration import (
    MAX_ERROR_RATIO,
    MIN_PHOTOS,
    MIN_TILT,
    OUTLIER_PX,
    SIMILAR_ERROR_RATIO,
    Board,
    CameraFit,
    CharucoBoard,
    Chessboard,
    Corners,
    RigFit,
    Size,
    dictionaries,
    fit_camera,
    fit_rig,
)
from depthcli.core.cameras.camera import Camera
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import luma
from depthcli.io.calibration_photos import find_photos
from depthcli.io.formats.calibrations import UNITS, write_calibration
from depthcli.io.formats.files import collected_warnings, remove_temporaries, write_text
from depthcli.io.formats.images import read_color8, write_drawn
from depthcli.run.console import Reporter
from depthcli.show.table import Row, aligned, to_json
from depthcli.show.view import draw_text

_NOT_FOUND, _OUTLIER = "board not found", "outlier"  # reasons for ignoring a photo
_LENGTH = re.compile(r"\s*([0-9]*\.?[0-9]+)\s*(mm|cm|m)\s*")
_BOARD = re.compile(r"(charuco:)?(\d{1,3})x(\d{1,3})", re.IGNORECASE)
_MAX_SQUARE = 10.0  # meters
_MAX_COUNT = 200  # of corners per row or column
_CELLS = (8, 6)  # cells per image, to measure the coverage by corners

# Beyond these limits the report has a warning.
_MAX_DEVIATION = 0.005  # of the focal length
_MAX_ERROR = 1.0  # pixels, root mean square
_MIN_COVERAGE = 0.5  # of an image's cells

_WIDTH, _TITLE = 640, 24  # width of a camera's picture and height of its title, pixels
_RED_PX = 1.0  # error from which a corner is red


@dataclass
class CameraPhotos:
    """A camera and the board's corners in its photos."""

    side: str
    name: str  # in messages
    size: Size = (0, 0)  # of most photos
    corners: dict[str, Corners] = field(default_factory=dict)  # name of a photo -> corners of the board
    left_out: dict[str, str] = field(default_factory=dict)  # name of an ignored photo -> reason
    unreadable: bool = False  # whether a photo could not be read
    fit: CameraFit = field(init=False)  # from its own photos alone

    @property
    def coverage(self) -> float:
        """Share of the image's 8 x 6 cells that contain a corner of a used photo."""
        used = np.concatenate([self.corners[name].pixels for name in self.fit.errors])
        cells = np.floor(used / self.size * _CELLS).astype(int)
        return len({(x, y) for x, y in cells.tolist()}) / (_CELLS[0] * _CELLS[1])


@dataclass
class Calibrated:
    """One or two calibrated cameras."""

    views: Sequence[CameraPhotos]
    rig: RigFit | None = None
    row_errors: dict[str, float] = field(default_factory=dict)  # name of a pair -> row error after rectification, px
    warnings: list[str] = field(default_factory=list)
    report: Row = field(default_factory=dict)
    summary: str = ""  # line about the written files

    @property
    def cameras(self) -> list[Camera]:
        """The cameras of the rig, or the single camera."""
        return [view.fit.camera for view in self.views] if self.rig is None else [self.rig.rig.left, self.rig.rig.right]


def board_of(board: str, square: str, marker: str | None, dictionary: str) -> Board:
    """Return the board that the options with these names describe. Raise ConfigError for impossible boards."""
    match = _BOARD.fullmatch(board.strip())
    if match is None:
        raise ConfigError(f"--board: expected 9x6 (inner corners) or charuco:7x5 (squares) (got {board!r})")
    edge, counts = _length("square", square), (int(match[2]), int(match[3]))
    columns, rows = (count - 1 for count in counts) if match[1] else counts
    low, smallest = (2, "charuco:4x3") if match[1] else (3, "3x3")  # OpenCV finds no smaller ones
    if not (low <= min(columns, rows) and 3 <= max(columns, rows) <= _MAX_COUNT):
        raise ConfigError(f"--board: {board} has too few or too many corners; expected {smallest} or more")
    if not match[1]:
        if marker is not None or dictionary != "4X4_50":
            raise ConfigError("--marker and --dictionary describe a ChArUco board: --board charuco:7x5")
        return Chessboard(columns, rows, edge)
    if marker is None:
        raise ConfigError("--board charuco: give the edge of its markers, too: --marker 18mm")
    marker_edge, n_markers = _length("marker", marker), dictionaries()
    name = dictionary.upper().removeprefix("DICT_")
    if marker_edge >= edge:
        raise ConfigError(f"--marker: {marker} is not smaller than a square of {square}")
    if name not in n_markers:
        raise ConfigError(f"--dictionary: no {dictionary}; there are {', '.join(n_markers)}")
    if (needed := counts[0] * counts[1] // 2) > n_markers[name]:
        raise ConfigError(f"--dictionary: {name} has {n_markers[name]} markers, the board {needed}")
    return CharucoBoard(columns, rows, edge, marker_edge, name)


def _length(name: str, text: str) -> float:
    """Return a length with its unit in meters."""
    match = _LENGTH.fullmatch(text)
    meters = float(match[1]) * UNITS[match[2]] if match else 0.0
    if not 0 < meters <= _MAX_SQUARE:
        raise ConfigError(f"--{name}: expected a length with its unit, such as 25mm (got {text!r})")
    return meters


def calibrate_cameras(
    folders: Sequence[Path], board: Board, target: Path, fisheye: bool, overwrite: bool, reporter: Reporter
) -> Calibrated:
    """Calibrate the cameras of the photos, and write calibration, report and picture."""
    if len(folders) > 2:
        raise ConfigError("PHOTOS: one folder, or one of each camera")
    if target.suffix.lower() not in (".yml", ".yaml"):
        raise ConfigError(f"--output: the calibration is YAML: expected FILE.yml (got {target})")
    report_file, picture_file = (target.with_name(f"{target.stem}_{end}") for end in ("report.json", "coverage.png"))
    for file in (target, report_file, picture_file):
        if os.path.lexists(file) and not overwrite:
            raise ConfigError(f"{file}: is there already; choose another --output, or --overwrite it")
    photos, unnamed = find_photos(folders)
    for file in unnamed:
        reporter.info(f"{file}: left out, because its name does not tell which camera took it")
    views = [CameraPhotos("left", "camera")]
    if any(photo.right for photo in photos):
        views = [CameraPhotos("left", "left camera"), CameraPhotos("right", "right camera")]
    with reporter.counting(len(views) * len(photos), 0, "calibrate"), collected_warnings() as turned:
        for view in views:
            _look(view, board, {photo.name: getattr(photo, view.side) for photo in photos}, reporter)
    if views[0].size != views[-1].size:
        left, right = (f"{view.size[0]} x {view.size[1]}" for view in views)
        raise InputError(
            f"the left camera's photos have {left} pixels, the right one's {right}: bring them to one size"
        )
    for view in views:
        view.fit = fit_camera(board, view.corners, view.size, fisheye)
        view.left_out |= dict.fromkeys(view.fit.outliers, _OUTLIER)
    calibrated = _with_rig(board, views[0], views[1]) if len(views) == 2 else Calibrated(views)
    report = calibrated.report = _report_of(calibrated, board, [photo.name for photo in photos], unnamed)
    report["warnings"] += turned[:1] + [f"so were {len(turned) - 1} other photos"] * (len(turned) > 1)
    for file in (target, report_file, picture_file):
        remove_temporaries(target.parent, file.name)
    write_drawn(picture_file, lambda: _picture_of(views))
    write_text(report_file, to_json(report))
    write_calibration(target, calibrated.cameras, calibrated.rig.rig if calibrated.rig else None)
    use = "for depthcli rectify --calibration" if calibrated.rig else "one camera, K1 and D1"
    calibrated.summary = f"{target}: {use}; see also {report_file.name} and {picture_file.name}"
    return calibrated


def _look(view: CameraPhotos, board: Board, files: Mapping[str, Path | None], reporter: Reporter) -> None:
    """Find the board in a camera's photos. Raise InputError if too few show it."""
    sizes: dict[str, Size] = {}
    for name, file in files.items():
        reporter.step()
        if file is None:
            view.left_out[name] = "no such photo"
            continue
        try:
            grey = np.ascontiguousarray(luma(read_color8(file)), np.uint8)
        except InputError as error:
            reporter.error(str(error))
            view.left_out[name], view.unreadable = "cannot be read", True
            continue
        sizes[name] = grey.shape[1], grey.shape[0]
        if (corners := board.find(grey)) is None:
            view.left_out[name] = _NOT_FOUND
        else:
            view.corners[name] = corners
    view.size = Counter(sizes.values()).most_common(1)[0][0] if sizes else (0, 0)
    for name, size in sizes.items():
        if size != view.size:
            view.left_out[name] = f"{size[0]} x {size[1]} pixels, not {view.size[0]} x {view.size[1]}"
            view.corners.pop(name, None)
    if len(view.corners) < MIN_PHOTOS:
        hint = "--board counts inner corners, one less than squares, and all of them must be in the photo"
        if isinstance(board, CharucoBoard):
            hint = "do --board (squares), --marker and --dictionary match the print?"
        raise InputError(
            f"{board.words} was found in {len(view.corners)} of {len(sizes)} photos of the {view.name}; at least "
            f"{MIN_PHOTOS} are needed; {hint}"
        )


def _with_rig(board: Board, left: CameraPhotos, right: CameraPhotos) -> Calibrated:
    """Return two cameras with their rig and the row error of each pair after rectification.

    Raise InputError if the rig fits the photos much worse than each camera alone.
    """
    both = [name for name in left.fit.errors if name in right.fit.errors]
    if len(both) < MIN_PHOTOS:
        raise InputError(
            f"the board is in both photos of {len(both)} pairs; at least {MIN_PHOTOS} are needed, better 15 or more"
        )
    pairs = {name: (left.corners[name], board.alike(left.corners[name], right.corners[name])) for name in both}
    fit = fit_rig(board, pairs, (left.fit, right.fit))
    try:
        rectified = fit.rig.rectified(left.size, right.size, mirrored=True)
    except InputError as error:
        return Calibrated((left, right), fit, warnings=[f"rectify does not take this rig: {error}"])
    errors: dict[str, float] = {}
    for name in fit.errors:
        ids = np.intersect1d(pairs[name][0].ids, pairs[name][1].ids)
        one, other = rectified.points(*(each.pixels[np.isin(each.ids, ids)] for each in pairs[name]))
        errors[name] = float(np.sqrt(np.mean((one[:, 1] - other[:, 1]) ** 2)))
    apart, own = float(np.median(list(errors.values()))), max(left.fit.error, right.fit.error)
    if not apart <= MAX_ERROR_RATIO * max(own, OUTLIER_PX):
        raise InputError(
            f"the photos do not determine the cameras: after rectification rows are {apart:.3g} px apart, where each "
            f"camera alone is off by {own:.2f} px at most; add photos with the board tilted, and up to the border"
        )
    warnings = []
    if fit.error > SIMILAR_ERROR_RATIO * own:
        warnings.append(
            f"the pairs are off by {fit.error:.2f} px, each camera alone by {own:.2f} px at most; "
            "was the board moved between the photos of a pair? see pair_error in the report"
        )
    if rectified.mirrored:
        warnings.append("the right camera is to the left of the left one; exchange the photos of the two")
    return Calibrated((left, right), fit, errors, warnings)


def _report_of(calibrated: Calibrated, board: Board, photos: Sequence[str], unnamed: Sequence[Path]) -> Row:
    """Return the report: board, cameras, rig, photos or pairs, warnings."""
    views, rig = calibrated.views, calibrated.rig
    kind = "charuco" if isinstance(board, CharucoBoard) else "chessboard"
    report: Row = {
        "board": {"kind": kind, "inner_corners": [board.columns, board.rows], "square": board.square},
        "cameras": [_camera(*each) for each in zip(views, calibrated.cameras, strict=True)],
        "photos": [_photo(name, calibrated) for name in photos],
        "unnamed": [str(file) for file in unnamed],
        "warnings": calibrated.warnings + [line for view in views for line in _doubts(view)],
    }
    if isinstance(board, CharucoBoard):
        report["board"] |= {"marker": board.marker, "dictionary": board.dictionary}
    if rig is not None:
        turn = float(np.degrees(np.linalg.norm(cv2.Rodrigues(rig.rig.rotation)[0])))
        errors = list(calibrated.row_errors.values())
        rows = float(np.sqrt(np.mean(np.square(errors)))) if errors else None
        report["rig"] = {"baseline": rig.rig.baseline, "turn": turn, "pairs": len(rig.errors)}
        report["rig"] |= {"reprojection_error": rig.error, "row_error": rows}
    return report


def _doubts(view: CameraPhotos) -> list[str]:
    """Return why a camera is doubtful."""
    fit, which = view.fit, "" if view.name == "camera" else f"{view.name}: "
    lines, why, focal = [], "", float(fit.camera.matrix[0, 0])
    if fit.focal_uncertainty > _MAX_DEVIATION:
        why = f"{focal:.1f} px with a standard deviation of {fit.focal_uncertainty * focal:.1f}"
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
    """Return a camera's entry in the report, in pixels and degrees; errors are from the fit to its own photos."""
    fit, (fx, fy), (cx, cy) = view.fit, np.diag(camera.matrix)[:2], camera.matrix[:2, 2]
    row: Row = {"side": view.side, "size": list(view.size), "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    row |= {"focal_lengths_alone": np.diag(fit.camera.matrix)[:2].tolist()} if camera is not fit.camera else {}
    row |= {"distortion": list(camera.distortion), "fisheye": camera.fisheye}
    row["focal_deviations"] = None if fit.focal_deviations is None else list(fit.focal_deviations)
    row |= {"reprojection_error": fit.error, "photos": len(fit.errors), "coverage": view.coverage}
    return row | {"tilt": fit.tilt}


def _photo(name: str, calibrated: Calibrated) -> Row:
    """Return the entry of a photo or pair in the report: errors in pixels, and reasons if it is ignored."""
    views, rig, row_errors = calibrated.views, calibrated.rig, calibrated.row_errors
    errors = {view.side: view.fit.outliers | view.fit.errors for view in views}
    row: Row = {
        "name": name,
        "errors": {side: each[name] for side, each in errors.items() if name in each},
        "left_out": {view.side: view.left_out[name] for view in views if name in view.left_out},
    }
    if rig is not None:
        row["left_out"] |= {"pair": _OUTLIER} if name in rig.outliers else {}
        row |= {"pair_error": (rig.outliers | rig.errors).get(name), "row_error": row_errors.get(name)}
    return row


def table_of(report: Row) -> str:
    """Return a table of photos or pairs: reprojection errors, row errors, and reasons for ignoring them."""
    sides = [camera["side"] for camera in report["cameras"]]
    two = len(sides) == 2
    lines: list[tuple[str, ...]] = [("photo", "used", *((*sides, "rows") if two else ("error",)))]
    for row in report["photos"]:
        errors = [row["errors"].get(side) for side in sides] + ([row["row_error"]] if two else [])
        reasons = [f"{side} {why}" if two and side != "pair" else why for side, why in row["left_out"].items()]
        used = f"no: {', '.join(reasons)}" if reasons else "yes"
        lines.append((row["name"], used, *("-" if error is None else f"{error:.3f} px" for error in errors)))
    return aligned(lines)


def print_summary(calibrated: Calibrated, reporter: Reporter) -> None:
    """Print ignored photos, warnings, a line per camera, a line about the rig, and the names of the files."""
    report, views = calibrated.report, calibrated.views
    for reason, text in ((_OUTLIER, "left out, since they do not fit the others"), (_NOT_FOUND, "no board")):
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
    reporter.info(calibrated.summary)


def _picture_of(views: Sequence[CameraPhotos]) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3) of the corners in each camera's image, from green (no error) to red (1 px)."""
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

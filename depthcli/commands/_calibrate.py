"""What ``calibrate`` computes: cameras from photos of a board, a report, and a picture of where the corners were."""

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
    MIN_PHOTOS,
    MIN_TILT,
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
from depthcli.commands._options import BoardOptions
from depthcli.commands._shared_options import Printing
from depthcli.core.cameras.camera import Camera
from depthcli.core.errors import SOME_FAILED, ConfigError, InputError
from depthcli.core.frames import color8, luma
from depthcli.io.calibration_photos import find_photos
from depthcli.io.formats.calibrations import UNITS, write_calibration
from depthcli.io.formats.files import remove_temporaries, write_text
from depthcli.io.formats.images import read_image, write_png
from depthcli.io.formats.pictures import draw_text
from depthcli.run.console import Reporter, aligned
from depthcli.run.json_csv import Row, to_json

_SIDES = ("left", "right")
_LENGTH = re.compile(r"\s*([0-9]*\.?[0-9]+)\s*(mm|cm|m)\s*")
_BOARD = re.compile(r"(charuco:)?(\d{1,3})x(\d{1,3})", re.IGNORECASE)
_LARGEST = 10.0  # meters, of a square
_COUNTS = (2, 200)  # corners of a row or column
_MAX_DEVIATION = 0.005  # of the focal length
_MAX_ERROR = 1.0  # pixels, root mean square
_MIN_COVERAGE = 0.5  # of the cells of an image
_CELLS = (8, 6)
_NOT_FOUND, _OUTLIER = "board not found", "outlier"
_WIDTH, _TITLE = 640, 24  # of a camera's picture, and the height of its title, pixels
_RED_PX = 1.0  # error of a corner that is drawn red


@dataclass
class _View:
    """A camera, and what its photos show."""

    side: str
    name: str  # in messages
    size: Size = (0, 0)  # of most photos
    corners: dict[str, Corners] = field(default_factory=dict)  # of the board, by the name of the photo
    left_out: dict[str, str] = field(default_factory=dict)  # name -> why a photo does not count
    unreadable: bool = False  # whether a photo could not be read
    fit: CameraFit = field(init=False)  # by its own photos alone

    @property
    def coverage(self) -> float:
        """Share of the 8 x 6 cells of the image in which a photo that counts has a corner."""
        used = np.concatenate([self.corners[name].pixels for name in self.fit.errors])
        cells = np.floor(used / self.size * _CELLS).astype(int)
        return len({(x, y) for x, y in cells.tolist()}) / (_CELLS[0] * _CELLS[1])


def calibrate_cameras(
    folders: Sequence[Path], options: BoardOptions, printing: Printing, target: Path, fisheye: bool, overwrite: bool
) -> int:
    """Calibrate and write calibration, report and picture; return the exit code, 3 where a photo could not be read."""
    reporter, board = printing.reporter, _board(options)
    if len(folders) > 2:
        raise ConfigError("PHOTOS: one folder, or one of each camera")
    if target.suffix.lower() not in (".yml", ".yaml"):
        raise ConfigError(f"--output: the calibration is YAML: want FILE.yml (got {target})")
    report_file, picture_file = (target.with_name(f"{target.stem}_{end}") for end in ("report.json", "coverage.png"))
    for file in (target, report_file, picture_file):
        if os.path.lexists(file) and not overwrite:
            raise ConfigError(f"{file}: is there already; choose another --output, or --overwrite it")
    photos, unnamed = find_photos(folders)
    for file in unnamed:
        reporter.info(f"{file}: left out, since its name does not say which camera took it")
    views = [_View("left", "camera")]
    if any(each.right for each in photos):
        views = [_View("left", "left camera"), _View("right", "right camera")]
    with reporter:
        reporter.start(len(views) * len(photos), 0, "calibrate")
        for view in views:
            _look(view, board, {each.name: getattr(each, view.side) for each in photos}, reporter)
    if views[0].size != views[-1].size:
        left, right = (f"{view.size[0]} x {view.size[1]}" for view in views)
        raise InputError(
            f"the left camera's photos have {left} pixels, the right one's {right}: bring them to one size"
        )
    for view in views:
        view.fit = fit_camera(board, view.corners, view.size, fisheye)
        view.left_out |= dict.fromkeys(view.fit.outliers, _OUTLIER)
    cameras, rig, row_errors, warnings = [view.fit.camera for view in views], None, dict[str, float](), list[str]()
    if len(views) == 2:
        rig, row_errors, warnings = _rig(board, *views)
        cameras = [rig.rig.left, rig.rig.right]
    kind = "charuco" if isinstance(board, CharucoBoard) else "chessboard"
    report: Row = {
        "board": {"kind": kind, "inner_corners": [board.columns, board.rows], "square": board.square},
        "cameras": [_camera(*each) for each in zip(views, cameras, strict=True)],
        "photos": [_photo(each.name, views, rig, row_errors) for each in photos],
        "unnamed": [str(file) for file in unnamed],
        "warnings": warnings + [line for view in views for line in _doubts(view)],
    }
    if isinstance(board, CharucoBoard):
        report["board"] |= {"marker": board.marker, "dictionary": board.dictionary}
    if rig is not None:
        turn = float(np.degrees(np.linalg.norm(cv2.Rodrigues(rig.rig.rotation)[0])))
        rows = float(np.sqrt(np.mean(np.square(list(row_errors.values()))))) if row_errors else None
        report["rig"] = {"baseline": rig.rig.baseline, "turn": turn, "pairs": len(rig.errors), "row_error": rows}
    for file in (target, report_file, picture_file):
        remove_temporaries(target.parent, file.name)
    write_png(picture_file, _picture(views))
    write_text(report_file, to_json(report))
    write_calibration(target, cameras, rig.rig if rig else None)
    if printing.json:
        reporter.data(to_json(report))
    elif not printing.quiet:
        reporter.data(_table(report["photos"], [view.side for view in views]))
    _say(report, views, reporter)
    use = "for depthcli rectify --calibration" if rig else "one camera, K1 and D1"
    reporter.info(f"{target}: {use}; beside it are {report_file.name} and {picture_file.name}")
    return SOME_FAILED if any(view.unreadable for view in views) else 0


def _board(options: BoardOptions) -> Board:
    """Return the board that the options describe; ConfigError where there is none like it."""
    match = _BOARD.fullmatch(options.board.strip())
    if match is None:
        raise ConfigError(f"--board: want 9x6 (inner corners) or charuco:7x5 (squares) (got {options.board!r})")
    square, counts = _length("square", options.square), (int(match[2]), int(match[3]))
    columns, rows = (count - 1 for count in counts) if match[1] else counts
    low, high = _COUNTS
    if not (low <= min(columns, rows) and low < max(columns, rows) <= high):
        raise ConfigError(f"--board: {options.board} has too few or too many corners; want {low + 1}x{low} or more")
    if not match[1]:
        if options.marker is not None or options.dictionary != "4X4_50":
            raise ConfigError("--marker and --dictionary are those of a ChArUco board: --board charuco:7x5")
        return Chessboard(columns, rows, square)
    if options.marker is None:
        raise ConfigError("--board charuco: give the edge of its markers, too: --marker 18mm")
    marker, known = _length("marker", options.marker), dictionaries()
    name = options.dictionary.upper().removeprefix("DICT_")
    if marker >= square:
        raise ConfigError(f"--marker: {options.marker} is not smaller than a square of {options.square}")
    if name not in known:
        raise ConfigError(f"--dictionary: no {options.dictionary}; there are {', '.join(known)}")
    if (wanted := counts[0] * counts[1] // 2) > known[name]:
        raise ConfigError(f"--dictionary: {name} has {known[name]} markers, the board {wanted}")
    return CharucoBoard(columns, rows, square, marker, name)


def _length(name: str, text: str) -> float:
    """Return the meters of a length with its unit."""
    match = _LENGTH.fullmatch(text)
    meters = float(match[1]) * UNITS[match[2]] if match else 0.0
    if not 0 < meters <= _LARGEST:
        raise ConfigError(f"--{name}: want a length with its unit, such as 25mm (got {text!r})")
    return meters


def _look(view: _View, board: Board, files: Mapping[str, Path | None], reporter: Reporter) -> None:
    """Find the board in the photos of a camera; InputError where too few show it."""
    sizes: dict[str, Size] = {}
    for name, file in files.items():
        reporter.step()
        if file is None:
            view.left_out[name] = "no such photo"
            continue
        try:
            grey = np.ascontiguousarray(luma(color8(read_image(file))), np.uint8)
        except InputError as error:
            reporter.error(str(error))
            view.left_out[name], view.unreadable = "cannot be read", True
            continue
        sizes[name] = grey.shape[1], grey.shape[0]
        if (seen := board.find(grey)) is None:
            view.left_out[name] = _NOT_FOUND
        else:
            view.corners[name] = seen
    view.size = Counter(sizes.values()).most_common(1)[0][0] if sizes else (0, 0)
    for name, size in sizes.items():
        if size != view.size:
            view.left_out[name] = f"{size[0]} x {size[1]} pixels, not {view.size[0]} x {view.size[1]}"
            view.corners.pop(name, None)
    if len(view.corners) < MIN_PHOTOS:
        hint = "--board counts inner corners, one less than squares, and all of them must be in the photo"
        if isinstance(board, CharucoBoard):
            hint = "are --board (squares), --marker and --dictionary those of the print?"
        raise InputError(
            f"{board.words} was found in {len(view.corners)} of {len(sizes)} photos of the {view.name}; at least "
            f"{MIN_PHOTOS} are needed; {hint}"
        )


def _rig(board: Board, left: _View, right: _View) -> tuple[RigFit, dict[str, float], list[str]]:
    """Return the rig of two cameras, the difference of rows of each pair once rectified, pixels, and warnings."""
    both = [name for name in left.fit.errors if name in right.fit.errors]
    if len(both) < MIN_PHOTOS:
        raise InputError(
            f"the board is in both photos of {len(both)} pairs; at least {MIN_PHOTOS} are needed, better 15 or more"
        )
    pairs = {name: (left.corners[name], board.alike(left.corners[name], right.corners[name])) for name in both}
    fit = fit_rig(board, pairs, (left.fit.camera, right.fit.camera))
    try:
        rectified = fit.rig.rectified(left.size, right.size, mirrored=True)
    except InputError as error:
        return fit, {}, [f"rectify does not take this rig: {error}"]
    errors: dict[str, float] = {}
    for name in fit.errors:
        ids = np.intersect1d(pairs[name][0].ids, pairs[name][1].ids)
        one, other = rectified.points(*(each.pixels[np.isin(each.ids, ids)] for each in pairs[name]))
        errors[name] = float(np.sqrt(np.mean((one[:, 1] - other[:, 1]) ** 2)))
    mirrored = "the right camera stands to the left of the left one; exchange the photos of the two"
    return fit, errors, [mirrored] if rectified.mirrored else []


def _doubts(view: _View) -> list[str]:
    """Return what makes a camera doubtful."""
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


def _camera(view: _View, camera: Camera) -> Row:
    """Return what the report says of a camera: pixels, degrees."""
    fit, (fx, fy), (cx, cy) = view.fit, np.diag(camera.matrix)[:2], camera.matrix[:2, 2]
    row: Row = {"side": view.side, "size": list(view.size), "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    row |= {"distortion": list(camera.distortion), "fisheye": camera.fisheye}
    row["focal_deviations"] = None if fit.focal_deviations is None else list(fit.focal_deviations)
    row |= {"reprojection_error": fit.error, "photos": len(fit.errors), "coverage": view.coverage}
    return row | {"tilt": fit.tilt}


def _photo(name: str, views: Sequence[_View], rig: RigFit | None, row_errors: Mapping[str, float]) -> Row:
    """Return what the report says of a photo or pair: errors in pixels, and why it does not count."""
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


def _table(photos: Sequence[Row], sides: Sequence[str]) -> str:
    """Return a line for every photo or pair: reprojection errors, rows, and why it does not count."""
    two = len(sides) == 2
    lines: list[tuple[str, ...]] = [("photo", "used", *((*sides, "rows") if two else ("error",)))]
    for row in photos:
        errors = [row["errors"].get(side) for side in sides] + ([row["row_error"]] if two else [])
        reasons = [f"{side} {why}" if two and side != "pair" else why for side, why in row["left_out"].items()]
        used = f"no: {', '.join(reasons)}" if reasons else "yes"
        lines.append((row["name"], used, *("-" if error is None else f"{error:.3f} px" for error in errors)))
    return aligned(lines)


def _say(report: Row, views: Sequence[_View], reporter: Reporter) -> None:
    """Name the photos that are left out, warn, and print a line a camera, and one of the rig."""
    for reason, text in ((_OUTLIER, "left out, since they do not fit the others"), (_NOT_FOUND, "no board")):
        if names := [row["name"] for row in report["photos"] if reason in row["left_out"].values()]:
            reporter.info(f"{text}: {', '.join(names)}")
    for line in report["warnings"]:
        reporter.error(f"warning: {line}")
    for view, row in zip(views, report["cameras"], strict=True):
        spread = "" if row["focal_deviations"] is None else f" +- {max(row['focal_deviations']):.2f}"
        reporter.info(
            f"{view.name}: focal length {row['fx']:.2f}{spread} px, error {row['reprojection_error']:.3f} px, "
            f"{row['photos']} photos, corners in {100 * row['coverage']:.0f} % of the image"
        )
    if rig := report.get("rig"):
        rows = "" if rig["row_error"] is None else f", rows {rig['row_error']:.3f} px apart after rectification"
        reporter.info(f"baseline {1000 * rig['baseline']:.2f} mm from {rig['pairs']} pairs{rows}")


def _picture(views: Sequence[_View]) -> NDArray[np.uint8]:
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

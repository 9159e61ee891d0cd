"""What ``calibrate`` computes: cameras from photos of a board, a report, and a picture of where the corners were."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Sequence
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
from depthcli.commands._options import BoardOptions, Printing
from depthcli.core.cameras.camera import Camera
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import color8, luma
from depthcli.io.calibration_photos import Photos, find_photos
from depthcli.io.formats.calibrations import UNITS, write_calibration
from depthcli.io.formats.files import remove_temporaries, write_text
from depthcli.io.formats.images import read_image, write_png
from depthcli.io.formats.pictures import draw_text
from depthcli.run.batch import SOME_FAILED
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


@dataclass(frozen=True)
class _Found:
    """The cameras of a set of photos.

    Attributes
    ----------
    cameras : the left one, and the right one where there is one, each by its own photos
    row_errors : name of a pair -> root mean square of the difference of rows after rectification, pixels
    """

    photos: Sequence[Photos]  # as they were given
    corners: list[dict[str, Corners]]  # of each camera, name -> corners that were found
    reasons: dict[str, dict[str, str]]  # name -> side -> why a photo does not count
    unreadable: list[str]  # files that cannot be read
    cameras: list[CameraFit] = field(default_factory=list)
    rig: RigFit | None = None  # both cameras, None for a single one
    row_errors: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)  # what makes the result doubtful, a sentence each

    @property
    def final(self) -> list[Camera]:
        """The cameras, refined by the pairs where there are two."""
        return [self.rig.rig.left, self.rig.rig.right] if self.rig else [fit.camera for fit in self.cameras]

    @property
    def names(self) -> list[str]:
        """What the cameras are called."""
        return [f"{side} camera" for side in _SIDES] if len(self.corners) == 2 else ["camera"]

    @property
    def row_error(self) -> float | None:
        """Root mean square of the difference of rows over all pairs, pixels."""
        values = list(self.row_errors.values())
        return float(np.sqrt(np.mean(np.square(values)))) if values else None

    def coverage(self, side: int) -> float:
        """Return the share of the 8 x 6 cells of a camera's image in which a photo that counts has a corner."""
        used = [self.corners[side][name].pixels for name in self.cameras[side].errors]
        width, height = self.cameras[side].camera.size or (1, 1)
        cells = np.floor(np.concatenate(used) / (width, height) * _CELLS).astype(int)
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
    found = _calibrated(board, photos, fisheye, reporter)
    for file in (target, report_file, picture_file):
        remove_temporaries(target.parent, file.name)
    document = _document(board, found, [str(file) for file in unnamed])
    write_png(picture_file, _picture(found))
    write_text(report_file, to_json(document))
    write_calibration(target, found.final, found.rig.rig if found.rig else None)
    if printing.json:
        reporter.data(to_json(document))
    elif not printing.quiet:
        reporter.data(_table(found))
    _say(found, reporter)
    use = "for depthcli rectify --calibration" if found.rig else "one camera, K1 and D1"
    reporter.info(f"{target}: {use}; beside it are {report_file.name} and {picture_file.name}")
    return SOME_FAILED if found.unreadable else 0


def _board(options: BoardOptions) -> Board:
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


def _calibrated(board: Board, photos: Sequence[Photos], fisheye: bool, reporter: Reporter) -> _Found:
    """Return the cameras that took the photos; InputError where these do not determine them."""
    n_cameras = 1 if all(each.right is None for each in photos) else 2
    found = _Found(photos, [{} for _ in range(n_cameras)], {each.name: {} for each in photos}, [])
    sizes: list[dict[str, Size]] = [{} for _ in range(n_cameras)]
    with reporter:
        reporter.start(len(photos), 0, "calibrate")
        for each in photos:
            for side, file in enumerate((each.left, each.right)[:n_cameras]):
                if file is None:
                    found.reasons[each.name][_SIDES[side]] = "no such photo"
                    continue
                try:
                    grey = np.ascontiguousarray(luma(color8(read_image(file))), np.uint8)
                except InputError as error:
                    reporter.error(str(error))
                    found.unreadable.append(str(file))
                    found.reasons[each.name][_SIDES[side]] = "cannot be read"
                    continue
                sizes[side][each.name] = grey.shape[1], grey.shape[0]
                if (seen := board.find(grey)) is None:
                    found.reasons[each.name][_SIDES[side]] = _NOT_FOUND
                else:
                    found.corners[side][each.name] = seen
            reporter.step()
    common = [Counter(each.values()).most_common(1)[0][0] if each else (0, 0) for each in sizes]
    for side, (width, height) in enumerate(common):
        for name, size in sizes[side].items():
            if size != (width, height):
                found.reasons[name][_SIDES[side]] = f"{size[0]} x {size[1]} pixels, not {width} x {height}"
                found.corners[side].pop(name, None)
        if (n_found := len(found.corners[side])) < MIN_PHOTOS:
            hint = "--board counts inner corners, one less than squares, and all of them must be in the photo"
            if isinstance(board, CharucoBoard):
                hint = "are --board (squares), --marker and --dictionary those of the print?"
            raise InputError(
                f"{board.words} was found in {n_found} of {len(sizes[side])} photos of the {found.names[side]}; at "
                f"least {MIN_PHOTOS} are needed; {hint}"
            )
    if common[0] != common[-1]:
        left, right = (f"{size[0]} x {size[1]}" for size in common)
        raise InputError(
            f"the left camera's photos have {left} pixels, the right one's {right}: bring them to one size"
        )
    for side, corners in enumerate(found.corners):
        found.cameras.append(fit_camera(board, corners, common[side], fisheye))
        for name in found.cameras[side].outliers:
            found.reasons[name][_SIDES[side]] = _OUTLIER
    if n_cameras == 2:
        found = _with_rig(board, found)
    found.warnings.extend(_doubts(found))
    return found


def _with_rig(board: Board, found: _Found) -> _Found:
    left, right = (
        {name: seen for name, seen in corners.items() if name in fit.errors}
        for corners, fit in zip(found.corners, found.cameras, strict=True)
    )
    pairs = {name: (left[name], board.alike(left[name], right[name])) for name in left if name in right}
    if len(pairs) < MIN_PHOTOS:
        raise InputError(
            f"the board is in both photos of {len(pairs)} pairs; at least {MIN_PHOTOS} are needed, better 15 or more"
        )
    fit = fit_rig(board, pairs, (found.cameras[0].camera, found.cameras[1].camera))
    for name in fit.outliers:
        found.reasons[name]["pair"] = _OUTLIER
    errors: dict[str, float] = {}
    warnings: list[str] = []
    try:
        size = fit.rig.left.size or (1, 1)
        rectified = fit.rig.rectified(size, size, mirrored=True)
        for name in fit.errors:
            ids = np.intersect1d(pairs[name][0].ids, pairs[name][1].ids)
            one, other = rectified.points(*(each.pixels[np.isin(each.ids, ids)] for each in pairs[name]))
            errors[name] = float(np.sqrt(np.mean((one[:, 1] - other[:, 1]) ** 2)))
        if rectified.mirrored:
            warnings.append("the right camera stands to the left of the left one; exchange the photos of the two")
    except InputError as error:
        warnings.append(f"rectify does not take this rig: {error}")
    return _Found(found.photos, found.corners, found.reasons, found.unreadable, found.cameras, fit, errors, warnings)


def _doubts(found: _Found) -> list[str]:
    """Return what makes a calibration doubtful."""
    lines = []
    for side, fit in enumerate(found.cameras):
        which = f"{found.names[side]}: " if len(found.cameras) == 2 else ""
        focal, why = float(fit.camera.matrix[0, 0]), ""
        if fit.focal_deviations is not None and max(fit.focal_deviations) > _MAX_DEVIATION * focal:
            why = f"{focal:.1f} px with a standard deviation of {max(fit.focal_deviations):.1f}"
        elif fit.tilt < MIN_TILT:
            why = f"between photos the board is tilted by {fit.tilt:.0f} degrees at most"
        if why:
            more = "add photos with the board tilted by 30 degrees or more"
            lines.append(f"{which}the focal length is not determined: {why}; {more}")
        if fit.error > _MAX_ERROR:
            lines.append(f"{which}an error of {fit.error:.2f} px; is the board flat, and are the photos sharp?")
        if (share := found.coverage(side)) < _MIN_COVERAGE:
            lines.append(
                f"{which}corners are in {100 * share:.0f} % of the image; lenses are known only there: see the picture"
            )
    return lines


def _document(board: Board, found: _Found, unnamed: list[str]) -> Row:
    """Return the report as JSON holds it: pixels, meters, degrees."""
    kind = "charuco" if isinstance(board, CharucoBoard) else "chessboard"
    described: Row = {"kind": kind, "inner_corners": [board.columns, board.rows], "square": board.square}
    if isinstance(board, CharucoBoard):
        described |= {"marker": board.marker, "dictionary": board.dictionary}
    report: Row = {
        "board": described,
        "cameras": [_camera(found, k) for k in range(len(found.cameras))],
        "photos": [_photo(found, each.name) for each in found.photos],
        "unnamed": unnamed,
        "warnings": found.warnings,
    }
    if found.rig is not None:
        rig = found.rig.rig
        turn = float(np.degrees(np.linalg.norm(cv2.Rodrigues(rig.rotation)[0])))
        pairs = len(found.rig.errors)
        report["rig"] = {"baseline": rig.baseline, "turn": turn, "pairs": pairs, "row_error": found.row_error}
    return report


def _camera(found: _Found, k: int) -> Row:
    fit, camera = found.cameras[k], found.final[k]
    row: Row = {"side": _SIDES[k], "size": list(camera.size or ())}
    row |= {"fx": camera.matrix[0, 0], "fy": camera.matrix[1, 1], "cx": camera.matrix[0, 2], "cy": camera.matrix[1, 2]}
    row |= {"distortion": list(camera.distortion), "fisheye": camera.fisheye}
    row["focal_deviations"] = None if fit.focal_deviations is None else list(fit.focal_deviations)
    return row | {
        "reprojection_error": fit.error, "photos": len(fit.errors), "coverage": found.coverage(k), "tilt": fit.tilt
    }  # fmt: skip


def _photo(found: _Found, name: str) -> Row:
    all_errors = [fit.outliers | fit.errors for fit in found.cameras]
    errors = {side: each[name] for side, each in zip(_SIDES, all_errors, strict=False) if name in each}
    row: Row = {"name": name, "errors": errors, "left_out": found.reasons[name]}
    if found.rig is not None:
        row["pair_error"] = (found.rig.outliers | found.rig.errors).get(name)
        row["row_error"] = found.row_errors.get(name)
    return row


def _table(found: _Found) -> str:
    """Return a line for every photo or pair: reprojection errors, rows, and why it does not count."""
    two = len(found.cameras) == 2
    lines: list[tuple[str, ...]] = [("photo", "used", *(("left", "right", "rows") if two else ("error",)))]
    for row in (_photo(found, each.name) for each in found.photos):
        figures = [row["errors"].get(side) for side in _SIDES[: len(found.cameras)]]
        figures += [row["row_error"]] if two else []
        reasons: dict[str, str] = row["left_out"]
        why = ", ".join(text if side == "pair" else f"{side} {text}" for side, text in reasons.items())
        if not two or (len(reasons) == 2 and len(set(reasons.values())) == 1):
            why = next(iter(reasons.values()), "")
        used = f"no: {why}" if reasons else "yes"
        lines.append((row["name"], used, *("-" if x is None else f"{x:.3f} px" for x in figures)))
    return aligned(lines)


def _say(found: _Found, reporter: Reporter) -> None:
    """Name the photos that are left out, warn, and print a line a camera, and one of the rig."""
    for reason, text in ((_OUTLIER, "left out, since they do not fit the others"), (_NOT_FOUND, "no board")):
        if names := [name for name, why in found.reasons.items() if reason in why.values()]:
            reporter.info(f"{text}: {', '.join(names)}")
    for line in found.warnings:
        reporter.error(f"warning: {line}")
    for k, (fit, camera) in enumerate(zip(found.cameras, found.final, strict=True)):
        spread = "" if fit.focal_deviations is None else f" +- {max(fit.focal_deviations):.2f}"
        reporter.info(
            f"{found.names[k]}: focal length {camera.matrix[0, 0]:.2f}{spread} px, error {fit.error:.3f} px, "
            f"{len(fit.errors)} photos, corners in {100 * found.coverage(k):.0f} % of the image"
        )
    if found.rig is not None:
        rows = "" if found.row_error is None else f", rows {found.row_error:.3f} px apart after rectification"
        reporter.info(f"baseline {1000 * found.rig.rig.baseline:.2f} mm from {len(found.rig.errors)} pairs{rows}")


def _picture(found: _Found) -> NDArray[np.uint8]:
    """Return (H, W, 3): the corners in every camera's image, green where they fit, red where off by a pixel."""
    pictures = []
    for side, fit in enumerate(found.cameras):
        width, height = fit.camera.size or (1, 1)
        scale = _WIDTH / width
        picture = np.full((max(round(height * scale), 1) + _TITLE, _WIDTH, 3), 255, np.uint8)
        picture[_TITLE:] = 236
        share = 100 * found.coverage(side)
        title = f"{found.names[side]}: {len(fit.errors)} photos, corners in {share:.0f} % of the image"
        draw_text(picture, title, (6, _TITLE // 2), (0, 0, 0), max_width=_WIDTH - 12)
        for name, residuals in fit.residuals.items():
            errors = np.minimum(np.linalg.norm(residuals, axis=1) / _RED_PX, 1)
            for (x, y), error in zip((found.corners[side][name].pixels + 0.5) * scale - 0.5, errors, strict=True):
                color = (round(220 * error), round(150 * (1 - error)), 40)
                cv2.circle(picture, (round(x), round(y) + _TITLE), 2, color, cv2.FILLED, cv2.LINE_AA)
        pictures.append(picture)
    height = max(picture.shape[0] for picture in pictures)
    padded = [np.pad(each, ((0, height - each.shape[0]), (0, 8), (0, 0)), constant_values=255) for each in pictures]
    return np.ascontiguousarray(np.hstack(padded)[:, :-8])

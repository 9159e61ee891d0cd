"""From photos of a board to cameras: what ``calibrate`` computes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.calibration.boards import Board, Chessboard, Corners, largest_chessboard
from depthcli.algorithms.calibration.solver import MIN_PHOTOS, MIN_TILT, CameraFit, RigFit, Size, fit_camera, fit_rig
from depthcli.core.cameras.camera import Camera
from depthcli.core.errors import InputError
from depthcli.core.frames import color8, luma
from depthcli.io.calibration_photos import Photos
from depthcli.io.formats.images import read_image
from depthcli.run.console import Reporter

SIDES = ("left", "right")

_MAX_DEVIATION = 0.005  # of the focal length
_MAX_ERROR = 1.0  # pixels, root mean square
_MIN_COVERAGE = 0.5  # of the cells of an image
_CELLS = (8, 6)
_LOOKED_AT = 5  # photos that a wrong number of corners is looked for in
_NOT_FOUND = "board not found"


@dataclass(frozen=True)
class Calibration:
    """The cameras of a set of photos.

    Attributes
    ----------
    photos : as they were given
    cameras : the left one, and the right one where there is one, each by its own photos
    rig : both cameras, None for a single one
    row_errors : name of a pair -> root mean square of the difference of rows after rectification, pixels
    corners : of each camera, name -> corners that were found
    reasons : name -> side -> why a photo does not count
    warnings : what makes the result doubtful, a sentence each
    unreadable : files that cannot be read
    """

    photos: Sequence[Photos]
    cameras: list[CameraFit]
    rig: RigFit | None
    row_errors: dict[str, float]
    corners: list[dict[str, Corners]]
    reasons: dict[str, dict[str, str]]
    warnings: list[str] = field(default_factory=list)
    unreadable: list[str] = field(default_factory=list)

    @property
    def final(self) -> list[Camera]:
        """The cameras, refined by the pairs where there are two."""
        return [self.rig.rig.left, self.rig.rig.right] if self.rig else [fit.camera for fit in self.cameras]

    def coverage(self, side: int) -> float:
        """Return the share of the 8 x 6 cells of a camera's image in which a photo that counts has a corner."""
        used = [self.corners[side][name].pixels for name in self.cameras[side].errors]
        width, height = self.cameras[side].camera.size or (1, 1)
        cells = np.floor(np.concatenate(used) / (width, height) * _CELLS).astype(int)
        return len({(x, y) for x, y in cells.tolist()}) / (_CELLS[0] * _CELLS[1])


def calibrated(board: Board, photos: Sequence[Photos], fisheye: bool, reporter: Reporter) -> Calibration:
    """Return the cameras that took the photos.

    Raises
    ------
    InputError
        The board is in too few photos, or they do not determine the cameras.
    """
    n_cameras = 1 if all(each.right is None for each in photos) else 2
    corners: list[dict[str, Corners]] = [{} for _ in range(n_cameras)]
    sizes: list[dict[str, Size]] = [{} for _ in range(n_cameras)]
    reasons: dict[str, dict[str, str]] = {each.name: {} for each in photos}
    unreadable: list[str] = []
    with reporter:
        reporter.start(len(photos), 0, "calibrate", "photo" if n_cameras == 1 else "pair")
        for each in photos:
            for side, file in enumerate((each.left, each.right)[:n_cameras]):
                try:
                    if file is None:
                        reasons[each.name][SIDES[side]] = "no such photo"
                        continue
                    grey = _grey8(file)
                except InputError as error:
                    reporter.error(str(error))
                    unreadable.append(str(file))
                    reasons[each.name][SIDES[side]] = "cannot be read"
                    continue
                sizes[side][each.name] = grey.shape[1], grey.shape[0]
                if (seen := board.find(grey)) is None:
                    reasons[each.name][SIDES[side]] = _NOT_FOUND
                else:
                    corners[side][each.name] = seen
            reporter.step()
    common = [_same_size(sizes[k], corners[k], SIDES[k], reasons) for k in range(n_cameras)]
    for side, found in enumerate(corners):
        if len(found) < MIN_PHOTOS:
            raise InputError(_photos_lacking(board, photos, side, n_cameras, len(found)))
    if n_cameras == 2 and common[0] != common[1]:
        left, right = (f"{size[0]} x {size[1]}" for size in common)
        raise InputError(
            f"the left camera's photos have {left} pixels, the right one's {right}: bring them to one size"
        )
    cameras = [fit_camera(board, corners[k], common[k], fisheye) for k in range(n_cameras)]
    for side, fit in enumerate(cameras):
        for name in fit.outliers:
            reasons[name][SIDES[side]] = "outlier"
    if n_cameras == 1:
        result = Calibration(photos, cameras, None, {}, corners, reasons, [], unreadable)
    else:
        result = _two_cameras(board, photos, cameras, corners, reasons, unreadable)
    result.warnings.extend(_doubts(result))
    return result


def _two_cameras(
    board: Board, photos: Sequence[Photos], cameras: list[CameraFit], corners: list[dict[str, Corners]],
    reasons: dict[str, dict[str, str]], unreadable: list[str],
) -> Calibration:  # fmt: skip
    left, right = (
        {name: seen for name, seen in found.items() if name in fit.errors}
        for found, fit in zip(corners, cameras, strict=True)
    )
    pairs = {name: (left[name], board.alike(left[name], right[name])) for name in left if name in right}
    if len(pairs) < MIN_PHOTOS:
        raise InputError(
            f"the board is in both photos of {len(pairs)} pairs; at least {MIN_PHOTOS} are needed, better 15 or more"
        )
    rig = fit_rig(board, pairs, (cameras[0].camera, cameras[1].camera))
    for name in rig.outliers:
        reasons[name]["pair"] = "outlier"
    warnings: list[str] = []
    sizes = [camera.size or (1, 1) for camera in (rig.rig.left, rig.rig.right)]
    errors: dict[str, float] = {}
    try:
        rectified = rig.rig.rectified(sizes[0], sizes[1], mirrored=True)
        for name in rig.errors:
            ids = np.intersect1d(pairs[name][0].ids, pairs[name][1].ids)
            views = [each.pixels[np.isin(each.ids, ids)] for each in pairs[name]]
            one, other = rectified.points(views[0], views[1])
            errors[name] = float(np.sqrt(np.mean((one[:, 1] - other[:, 1]) ** 2)))
        if rectified.mirrored:
            warnings.append("the right camera stands to the left of the left one; exchange the photos of the two")
    except InputError as error:
        warnings.append(f"rectify does not take this rig: {error}")
    return Calibration(photos, cameras, rig, errors, corners, reasons, warnings, unreadable)


def _grey8(file: Path) -> NDArray[np.uint8]:
    return np.ascontiguousarray(luma(color8(read_image(file))), np.uint8)


def _same_size(
    sizes: dict[str, Size], corners: dict[str, Corners], side: str, reasons: dict[str, dict[str, str]]
) -> Size:
    """Return the size of most photos of a camera; those of another size do not count."""
    if not sizes:
        return 0, 0
    common_size = Counter(sizes.values()).most_common(1)[0][0]
    for name, size in sizes.items():
        if size != common_size:
            reasons[name][side] = f"{size[0]} x {size[1]} pixels, not {common_size[0]} x {common_size[1]}"
            corners.pop(name, None)
    return common_size


def _photos_lacking(board: Board, photos: Sequence[Photos], side: int, n_cameras: int, n_found: int) -> str:
    files = [file for each in photos if (file := (each.left, each.right)[side]) is not None]
    of = f" of the {SIDES[side]} camera" if n_cameras == 2 else ""
    text = f"{board.words} was found in {n_found} of {len(files)} photos{of}; at least {MIN_PHOTOS} are needed"
    if not isinstance(board, Chessboard):
        return f"{text}; are --board (squares), --marker and --dictionary those of the print?"
    sizes = []
    for file in files[:_LOOKED_AT]:
        try:
            sizes.append((largest_chessboard(_grey8(file)), file.name))
        except InputError:
            continue
    largest, name = max(((size or (0, 0), name) for size, name in sizes), default=((0, 0), ""))
    if largest[0] and largest != (max(board.columns, board.rows), min(board.columns, board.rows)):
        return f"{text}; {name} shows {largest[0]} x {largest[1]} inner corners: --board {largest[0]}x{largest[1]}?"
    return f"{text}; --board counts inner corners, one less than squares, and all of them must be in the photo"


def _doubts(found: Calibration) -> list[str]:
    """Return what makes a calibration doubtful."""
    lines = []
    for side, fit in enumerate(found.cameras):
        which = f"{SIDES[side]} camera: " if len(found.cameras) == 2 else ""
        focal = float(fit.camera.matrix[0, 0])
        if fit.focal_deviations is not None and max(fit.focal_deviations) > _MAX_DEVIATION * focal:
            lines.append(
                f"{which}the focal length is not determined: {focal:.1f} px with a standard deviation of "
                f"{max(fit.focal_deviations):.1f}; add photos with the board tilted by 30 degrees or more"
            )
        elif fit.tilt < MIN_TILT:
            lines.append(
                f"{which}the focal length is not determined: between photos the board is tilted by {fit.tilt:.0f} "
                "degrees at most; add photos with it tilted by 30 degrees or more"
            )
        if fit.error > _MAX_ERROR:
            lines.append(f"{which}an error of {fit.error:.2f} px; is the board flat, and are the photos sharp?")
        if (share := found.coverage(side)) < _MIN_COVERAGE:
            lines.append(
                f"{which}corners are in {100 * share:.0f} % of the image; lenses are known only there: see the picture"
            )
    return lines

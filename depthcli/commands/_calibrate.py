"""What ``calibrate`` computes: cameras from photos of a board, with a report and a picture of the corners."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from depthcli.algorithms.calibration import (
    MAX_ERROR_RATIO,
    MIN_PHOTOS,
    OUTLIER_PX,
    SIMILAR_ERROR_RATIO,
    Board,
    fit_camera,
    fit_rig,
)
from depthcli.commands._board_photos import OUTLIER, CameraPhotos, board_of, look
from depthcli.commands._calibration_report import Calibrated, picture_of, print_summary, report_of, table_of
from depthcli.commands._options import BoardOptions
from depthcli.commands._shared_options import Printing
from depthcli.core.errors import SOME_FAILED, ConfigError, InputError
from depthcli.io.calibration_photos import find_photos
from depthcli.io.formats.calibrations import write_calibration
from depthcli.io.formats.files import collected_warnings, remove_temporaries, write_text
from depthcli.io.formats.images import write_png
from depthcli.run.json_csv import to_json


def calibrate_cameras(
    folders: Sequence[Path], options: BoardOptions, printing: Printing, target: Path, fisheye: bool, overwrite: bool
) -> int:
    """Calibrate and write calibration, report and picture; return the exit code, 3 where a photo could not be read."""
    reporter, board = printing.reporter, board_of(options)
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
    if any(each.right for each in photos):
        views = [CameraPhotos("left", "left camera"), CameraPhotos("right", "right camera")]
    with reporter, collected_warnings() as turned:
        reporter.start(len(views) * len(photos), 0, "calibrate")
        for view in views:
            look(view, board, {each.name: getattr(each, view.side) for each in photos}, reporter)
    if views[0].size != views[-1].size:
        left, right = (f"{view.size[0]} x {view.size[1]}" for view in views)
        raise InputError(
            f"the left camera's photos have {left} pixels, the right one's {right}: bring them to one size"
        )
    for view in views:
        view.fit = fit_camera(board, view.corners, view.size, fisheye)
        view.left_out |= dict.fromkeys(view.fit.outliers, OUTLIER)
    found = _with_rig(board, views[0], views[1]) if len(views) == 2 else Calibrated(views)
    report = report_of(found, board, [each.name for each in photos], unnamed)
    report["warnings"] += turned[:1] + [f"so were {len(turned) - 1} other photos"] * (len(turned) > 1)
    for file in (target, report_file, picture_file):
        remove_temporaries(target.parent, file.name)
    write_png(picture_file, picture_of(views))
    write_text(report_file, to_json(report))
    write_calibration(target, found.cameras, found.rig.rig if found.rig else None)
    if printing.json:
        reporter.data(to_json(report))
    elif not printing.quiet:
        reporter.data(table_of(report))
    print_summary(report, views, reporter)
    use = "for depthcli rectify --calibration" if found.rig else "one camera, K1 and D1"
    reporter.info(f"{target}: {use}; see also {report_file.name} and {picture_file.name}")
    return SOME_FAILED if any(view.unreadable for view in views) else 0


def _with_rig(board: Board, left: CameraPhotos, right: CameraPhotos) -> Calibrated:
    """Return two cameras with their rig, and by how much the rows of each pair differ once rectified.

    InputError where they do not fit the photos about as well as each camera alone.
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

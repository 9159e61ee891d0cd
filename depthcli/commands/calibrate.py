"""Calibrate one camera or two from photos of a board.

The board is a chessboard or a ChArUco board. The result is the file that `rectify` and `stereo --calibration` read;
a report and a picture of the corners are written to the same folder.

Examples:
  depthcli calibrate photos --board 9x6 --square 25mm -o stereo.yml
  depthcli calibrate left right --board 9x6 --square 25mm -o stereo.yml
  depthcli calibrate a --board charuco:7x5 --square 2cm --marker 1cm -o c.yml
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from depthcli.commands._options import BoardOptions, Printing, local_output
from depthcli.core.errors import SOME_FAILED
from depthcli.show.table import to_json


def calibrate(
    photos: Annotated[
        list[Path], Argument(metavar="PHOTOS", help="Folder of photos, or one of each camera, left first.")
    ],
    board: BoardOptions,
    printing: Printing,
    output: Annotated[
        Path,
        Option(
            "--output",
            "-o",
            metavar="FILE.yml",
            help="Calibration to write; the report goes to its folder.",
            callback=local_output,
        ),
    ],
    fisheye: Annotated[bool, Option("--fisheye", help="The lenses follow OpenCV's fisheye model.")] = False,
    overwrite: Annotated[bool, Option("--overwrite", help="Replace an earlier calibration.")] = False,
) -> int:
    """Calibrate the cameras of the photos; return the exit code, 3 if a photo could not be read."""
    from depthcli.problems.boards import board_of, calibrate_cameras, print_summary, table_of

    reporter = printing.reporter
    calibrated = calibrate_cameras(photos, board_of(**vars(board)), output, fisheye, overwrite, reporter)
    if printing.json:
        reporter.data(to_json(calibrated.report))
    elif not printing.quiet:
        reporter.data(table_of(calibrated.report))
    print_summary(calibrated, reporter)
    return SOME_FAILED if any(view.unreadable for view in calibrated.views) else 0

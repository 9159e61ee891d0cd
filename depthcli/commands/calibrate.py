"""Calibrate one camera or two from photos of a board.

The board is a chessboard or a ChArUco board. The result is the file that `rectify` and `stereo --calibration` read;
beside it are a report and a picture of where the corners were.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.core.errors import ConfigError
from depthcli.core.option import Option
from depthcli.run.batch import SOME_FAILED
from depthcli.run.command import Command, Values
from depthcli.run.console import Reporter

if TYPE_CHECKING:
    from depthcli.algorithms.calibration.boards import Board

_METERS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_LENGTH = re.compile(r"\s*([0-9]*\.?[0-9]+)\s*(mm|cm|m)\s*")
_BOARD = re.compile(r"(charuco:)?(\d{1,3})x(\d{1,3})", re.IGNORECASE)
_LARGEST = 10.0  # meters, of a square
_COUNTS = (2, 200)  # corners of a row or column


class CalibrateCommand(Command):
    """``depthcli calibrate PHOTOS --board 9x6 --square 25mm -o stereo.yml``."""

    arguments = (
        Option("photos", Path, "Folder of photos, or one of each camera, left first.", "PHOTOS", repeatable=True,
               required=True, group="Input"),
    )  # fmt: skip

    options = (
        Option("board", str, "COLUMNSxROWS: inner corners; charuco:COLUMNSxROWS: squares.", "BOARD", required=True,
               group="Input"),
        Option("square", str, "Edge of a square, with its unit (mm, cm, m).", "LENGTH", required=True, group="Input"),
        Option("marker", str, "Edge of a marker of a ChArUco board.", "LENGTH", group="Input"),
        Option("dictionary", str, "Markers of a ChArUco board.", "NAME", default="4X4_50", group="Input"),
        Option("fisheye", bool, "The lenses follow OpenCV's fisheye model.", default=False),
        Option("output", Path, "Calibration to write; the report lies beside it.", "FILE.yml", short="-o",
               required=True, group="Output"),
        Option("overwrite", bool, "Replace an earlier calibration.", default=False, group="Output"),
    )  # fmt: skip

    page = "how_to/calibrate"
    examples = (
        "depthcli calibrate photos --board 9x6 --square 25mm -o stereo.yml",
        "depthcli calibrate left right --board 9x6 --square 25mm -o stereo.yml",
        "depthcli calibrate a --board charuco:7x5 --square 2cm --marker 1cm -o c.yml",
    )

    def run(self, values: Values, reporter: Reporter) -> int:
        """Calibrate; return the exit code, 3 where a photo could not be read.

        Raises
        ------
        ConfigError
            An option is wrong, or the output is there already.
        InputError
            There are no photos, or the board is in too few of them.
        """
        from depthcli.commands import _calibration_report as report
        from depthcli.commands._calibration import calibrated
        from depthcli.io.calibration_photos import find_photos
        from depthcli.io.formats.calibrations import write_calibration
        from depthcli.io.formats.files import remove_temporaries, write_text
        from depthcli.io.formats.images import write_png
        from depthcli.run.json_csv import to_json

        board = _board(values)
        if len(values["photos"]) > 2:
            raise ConfigError("PHOTOS: one folder, or one of each camera")
        target: Path = values["output"]
        if target.suffix.lower() not in (".yml", ".yaml"):
            raise ConfigError(f"--output: the calibration is YAML: want FILE.yml (got {target})")
        files = {kind: target.with_name(f"{target.stem}_{kind}") for kind in ("report.json", "coverage.png")}
        for each in (target, *files.values()):
            if os.path.lexists(each) and not values["overwrite"]:
                raise ConfigError(f"{each}: is there already; choose another --output, or --overwrite it")
        photos, unnamed = find_photos(values["photos"])
        for file in unnamed:
            reporter.info(f"{file}: left out, since its name does not say which camera took it")
        found = calibrated(board, photos, values["fisheye"], reporter)
        for each in (target, *files.values()):
            remove_temporaries(target.parent, each.name)
        document = report.document(board, found, [str(file) for file in unnamed])
        write_png(files["coverage.png"], report.coverage(found))
        write_text(files["report.json"], to_json(document))
        write_calibration(target, found.final, found.rig.rig if found.rig else None)
        if values["json"]:
            reporter.data(to_json(document))
        elif not values["quiet"]:
            reporter.data(report.table(found))
        for line in report.left_out(found):
            reporter.info(line)
        for line in found.warnings:
            reporter.error(f"warning: {line}")
        for line in report.summary(found):
            reporter.info(line)
        use = "for depthcli rectify --calibration" if found.rig else "one camera, K1 and D1"
        reporter.info(f"{target}: {use}; beside it are {' and '.join(file.name for file in files.values())}")
        return SOME_FAILED if found.unreadable else 0


def _board(values: Values) -> Board:
    from depthcli.algorithms.calibration.boards import CharucoBoard, Chessboard, dictionaries

    match = _BOARD.fullmatch(values["board"].strip())
    if match is None:
        raise ConfigError(f"--board: want 9x6 (inner corners) or charuco:7x5 (squares) (got {values['board']!r})")
    square, counts = _length("square", values["square"]), (int(match[2]), int(match[3]))
    columns, rows = (count - 1 for count in counts) if match[1] else counts
    low, high = _COUNTS
    if not (low <= min(columns, rows) and low < max(columns, rows) <= high):
        raise ConfigError(f"--board: {values['board']} has too few or too many corners; want {low + 1}x{low} or more")
    if not match[1]:
        if values["marker"] is not None or values["dictionary"] != "4X4_50":
            raise ConfigError("--marker and --dictionary are those of a ChArUco board: --board charuco:7x5")
        return Chessboard(columns, rows, square)
    if values["marker"] is None:
        raise ConfigError("--board charuco: give the edge of its markers, too: --marker 18mm")
    marker, name, known = _length("marker", values["marker"]), values["dictionary"].upper(), dictionaries()
    if marker >= square:
        raise ConfigError(f"--marker: {values['marker']} is not smaller than a square of {values['square']}")
    if name.removeprefix("DICT_") not in known:
        raise ConfigError(f"--dictionary: no {values['dictionary']}; there are {', '.join(known)}")
    name = name.removeprefix("DICT_")
    if (wanted := counts[0] * counts[1] // 2) > known[name]:
        raise ConfigError(f"--dictionary: {name} has {known[name]} markers, the board {wanted}")
    return CharucoBoard(columns, rows, square, marker, name)


def _length(name: str, text: str) -> float:
    """Return the meters of a length with its unit."""
    match = _LENGTH.fullmatch(text)
    meters = float(match[1]) * _METERS[match[2]] if match else 0.0
    if not 0 < meters <= _LARGEST:
        raise ConfigError(f"--{name}: want a length with its unit, such as 25mm (got {text!r})")
    return meters


COMMAND = CalibrateCommand()

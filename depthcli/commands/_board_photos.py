"""What ``calibrate`` looks at: the board that its options describe, and the photos of a camera that show it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from depthcli.algorithms.calibration import (
    MIN_PHOTOS,
    Board,
    CameraFit,
    CharucoBoard,
    Chessboard,
    Corners,
    Size,
    dictionaries,
)
from depthcli.commands._options import BoardOptions
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import color8, luma
from depthcli.io.formats.calibrations import UNITS
from depthcli.io.formats.images import read_image
from depthcli.run.console import Reporter

NOT_FOUND, OUTLIER = "board not found", "outlier"
"""Why a photo does not count."""

_LENGTH = re.compile(r"\s*([0-9]*\.?[0-9]+)\s*(mm|cm|m)\s*")
_BOARD = re.compile(r"(charuco:)?(\d{1,3})x(\d{1,3})", re.IGNORECASE)
_LARGEST = 10.0  # meters, of a square
_COUNTS = (2, 200)  # corners of a row or column
_CELLS = (8, 6)


def board_of(options: BoardOptions) -> Board:
    """Return the board that the options describe; ConfigError if no board is like that."""
    match = _BOARD.fullmatch(options.board.strip())
    if match is None:
        raise ConfigError(f"--board: expected 9x6 (inner corners) or charuco:7x5 (squares) (got {options.board!r})")
    square, counts = _length("square", options.square), (int(match[2]), int(match[3]))
    columns, rows = (count - 1 for count in counts) if match[1] else counts
    low, high = _COUNTS
    if not (low <= min(columns, rows) and low < max(columns, rows) <= high):
        raise ConfigError(f"--board: {options.board} has too few or too many corners; expected {low + 1}x{low} or more")
    if not match[1]:
        if options.marker is not None or options.dictionary != "4X4_50":
            raise ConfigError("--marker and --dictionary describe a ChArUco board: --board charuco:7x5")
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
        raise ConfigError(f"--{name}: expected a length with its unit, such as 25mm (got {text!r})")
    return meters


@dataclass
class CameraPhotos:
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


def look(view: CameraPhotos, board: Board, files: Mapping[str, Path | None], reporter: Reporter) -> None:
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
            view.left_out[name] = NOT_FOUND
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
            hint = "do --board (squares), --marker and --dictionary match the print?"
        raise InputError(
            f"{board.words} was found in {len(view.corners)} of {len(sizes)} photos of the {view.name}; at least "
            f"{MIN_PHOTOS} are needed; {hint}"
        )

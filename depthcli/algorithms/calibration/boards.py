"""Boards of known size, and where their corners are in an image."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

MIN_CORNERS = 6
"""Fewest corners of a photo that count; four fit any camera."""

_TURNS = (0, 1, 2, 3)  # quarter turns of a square board
_WINDOW = 0.25  # of the spacing of corners: half the window in which a corner's edges are fitted
_FREE_SHARE = 1.0  # of the space up to the next marker, whose corner is farther away than its edges are
_BLUR = (0.4, 0.2)  # standard deviation, pixels, alone and for each of half the window: fewer steps along edges
_AGREEMENT = 0.15  # pixels
_MIN_WINDOW, _MAX_WINDOW = 3, 25  # pixels; smaller ones hold too few
_REFINEMENT = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY


@dataclass(frozen=True)
class Corners:
    """The corners of a board that an image shows.

    Attributes
    ----------
    ids : (N,) int, which corners of the board, row by row, ascending
    pixels : (N, 2) float64, x and y
    """

    ids: NDArray[np.int64]
    pixels: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True)
class Board(ABC):
    """A plane with ``columns`` x ``rows`` corners where squares meet, ``square`` meters apart."""

    columns: int
    rows: int
    square: float

    @cached_property
    def points(self) -> NDArray[np.float32]:
        """The corners (N, 3), row by row, meters, z = 0."""
        y, x = np.mgrid[: self.rows, : self.columns]
        return np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3).astype(np.float32) * np.float32(self.square)

    @property
    @abstractmethod
    def words(self) -> str:
        """What is looked for, for a message."""

    @abstractmethod
    def find(self, grey: NDArray[np.uint8]) -> Corners | None:
        """Return the corners in an (H, W) image; None where the board is not found."""

    def alike(self, left: Corners, right: Corners) -> Corners:
        """Return the right view's corners, numbered as those of the left view."""
        return right

    def _refined(
        self, grey: NDArray[np.uint8], corners: Corners, share: float
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the corners where edges in a window meet, and which of them another window agrees with.

        Parameters
        ----------
        share : half of the window, of the smallest spacing of corners

        Returns
        -------
        (N, 2) pixels; (N,) bool
        """
        places = np.full((self.rows * self.columns, 2), np.nan)
        places[corners.ids] = corners.pixels
        grid = places.reshape(self.rows, self.columns, 2)
        steps = np.concatenate([np.linalg.norm(np.diff(grid, axis=k), axis=-1).ravel() for k in (0, 1)])
        steps = steps[~np.isnan(steps)]
        half = min(int(share * steps.min()), _MAX_WINDOW) if len(steps) else 0
        half = max(half, _MIN_WINDOW)
        smooth = cv2.GaussianBlur(grey, (0, 0), _BLUR[0] + _BLUR[1] * half)
        start = np.ascontiguousarray(corners.pixels, np.float32).reshape(-1, 1, 2)
        wide, narrow = (
            cv2.cornerSubPix(smooth, start.copy(), (size, size), (-1, -1), _REFINEMENT).reshape(-1, 2)
            for size in (half, half - 1)
        )
        return np.asarray(wide, np.float64), np.asarray(np.abs(wide - narrow).max(axis=1) < _AGREEMENT, np.bool_)


class Chessboard(Board):
    """A plain chessboard: found as a whole or not at all.

    With an even and an odd number of corners, the dark square at the first corner says which way up the board is.
    Other boards look the same upside down: their first corner is the one at the upper left of the image, and that of a
    second view is chosen so that the board is turned least against the first view.
    """

    @property
    def words(self) -> str:
        return (
            f"a chessboard of {self.columns} x {self.rows} inner corners ({self.columns + 1} x {self.rows + 1} squares)"
        )

    def find(self, grey: NDArray[np.uint8]) -> Corners | None:
        found, pixels = cv2.findChessboardCornersSB(grey, (self.columns, self.rows), flags=_FLAGS)
        if not found or len(pixels) != self.columns * self.rows:
            return None
        ids = np.arange(self.columns * self.rows)
        refined, _ = self._refined(grey, Corners(ids, np.asarray(pixels, np.float64).reshape(-1, 2)), _WINDOW)
        grid = refined.reshape(self.rows, self.columns, 2)
        (ax, ay), (bx, by) = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
        if ax * by - ay * bx < 0:  # seen from behind; boards are printed on one side
            grid = grid[::-1]
        if (self.columns + self.rows) % 2:
            grid = grid if _first_square_is_darker(grey, grid) else grid[::-1, ::-1]
        else:
            grid = max(self._turned(grid), key=lambda each: float(_direction(each) @ (1, 0.5)))
        return Corners(ids, grid.reshape(-1, 2))

    def alike(self, left: Corners, right: Corners) -> Corners:
        """Return the right view's corners in the order in which the board is turned least against the left view."""
        if (self.columns + self.rows) % 2:
            return right
        wanted, grid = (each.pixels.reshape(self.rows, self.columns, 2) for each in (left, right))
        axis = _direction(wanted)
        best = max(self._turned(grid), key=lambda each: float(_direction(each) @ axis))
        return Corners(right.ids, best.reshape(-1, 2))

    def _turned(self, grid: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        turns = _TURNS if self.columns == self.rows else _TURNS[::2]
        return [np.rot90(grid, k) for k in turns]


def _direction(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vector along the rows of a grid of corners."""
    vector = grid[:, -1].mean(axis=0) - grid[:, 0].mean(axis=0)
    return np.asarray(vector / np.linalg.norm(vector), np.float64)


def _first_square_is_darker(grey: NDArray[np.uint8], grid: NDArray[np.float64]) -> bool:
    """Return whether the square between the first four corners is darker than those beside it."""
    centers = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    x, y = centers[..., 0].astype(np.float32), centers[..., 1].astype(np.float32)
    levels = cv2.remap(cv2.blur(grey, (3, 3)), x, y, cv2.INTER_LINEAR).astype(np.float64)
    row, column = np.indices(levels.shape)
    first = (row + column) % 2 == 0
    return bool(levels[first].mean() < levels[~first].mean())


@dataclass(frozen=True)
class CharucoBoard(Board):
    """A chessboard with a marker in every light square, of which any part may be seen.

    Attributes
    ----------
    marker : edge of a marker, meters
    dictionary : name of OpenCV's dictionary of markers, without ``DICT_``
    """

    marker: float
    dictionary: str

    @property
    def words(self) -> str:
        return f"a ChArUco board of {self.columns + 1} x {self.rows + 1} squares with markers of {self.dictionary}"

    @cached_property
    def board(self) -> cv2.aruco.CharucoBoard:
        """The board as OpenCV takes it."""
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))
        return cv2.aruco.CharucoBoard((self.columns + 1, self.rows + 1), self.square, self.marker, markers)

    def find(self, grey: NDArray[np.uint8]) -> Corners | None:
        pixels, ids, _, _ = cv2.aruco.CharucoDetector(self.board).detectBoard(grey)
        if ids is None or len(ids) < MIN_CORNERS:
            return None
        numbers = np.asarray(ids, np.int64).ravel()
        order = np.argsort(numbers, kind="stable")
        found = Corners(numbers[order], np.asarray(pixels, np.float64).reshape(-1, 2)[order])
        free = (self.square - self.marker) / 2 / self.square  # of a square, between a corner and the next marker
        refined, sure = self._refined(grey, found, _FREE_SHARE * free)
        numbers = found.ids[sure]  # in a doubtful window is a part of a marker
        n_lines = min(len(np.unique(numbers // self.columns)), len(np.unique(numbers % self.columns)))
        if len(numbers) < MIN_CORNERS or n_lines < 2:  # one line does not say where the plane lies
            return None
        return Corners(numbers, refined[sure])


def dictionaries() -> dict[str, int]:
    """Return the names of OpenCV's dictionaries of markers, without ``DICT_``, and how many markers each has."""
    names = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_") and name.upper() == name)
    return {name[5:]: len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)).bytesList) for name in names}


def largest_chessboard(grey: NDArray[np.uint8]) -> tuple[int, int] | None:
    """Return columns and rows of inner corners of the chessboard in an image, the larger first; None: there is none."""
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
    found, _, meta = cv2.findChessboardCornersSBWithMeta(grey, (3, 3), flags)
    return (max(meta.shape), min(meta.shape)) if found and meta is not None else None

"""Tiles: parts of a pair that are matched one after the other, each over its own disparities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple, cast

import cv2
import numpy as np

from depthcli.core.errors import InputError
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import Ints, Mask

BLOCK = 16
"""Side of the blocks of pixels that share candidates, and unit of the tiles' sides, pixels."""
BIN = 16
"""Number of disparities that are candidates together, as many as kernels take at a time."""
# Work of a tile besides its cells, set by hand: each pixel takes as long as this many disparities, each tile as long as
# this many cells.
_PIXEL_OVERHEAD, _TILE_OVERHEAD = 24, 300_000
_MIN_TILE_BLOCKS = 8  # smaller tiles are only made if memory requires them: margins would be most of the work
PROCESS_BYTES = 256 << 20  # upper bound of the memory of the interpreter and the libraries
# Bytes per pixel of the image while tiles are matched (winners of both views, keys, minima, prior), and while the map
# is refined and written.
_MATCHING_BYTES, _FINISHING_BYTES = 26, 48


class Span(NamedTuple):
    """Disparities ``low`` .. ``low`` + ``n`` - 1."""

    low: int
    n: int


@dataclass(frozen=True)
class Tile:
    """A part of the left view and the disparities that are searched there."""

    rows: tuple[int, int]  # the first and the one after the last of the pixels that get their values from this tile
    columns: tuple[int, int]
    around: tuple[int, int, int, int]  # top, bottom, left, right of these pixels with the margins
    spans: tuple[Span, ...]  # disparities that are searched, ascending, with gaps between

    @property
    def shape(self) -> tuple[int, int]:
        """Return (height, width), margins included."""
        top, bottom, left, right = self.around
        return bottom - top, right - left

    @property
    def n_disparities(self) -> int:
        """Return the number of cells of a pixel: the disparities, and one between spans."""
        return sum(span.n for span in self.spans) + len(self.spans) - 1

    @property
    def inside(self) -> tuple[slice, slice]:
        """Return the rows and columns of the tile without its margins, within the tile."""
        top, _, left, _ = self.around
        return slice(self.rows[0] - top, self.rows[1] - top), slice(self.columns[0] - left, self.columns[1] - left)

    @property
    def place(self) -> tuple[slice, slice]:
        """Return the rows and columns of the tile without its margins, within the image."""
        return slice(*self.rows), slice(*self.columns)

    def cut(self, pair: StereoPair, low: int = 0) -> StereoPair:
        """Return the tile, margins included, as a pair whose disparities are smaller by ``low``."""
        top, bottom, left, right = self.around
        before = max(0, low - left)  # columns outside the right image
        other = pair.right[top:bottom, left - low + before : right - low]
        if before:
            other = cast(Image, cv2.copyMakeBorder(other, 0, 0, before, 0, cv2.BORDER_REPLICATE))
        trust = None if pair.light_trust is None else pair.light_trust[top:bottom, left:right].copy()
        return StereoPair(pair.left[top:bottom, left:right].copy(), other.copy(), pair.bits, trust)


class Margins(NamedTuple):
    """The margins of a tile, pixels."""

    halo: int  # on all sides
    lead: int  # on the left, beyond the longest span, whose cells are outside the tile's right image
    whole: bool  # tiles are matched as pairs: over one span, with a margin for it on the right side, too


@dataclass(frozen=True)
class Candidates:
    """Disparities that may occur in blocks of 16 x 16 pixels of an image of (H, W) ``shape``.

    ``bins`` (ceil(H / 16), ceil(W / 16), ceil(D / 16)) is True if a block may have any of 16 consecutive disparities.
    """

    bins: Mask
    shape: tuple[int, int]
    max_disparity: int

    @classmethod
    def everywhere(cls, shape: tuple[int, int], max_disparity: int) -> Candidates:
        """Return candidates 0 .. ``max_disparity`` for all blocks."""
        blocks = (-(-side // BLOCK) for side in shape)
        return cls(np.ones((*blocks, max_disparity // BIN + 1), np.bool_), shape, max_disparity)

    @cached_property
    def _sums(self) -> Ints:
        sums = np.zeros(tuple(n + (axis < 2) for axis, n in enumerate(self.bins.shape)), np.int32)
        np.cumsum(np.cumsum(self.bins, axis=0, dtype=np.int32), axis=1, out=sums[1:, 1:])
        return sums

    def tiles(self, margins: Margins, fits: Callable[[Tile], bool]) -> list[Tile] | None:
        """Return the tiles that together take the shortest time; None if not even the smallest fit.

        The image is halved again and again, along the better side, as long as two parts with their own candidates are
        cheaper than the whole, margins included.
        """
        rows, columns = self.bins.shape[:2]

        @cache
        def best(y0: int, y1: int, x0: int, x1: int) -> tuple[float, tuple[tuple[int, int, int, int], ...]]:
            tile = self.tile(y0, y1, x0, x1, margins)
            height, width = tile.shape
            cost = float("inf")
            if fits(tile):
                cost = float(height * width * (tile.n_disparities + _PIXEL_OVERHEAD) + _TILE_OVERHEAD)
            n_min = _MIN_TILE_BLOCKS if cost < float("inf") else 1
            chosen: tuple[tuple[int, int, int, int], ...] = ((y0, y1, x0, x1),)
            y, x = (y0 + y1) // 2, (x0 + x1) // 2
            halves = (y0, y, x0, x1), (y, y1, x0, x1), (y0, y1, x0, x), (y0, y1, x, x1)
            for length, one, other in ((y1 - y0, *halves[:2]), (x1 - x0, *halves[2:])):
                if length >= 2 * n_min:
                    (first, parts), (second, rest) = best(*one), best(*other)
                    if first + second < cost:
                        cost, chosen = first + second, parts + rest
            return cost, chosen

        cost, chosen = best(0, rows, 0, columns)
        return None if cost == float("inf") else [self.tile(*part, margins) for part in chosen]

    def tile(self, y0: int, y1: int, x0: int, x1: int, margins: Margins) -> Tile:
        """Return the tile of blocks ``y0`` .. ``y1`` - 1, ``x0`` .. ``x1`` - 1 with its margins."""
        height, width = self.shape
        rows = y0 * BLOCK, min(y1 * BLOCK, height)
        columns = x0 * BLOCK, min(x1 * BLOCK, width)
        reach = -(-margins.halo // BLOCK)
        v0, v1 = max(0, y0 - reach), min(self.bins.shape[0], y1 + reach)
        u0, u1 = max(0, x0 - reach), min(self.bins.shape[1], x1 + reach)
        sums = self._sums
        there = sums[v1, u1] - sums[v0, u1] - sums[v1, u0] + sums[v0, u0] > 0
        # Runs of bins. Candidates are cut off beyond the last pixel's column; the first pixel needs one up to its own.
        there = there[: min(self.max_disparity, columns[1] - 1) // BIN + 1].copy()
        if not there.any() or there.argmax() * BIN > columns[0]:
            there[columns[0] // BIN] = True
        edges = BIN * np.flatnonzero(np.diff(there.astype(np.int8), prepend=0, append=0))
        ends = np.minimum(edges[1::2], self.max_disparity + 1)
        spans = tuple(Span(int(low), int(end - low)) for low, end in zip(edges[::2], ends, strict=True))
        if margins.whole:
            low = spans[0].low
            spans = (Span(low, spans[-1].low + spans[-1].n - low),)
        longest = max(span.n for span in spans) - 1
        before = max(margins.halo, longest + margins.lead)
        behind = max(margins.halo, longest) if margins.whole else margins.halo
        around = (
            max(0, rows[0] - margins.halo),
            min(height, rows[1] + margins.halo),
            max(spans[0].low if margins.whole else 0, columns[0] - before),
            min(width, columns[1] + behind),
        )
        return Tile(rows, columns, around, spans)


class Memory(NamedTuple):
    """The bytes that a process may take (``allowed``), and the bytes in use besides tiles (``held``)."""

    allowed: int
    held: int

    def beside(self, pair: StereoPair) -> Memory:
        """Return the memory with the bytes of the images of ``pair`` added to ``held``."""
        return Memory(self.allowed, self.held + pair.left.nbytes + pair.right.nbytes)

    def tiles(
        self, pair: StereoPair, candidates: Candidates, margins: Margins, need: Callable[[Tile], int]
    ) -> list[tuple[Tile, int]]:
        """Return tiles of ``pair`` that fit, in order, and the free bytes that the pool of arrays may have before each.

        A tile takes ``need`` bytes. Raise InputError if not even the smallest fit.
        """
        held = self.beside(pair).held
        pixels = pair.shape[0] * pair.shape[1]
        free = self.allowed - held - _MATCHING_BYTES * pixels

        def left(tile: Tile) -> int:  # minus the pool's blocks that only the next tile can use
            return free - need(tile) - 2 * tile.shape[0] * tile.shape[1] * tile.n_disparities

        tiles = candidates.tiles(margins, lambda tile: left(tile) >= 0)
        if tiles is None or held + _FINISHING_BYTES * pixels > self.allowed:
            smallest = self.allowed - left(candidates.tile(0, 1, 0, 1, margins))
            total = max(held + _FINISHING_BYTES * pixels, smallest)
            raise InputError(
                f"needs at least {-(-total >> 20)} MiB of memory even in tiles, {self.allowed >> 20} MiB may be used"
            )
        return [(tile, left(tile)) for tile in tiles]

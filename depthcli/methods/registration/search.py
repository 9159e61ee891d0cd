"""Search around every voxel of a registered pair, and measures of the cost curve at displacement zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.kernels.jit import n_threads, run_bands
from depthcli.methods.registration._search_kernels import MAX_SMALL_VALUE, PLANES, Curve, Scale, Window, search_tiles

SearchShape = Literal["cube", "planes", "axes"]

MEASURES = {
    "eshift": "expected length of the displacement under exp(-(c - c_min) / (k s)), s = deviation of the curve, mm",
    "vshift": "length of the expected displacement, mm",
    "shift": "length of the cheapest displacement, mm",
    "mlm0": "likelihood that the match is at displacement zero, k = 0.5",
    "aml0": "likelihood that the match is at displacement zero, from squared cost differences",
    "rank0": "share of displacements that are cheaper than zero",
    "cur0": "Laplacian of the costs at zero",
    "cost0": "cost at zero, which needs no search",
    "msm": "minus the smallest cost: like the next three a measure of stereo, the same for any displacement",
    "mlm": "likelihood of the cheapest displacement, k = 0.5",
    "aml": "likelihood of the cheapest displacement, from squared cost differences",
    "pkr": "peak ratio: second smallest local minimum among the 26 neighbors / smallest cost",
}
SURER_IF_LARGER = frozenset({"mlm0", "aml0", "cur0", "msm", "mlm", "aml", "pkr"})
"""Measures that grow with confidence; all others grow with the error."""

COSTLY = frozenset({"aml0", "aml", "pkr"})
"""Measures that are computed only on request: together they take as long as all others."""

_SCRATCH_BYTES = 48 << 20  # memory for the costs of a tile, per thread
_LANES = 32  # rows are measured in whole vectors: rounding would differ in the rest of a row
_MAX_TILE_WIDTH = 128  # voxels


@dataclass(frozen=True)
class CurveMeasures:
    """Measures of the cost curves of all measured voxels."""

    # measure -> (z, y, x) float32, at every ``stride``-th voxel; measures in ``COSTLY`` only if requested
    maps: dict[str, NDArray[np.float32]]
    displacement: NDArray[np.float32]  # (3, z, y, x) float32, expected displacement (z, y, x), mm
    # (z, y, x) float32, variance of the displacement, mm^2, summed over the axes
    variance: NDArray[np.float32]
    border: NDArray[np.bool_]  # (z, y, x) bool, the cheapest displacement is on the border of the search


def displacements(shape: Sequence[int], radius: int, span: SearchShape = "cube") -> NDArray[np.int64]:
    """Return (K, 3) displacements (z, y, x) in voxels, sorted by length, zero first; 0 along axes of one voxel."""
    sides = [np.arange(-radius, radius + 1) if size > 1 else np.zeros(1, np.int64) for size in shape]
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = grid[np.count_nonzero(grid, axis=1) <= {"cube": 3, "planes": 2, "axes": 1}[span]]
    return np.ascontiguousarray(grid[np.argsort((grid**2).sum(axis=1), kind="stable")], np.int64)


def search(
    fixed: NDArray[np.uint8],
    warped: NDArray[np.uint8],
    spacing: float,
    radius: int = 5,
    half_window: int = 3,
    sharpness: int = 10,
    span: SearchShape = "cube",
    costly: bool = False,
    stride: int = 1,
    tile: tuple[int, int, int] | None = None,
) -> CurveMeasures:
    """Compare every voxel with the voxels around its position in the other volume.

    ``fixed`` and ``warped`` are channels (C, Z, Y, X). A cost is the mean of |fixed - warped| over channels and a
    (2 half_window + 1)^3 window, on a scale of 0 to 1. Volumes are extended by repeating their borders. Among equally
    cheap displacements the shortest wins.

    Parameters
    ----------
    spacing : mm per voxel; ``radius``, ``half_window`` and ``stride`` are in voxels
    sharpness : 0.5 / k; k is the scale of the likelihoods of ``eshift`` and ``vshift``, in deviations of the curve
    span : displacements: all, in the three planes, or on the three axes
    costly : also compute the measures in ``COSTLY``
    stride : measure every ``stride``-th voxel along each axis, from the first one on; at most 2 half_window + 1
    tile : number of voxels measured at once, (z, y, x); changes time and memory, not the result
    """
    channels, *shape = fixed.shape
    offsets = displacements(shape, radius, span)
    steps = np.array([stride if size > 1 else 1 for size in shape], np.int64)
    measured = tuple(-(-n // int(step)) for n, step in zip(shape, steps, strict=True))
    half = np.array([half_window if size > 1 else 0 for size in shape], np.int64)
    reach = np.array([radius if size > 1 else 0 for size in shape], np.int64)
    top = MAX_SMALL_VALUE if max(int(fixed.max(initial=0)), int(warped.max(initial=0))) <= MAX_SMALL_VALUE else 255
    largest = top * channels * int(np.prod(2 * half + 1))
    shift = max(0, largest.bit_length() - 16)
    layer = np.zeros(0, np.uint16 if top * channels * (2 * half_window + 1) ** 2 < 1 << 16 else np.uint32)
    lengths = (np.linalg.norm(offsets, axis=1) * spacing).astype(np.float32)
    edge = np.abs(offsets).max(axis=1) == radius
    neighbors = np.flatnonzero((offsets**2).sum(axis=1) == 1)
    # Indices (K, 13) of each displacement's neighbors before and after it; -1: not searched.
    place = {tuple(offset): k for k, offset in enumerate(offsets.tolist())}
    ahead = [step for step in np.ndindex(3, 3, 3) if step > (1, 1, 1)]
    before, after = (
        np.array(
            [
                [place.get((z + s * (c - 1), y + s * (b - 1), x + s * (a - 1)), -1) for c, b, a in ahead]
                for z, y, x in offsets.tolist()
            ],
            np.int64,
        )
        for s in (-1, 1)
    )
    size = np.array(tile or _tile(measured, len(offsets)), np.int64)
    grid = np.stack(np.meshgrid(*(np.arange(0, n, s) for n, s in zip(measured, size, strict=True)), indexing="ij"), -1)
    tiles = np.ascontiguousarray(grid.reshape(-1, 3), np.int64)
    workers = min(n_threads(), len(tiles))
    width = -(-int(size[2]) // _LANES) * _LANES
    scratch = memory.empty((workers, int(size[0]), int(size[1]), len(offsets), width), np.uint16)
    out = np.empty((len(PLANES), *measured), np.float32)
    volumes = _phases(fixed, half, steps), _phases(warped, half + reach, steps)
    curve, window = Curve(offsets, lengths, edge, neighbors, before, after), Window(half, reach, steps)
    unit = np.float32((1 << shift) / largest)
    scale = Scale(np.uint32(shift), unit, sharpness, top == MAX_SMALL_VALUE, costly)
    run_bands(search_tiles, workers, *volumes, curve, window, tiles, size, scale, layer, scratch, out)
    planes = dict(zip(PLANES, out, strict=True))
    displacement = out[2:5] * np.float32(spacing)
    planes["vshift"] = np.sqrt((displacement**2).sum(axis=0))
    variance = np.maximum(planes["square"] - planes["vshift"] ** 2, 0)
    maps = {name: planes[name] for name in MEASURES if costly or name not in COSTLY}
    return CurveMeasures(maps, displacement, variance, planes["border"] > 0)


def search_bytes(
    shape: tuple[int, int, int], channels: int, radius: int, half_window: int, stride: int, workers: int
) -> int:
    """Estimate the memory of :func:`search` in addition to its inputs, bytes."""
    voxels = int(np.prod([-(-n // stride) for n in shape]))
    padded = sum(channels * int(np.prod([n + 2 * r for n in shape])) for r in (half_window, half_window + radius))
    return 3 * padded // 2 + 24 * 4 * voxels + workers * _SCRATCH_BYTES


def _tile(shape: tuple[int, ...], count: int) -> tuple[int, int, int]:
    """Return the tile with the smallest halo whose costs fit the scratch memory of a thread."""
    widths = range(_LANES, _MAX_TILE_WIDTH + 1, _LANES)
    width = min(widths, key=lambda w: -(-shape[2] // w) * (w + 8))
    cells = _SCRATCH_BYTES // (2 * count)
    side = max(1, int(np.sqrt(cells / width)))
    z, y, x = min(shape[0], side, 32), min(shape[1], side, 32), min(shape[2], width)
    if -(-shape[0] // z) * -(-shape[1] // y) * -(-shape[2] // x) < n_threads():
        z = -(-shape[0] // n_threads())  # divide a small volume among all threads, too
    return z, y, x


def _phases(channels: NDArray[np.uint8], width: NDArray[np.int64], stride: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return (C, Z, Y, sx, Xs), widened by repeating the border, with voxel x at [x % sx, x // sx]."""
    around = [(0, 0), *((int(w), int(w)) for w in width)]
    step = int(stride[2])
    around[3] = (int(width[2]), int(width[2]) + step)
    padded = np.pad(channels, around, mode="edge")
    if step == 1:
        return padded[:, :, :, None]
    length = padded.shape[3] // step
    parts = padded[..., : length * step].reshape(*padded.shape[:3], length, step)
    return np.ascontiguousarray(parts.swapaxes(3, 4))

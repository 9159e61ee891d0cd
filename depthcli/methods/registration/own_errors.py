"""A model of the errors of one pair, learned from errors that are known because they were put into the pair itself.

Needs no landmarks and no training set: parts of the warped volume are moved to where the search says that they belong,
moved away again by smooth random fields, and searched again. Source: simulated errors as a training set after Sokooti
et al. (Medical Image Analysis 2019), here of the pair itself, and a few blocks of it: memory and time do not grow with
the volume.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.data.generated.deformed_volumes import smooth_noise
from depthcli.methods.registration._volume import moved, resample
from depthcli.methods.registration.calibration import MonotoneModel, evidence, fit, length
from depthcli.methods.registration.search import Curves

Volume = NDArray[np.float32]
Search = Callable[[Volume, Volume], tuple[list[Curves], list[Curves]]]

# Errors put in: largest one in units of the pair's own, and correlation length, working voxels.
_ERRORS = ((1.0, 3.0), (2.0, 6.0), (4.0, 4.0), (4.0, 9.0))
_SIDES = (40, 40, 64)  # of a block, working voxels: along x, whole vectors of the search at a stride of 2
_MARGIN = 12  # what a block's face that is not the volume's spoils
_SHARE, _FEWEST, _MOST = 0.2, 2, 12  # of the volume; blocks
_EACH = 2  # errors put into one block
_SAMPLES, _LEAST = 20_000, 1000
_COARSE = 4  # a random field is made on every fourth voxel


@dataclass(frozen=True)
class Block:
    """Part of the working grid.

    Attributes
    ----------
    start, shape : (z, y, x) working voxels; ``start`` is measured
    core : its measured places that the faces do not reach, as slices
    """

    start: tuple[int, int, int]
    shape: tuple[int, int, int]
    core: tuple[slice, slice, slice]

    def of(self, volume: NDArray[np.generic]) -> NDArray[np.generic]:
        """Its part of a volume on the working grid."""
        return volume[tuple(slice(a, a + n) for a, n in zip(self.start, self.shape, strict=True))]


def blocks(chosen: NDArray[np.bool_], shape: tuple[int, ...], stride: int, rng: np.random.Generator) -> list[Block]:
    """A few blocks around random places of interest.

    Parameters
    ----------
    chosen : (z, y, x) places of interest, at least one, at every ``stride``-th voxel
    shape : of the working grid
    """
    size = [min(side, n) for side, n in zip(_SIDES, shape, strict=True)]
    wanted = round(_SHARE * float(np.prod(shape)) / float(np.prod(size)))
    count = 1 if size == list(shape) else min(max(wanted, _FEWEST), _MOST)
    found = []
    for center in rng.choice(np.argwhere(chosen), count):
        starts, cores = [], []
        for place, side, n in zip(center, size, shape, strict=True):
            step = stride if n > 1 else 1
            start = int(np.clip(place * step - side // 2, 0, n - side)) // step * step
            first = 0 if start == 0 else -(-_MARGIN // step)
            last = -(-side // step) if start + side + step > n else (side - _MARGIN) // step
            starts.append(start)
            cores.append(slice(first, last))
        found.append(Block((starts[0], starts[1], starts[2]), (size[0], size[1], size[2]), tuple(cores)))  # type: ignore[arg-type]
    return found


def learn(
    fixed: Volume,
    warped: Volume,
    displacement: Volume,
    chosen: NDArray[np.bool_],
    usual: float,
    reach: float,
    iso: float,
    stride: int,
    search: Search,
    seed: int,
) -> MonotoneModel:
    """Fit a model of :func:`evidence` to errors put into blocks of the pair; deterministic by seed.

    Features that take their scale from a volume's percentiles take it from the block's here.

    Parameters
    ----------
    displacement : (3, z, y, x) mm, where the match of a place lies, at every ``stride``-th voxel
    chosen : (z, y, x), places of interest among them
    usual : size of the pair's own errors, mm
    reach : largest error that the search sees, mm
    iso : side of a voxel, mm
    search : curves of all features, and those of the coarser resolutions
    """
    rng = np.random.default_rng(seed)
    tables: list[dict[str, NDArray[np.float32]]] = []
    known: list[NDArray[np.float32]] = []
    trusted: list[NDArray[np.bool_]] = []
    found_blocks = blocks(chosen, fixed.shape, stride, rng)
    most = _SAMPLES * len(_ERRORS) // (len(found_blocks) * _EACH)
    for k, block in enumerate(found_blocks):
        part = np.ascontiguousarray(block.of(fixed), np.float32)
        steps = [1 / stride if n > 1 else 1.0 for n in fixed.shape]
        starts = [start * step for start, step in zip(block.start, steps, strict=True)]
        correction = _at(displacement, block.shape, steps, starts, iso)
        # Once more from there: places that the search still does not call aligned cannot teach what an error is.
        found, rest = evidence(*search(part, moved(warped, correction, block.start)), iso, stride)
        further = _at(rest, block.shape, steps, (0.0, 0.0, 0.0), iso)
        correction = further + np.stack([moved(axis, further) for axis in correction])
        aligned = found["smooth_2"] <= iso
        first = [start // (stride if n > 1 else 1) for start, n in zip(block.start, fixed.shape, strict=True)]
        inside = chosen[tuple(slice(a, a + n) for a, n in zip(first, aligned.shape, strict=True))][block.core]
        for j in range(_EACH if len(found_blocks) > 1 else len(_ERRORS)):
            times, wave = _ERRORS[(_EACH * k + j) % len(_ERRORS)]
            largest = min(max(times * usual, iso), reach)
            field = random_error(rng, block.shape, largest / iso, wave)
            displaced, error = misregister(warped, correction, field, block.start)
            found, _ = evidence(*search(part, displaced), iso, stride)
            places = np.flatnonzero(inside)
            some = rng.choice(places, min(len(places), most), replace=False) if len(places) else places
            measured = error[tuple(slice(None, None, stride if n > 1 else 1) for n in fixed.shape)]
            tables.append({name: values[block.core].ravel()[some] for name, values in found.items()})
            known.append((measured[block.core].ravel()[some] * np.float32(iso)).astype(np.float32))
            trusted.append(aligned[block.core].ravel()[some])
    table = {name: np.concatenate([each[name] for each in tables]) for name in tables[0]}
    error, use = np.concatenate(known), np.concatenate(trusted)
    if use.sum() < _LEAST:
        use[:] = True
    return fit({name: values[use] for name, values in table.items()}, error[use])


def random_error(rng: np.random.Generator, shape: tuple[int, ...], largest: float, wave: float) -> Volume:
    """(3, Z, Y, X) smooth field in voxels, ``largest`` long at most; ``wave``: its correlation length, voxels."""
    sizes = tuple(-(-n // _COARSE) + 1 if n > 1 else 1 for n in shape)
    step = [1 / _COARSE if n > 1 else 1.0 for n in shape]
    small = (sizes[0], sizes[1], sizes[2])
    whole = (shape[0], shape[1], shape[2])
    field = np.stack([smooth_noise(rng, small, wave / _COARSE) for _ in range(3)])
    for axis in range(3):
        if shape[axis] == 1:
            field[axis] = 0
    field = np.stack([resample(part, whole, step, (0.0, 0.0, 0.0)) for part in field])
    field *= np.float32(largest / max(float(length(field).max()), 1e-6))
    return field


def misregister(
    warped: Volume, correction: Volume, error: Volume, start: tuple[int, int, int] = (0, 0, 0)
) -> tuple[Volume, Volume]:
    """A part of the warped volume corrected, then moved by ``error``, with one interpolation; and its error's length.

    Where the corrected volume W' fits, the match of x in W'(y + u(y)) is at x + r with r = -u(x + r).

    Parameters
    ----------
    correction, error : (3, Z, Y, X) voxels, of the part
    start : its first voxel in ``warped``
    """
    both = error + np.stack([moved(part, error) for part in correction])
    residual = -error
    for _ in range(4):
        residual = -np.stack([moved(part, residual) for part in error])
    return moved(warped, both, start), length(residual)


def _at(
    displacement: Volume, shape: tuple[int, int, int], steps: list[float], starts: list[float] | tuple[float, ...],
    iso: float,
) -> Volume:  # fmt: skip
    """Displacements in mm, on measured places, at every voxel of a part, in voxels."""
    return np.stack([resample(axis / np.float32(iso), shape, steps, starts) for axis in displacement])

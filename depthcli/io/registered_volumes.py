"""Two volumes on one grid, checked and made small enough to be searched."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.core.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.core.volumes import Grid, RegisteredPair


_LABEL_TOLERANCE = 1e-3  # of a whole number: what rounding leaves of a label
_MAX_LABELS = 2000  # more are the gray values of a scan; atlases have some hundreds
_MAX_LABEL = 1 << 24  # whole numbers up to here are exact in float32


@dataclass(frozen=True)
class LoadedPair:
    """A registered pair in memory.

    Attributes
    ----------
    grid : the fixed volume's
    blocks : how many of its voxels (z, y, x) a voxel of ``pair`` is the mean of
    """

    pair: RegisteredPair
    grid: Grid
    blocks: tuple[int, int, int] = (1, 1, 1)

    def on_grid(self, start: Sequence[float], step: Sequence[float]) -> tuple[list[float], list[float]]:
        """``start`` and ``step`` of maps in voxels of ``pair`` as those in voxels of the fixed volume."""
        begin = [(n - 1) / 2 + n * a for n, a in zip(self.blocks, start, strict=True)]
        return begin, [n * a for n, a in zip(self.blocks, step, strict=True)]


def joined(
    fixed: NDArray[np.float32],
    warped: NDArray[np.float32],
    inside: NDArray[np.bool_] | None,
    grid: Grid,
    blocks: tuple[int, int, int],
) -> LoadedPair:
    """Return block means of two volumes as a pair, with the mask of the whole volume reduced likewise."""
    from depthcli.algorithms.resampling import block_means
    from depthcli.core.volumes import RegisteredPair

    if inside is not None and max(blocks) > 1:
        inside = block_means(inside, blocks) >= 0.5
    placed = grid if max(blocks) == 1 else None
    return LoadedPair(RegisteredPair(fixed, warped, spacing_of(grid, blocks), inside, placed), grid, blocks)


def usable(values: NDArray[np.float32], inside: NDArray[np.bool_] | None, name: Path | str) -> NDArray[np.float32]:
    """Return a volume without NaN and infinite values outside the mask; InputError where they are inside, or all equal.

    Parameters
    ----------
    name : of the volume, for messages
    """
    import numpy as np

    if not all(np.isfinite(one_slice).all() for one_slice in values):  # a mask of the whole would take memory
        bad = ~np.isfinite(values)
        count = int(np.count_nonzero(bad if inside is None else bad & inside))
        if count:
            raise InputError(f"{name}: {count} voxels are no numbers; leave them out with a mask")
        values = np.where(bad, values[~bad].min(), values)
    if values.min() == values.max():
        raise InputError(f"{name}: all voxels are {values.flat[0]:g}; nothing to compare")
    return values


def label_masks(
    values: NDArray[np.float32], name: str, regions: Sequence[tuple[str, int]] = ()
) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield the regions of a mask or label map, one mask at a time.

    Parameters
    ----------
    values : 0 is outside. Whole numbers of which several occur are labels, as is one other than 1 and 255. Fractions
        up to 1 are probabilities, of which the region has at least 0.5
    name : of the mask
    regions : (name, label) of regions, where the map's labels have names; then whatever occurs is a label

    Yields
    ------
    Name, and mask, bool; a label without a name is ``NAME_LABEL``. Regions with a name are given where none of their
    voxels is set, too

    Raises
    ------
    InputError
        Fractions above 1, or of labels that have names: what a label map is after linear interpolation; or more
        labels than label maps have.
    """
    import numpy as np

    values = np.where(np.isfinite(values), values, np.float32(0))
    near = np.rint(values)
    whole = all(np.allclose(plane, near[z], rtol=0, atol=_LABEL_TOLERANCE) for z, plane in enumerate(values))
    if not whole:
        top = float(values.max())
        if regions or top > 1:
            raise InputError(f"values between whole numbers, up to {top:g}: resample labels by the nearest neighbor")
        yield name, values >= 0.5
        return
    present = sorted({float(label) for plane in near for label in np.unique(plane[plane > 0])})
    if present and (len(present) > _MAX_LABELS or present[-1] > _MAX_LABEL):
        raise InputError(f"{len(present)} values up to {present[-1]:g}: no label map, of at most {_MAX_LABELS} labels")
    names = {float(label): region for region, label in regions}
    if not names and present in ([], [1.0], [255.0]):
        yield name, near > 0
        return
    for label in sorted({*present, *names}):
        yield names.get(label, f"{name}_{label:.0f}"), near == label


def spacing_of(grid: Grid, blocks: tuple[int, int, int]) -> tuple[float, float, float]:
    """Return the distances (z, y, x) of the centers of blocks of voxels, mm."""
    z, y, x = (s * n for s, n in zip(grid.spacing[::-1], blocks, strict=True))
    return z, y, x


def blocks_of(grid: Grid, max_voxels: int | None) -> tuple[int, int, int]:
    """Voxels (z, y, x) that are taken together so that about ``max_voxels`` cubes are left."""
    count = grid.size[0] * grid.size[1] * grid.size[2]
    if max_voxels is None or count <= max_voxels:
        return (1, 1, 1)
    axes = [a for a in range(3) if grid.shape[a] > 1]
    spacing = grid.spacing[::-1]
    extent = math.prod(grid.shape[a] * spacing[a] for a in axes)
    side = float((extent / max_voxels) ** (1 / len(axes)))
    z, y, x = (max(1, int(side / spacing[a] + 1e-6)) if a in axes else 1 for a in range(3))
    return z, y, x

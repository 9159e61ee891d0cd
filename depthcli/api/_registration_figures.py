"""What a registration's expected errors come to within the mask or the body: figures of a report."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from depthcli.algorithms.body import body_of_volume
from depthcli.algorithms.resampling import block_means, resample
from depthcli.core.errors import InputError
from depthcli.io.registered_volumes import LoadedPair
from depthcli.io.scenes.volume_pair import VolumePairScene
from depthcli.methods.registration.pipeline import RegistrationResult

_WRONG_MM = 3.0  # expected errors above it are located


def inside_figures(result: RegistrationResult, loaded: LoadedPair) -> dict[str, float]:
    """Return figures of the expected error in the mask, or else in the body; empty where no voxel lies there.

    Returns
    -------
    ``inside_mean``, ``inside_95`` (quantile) and ``inside_max``, mm; ``above_3mm``, the volume of larger errors, mL;
    where there are any, ``above_x``, ``above_y`` and ``above_z``: center of their largest connected region, mm, LPS.
    """
    pair, grid = loaded.pair, loaded.grid
    inside = pair.mask
    if inside is None:
        order, flipped = grid.anatomical_axes()
        turned = np.flip(body_of_volume(grid.turned(pair.fixed)), flipped)
        inside = turned.transpose(np.argsort(order))
    error = _error_of_voxels(result, loaded)
    known = error[inside]
    if not known.size:
        return {}
    wrong = inside & (error > _WRONG_MM)
    figures = {
        "inside_mean": float(known.mean(dtype=np.float64)), "inside_95": float(np.quantile(known, 0.95)),
        "inside_max": float(known.max()),
        "above_3mm": int(np.count_nonzero(wrong)) * math.prod(pair.spacing) / 1000,
    }  # fmt: skip
    if wrong.any():
        labels, _ = ndimage.label(wrong)
        largest = int(np.bincount(labels[wrong]).argmax())
        center = np.array([ndimage.center_of_mass(labels == largest)])
        first, blocks = (np.array(values) for values in loaded.on_grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
        place = grid.to_point(first + blocks * center)[0]
        figures |= dict(zip(("above_x", "above_y", "above_z"), map(float, place), strict=True))
    return {name: round(value, 4) for name, value in figures.items()}


def region_figures(result: RegistrationResult, loaded: LoadedPair, scene: VolumePairScene) -> dict[str, float | str]:
    """Return figures of the expected error in the regions of a pair, such as organs.

    Returns
    -------
    ``region_mean_NAME`` and ``region_95_NAME`` (quantile), mm, and ``region_volume_NAME``, mL; the volume alone
    of a region without a voxel. ``region_error_NAME``: why a mask cannot be used; the others are measured all the same.
    """
    figures: dict[str, float | str] = {}
    error = _error_of_voxels(result, loaded) if scene.regions else np.zeros(0, np.float32)
    voxel = math.prod(loaded.grid.spacing) / 1000
    for file, _ in scene.regions:
        try:
            for name, mask in scene.region_masks(file, loaded.grid):
                if f"region_volume_{name}" in figures:
                    twice = f"{scene.folder}: two regions are called {name}: give one of them another name"
                    figures.setdefault(f"region_error_{file}", twice)
                    continue
                known = error[_in_blocks(mask, loaded.blocks)]
                figures[f"region_volume_{name}"] = round(int(np.count_nonzero(mask)) * voxel, 4)
                if known.size:
                    figures[f"region_mean_{name}"] = round(float(known.mean(dtype=np.float64)), 4)
                    figures[f"region_95_{name}"] = round(float(np.quantile(known, 0.95)), 4)
        except InputError as problem:
            figures[f"region_error_{file}"] = str(problem)
    return figures


def _in_blocks(mask: NDArray[np.bool_], blocks: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Return the blocks of which a mask holds half; of a mask that is too small for it, those that it holds most of."""
    if max(blocks) == 1:
        return mask
    shares = block_means(mask, blocks)
    largest = float(shares.max())
    return shares >= min(0.5, largest) if largest > 0 else np.zeros(shares.shape, np.bool_)


def _error_of_voxels(result: RegistrationResult, loaded: LoadedPair) -> NDArray[np.float32]:
    """Return the expected error of each voxel of the pair, mm."""
    steps = [1 / step for step in result.step]
    starts = [-start / step for start, step in zip(result.start, result.step, strict=True)]
    return resample(result.expected_error, loaded.pair.shape, steps, starts)

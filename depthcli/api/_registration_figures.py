"""What a registration's expected errors come to within the mask or the body: figures of a report."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from depthcli.algorithms.body import body_of_volume
from depthcli.algorithms.resampling import resample
from depthcli.data.registered_volumes import LoadedPair
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
    steps = [1 / step for step in result.step]
    starts = [-start / step for start, step in zip(result.start, result.step, strict=True)]
    error = resample(result.expected_error, pair.shape, steps, starts)
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

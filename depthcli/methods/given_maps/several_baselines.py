"""Maps of pairs that share their left view, with other cameras on the right: one inverse depth from all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import DisparityMap

_AGREEMENT = 0.5  # pixels of a map's own pair


def with_agreed_values(
    fused: DisparityMap, maps: Sequence[NDArray[np.float32]], baselines: Sequence[float]
) -> DisparityMap:
    """Return the fused map, with the mean of the maps where one agrees with that of the longest baseline.

    Two pairs seldom agree on a wrong depth. In the mean a map counts by the square of its baseline, since the error of
    an inverse depth is that of the disparity over the baseline. Elsewhere the fused value stays.

    Parameters
    ----------
    maps : (H, W) float32 each, disparities of the first map's pair, NaN = no value
    baselines : of the maps over that of the first pair, of either sign
    """
    lengths = np.abs(np.asarray(baselines, np.float64))
    longest = int(np.argmax(lengths))
    reference = maps[longest]
    total, weights = np.zeros(reference.shape), np.zeros(reference.shape)
    agree = np.zeros(reference.shape, np.bool_)
    for number, (one, length) in enumerate(zip(maps, lengths, strict=True)):
        with np.errstate(invalid="ignore"):
            near = np.abs(one - reference) < _AGREEMENT / length
        total += np.where(near, one, 0) * length**2
        weights += near * length**2
        if number != longest:
            agree |= near
    mean = np.divide(total, weights, out=np.zeros_like(total), where=agree)
    values = np.where(agree, mean.astype(np.float32), fused.values)
    return DisparityMap(values, np.where(agree, np.uint8(0), fused.status))

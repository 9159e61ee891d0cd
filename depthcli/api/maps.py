"""Disparity maps that any program made: ``map_confidence`` says how sure they are, ``fuse_maps`` takes the best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from depthcli.api.arrays import as_image, as_map
from depthcli.api.judging import MapConfidence, fused, fusion_of, judge, judge_by_one_view, judge_of
from depthcli.api.results import Disparity
from depthcli.api.running import computing
from depthcli.api.wording import worded
from depthcli.core.errors import ConfigError
from depthcli.core.frames import StereoPair
from depthcli.io.formats.stereo_images import pair_of
from depthcli.run.resources import available_memory


@worded
def map_confidence(
    left: ArrayLike,
    right: ArrayLike | None,
    disparity: ArrayLike,
    *,
    max_disparity: int | None = None,
    witnesses: Sequence[ArrayLike] = (),
    right_disparity: ArrayLike | None = None,
    within: float = 1.0,
    measures: Sequence[str] = (),
) -> MapConfidence:
    """Judge a disparity map of a rectified pair that any program made.

    Parameters
    ----------
    left, right : the images, as for :func:`stereo`; right None: there is none, and the map is judged by its shape and
        the left image alone, which say far less. Witnesses, most measures and what is hidden want a right image
    disparity : (H, W) pixels, the left view's map; NaN, infinite and negative ones = no value
    max_disparity : largest disparity that is compared with, pixels; None: that of the maps
    witnesses : maps of the same view by other methods, which make the judgment better
    right_disparity : (H, W) pixels, the map of the right view by the same program, for the measure ``left_right``
    within : error up to which a value counts as right, pixels, 0.25 to 8
    measures : names of single measures that are wanted, too; ``depthcli help measures`` lists them

    Raises
    ------
    ConfigError
        An unknown measure, or a number out of bounds.
    InputError
        Images and maps that do not fit each other, negative disparities, or too little memory.

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> left = np.random.default_rng(0).integers(0, 256, (48, 96), np.uint8)
    >>> right = np.roll(left, -8, axis=1)
    >>> disparity = np.full((48, 96), 8.0)
    >>> disparity[20:30, 40:60] = 3
    >>> sure = depthcli.map_confidence(left, right, disparity).probability
    >>> bool(sure[5:15, 40:60].mean() > sure[20:30, 40:60].mean())
    True
    """
    if right is None:
        if witnesses or right_disparity is not None:
            raise ConfigError("right: witnesses and right_disparity want a right image")
        image = as_image(left, "left")
        values = as_map(disparity, "disparity", image.shape[:2])
        with computing():
            return judge_by_one_view(judge_of(within, measures), image, values, max_disparity)
    names = ("disparity", *(f"witnesses[{k}]" for k in range(len(witnesses))))
    pair, maps = _inputs(left, right, dict(zip(names, (disparity, *witnesses), strict=True)))
    other = None if right_disparity is None else as_map(right_disparity, "right_disparity", pair.shape)
    with computing():
        return judge(judge_of(within, measures), pair, maps, max_disparity, other, available_memory())


@worded
def fuse_maps(
    left: ArrayLike,
    right: ArrayLike,
    maps: Sequence[ArrayLike],
    *,
    max_disparity: int | None = None,
    within: float = 1.0,
    surfaces: bool = False,
) -> Disparity:
    """Take the best of several disparity maps of a rectified pair at every pixel; one alone is completed and corrected.

    Parameters
    ----------
    left, right : the images, as for :func:`stereo`
    maps : (H, W) pixels each, maps of the left view by any programs; NaN, infinite and negative ones = no value
    max_disparity : largest disparity that is compared with, pixels; None: that of the maps
    within : error up to which a value counts as right in ``confidence["probability"]``, pixels, 0.25 to 8
    surfaces : whether planes of segments are proposed, too; slower

    Returns
    -------
    The map, with a value everywhere.

    Raises
    ------
    ConfigError, InputError
        As for :func:`map_confidence`; no map, or more than 14.

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> left = np.random.default_rng(0).integers(0, 256, (48, 96), np.uint8)
    >>> right = np.roll(left, -8, axis=1)
    >>> upper, lower = np.full((48, 96), 8.0), np.full((48, 96), 8.0)
    >>> upper[:24], lower[24:] = 3, 2
    >>> bool(np.mean(np.abs(depthcli.fuse_maps(left, right, [upper, lower]).values - 8) < 1) > 0.9)
    True
    """
    pair, arrays = _inputs(left, right, {f"maps[{k}]": one for k, one in enumerate(maps)})
    with computing():
        return fused(fusion_of(within, surfaces), pair, arrays, max_disparity, available_memory())


def _inputs(
    left: ArrayLike, right: ArrayLike, maps: Mapping[str, ArrayLike]
) -> tuple[StereoPair, dict[str, NDArray[np.float32]]]:
    images = as_image(left, "left"), as_image(right, "right")
    floats = np.asarray(left).dtype.kind == "f"  # dark ones use all 16 bits, too
    pair = pair_of(*images, (Path("left"), Path("right")), 16 if floats else None)
    return pair, {name: as_map(one, name, pair.shape) for name, one in maps.items()}

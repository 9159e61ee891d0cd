"""Check the map of a matched pair: warnings about doubtful properties, and error bounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np

from depthcli.core.bound import Bound
from depthcli.core.context import Context
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Status
from depthcli.core.text import show_bytes
from depthcli.io.formats.networks import network_path, read_errors, read_network
from depthcli.methods.given_maps import Networks, bounds, peak_bytes
from depthcli.methods.stereo.matching import Limits
from depthcli.methods.stereo.search_range import SearchRange, matched_beyond
from depthcli.methods.stereo.volume import StereoResult
from depthcli.problems.results import Disparity
from depthcli.run.job import check_memory

_MIN_MEASURED_SHARE = 0.5  # share of measured pixels below which a map has a warning
# Shares of measured pixels at an end of the search range. Above the first, a map has a warning. A third of the ranges
# that end at 3/4 of the largest disparity stay below it; above the second, the pair's own range is estimated.
_MAX_SHARE_AT_END, _MIN_SHARE_AT_END = 0.05, 0.01


def doubts(
    pair: StereoPair, search: SearchRange, key_points: Mapping[str, int], result: StereoResult, limits: Limits
) -> tuple[str, ...]:
    """Return one line for each doubtful property of a map."""
    found, warnings = result.disparity, []
    if pair.top < np.iinfo(pair.left.dtype).max:
        warnings.append(f"samples of {pair.bits} bits in {pair.left.dtype} files; scaled accordingly")
    if flat := [name for name, image in (("left", pair.left), ("right", pair.right)) if image.min() == image.max()]:
        warnings.append(f"the {' and the '.join(flat)} image has one level alone: nothing can be matched")
    elif np.array_equal(pair.left, pair.right):
        warnings.append("both images are the same: the disparity is 0 or chance; was one file given twice?")
    measured = np.count_nonzero(found.measured) / found.values.size
    if measured < _MIN_MEASURED_SHARE:
        warnings.append(
            f"only {100 * measured:.0f} % of the map was measured, the rest is filled in or empty: views swapped, "
            "not rectified, search range too small, or no texture?"
        )
    bounds = ((search.min_disparity, "min_disparity"), (search.max_disparity, "max_disparity"))
    shares = search.share_at_ends(found)
    for part, (end, option) in zip(shares, bounds, strict=True):
        if part > _MAX_SHARE_AT_END:
            warnings.append(
                f"{100 * part:.0f} % of the measured pixels are at the end of the search range, {end}; see {option}"
            )
    if _MIN_SHARE_AT_END < shares[1] <= _MAX_SHARE_AT_END and (top := matched_beyond(pair, search)) is not None:
        warnings.append(
            f"the images match at disparities up to {top}, searched up to {bounds[1][0]}; see max_disparity"
        )
    if key_points and search.min_disparity > key_points["range_low"] and key_points["range_low"] < 0:
        warnings.append(f"the images match at disparities down to {key_points['range_low']}; see min_disparity")
    if search.min_disparity < 0:
        warnings.append("disp_left.png has no value for negative disparities; disp_left.pfm has them")
    if result.figures.get("exact") == 0 and limits.memory < limits.tile_memory:
        warnings.append(
            f"matched in {result.figures['tiles']:.0f} tiles at {result.figures['levels']:.0f} sizes, since only "
            f"{show_bytes(limits.memory)} of memory may be used: with more the map is another one"
        )
    return tuple(warnings)


@cache
def networks() -> Networks:
    """Return the package's networks and error table for disparity maps."""
    right, hidden, one_view = (read_network(network_path(f"map_{name}")) for name in ("right", "hidden", "one_view"))
    return Networks(right, hidden, one_view, read_errors("map_errors"))


def with_bound(disparity: Disparity, pair: StereoPair, promise: Bound, context: Context) -> Disparity:
    """Return the map of a pair with ``bound`` and ``probability``, which take somewhat longer than ``stereo fast``.

    Raise InputError if there is not enough memory.
    """
    search = disparity.search
    shifted, width = search.shift(pair), disparity.values.shape[1]
    # If the range begins above 0, the first columns have no match.
    first, top = max(search.min_disparity, 0), search.shifted_max_disparity
    values, filled = np.full(shifted.shape, np.nan, np.float32), np.zeros(shifted.shape, np.bool_)
    values[:, : width - first] = disparity.values[:, first:] - np.float32(search.min_disparity)
    filled[:, : width - first] = (disparity.status[:, first:] & np.uint8(Status.FILLED)) > 0
    size = f"a bound of {shifted.shape[1]} x {shifted.shape[0]} pixels, {top + 1} disparities"
    check_memory(peak_bytes(shifted.shape, top, 1), context.memory, size)
    probable, bounded = bounds(networks(), shifted, values, filled, top, promise.within, promise.level, context)
    known = np.isfinite(disparity.values)
    # A value without a match may be anywhere in the range.
    bound = np.where(known, np.float32(max(top, 1)), np.float32(np.nan))
    probability = np.zeros(disparity.values.shape, np.float32)
    bound[:, first:] = np.where(known[:, first:], bounded[:, : width - first], np.float32(np.nan))
    probability[:, first:] = probable[:, : width - first]
    return replace(disparity, bound=bound, probability=probability, seconds=dict(context.clock.seconds))

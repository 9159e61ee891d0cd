"""Bounds of the errors of a map: the networks and tables that give them, and maps with their bounds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from depthcli.api.results import Disparity
from depthcli.core.bound import Bound
from depthcli.core.context import Context
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Status
from depthcli.core.result import Clock
from depthcli.io.formats.networks import network_path, read_errors, read_network
from depthcli.methods.given_maps import Networks, bounds, peak_bytes
from depthcli.run.resources import check_memory


@cache
def networks() -> Networks:
    """Return the networks of the package, and their tables of errors."""
    right, hidden, one_view = (read_network(network_path(f"map_{name}")) for name in ("right", "hidden", "one_view"))
    return Networks(right, hidden, one_view, read_errors("map_errors"), read_errors("map_errors_one_view"))


def with_bound(found: Disparity, pair: StereoPair, promise: Bound, context: Context) -> Disparity:
    """Return the map of a pair with its ``bound`` and ``probability``, which cost somewhat more than ``stereo fast``.

    InputError where the memory does not suffice.
    """
    search, clock = found.search, Clock()
    clock.start("bound")
    shifted, width = search.shift(pair), found.values.shape[1]
    # Where the range begins above 0, the first columns have no match at all.
    first, top = max(search.min_disparity, 0), search.shifted_max_disparity
    values, filled = np.full(shifted.shape, np.nan, np.float32), np.zeros(shifted.shape, np.bool_)
    values[:, : width - first] = found.values[:, first:] - np.float32(search.min_disparity)
    filled[:, : width - first] = (found.status[:, first:] & np.uint8(Status.FILLED)) > 0
    size = f"a bound of {shifted.shape[1]} x {shifted.shape[0]} pixels, {top + 1} disparities"
    check_memory(peak_bytes(shifted.shape, top, 1), context.memory, size)
    probable, bounded = bounds(networks(), shifted, values, filled, top, promise.within, promise.level, context)
    known = np.isfinite(found.values)
    # A value without a match may be any of the range.
    bound = np.where(known, np.float32(max(top, 1)), np.float32(np.nan))
    probability = np.zeros(found.values.shape, np.float32)
    bound[:, first:] = np.where(known[:, first:], bounded[:, : width - first], np.float32(np.nan))
    probability[:, first:] = probable[:, : width - first]
    return replace(found, bound=bound, probability=probability, seconds={**found.seconds, **clock.seconds})

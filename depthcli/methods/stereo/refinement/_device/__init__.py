"""Device implementations of the refinement steps; see :mod:`depthcli.methods.stereo._device_table`.

Each returns the same map as the step of its name, unless its docstring states otherwise.
"""

from __future__ import annotations

import numpy as np

from depthcli.algorithms.plane_fitting.window_slopes import window_sampling
from depthcli.device import DeviceArray, Kernels
from depthcli.methods.stereo.on_device import PIXELS, DeviceContext, DeviceMap
from depthcli.methods.stereo.refinement.background_fill import BackgroundFill
from depthcli.methods.stereo.refinement.directional_fill import DirectionalFill
from depthcli.methods.stereo.refinement.left_right_check import LeftRightCheck
from depthcli.methods.stereo.refinement.median import Median
from depthcli.methods.stereo.refinement.slanted_median import BLOCK, SlantedMedian
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter, steps_of
from depthcli.methods.stereo.refinement.subpixel import Subpixel
from depthcli.methods.stereo.refinement.surface_fill import SurfaceFill
from depthcli.methods.stereo.refinement.weighted_median import WeightedMedian

_FILLS, _MEDIANS, _SLANTED, _SPECKLES = (
    Kernels(__name__, f"{file}.cl") for file in ("fills", "medians", "slanted", "speckles")
)
_SELECTION = Kernels("depthcli.methods.stereo", "selection.cl")


def background_fill(method: BackgroundFill, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the map of :class:`BackgroundFill`."""
    height, width = disparity.values.shape
    rows = disparity.device.empty((height, width), np.float32)
    disparity.device.launch(_FILLS, "fill_rows", (width, height), PIXELS, disparity.values, rows, height, width)
    return disparity.refined(_FILLS, "fill_columns", [rows])


def directional_fill(method: DirectionalFill, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the map of :class:`DirectionalFill`; rounding of costs may change a decision."""
    image = disparity.device.upload(method.smoothed(context.pair.host))
    return disparity.refined(_FILLS, "replace_fills", [image, context.right], *map(float, method.rates()))


def left_right_check(method: LeftRightCheck, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the map of :class:`LeftRightCheck`."""
    parameters = context.volume.n_disparities, float(method.tolerance)
    return disparity.refined(_SELECTION, "left_right_check", [context.right], *parameters)


def median(method: Median, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the map of :class:`Median`."""
    return disparity.refined(_MEDIANS.with_macros(WINDOW=method.window), "plain_median")


def slanted_median(method: SlantedMedian, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the map of :class:`SlantedMedian`."""
    device = disparity.device
    height, width = disparity.values.shape
    count = height * width
    image = context.pair.color[0]
    known, trust = device.empty((height, width), np.float32), device.empty((height, width), np.float32)
    device.launch(_SLANTED, "split_values", (count,), (256,), disparity.values, known, trust, count)
    step, limits, spread = window_sampling(method.slope_radius)
    gradient = device.empty((2, height, width), np.float32)
    device.launch(
        _SLANTED, "slopes", (width, height), PIXELS, known, trust, image, device.upload(limits), gradient, height,
        width, step, spread,
    )  # fmt: skip
    distance, rate = method.weights()
    distances = device.upload(distance)
    for _ in range(method.passes):
        out = device.empty((height, width), np.float32)
        device.launch(
            _SLANTED, "slanted_median", (width, height), (BLOCK, 1), image, known, trust, gradient, distances, out,
            height, width, method.radius, rate, float(context.volume.n_disparities - 1),
        )  # fmt: skip
        known = out
    values = device.empty((height, width), np.float32)
    device.launch(_SLANTED, "join_values", (count,), (256,), disparity.values, known, values, count)
    return _with_smoothed(disparity, values)


def speckle_filter(method: SpeckleFilter, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the map of :class:`SpeckleFilter`: regions by union of trees (Playne and Hawick 2018)."""
    device = disparity.device
    height, width = disparity.values.shape
    count, steps = height * width, steps_of(context.volume.n_disparities)
    fixed = device.empty((height, width), np.int16)
    parent, roots, sizes = (device.empty((height, width), np.int32) for _ in range(3))
    all_pixels = ((count,), (256,))
    device.launch(_SPECKLES, "start_regions", *all_pixels, disparity.values, fixed, parent, sizes, count, steps)
    largest = round(method.step * steps)
    device.launch(_SPECKLES, "join_regions", (width, height), PIXELS, fixed, parent, height, width, largest)
    device.launch(_SPECKLES, "count_regions", *all_pixels, parent, roots, sizes, count)
    out = DeviceMap.empty(device, (height, width))
    device.launch(
        _SPECKLES, "remove_small", *all_pixels, disparity.values, disparity.status, roots, sizes, out.values,
        out.status, count, method.size,
    )  # fmt: skip
    return out


def subpixel(method: Subpixel, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the map of :class:`Subpixel`, to a millionth of a pixel if the device has no double precision."""
    height, width, n_disparities = context.volume.costs.shape
    values = disparity.device.empty((height, width), np.float32)
    disparity.device.launch(
        _SELECTION.with_macros(COST=context.volume.c_type), "move_to_minimum", (width, height), PIXELS,
        context.volume.costs, disparity.values, values, height, width, n_disparities,
    )  # fmt: skip
    return DeviceMap(disparity.device, values, disparity.status)


def surface_fill(method: SurfaceFill, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the map of :class:`SurfaceFill`, up to rounding if the device has no double precision."""
    height, width = disparity.values.shape
    real = np.float64 if disparity.device.has_double else np.float32
    planes = disparity.device.empty((height, width, 4), real)
    disparity.device.launch(
        _FILLS, "surfaces_at_gaps", (width, height), PIXELS, disparity.values, planes, height, width,
        method.rows, method.reach, method.support,
    )  # fmt: skip
    return disparity.refined(_FILLS, "continue_surfaces", [planes], float(context.volume.n_disparities - 1))


def weighted_median(method: WeightedMedian, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the map of :class:`WeightedMedian`.

    A value may be off by a bin of 1/8 pixel if sums in another order reach half of the weights in another bin.
    """
    device = disparity.device
    height, width = disparity.values.shape
    by_color, by_distance = (device.upload(table) for table in method.tables())
    values = disparity.values
    for _ in range(method.passes):
        filtered = device.empty((height, width), np.float32)
        device.launch(
            _MEDIANS, "weighted_median", (width, height), PIXELS, context.pair.color[0], values, disparity.status,
            by_color, by_distance, filtered, height, width, method.radius, float(method.filled_weight),
        )  # fmt: skip
        values = filtered
    return _with_smoothed(disparity, values)


def _with_smoothed(disparity: DeviceMap, values: DeviceArray) -> DeviceMap:
    device, count = disparity.device, values.size
    status = device.empty(values.shape, np.uint8)
    device.launch(_MEDIANS, "mark_changes", (count,), (256,), disparity.values, values, disparity.status, status, count)
    return DeviceMap(device, values, status)

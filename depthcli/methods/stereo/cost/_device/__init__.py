"""Device implementations of the cost measures; see :mod:`depthcli.methods.stereo._device_table`.

Each returns the same costs as the measure of its name, unless its docstring states otherwise.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from depthcli.device import DeviceArray, Kernels
from depthcli.methods.stereo.cost import light_weights
from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.cost.combined import Combined, part_shares
from depthcli.methods.stereo.cost.gradient import Gradient, derivative_filters
from depthcli.methods.stereo.cost.rank import Rank
from depthcli.methods.stereo.on_device import PIXELS, DevicePair, DeviceVolume, c_type, cells

_FILL, _FEATURES, _COMBINED = (Kernels(__name__, f"{file}.cl") for file in ("fill", "features", "combined"))


def _fill_volume(
    kernel: str, pair: DevicePair, left: DeviceArray, right: DeviceArray, n_disparities: int, outside: int, *more: Any,
    **macros: Any,
) -> DeviceArray:  # fmt: skip
    # (H, W, D) uint8 from two feature images, by a kernel of fill.cl.
    height, width = pair.shape
    costs = pair.device.empty((height, width, n_disparities), np.uint8)
    kernels = _FILL.with_macros(**macros) if macros else _FILL
    pair.device.launch(kernels, kernel, *cells(costs), left, right, costs, height, width, n_disparities, outside, *more)
    return costs


def absolute_difference(method: AbsoluteDifference, pair: DevicePair, n_disparities: int) -> DeviceVolume:
    """Return the costs of :class:`AbsoluteDifference`."""
    channels = 3 if pair.host.left.ndim == 3 else 1
    left, right = pair.color if channels == 3 else pair.grey8
    limit = min(round(method.truncation * channels), method.MAX_STORED)
    outside = min(round(method.outside * channels), limit)
    kernel = "tolerant_difference" if method.sampling == "tolerant" else "difference"
    costs = _fill_volume(kernel, pair, left, right, n_disparities, outside, 0, limit, CHANNELS=channels)
    return DeviceVolume(pair.device, costs, float(channels))


def census(method: Census, pair: DevicePair, n_disparities: int) -> DeviceVolume:
    """Return the costs of :class:`Census`."""
    left, right = (_window_feature("census", pair, image, method.window, np.uint64) for image in pair.grey)
    costs = _fill_volume("hamming", pair, left, right, n_disparities, round(method.outside))
    return DeviceVolume(pair.device, costs, 1.0)


def _window_feature(
    kernel: str, pair: DevicePair, image: DeviceArray, window: tuple[int, int], dtype: type
) -> DeviceArray:
    # (H, W) features of the windows around all pixels, by a kernel of features.cl.
    height, width = pair.shape
    out = pair.device.empty((height, width), dtype)
    kernels = _FEATURES.with_macros(GREY=c_type(image.dtype))
    radii = window[1] // 2, window[0] // 2
    pair.device.launch(kernels, kernel, (width, height), PIXELS, image, out, height, width, *radii)
    return out


def combined(method: Combined, pair: DevicePair, n_disparities: int) -> DeviceVolume:
    """Return the costs of :class:`Combined`; a part without a device implementation is computed on the host."""
    height, width = pair.shape
    device = pair.device
    unit = 255 // len(method.parts)
    outside = min(255, round(method.outside * unit))
    total = device.empty((height, width, n_disparities), np.uint8)
    weights = light_weights([part.cost for part in method.parts], pair.host)
    if weights is None:
        weights = np.ones((len(method.parts), height, width), np.float32)
    for k, part in enumerate(method.parts):
        units = device.upload(np.float32(unit) * weights[k])
        volume: DeviceVolume = pair.run(part.cost, pair, n_disparities)
        table = device.upload(part_shares(volume.scale * part.lambda_))
        last = k == len(method.parts) - 1
        device.launch(
            _COMBINED, "add_part", (width * n_disparities, height), (256, 1),
            volume.costs, table, units, total, int(k == 0), n_disparities, width, outside, int(last), height,
        )  # fmt: skip
    return DeviceVolume(device, total, float(unit))


def gradient(method: Gradient, pair: DevicePair, n_disparities: int) -> DeviceVolume:
    """Return the costs of :class:`Gradient` to a sixteenth of a grey level; derivatives have single precision."""
    left, right = (_derivatives(method, pair, image) for image in pair.grey)
    limit = round(method.truncation * method.SCALE)
    outside = min(limit, round(method.outside * method.SCALE))
    kernel = "tolerant_difference" if method.sampling == "tolerant" else "difference"
    costs = _fill_volume(kernel, pair, left, right, n_disparities, outside, 2, limit, FEATURE="short", CHANNELS=2)
    return DeviceVolume(pair.device, costs, float(method.SCALE))


def _derivatives(method: Gradient, pair: DevicePair, image: DeviceArray) -> DeviceArray:
    height, width = pair.shape
    smooth, slope = (pair.device.upload(taps.astype(np.float32)) for taps in derivative_filters(method.sigma))
    out = pair.device.empty((height, width, 2), np.int16)
    unit = 16.0 if image.dtype == np.uint8 else 16 / 257
    kernels = _FEATURES.with_macros(GREY=c_type(image.dtype))
    pair.device.launch(kernels, "gradient", (width, height), PIXELS, image, smooth, slope, unit, out, height, width)
    return out


def rank(method: Rank, pair: DevicePair, n_disparities: int) -> DeviceVolume:
    """Return the costs of :class:`Rank`."""
    left, right = (_window_feature("rank", pair, image, method.window, np.uint8) for image in pair.grey)
    costs = _fill_volume("difference", pair, left, right, n_disparities, round(method.outside), 0, 255, CHANNELS=1)
    return DeviceVolume(pair.device, costs, 1.0)

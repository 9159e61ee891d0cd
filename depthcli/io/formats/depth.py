"""Depth maps as files: codes of sensors and data sets, meters; colored point clouds."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.formats.disparity import far_constant, read_plane, without_value
from depthcli.io.formats.files import is_of_a_run, shown, warn, write_bytes
from depthcli.io.formats.images import write_png

MILLIMETERS = 1000.0
"""Codes per meter of Kinect, NYU and ROS (``16UC1``, REP 118); TUM RGB-D has 5000, KITTI 256."""

SENSOR = (0.35, 5.0)
"""Plausible median depths of an indoor depth sensor such as the Kinect, meters."""

_LARGEST_CODE = 65535
_MAX_SHARE_BEYOND = 0.01  # largest share of depths beyond the last code without a warning
_MAX_SENSOR_DEPTH = 10.0  # largest 95 % quantile of a sensor's depths, meters; the first Kinect reaches 9.7 m
_ROOM = (0.2, 20.0)  # plausible median depths of a room, meters

MIN_DEPTH, MAX_DEPTH = 0.01, 100.0
"""Plausible median depths of any scene, meters: from a macro lens to a street."""

# Codes per meter of common files: millimeters, TUM RGB-D, RealSense L515, 1/8 and 1/10 mm, KITTI, centimeters, meters.
_COMMON_SCALES = (1000.0, 5000.0, 4000.0, 8000.0, 10_000.0, 256.0, 100.0, 1.0)

_NO_DEPTH = (65504.0, 65535.0)  # largest float16 and uint16, which mean no depth
_RAW_CODE, _MIN_RAW_SHARE = 2047, 0.005  # the first Kinect's code for no depth; its smallest share in raw maps


def codes_of(values: NDArray[Any], path: Path | str) -> NDArray[np.uint16]:
    """Return integers as 16-bit codes. Raise InputError for other numbers."""
    if values.dtype.kind not in "iu" or (values.dtype.itemsize > 1 and (values.min() < 0 or values.max() > 65535)):
        raise InputError(f"{shown(path)}: expected codes from 0 to 65535, got {values.dtype}")
    return values.astype(np.uint16)


def read_depth(path: Path | str, scale: float | None = None, **options: Any) -> NDArray[np.float32]:
    """Return a depth map, (H, W) float32, meters, NaN = unknown, with the options of :func:`meters`."""
    return meters(read_plane(path), scale, path, **options)


def meters(
    values: NDArray[Any],
    scale: float | None,
    name: Path | str,
    rotate: int = 0,
    invalid: float | None = None,
    scale_floats: bool = True,
) -> NDArray[np.float32]:
    """Convert stored numbers to (H, W) float32 meters, NaN = unknown.

    Integer codes are rotated right by ``rotate`` bits (SUN RGB-D: 3) and divided by ``scale``, codes per meter; the
    default for 16-bit codes is 1000. Floating-point values are in meters, unless ``scale_floats`` is set and a scale is
    given.

    Values that are not positive and finite, or are ``invalid``, are unknown. The largest code of the integers, the
    largest uint16 and float16, greater depths, and a depth of several pixels that is far beyond all others and 100 m,
    are unknown, too, with a warning. Implausible depths cause a warning that begins with ``name``.

    Raise InputError for 8-bit codes, or codes that look like raw Kinect codes, without a scale.
    """
    if values.dtype.kind == "b":
        raise InputError(f"{shown(name)}: true or false, expected depths")
    none_too = list(_NO_DEPTH)
    if values.dtype.kind in "iu":
        none_too.append(np.iinfo(values.dtype).max)
        if scale is None and values.dtype.itemsize == 1:
            raise InputError(f"{shown(name)}: 8-bit depth needs a scale (codes per meter): --depth-scale")
        values = codes_of(values, name)
        if rotate:
            values = (values >> np.uint16(rotate)) | (values << np.uint16(16 - rotate))
        elif scale is None and (share := _raw_share(values)):
            raise InputError(
                f"{shown(name)}: {100 * share:.3g} % of the pixels have the largest code, {_RAW_CODE}, as in raw maps "
                "of a Kinect: call it disparity.* for layout kinect-raw, or give the scale, such as --depth-scale 1000"
            )
        scale = scale or MILLIMETERS
    elif not scale_floats:
        scale = None
    scale = scale or 1.0
    with np.errstate(all="ignore"):  # infinite results are unknown, like infinite values
        depth = (values / np.float64(scale)).astype(np.float32)
        marked = np.isin(values, none_too) | (np.isfinite(values) & (depth > _NO_DEPTH[0]))
    none = without_value(values, invalid)
    marked &= ~none
    known = depth[~(none | marked | without_value(depth, positive=True))]
    if (far := far_constant(known, MAX_DEPTH)) is not None and not is_of_a_run(name):
        marked |= depth == far
    if marked.any():
        share, mark = 100 * np.mean(marked), values[marked].max()
        warn(f"{shown(name)}: {share:.3g} % of the pixels are {mark:g}: taken as no depth")
    depth[none | marked | without_value(depth, positive=True)] = np.nan
    if text := implausible_depth(name, depth, scale):
        warn(text)
    return depth


def _raw_share(codes: NDArray[np.uint16]) -> float:
    """Return the share of the largest code of raw Kinect maps, or 0 if the codes do not look raw."""
    share = float(np.mean(codes == _RAW_CODE))
    return share if codes.max() == _RAW_CODE and share >= _MIN_RAW_SHARE else 0.0


def implausible_depth(
    path: Path | str, depth: NDArray[np.float32], scale: float, limits: tuple[float, float] = (MIN_DEPTH, MAX_DEPTH)
) -> str:
    """Return a warning if the median depth is outside ``limits`` (meters), otherwise an empty text.

    With the limits ``SENSOR``, more than 5 % of depths beyond 10 m cause a warning, too. The warning suggests codes per
    meter, other than ``scale``, that would make the depths fit a room.
    """
    known = depth[np.isfinite(depth)]
    median = float(np.median(known)) if known.size else math.nan
    far = float(np.quantile(known, 0.95)) if known.size and limits == SENSOR else 0.0
    if not known.size or (limits[0] <= median <= limits[1] and far <= _MAX_SENSOR_DEPTH):
        return ""

    def fits(other: float, low: float, high: float) -> bool:
        return other != scale and low <= median * scale / other <= high

    fitting = [s for s in _COMMON_SCALES if fits(s, *SENSOR) and far * scale / s <= _MAX_SENSOR_DEPTH]
    fitting += [s for s in _COMMON_SCALES if limits != SENSOR and fits(s, *_ROOM)]
    read_as = "" if scale == 1 else f" at {scale:g} codes per meter"
    hint = f"; a depth scale of {fitting[0]:g} would fit" if fitting else ""
    if fitting and scale == 1:  # floating-point depths have a unit rather than a scale
        units = {MILLIMETERS: " (millimeters)", 100.0: " (centimeters)"}
        best = next((s for s in units if s in fitting), fitting[0])
        hint = f"; divided by {best:g}{units.get(best, '')} it would fit"
    beyond = f", and 5 % are beyond {far:.3g} m," if limits[0] <= median <= limits[1] else ""
    return f"{shown(path)}: the median depth is {median:.3g} m{beyond}{read_as}{hint}"


def sensor_warning(path: Path | str, depth: NDArray[np.float32], scale: float) -> str:
    """Return a warning if depths are implausible for an indoor sensor only, otherwise an empty text.

    :func:`meters` warns of depths that are implausible for any scene.
    """
    text = "" if implausible_depth(path, depth, scale) else implausible_depth(path, depth, scale, SENSOR)
    return f"{text}; see depth_scale" if text else ""


def check_fb(path: Path | str, fb: float, depth: NDArray[np.float32]) -> None:
    """Warn if ``fb``, pixel meters, makes the median disparity of a depth map (H, W) larger than the image width."""
    known = depth[np.isfinite(depth)]
    disparity, width = fb / float(np.median(known)) if known.size else 0.0, depth.shape[1]
    if disparity > width:
        warn(
            f"{shown(path)}: fb {fb:g} makes the median disparity {disparity:.4g} px, wider than the image of {width} "
            "px; expected focal length x baseline in pixels x meters"
        )


def write_depth_png(
    path: Path | str, depth: NDArray[np.floating[Any]], scale: float = MILLIMETERS, rotate: int = 0
) -> None:
    """Write (H, W) meters atomically as 16-bit codes, ``depth x scale`` rounded; 0 = unknown.

    Depths beyond the largest code are written as unknown, since clipping would invent a nearer surface. Positive
    depths below the smallest code get that code. The codes are rotated left by ``rotate`` bits (SUN RGB-D: 3).
    """
    codes = np.zeros(depth.shape, np.uint16)
    with np.errstate(all="ignore"):
        exact = np.rint(depth.astype(np.float64) * scale)
    known = (depth > 0) & (exact <= _LARGEST_CODE)
    codes[known] = np.maximum(exact[known], 1).astype(np.uint16)
    if rotate:
        codes = (codes << np.uint16(rotate)) | (codes >> np.uint16(16 - rotate))
    write_png(path, codes)


def beyond_png(depth: NDArray[np.floating[Any]], scale: float) -> tuple[float, str]:
    """Return the share of depths (meters) beyond 16-bit codes, and a warning if it is large."""
    known = depth[np.isfinite(depth)]
    share = float(np.mean(known * scale >= _LARGEST_CODE + 0.5)) if known.size else 0.0
    if share <= _MAX_SHARE_BEYOND:
        return share, ""
    return share, (
        f"{100 * share:.0f} % of the depths are beyond the {_LARGEST_CODE / scale:.4g} m that depth.png can hold: 0 "
        "there, depth.pfm has them"
    )


def write_points(path: Path | str, points: NDArray[np.float32], color: NDArray[np.uint8]) -> None:
    """Write points (N, 3) with colors (N, 3) RGB as binary little-endian PLY. Raise OutputError on failure."""
    vertices = np.empty(len(points), [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    vertices["xyz"], vertices["rgb"] = points, color
    floats = "".join(f"property float {name}\n" for name in "xyz")
    bytes_ = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{floats}{bytes_}end_header\n"
    write_bytes(path, header.encode("ascii") + vertices.tobytes())

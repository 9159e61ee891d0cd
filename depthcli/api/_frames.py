"""Frames of depth sensors from the arrays that users give."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from depthcli.api.arrays import as_color8, as_depth, as_image
from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.color_and_depth import Place, registered
from depthcli.core.cameras.kinect import sensor_fb
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import RgbdFrame, RgbIrFrame, infrared_image
from depthcli.io.formats.depth import MILLIMETERS
from depthcli.io.formats.files import naming, warn
from depthcli.io.formats.plain_text import numbers
from depthcli.io.formats.rigs import read_color_infrared_rig
from depthcli.methods.kinect.config import RefineKinectConfig
from depthcli.run.resources import available_memory, check_memory

Image = NDArray[Any]


def depth_camera(
    intrinsics: Sequence[float] | None, depth_to_color: tuple[ArrayLike, ArrayLike] | None
) -> tuple[Intrinsics | None, Place | None]:
    """Return the depth camera and its place, if given; InputError where they are not the numbers of such."""
    camera = None if intrinsics is None else Intrinsics(*numbers(list(intrinsics), "depth_intrinsics", (4,)).tolist())
    if depth_to_color is None:
        return camera, None
    if len(depth_to_color) != 2:
        raise InputError(f"depth_to_color: want rotation and translation (got {len(depth_to_color)} parts)")
    rotation, translation = (np.ravel(np.asarray(part)).tolist() for part in depth_to_color)
    rotation = numbers(rotation, "depth_to_color: rotation", (9,)).tolist()
    return camera, (tuple(rotation), tuple(numbers(translation, "depth_to_color: translation", (3,)).tolist()))


def rgbd_frame(
    config: RefineKinectConfig,
    color: Any,
    depth: Any,
    fb: float | None,
    depth_camera: tuple[Intrinsics | None, Place | None],
    where: str,
) -> RgbdFrame:
    """Return color and depth of one size; InputError as for :func:`depthcli.refine_depth`, begun with ``where``."""
    measured = as_depth(depth, f"{where}depth", config.depth_scale or MILLIMETERS)
    image = None if color is None else as_color8(color, f"{where}color")
    shape = measured.shape if image is None else (image.shape[0], image.shape[1])
    check_memory(config.pipeline.peak_bytes(shape), available_memory(), f"{shape[1]} x {shape[0]} pixels")
    camera = None if config.intrinsics is None else Intrinsics(*config.intrinsics)
    if image is None:
        camera = camera or depth_camera[0]
        return RgbdFrame.without_color(measured, fb or sensor_fb(camera), camera)
    with naming(f"{where}depth"):
        found = registered(measured, shape, camera, *depth_camera)
    if found.note:
        warn(f"{where}depth: {found.note}")
    return RgbdFrame(image, found.depth, fb or sensor_fb(camera), camera, found.interpolated)


def color_infrared_pair(
    color: NDArray[np.uint8],
    depth: NDArray[np.float32],
    infrared: Image | None,
    calibration: str | Path | None,
    fb: float | None,
) -> RgbIrFrame:
    """Return the frame with its infrared image; InputError or ConfigError where the calibration does not fit it."""
    if infrared is None:
        raise InputError("this config wants an infrared image: give infrared, or sparse with another preset")
    if (calibration is None) == (fb is None):
        raise ConfigError("an infrared image wants either the calibration of both cameras, or fb of a rectified pair")
    grey = infrared_image(as_image(infrared, "infrared"))
    rig: Any = fb
    if calibration is not None:
        sizes = ((each.shape[1], each.shape[0]) for each in (color, grey))
        rig = read_color_infrared_rig(Path(calibration), *sizes)
    if not isinstance(rig, int | float):
        return RgbIrFrame(color, grey, depth, rig)
    if grey.shape != depth.shape:
        raise InputError("infrared: a rectified pair has one size")
    return RgbIrFrame(color, grey, depth, None, float(rig))

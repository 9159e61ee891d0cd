"""Depth maps of sensors: ``refine_depth`` cleans and completes them, ``complete_transparent`` where they see glass."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from depthcli.api.depth_bounds import depth_bounds
from depthcli.api.inputs import Overrides, as_depth, as_image, as_map, load_config
from depthcli.api.results import PointCloud, Shown
from depthcli.api.saving import Pixels, chosen_pixels, made, write_depth, write_details
from depthcli.core.bound import DepthBound
from depthcli.core.cameras.camera import Intrinsics, typical_intrinsics
from depthcli.core.cameras.color_and_depth import registered
from depthcli.core.cameras.kinect import sensor_fb
from depthcli.core.color_and_infrared import RgbIrFrame
from depthcli.core.depth_config import DepthConfig
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import RgbdFrame, SparseFrame, color8, infrared_image
from depthcli.core.maps import DepthMap, DepthStatus
from depthcli.core.result import Clock, DepthResult
from depthcli.io.formats.calibrations import read_color_infrared_rig
from depthcli.io.formats.depth import MILLIMETERS, beyond_png, sensor_warning
from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.files import collected_warnings, naming
from depthcli.io.formats.plain_text import numbers
from depthcli.kernels.jit import one_at_a_time
from depthcli.methods.kinect.config import RefineKinectConfig
from depthcli.methods.kinect.pipeline import frame_by_frame
from depthcli.methods.transparent.config import TransparentConfig
from depthcli.run.resources import available_memory, check_memory

Image = NDArray[Any]
_Preset = str | Path | RefineKinectConfig


@dataclass(frozen=True, eq=False, repr=False)
class RefinedDepth(Shown, DepthMap):
    """The depth map of a sensor, cleaned and completed.

    ``values`` (H, W) are float32, meters, NaN = no value; ``status`` (H, W) uint8 has bits of :class:`DepthStatus`,
    which ``kept``, ``filled`` and ``corrected`` read.
    """

    color: NDArray[np.uint8]  # (H, W, 3)
    camera: Intrinsics | None  # of the color image; None: not known
    bound: NDArray[np.float32]  # (H, W) of the error, meters: a share ``level`` is not larger; NaN = no value
    probability: NDArray[np.float32]  # (H, W) of an error up to ``within`` meters; 0 where there is no value
    details: DepthResult  # what the method returns beside the map: confidence, tables, pictures, figures
    seconds: Mapping[str, float]  # stage -> time
    scale: float = MILLIMETERS  # codes per meter of depth.png
    rotate: int = 0  # bits that the codes are rotated left by
    cloud: NDArray[np.bool_] | None = None  # (H, W), the pixels that ``save`` writes as points.ply
    warnings: tuple[str, ...] = ()  # what looks wrong, one line each

    @property
    def confidence(self) -> Mapping[str, NDArray[np.float32]]:
        """Name of a measure -> (H, W) float32, higher is surer."""
        return self.details.confidence

    def to_points(
        self,
        mask: Pixels = "all",
        near: float = 0.0,
        far: float = math.inf,
        intrinsics: tuple[float, float, float, float] | None = None,
        max_bound: float = math.inf,
    ) -> PointCloud:
        """Return the colored points of the pixels that ``mask`` chooses, from ``near`` to ``far`` meters.

        The mask is ``all``, ``measured`` (not those that were filled in), or (H, W) bool; ``intrinsics`` are fx, fy,
        cx, cy, pixels, by default those of ``camera``, or of a typical Kinect where that is not known. Points with a
        ``bound`` above ``max_bound`` meters are left out.
        """
        camera = self.camera or typical_intrinsics(self.values.shape[1], self.values.shape[0])
        camera = camera if intrinsics is None else Intrinsics(*intrinsics)
        chosen = chosen_pixels(self, mask)
        chosen = chosen & (self.bound <= max_bound) if max_bound < math.inf else chosen
        return PointCloud.of(self, camera, self.color, chosen, near, far)

    def save(self, folder: str | Path) -> None:
        """Write the files that ``depthcli refine-kinect`` and ``transparent`` write for a scene, with the same bytes.

        The folder is created where it is missing.
        """
        files = made(folder)
        write_depth(self, files, self.scale, self.rotate, self.bound)
        write_pfm(files / "probability.pfm", self.probability)
        if self.cloud is not None:
            self.to_points(self.cloud).save(files / "points.ply")
        write_details(self.details, files)


@overload
def refine_depth(color: Image | None, depth: Image, preset: _Preset = ..., **options: Any) -> RefinedDepth: ...
@overload
def refine_depth(
    color: Sequence[Image], depth: Sequence[Image], preset: _Preset = ..., **options: Any
) -> list[RefinedDepth]: ...
def refine_depth(
    color: Image | Sequence[Image | None] | None,
    depth: Image | Sequence[Image],
    preset: _Preset = "accurate",
    overrides: Overrides | None = None,
    *,
    fb: float | None = None,
    depth_intrinsics: Sequence[float] | None = None,
    depth_to_color: tuple[ArrayLike, ArrayLike] | None = None,
    **fields: object,
) -> RefinedDepth | list[RefinedDepth]:
    """Return the depth map of a Kinect or a sensor like it cleaned and completed, or a list of such maps.

    ConfigError for an unknown preset, or keys and values that do not fit; InputError for arrays that are no images or
    maps, or have no depth, sizes that differ while the cameras are not known, or too little memory.

    Parameters
    ----------
    color : (H, W, 3) RGB or (H, W) grey, as for :func:`depthcli.stereo`; None: there is depth alone, whose gaps are
        filled and noise removed by geometry; or a list of the frames of a sequence
    depth : (H, W), registered to the color image: floats are meters, integers ``depth_scale`` codes a meter; what is
        not a positive number is unknown. A smaller one of the same aspect ratio is scaled. Or a list of as many
    preset : name of a preset of ``depthcli refine-kinect``, path of a YAML file, or a config. ``"sequence"`` carries
        a state along a list; others refine each frame alone
    overrides : config keys -> values, as ``--set`` has them
    fb : focal length x baseline of the sensor, pixel meters; None: by the ``intrinsics``, else that of a Kinect
    depth_intrinsics : fx, fy, cx, cy of the depth camera, pixels of ``depth``, of any size; with ``intrinsics``, those
        of the color camera, the depth is registered to the color image. None: it is registered
    depth_to_color : rotation (3, 3) and translation (3,), meters, from the depth camera's frame to the color camera's;
        None: both are at one place
    **fields : config keys that are Python names, such as ``intrinsics=(fx, fy, cx, cy)`` and ``depth_scale=5000``

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> color = np.full((48, 64, 3), 128, np.uint8)
    >>> measured = np.full((48, 64), 2.0, np.float32)  # a wall at 2 m
    >>> measured[20:24, 20:30] = np.nan
    >>> refined = depthcli.refine_depth(color, measured, preset="nearest")
    >>> bool(np.isnan(refined.values).any()), int(refined.filled.sum())
    (False, 40)
    """
    config = load_config(RefineKinectConfig, preset, overrides, **fields)
    depth_camera = place = None
    if depth_intrinsics is not None:
        depth_camera = Intrinsics(*numbers(list(depth_intrinsics), "depth_intrinsics", (4,)).tolist())
    if depth_to_color is not None:
        if len(depth_to_color) != 2:
            raise InputError(f"depth_to_color: expected rotation and translation (got {len(depth_to_color)} parts)")
        turn, shift = (np.ravel(np.asarray(part)).tolist() for part in depth_to_color)
        rotation = numbers(turn, "depth_to_color: rotation", (9,)).tolist()
        place = tuple(rotation), tuple(numbers(shift, "depth_to_color: translation", (3,)).tolist())
    scale = config.depth_scale or MILLIMETERS
    single = not isinstance(color, list | tuple) and not isinstance(depth, list | tuple)
    colors, depths = ([color], [depth]) if single else (color, depth)
    if colors is None:
        colors = [None] * len(depth)
    if not isinstance(colors, list | tuple) or not isinstance(depths, list | tuple) or len(colors) != len(depths):
        raise InputError("color, depth: give two images, or two lists of as many")
    refine = frame_by_frame(config.pipeline)
    refined: list[RefinedDepth] = []
    for number, (one_color, one_depth) in enumerate(zip(colors, depths, strict=True)):
        where = "" if single else f"frame {number}: "
        with collected_warnings() as lines:
            measured = as_depth(one_depth, f"{where}depth", scale)
        image = None if one_color is None else color8(as_image(one_color, f"{where}color"))
        height, width = measured.shape if image is None else image.shape[:2]
        if refined and (height, width) != refined[0].values.shape:
            first_height, first_width = refined[0].values.shape
            raise InputError(f"frame {number}: {width} x {height}, but frame 0 is {first_width} x {first_height}")
        check_memory(config.peak_bytes((height, width)), available_memory(), f"{width} x {height} pixels")
        camera = None if config.intrinsics is None else Intrinsics(*config.intrinsics)
        if image is None:
            camera = camera or depth_camera
            frame = RgbdFrame.without_color(measured, fb or sensor_fb(camera), camera)
        else:
            with naming(f"{where}depth"):
                found = registered(measured, (height, width), camera, depth_camera, place)
            lines += [f"{where}depth: {found.note}"] if found.note else []
            frame = RgbdFrame(image, found.depth, fb or sensor_fb(camera), camera, found.interpolated)
        if np.asarray(one_depth).dtype.kind != "f" and (text := sensor_warning(f"{where}depth", frame.depth, scale)):
            lines.append(text)
        with one_at_a_time():
            result = refined_frame(config, frame, refine, Clock(), scale)
        refined.append(replace(result, warnings=(*lines, *result.warnings)))
    return refined[0] if single else refined


def complete_transparent(
    color: Image,
    depth: Image,
    sparse: Image | None = None,
    preset: str | Path | TransparentConfig | None = None,
    overrides: Overrides | None = None,
    *,
    sparse_confidence: Image | None = None,
    objects: Image | None = None,
    infrared: Image | None = None,
    calibration: str | Path | None = None,
    fb: float | None = None,
    **fields: object,
) -> RefinedDepth:
    """Return depth completed at transparent objects, from sparse depth or stereo of the color and an infrared image.

    ConfigError for an unknown preset, or keys and values that do not fit; InputError for arrays that are no images or
    maps, or differ in size, where what the preset needs is missing, or with too little memory.

    Parameters
    ----------
    color, depth : as for :func:`depthcli.refine_depth`
    sparse : (H, W), a second measurement in the same unit, known at some pixels
    preset : name of a preset of ``depthcli transparent``, path of a YAML file, or a config; None: ``"sparse"`` where
        ``sparse`` is given, ``"sensor"`` where ``objects`` are, else ``"kinect"``
    overrides : config keys -> values, as ``--set`` has them
    sparse_confidence : (H, W) floats, higher is surer; None: all alike
    objects : (H, W), not 0 at transparent objects, for ``"sensor"``, which continues what surrounds them
    infrared : (h, w) grey image of a second camera, for presets with stereo
    calibration : file of both cameras, JSON or OpenCV's YAML; None: the images are a rectified pair
    fb : focal length x baseline of the rectified pair, pixel meters; with ``sparse``, that of the sensor
    **fields : config keys that are Python names, such as ``depth_scale=4000``

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> color = np.full((48, 64, 3), 128, np.uint8)
    >>> measured = np.full((48, 64), 1.0, np.float32)
    >>> color[16:32, 16:32], measured[16:32, 16:32] = 90, np.nan  # glass that the sensor does not see
    >>> sparse = np.full((48, 64), np.nan, np.float32)
    >>> sparse[16:32:3, 16:32:3] = 0.8
    >>> completed = depthcli.complete_transparent(color, measured, sparse)
    >>> round(float(completed.values[24, 24]), 1)
    0.8
    """
    default = "sparse" if sparse is not None else "kinect" if objects is None else "sensor"
    chosen = preset if preset is not None else default
    config = load_config(TransparentConfig, chosen, overrides, **fields)
    scale = config.depth_scale or MILLIMETERS
    image = color8(as_image(color, "color"))
    height, width = image.shape[:2]
    with collected_warnings() as lines:
        measured = as_depth(depth, "depth", scale, (height, width))
        second = None if sparse is None or config.stereo else as_depth(sparse, "sparse", scale, measured.shape)
    camera = None if config.intrinsics is None else Intrinsics(*config.intrinsics)
    frame: SparseFrame | RgbIrFrame
    if config.stereo is None and config.pipeline.needs == "objects":
        if objects is None:
            raise InputError("this config needs a mask of the transparent objects: give objects")
        inside, nothing = as_map(objects, "objects", measured.shape) != 0, np.full_like(measured, np.nan)
        if not (np.isfinite(measured) & ~inside).any():
            raise InputError("objects: no pixel outside of them has a depth")
        frame = SparseFrame(image, measured, fb or sensor_fb(camera), camera, sparse=nothing, objects=inside)
    elif config.stereo is None:
        if second is None:
            raise InputError("this config needs sparse depth: give sparse, or a preset with stereo")
        surer = None if sparse_confidence is None else as_map(sparse_confidence, "sparse_confidence", second.shape)
        frame = SparseFrame(image, measured, fb or sensor_fb(None), camera, sparse=second, sparse_confidence=surer)
    else:
        if infrared is None:
            raise InputError("this config needs an infrared image: give infrared, or sparse with another preset")
        if (calibration is None) == (fb is None):
            both = "the calibration of both cameras, or fb of a rectified pair"
            raise ConfigError(f"an infrared image needs either {both}")
        grey, rig = infrared_image(as_image(infrared, "infrared")), None
        if calibration is not None:
            found = read_color_infrared_rig(Path(calibration), (width, height), (grey.shape[1], grey.shape[0]))
            rig, fb = (None, found) if isinstance(found, int | float) else (found, None)
        if rig is None and grey.shape != measured.shape:
            raise InputError("infrared: a rectified pair has one size")
        frame = RgbIrFrame(image, grey, measured, rig, fb or 1.0)
    with one_at_a_time():
        completed = completed_frame(config, frame, Clock(), scale, available_memory())[1]
    return replace(completed, warnings=(*lines, *completed.warnings))


def refined_frame(
    config: RefineKinectConfig,
    frame: RgbdFrame,
    refine: Callable[[RgbdFrame], DepthResult],
    clock: Clock,
    scale: float,
    rotate: int = 0,
) -> RefinedDepth:
    """Return a refined frame; ``refine`` is the config's pipeline, or that for the next frame of a sequence.

    ``clock`` books the stages, and ``other``; ``scale`` and ``rotate`` are of the codes that are written.
    """
    found = _refined(refine, frame, config.bound, clock, scale, rotate)
    return _with_cloud(config, found, found.confidence or {"bound": -found.bound})


def completed_frame(
    config: TransparentConfig, given: SparseFrame | RgbIrFrame, clock: Clock, scale: float, memory: int, rotate: int = 0
) -> tuple[SparseFrame, RefinedDepth]:
    """Return a frame with sparse depth, by stereo of color and infrared where it is not given, and it completed.

    InputError where ``memory`` bytes do not suffice.
    """
    shape, stereo = (given.depth.shape[0], given.depth.shape[1]), config.stereo
    need = max(each.peak_bytes(shape) for each in (config.pipeline, stereo) if each is not None)
    check_memory(need, memory, f"{shape[1]} x {shape[0]} pixels")
    figures: dict[str, float] | None = None
    if isinstance(given, SparseFrame):
        frame = given
    else:
        assert stereo is not None
        frame, figures = stereo(given, clock)
    found = _refined(config.pipeline, frame, config.bound, clock, scale, rotate)
    camera = found.camera if config.intrinsics is None else Intrinsics(*config.intrinsics)
    found = _with_cloud(config, replace(found, camera=camera), {"bound": -found.bound})
    if frame.objects is not None:
        text = "inside the mask is the depth of the surroundings, not of the objects: nothing measured it"
        found = replace(found, warnings=(text, *found.warnings))
    if figures is None:
        return frame, found
    with np.errstate(invalid="ignore"):
        codes = np.nan_to_num(np.rint(frame.sparse * scale), nan=0.0)
    found.details.figures |= figures
    found.details.pictures["stereo"] = np.where(codes <= 65535, codes, 0).astype(np.uint16)
    if frame.sparse_confidence is not None:
        found.details.confidence["stereo"] = frame.sparse_confidence
    return frame, found


def _with_cloud(config: DepthConfig, found: RefinedDepth, maps: Mapping[str, NDArray[np.float32]]) -> RefinedDepth:
    """Return a map with the pixels of its cloud, if there is to be one; ``maps``: of ``confident:0.8``."""
    if not config.ply:
        return found
    chosen = chosen_pixels(found, config.mask, maps) & (found.values >= config.near) & (found.values <= config.far)
    return replace(found, cloud=chosen if config.max_bound is None else chosen & (found.bound <= config.max_bound))


def _refined(
    refine: Callable[[Any], DepthResult],
    frame: RgbdFrame,
    promise: DepthBound,
    clock: Clock,
    scale: float,
    rotate: int,
) -> RefinedDepth:
    clock.start("other")
    result = refine(frame)
    clock.include(result.seconds)
    clock.start("bound")
    bound, probability = depth_bounds(frame, result.depth, promise)
    found = result.depth
    if frame.interpolated:
        found.status[found.kept] |= np.uint8(DepthStatus.SMOOTHED)
    _, beyond = beyond_png(found.values, scale)
    warnings = (f"{beyond}; see depth_scale",) if beyond else ()
    camera, seconds = frame.intrinsics, dict(clock.seconds)
    return RefinedDepth(
        found.values,
        found.status,
        frame.color,
        camera,
        bound,
        probability,
        result,
        seconds,
        scale,
        rotate,
        warnings=warnings,
    )

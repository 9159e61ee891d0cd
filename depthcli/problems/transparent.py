"""Complete the depth of transparent objects: ``transparent`` and ``complete_transparent``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.cameras.camera import Intrinsics, sensor_fb
from depthcli.core.color_and_infrared import RgbIrFrame
from depthcli.core.context import Context
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import SparseFrame, infrared_image
from depthcli.core.maps import DepthStatus, Floats
from depthcli.io.formats.calibrations import read_color_infrared_rig
from depthcli.io.formats.depth import MILLIMETERS
from depthcli.io.formats.files import collected_warnings
from depthcli.io.rgbd_frames import (
    TRANSPARENT,
    check_center,
    frame_size,
    load_infrared_frame,
    load_masked_frame,
    load_sparse_frame,
)
from depthcli.io.scenes import RgbdScene, RgbIrScene
from depthcli.methods.transparent.cross_modal import CrossModal
from depthcli.methods.transparent.pipeline import Pipeline
from depthcli.problems.frames import DepthConfig, DepthProblem, FrameInputs, RefinedDepth
from depthcli.problems.inputs import Overrides, as_color8, as_depth, as_image, as_map, load_config
from depthcli.problems.problem import DEPTH_FILES, Shown
from depthcli.run.job import available_memory, check_memory
from depthcli.show.table import SIZE, Row, number, percent, share
from depthcli.show.view import DEPTH_STATUS_PALETTE

Image = NDArray[Any]


class TransparentConfig(DepthConfig):
    """A pipeline with its parameters."""

    command: ClassVar[str] = "transparent"

    pipeline: Pipeline = Field(description="the data flow from sensor and sparse depth to a dense map")
    stereo: CrossModal | None = Field(
        None, description="stereo of color and infrared for the sparse depth; null: a file has it"
    )


@dataclass(frozen=True)
class Transparent(DepthProblem[RgbdScene, TransparentConfig]):
    """Compute dense depth of frames with transparent objects."""

    command = "transparent"
    model = TransparentConfig
    writes = (*DEPTH_FILES, "probability.pfm", "confidence_*", "unreliable.png", "stereo.png")
    shown = Shown(
        (
            SIZE,
            *map(percent, ("known", "sparse", "kept", "filled", "replaced", "from_stereo")),
            number("median_bound", "{:.3g} m"),
        ),
        palette=DEPTH_STATUS_PALETTE,
        legend=(
            0,
            DepthStatus.GAP_FILLED,
            DepthStatus.CORRECTED,
            DepthStatus.GAP_FILLED | DepthStatus.SAMPLED,
            DepthStatus.CORRECTED | DepthStatus.SAMPLED,
            DepthStatus.EMPTY,
        ),
        protocol="depth",
    )

    def files(self, scene: RgbdScene) -> dict[str, Path]:
        """Return role -> file for the frame, and for its sparse depth or mask if the config uses them."""
        sparse = {"sparse": scene.sparse, "sparse_confidence": scene.sparse_confidence}
        if self.by_mask:
            sparse = {"objects": scene.masks.get(TRANSPARENT)}
        given = {role: file for role, file in sparse.items() if file is not None and self.config.stereo is None}
        return scene.input_files | given

    @property
    def by_mask(self) -> bool:
        """True if the mask of objects is an input."""
        return self.config.stereo is None and self.config.pipeline.needs == "objects"

    def truth_scenes(self, scenes: Sequence[RgbdScene]) -> Sequence[RgbdScene]:
        """Return the frames, without the source of sparse depth if it is not used."""
        read = self.config.stereo is None and not self.by_mask
        scenes = [scene.with_scale(self.config.depth_scale) for scene in scenes]
        return scenes if read else [replace(scene, sparse_source="") for scene in scenes]

    def settings(self, scene: RgbdScene) -> dict[str, str]:
        """Return the scale of the depth, and the largest disparity of the color and infrared images."""
        scale, top = scene.with_scale(self.config.depth_scale).depth_scale, getattr(scene, "max_disparity", None)
        found = {"depth_scale": str(scale or MILLIMETERS), "max_disparity": str(top)}
        return found | ({"camera": str(scene.intrinsics)} if self.config.ply else {})

    def memory(self, scene: RgbdScene) -> int:
        """Return an estimate of the peak memory, in bytes, without matching color and infrared."""
        return self.config.pipeline.peak_bytes(frame_size(scene))

    def memory_bound(self, scene: RgbdScene) -> int | None:
        """Return the estimate, or None if color and infrared are matched."""
        return self.memory(scene) if self.config.stereo is None else None

    def load(self, scene: RgbdScene, context: Context) -> FrameInputs:
        """Return a scene's frame with its sparse depth, mask of objects, or infrared image."""
        context.clock.start("load")
        config, stereo = self.config, self.config.stereo
        intrinsics = config.intrinsics or scene.intrinsics
        scene = replace(scene, intrinsics=intrinsics).with_scale(config.depth_scale)
        frame: SparseFrame | RgbIrFrame
        if self.by_mask:
            frame = load_masked_frame(scene)
        elif stereo is None:
            frame = load_sparse_frame(scene)
        elif not isinstance(scene, RgbIrScene):
            raise InputError(f"{scene.folder}: {scene.name} has no infrared image (ir.*), which this config needs")
        else:
            frame = load_infrared_frame(scene)
            if stereo.max_disparity is None and scene.max_disparity is not None:
                stereo = stereo.model_copy(update={"max_disparity": scene.max_disparity})
        camera = None if intrinsics is None else Intrinsics(*intrinsics)
        coding = scene.depth_scale or MILLIMETERS, 3 if scene.rotated else 0
        return FrameInputs(frame, *coding, stereo=stereo, camera=camera)

    def solve(self, inputs: FrameInputs, context: Context) -> RefinedDepth:
        """Match color and infrared if the config has stereo, and complete the frame.

        Raise InputError if there is not enough memory.
        """
        config, stereo, frame = self.config, inputs.stereo, inputs.frame
        shape = frame.depth.shape[0], frame.depth.shape[1]
        need = max(part.peak_bytes(shape) for part in (config.pipeline, stereo) if part is not None)
        check_memory(need, context.memory, f"{shape[1]} x {shape[0]} pixels")
        figures: dict[str, float] | None = None
        if isinstance(frame, RgbIrFrame):
            assert stereo is not None
            frame, figures = stereo(frame, context.clock)
        assert isinstance(frame, SparseFrame)
        depth = self.refined(config.pipeline, frame, inputs, context)
        if figures is not None:
            with np.errstate(invalid="ignore"):
                codes = np.nan_to_num(np.rint(frame.sparse * inputs.scale), nan=0.0)
            depth.details.figures |= figures
            depth.details.pictures["stereo"] = np.where(codes <= 65535, codes, 0).astype(np.uint16)
            if frame.sparse_confidence is not None:
                depth.details.confidence["stereo"] = frame.sparse_confidence
        if frame.objects is None:
            return depth
        text = "inside the mask is the depth of the surroundings, not of the objects: nothing measured it"
        return replace(depth, warnings=(text, *depth.warnings))

    def shares(self, result: RefinedDepth) -> Row:
        """Return the shares of pixels by source of depth."""
        assert isinstance(result.frame, SparseFrame)
        return {
            "sparse": share(np.isfinite(result.frame.sparse)),
            "kept": share(result.kept),
            "filled": share((result.status & DepthStatus.GAP_FILLED) != 0),
            "replaced": share(result.corrected),
            "from_stereo": share((result.status & DepthStatus.SAMPLED) != 0),
        }


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
    """Return depth completed at transparent objects, from sparse depth, a mask, or stereo of color and infrared.

    Raise ConfigError for an unknown preset, unknown keys or invalid values; raise InputError for arrays that are no
    images or maps or differ in size, missing inputs of the preset, or too little memory.

    Parameters
    ----------
    color, depth : as for :func:`depthcli.refine_depth`
    sparse : (H, W), a second measurement in the same unit, known at some pixels
    preset : name of a preset of ``depthcli transparent``, path of a YAML file, or a config; None: ``"sparse"`` with
        ``sparse``, ``"sensor"`` with ``objects``, otherwise ``"kinect"``
    overrides : config keys -> values, as in ``--set``
    sparse_confidence : (H, W) floats, higher is more certain; None: all pixels are equal
    objects : (H, W), not 0 at transparent objects, for ``"sensor"``, which continues their surroundings
    infrared : (h, w) grey image of a second camera, for presets with stereo
    calibration : file of both cameras, JSON or OpenCV's YAML; None: the images are a rectified pair
    fb : focal length x baseline of the rectified pair, pixel meters; with ``sparse``, the sensor's
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
    with collected_warnings() as lines:
        image = as_color8(color, "color")
        height, width = image.shape[:2]
        measured = as_depth(depth, "depth", config.depth_scale, (height, width))
        floats = np.asarray(depth).dtype.kind == "f"  # if the sensor has codes, sparse floats are meters
        second = None
        if sparse is not None and not config.stereo:
            second = as_depth(sparse, "sparse", config.depth_scale, measured.shape, floats)
        camera = config.camera
        check_center("intrinsics", camera, measured.shape)
    problem = Transparent(config)
    frame: SparseFrame | RgbIrFrame
    if problem.by_mask:
        frame = _masked_frame(image, measured, fb or sensor_fb(camera), camera, objects)
    elif config.stereo is None:
        frame = _sparse_frame(image, measured, fb or sensor_fb(None), camera, second, sparse_confidence)
    else:
        frame = _infrared_frame(image, measured, infrared, calibration, fb)
    inputs = FrameInputs(frame, scale, stereo=config.stereo, camera=camera)
    completed = problem.solve(inputs, Context(available_memory()))
    return replace(completed, warnings=(*lines, *completed.warnings))


def _masked_frame(
    color: NDArray[np.uint8], measured: Floats, fb: float, camera: Intrinsics | None, objects: Image | None
) -> SparseFrame:
    """Return the frame with a mask of its objects and no sparse depth. Raise InputError for an unusable mask."""
    if objects is None:
        raise InputError("this config needs a mask of the transparent objects: give objects")
    inside = np.nan_to_num(as_map(objects, "objects", measured.shape)) != 0
    if not inside.any():
        raise InputError("objects: no pixel is inside the mask")
    nothing = np.full_like(measured, np.nan)
    if not (np.isfinite(measured) & ~inside).any():
        raise InputError("objects: no pixel outside of them has a depth")
    return SparseFrame(color, measured, fb, camera, sparse=nothing, objects=inside)


def _sparse_frame(
    color: NDArray[np.uint8],
    measured: Floats,
    fb: float,
    camera: Intrinsics | None,
    sparse: Floats | None,
    confidence: Image | None,
) -> SparseFrame:
    """Return the frame with its sparse depth, meters. Raise InputError without sparse depth."""
    if sparse is None:
        raise InputError("this config needs sparse depth: give sparse, or a preset with stereo")
    surer = None if confidence is None else as_map(confidence, "sparse_confidence", sparse.shape)
    return SparseFrame(color, measured, fb, camera, sparse=sparse, sparse_confidence=surer)


def _infrared_frame(
    color: NDArray[np.uint8],
    measured: Floats,
    infrared: Image | None,
    calibration: str | Path | None,
    fb: float | None,
) -> RgbIrFrame:
    """Return the frame with its infrared image, and the cameras of a calibration or ``fb`` of a rectified pair.

    Raise InputError without an infrared image or for one of another size, ConfigError for both or none of the cameras.
    """
    if infrared is None:
        raise InputError("this config needs an infrared image: give infrared, or sparse with another preset")
    if (calibration is None) == (fb is None):
        both = "the calibration of both cameras, or fb of a rectified pair"
        raise ConfigError(f"an infrared image needs either {both}")
    height, width = measured.shape
    grey, rig = infrared_image(as_image(infrared, "infrared")), None
    if calibration is not None:
        found = read_color_infrared_rig(Path(calibration), (width, height), (grey.shape[1], grey.shape[0]))
        rig, fb = (None, found) if isinstance(found, int | float) else (found, None)
    if rig is None and grey.shape != measured.shape:
        raise InputError("infrared: a rectified pair has one size")
    return RgbIrFrame(color, grey, measured, rig, fb or 1.0)

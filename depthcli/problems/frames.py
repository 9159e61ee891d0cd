"""Common parts of ``refine-kinect`` and ``transparent``, which refine the depth of sensors."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.bound import DepthBound
from depthcli.core.cameras.camera import Intrinsics, typical_intrinsics
from depthcli.core.color_and_infrared import RgbIrFrame
from depthcli.core.context import Context
from depthcli.core.frames import RgbdFrame, SparseFrame
from depthcli.core.maps import DepthMap, Floats, without_smoothed
from depthcli.core.method import RootConfig
from depthcli.core.result import DepthResult
from depthcli.io.formats.depth import MILLIMETERS, beyond_png
from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.files import made
from depthcli.io.formats.networks import network_path, read_errors, read_network, read_numbers
from depthcli.io.rgbd_frames import check_center
from depthcli.io.scenes.frames import FRAMES
from depthcli.methods.kinect.bounds import DepthErrors
from depthcli.methods.kinect.bounds import depth_bounds as kinect_bounds
from depthcli.methods.transparent.bounds import KINDS, GlassErrors, glass_bounds
from depthcli.methods.transparent.cross_modal import CrossModal
from depthcli.problems.problem import Inputs, Problem
from depthcli.problems.results import (
    MapRepr,
    Pixels,
    PointCloud,
    check_limits,
    cloud_pixels,
    empty_cloud,
    mask_parts,
    write_depth,
    write_details,
)
from depthcli.run.console import Reporter
from depthcli.run.job import SceneT
from depthcli.show.table import Row, median, share, size_of


class DepthConfig(RootConfig):
    """Options for reading depth, its error bounds, and point clouds."""

    depth_scale: float | None = Field(
        None, gt=0, le=1e6, description="codes per meter in the files; null: from the layout"
    )
    intrinsics: tuple[float, float, float, float] | None = Field(
        None, description="fx, fy, cx, cy of the color camera, pixels; null: from the layout"
    )
    mask: str = Field(
        "measured",
        description="pixels of point clouds: measured, all, or confident:0.8, the most certain 80 % of the measured",
    )
    near: float = Field(0.0, ge=0, description="smallest depth of points in clouds, meters")
    far: float = Field(1000.0, gt=0, description="largest depth of points in clouds, meters")
    max_bound: float | None = Field(None, ge=0, description="largest bound of points in clouds, meters; null: any")
    ply: bool = Field(False, description="write a colored point cloud of every frame, too")
    bound: DepthBound = Field(DepthBound(), description="error bound, and probability of a small error")

    @property
    def camera(self) -> Intrinsics | None:
        """The color camera, if it is given."""
        return None if self.intrinsics is None else Intrinsics(*self.intrinsics)


@dataclass(frozen=True, eq=False, repr=False)
class RefinedDepth(MapRepr, DepthMap):
    """A sensor's depth map, cleaned and completed.

    ``values`` (H, W) are float32, meters, NaN = no value; ``status`` (H, W) uint8 has bits of :class:`DepthStatus`,
    which ``kept``, ``filled`` and ``corrected`` read.
    """

    frame: RgbdFrame  # color image, measured depth, and sparse depth if any
    camera: Intrinsics | None  # of the color image; None: unknown
    bound: NDArray[np.float32]  # (H, W) error bound, meters: a share ``level`` of errors is within it; NaN = no value
    probability: NDArray[np.float32]  # (H, W) probability of an error up to ``within`` meters; 0 if there is no value
    details: DepthResult  # the method's further results: confidence, tables, pictures, figures
    seconds: Mapping[str, float]  # stage -> time
    scale: float = MILLIMETERS  # codes per meter of depth.png
    rotate: int = 0  # bits by which the codes are rotated left
    cloud: NDArray[np.bool_] | None = None  # (H, W), the pixels that ``save`` writes to points.ply
    warnings: tuple[str, ...] = ()  # one line per warning

    @property
    def color(self) -> NDArray[np.uint8]:
        """The color image, (H, W, 3)."""
        return self.frame.color

    @property
    def confidence(self) -> Mapping[str, NDArray[np.float32]]:
        """Name of a measure -> (H, W) float32, higher is more certain."""
        return self.details.confidence

    def to_points(
        self,
        mask: Pixels = "measured",
        near: float = 0.0,
        far: float = math.inf,
        intrinsics: tuple[float, float, float, float] | None = None,
        max_bound: float = math.inf,
    ) -> PointCloud:
        """Return the colored points of the pixels that ``mask`` selects, from ``near`` to ``far`` meters.

        The mask is ``measured`` (not filled in or corrected), ``all``, or (H, W) bool. ``intrinsics`` are fx, fy, cx,
        cy, pixels; the default is ``camera``, or a typical Kinect if it is unknown. Points with a ``bound`` above
        ``max_bound`` meters are left out.
        """
        camera = self.camera or typical_intrinsics(self.values.shape[1], self.values.shape[0])
        if intrinsics is not None:
            camera = Intrinsics(*intrinsics)
            check_center("intrinsics", camera, self.values.shape)
        return PointCloud.of(self, camera, self.color, cloud_pixels(self, self.bound, mask, near, far, max_bound))

    def save(self, folder: str | Path) -> None:
        """Write the same files as ``depthcli refine-kinect`` and ``transparent``; create the folder if needed."""
        files = made(folder)
        write_depth(self, files, self.scale, self.rotate, self.bound)
        write_pfm(files / "probability.pfm", self.probability)
        if self.cloud is not None:
            self.to_points(self.cloud).save(files / "points.ply")
        write_details(self.details, files)


@dataclass(frozen=True, eq=False)
class FrameInputs(Inputs):
    """A frame with the coding of its depth."""

    frame: RgbdFrame | RgbIrFrame
    scale: float = MILLIMETERS  # codes per meter of depth.png
    rotate: int = 0  # bits by which the codes are rotated left
    registered: str = ""  # how depth and color were registered here; empty: they already were
    stereo: CrossModal | None = None  # matches color and infrared; None: nothing is to be matched
    camera: Intrinsics | None = None  # the color camera, for a frame without one
    warnings: Sequence[str] = ()


ConfigT = TypeVar("ConfigT", bound=DepthConfig)


@dataclass(frozen=True)
class DepthProblem(Problem[SceneT, FrameInputs, RefinedDepth], Generic[SceneT, ConfigT]):
    """Depth of sensors, refined; the commands differ in their inputs and methods."""

    layouts = FRAMES

    config: ConfigT

    @classmethod
    def ready(cls, config: ConfigT) -> Self:
        """Return the problem. Raise ConfigError for wrong options of clouds, before any frame is opened."""
        check_limits(config.near, config.far)
        mask_parts(config.mask)
        return cls(config)

    def units(self, scenes: Sequence[Any], reporter: Reporter) -> Sequence[SceneT]:
        """Return the frames; warn about missing intrinsics if clouds need them."""
        own = [scene for scene in scenes if not (scene.problem or scene.raw)]
        needed = self.config.ply and self.config.intrinsics is None
        if needed and (n_without := sum(frame.intrinsics is None for frame in own)):
            reporter.info(
                f"warning: {n_without} of {len(own)} frames have no intrinsics; point clouds assume a "
                "typical Kinect (fx, fy 525 at a width of 640); see --intrinsics, or meta.json"
            )
        return scenes

    def refined(
        self, refine: Callable[[Any], DepthResult], frame: RgbdFrame, inputs: FrameInputs, context: Context
    ) -> RefinedDepth:
        """Return a frame's refined map with its bound, and the pixels of its cloud if a cloud is written.

        The clock measures the stages; the remaining time is ``other``.
        """
        config, clock = self.config, context.clock
        clock.start("other")
        result = refine(frame)
        clock.include(result.seconds)
        clock.start("bound")
        bound, probability = depth_bounds(frame, result.depth, config.bound)
        values, status = result.depth.values, without_smoothed(result.depth.status)
        _, beyond = beyond_png(values, inputs.scale)
        warnings = (f"{beyond}; see depth_scale",) if beyond else ()
        camera, coding = inputs.camera or frame.intrinsics, (inputs.scale, inputs.rotate)
        seconds = dict(clock.seconds)
        depth = RefinedDepth(
            values, status, frame, camera, bound, probability, result, seconds, *coding, None, warnings
        )
        if not config.ply:
            return depth
        ranked = depth.confidence or {"bound": -bound}
        cloud = cloud_pixels(depth, bound, config.mask, config.near, config.far, config.max_bound, ranked)
        return replace(depth, cloud=cloud, warnings=(*warnings, *empty_cloud(values, cloud)))

    def row(self, inputs: FrameInputs, result: RefinedDepth) -> Row:
        """Return size, shares of pixels by status, the bound, and figures of the method."""
        row: Row = {
            **size_of(result.values),
            "known": share(np.isfinite(result.frame.depth)),
            **self.shares(result),
            "density": share(result.valid),
            "median_bound": median(result.bound),
            **{name: float(value) for name, value in result.details.figures.items()},
            **result.details.words,
        }
        if inputs.registered:
            row["registered"] = inputs.registered
        if result.cloud is not None:
            row["intrinsics"] = "of the camera" if result.camera else "typical"
        return row

    @abstractmethod
    def shares(self, result: RefinedDepth) -> Row:
        """Return the shares of pixels by status."""


@cache
def kinect_errors() -> DepthErrors:
    """Return the package's network and error table for sensor depth."""
    return DepthErrors(read_network(network_path("depth_error")), read_errors("depth_errors"))


@cache
def glass_errors() -> GlassErrors:
    """Return the package's curves and error tables for completed depth."""
    return GlassErrors(read_numbers("glass_curves"), tuple(read_errors(f"glass_{kind}") for kind in KINDS))


def depth_bounds(frame: RgbdFrame, found: DepthMap, promise: DepthBound) -> tuple[Floats, Floats]:
    """Return a map's error bound, meters, NaN = no value, and the probability of errors up to ``promise.within``."""
    if isinstance(frame, SparseFrame):
        return glass_bounds(glass_errors(), frame, found, promise.level, promise.within)
    return kinect_bounds(kinect_errors(), frame, found, promise.level, promise.within)

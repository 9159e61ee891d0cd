"""What a matched pair becomes: a disparity map, its metric depth, and colored points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.api.saving import Pixels, chosen_pixels, made, write_depth, write_details, write_disparity
from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import ConfigError
from depthcli.core.frames import Image, color8
from depthcli.core.maps import DepthMap, DisparityMap, MatchedMap
from depthcli.io.formats.calibrations import read_geometry, write_geometry
from depthcli.io.formats.depth import MILLIMETERS, write_points
from depthcli.io.formats.images import png_bytes, write_png
from depthcli.io.formats.pictures import preview, preview_depth
from depthcli.methods.stereo.search_range import SearchRange
from depthcli.methods.stereo.volume import StereoResult


@dataclass(frozen=True, eq=False, repr=False)
class PointCloud:
    """Points in the frame of a camera: x right, y down, z forward."""

    points: NDArray[np.float32]  # (N, 3), meters
    color: NDArray[np.uint8]  # (N, 3), RGB

    @classmethod
    def of(
        cls,
        found: MatchedMap | DepthMap,
        camera: Intrinsics,
        image: Image,
        mask: Pixels = "all",
        near: float = 0.0,
        far: float = math.inf,
    ) -> PointCloud:
        """Return the points of a depth map's pixels from ``near`` to ``far``, meters, with the colors of its image."""
        chosen = chosen_pixels(found, mask) & found.valid & (found.values >= near) & (found.values <= far)
        return cls(camera.points(found.values, chosen), color8(image)[chosen])

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        return f"PointCloud({len(self)} points)"

    def save(self, path: str | Path) -> None:
        """Write the points as PLY, binary little endian; OutputError where that cannot be."""
        write_points(path, self.points, self.color)


class Shown:
    """How a map in meters shows itself, in the console and in notebooks."""

    values: NDArray[np.float32]

    def _preview(self) -> NDArray[np.uint8]:
        return preview_depth(self.values)

    def _range(self) -> str:
        known = self.values[~np.isnan(self.values)]
        return f"{known.min():.4g} to {known.max():.4g} m" if known.size else "no value"

    def __repr__(self) -> str:
        (height, width), share = self.values.shape, np.mean(~np.isnan(self.values))
        return f"{type(self).__name__}({width} x {height}, {self._range()}, {100 * share:.1f} % with a value)"

    def _repr_png_(self) -> bytes:
        return png_bytes(self._preview())


@dataclass(frozen=True, eq=False, repr=False)
class Depth(Shown, MatchedMap):
    """Metric depth of a disparity map: ``values`` (H, W) float32, meters; ``status``, bits of :class:`Status`."""

    camera: Intrinsics  # the left one
    left: Image
    bound: NDArray[np.float32] | None = None  # of the error, meters, where the disparity map had one

    def to_points(
        self, mask: Pixels = "measured", near: float = 0.0, far: float = math.inf, max_bound: float = math.inf
    ) -> PointCloud:
        """Return the colored points of the pixels that ``mask`` chooses, from ``near`` to ``far`` meters.

        The mask is ``measured``, ``all``, or (H, W) bool. Points with a ``bound`` above ``max_bound`` meters are left
        out; ConfigError where there is no bound.
        """
        chosen = chosen_pixels(self, mask)
        if max_bound < math.inf:
            if self.bound is None:
                raise ConfigError("max_bound: the map has no bound; compute it with bound=True")
            chosen = chosen & (self.bound <= max_bound)
        return PointCloud.of(self, self.camera, self.left, chosen, near, far)

    def save(self, folder: str | Path, scale: float = MILLIMETERS) -> None:
        """Write ``depth.pfm``, ``depth.png`` (``scale`` codes a meter), ``status.png`` and ``preview.png``.

        And ``bound.pfm``, where there is one. ``depthcli depth`` writes the same. The folder is created where it is
        missing.
        """
        write_depth(self, made(folder), scale, bound=self.bound)


@dataclass(frozen=True, eq=False, repr=False)
class Disparity(Shown, DisparityMap):
    """The disparity map of a pair's left view.

    ``values`` (H, W) are float32, pixels, NaN = no value; ``status`` (H, W) uint8 has bits of :class:`Status`, which
    ``measured``, ``filled``, ``occluded`` and ``mismatched`` read.
    """

    left: Image  # the left image, rectified where a calibration was given; not a copy
    search: SearchRange  # the disparities that were searched
    details: StereoResult  # what the method returns beside the map: confidence, tables, pictures, figures
    seconds: Mapping[str, float]  # stage -> time
    warnings: tuple[str, ...] = ()  # what looks wrong, one line each
    key_points: Mapping[str, int] = field(default_factory=dict)  # matches and their range, where an end was "auto"
    geometry: PairGeometry | None = None  # of the rectified views, where a calibration was given
    # Where a bound was asked for, (H, W) float32: of the error, pixels, and the chance of a small error.
    bound: NDArray[np.float32] | None = None
    probability: NDArray[np.float32] | None = None

    @property
    def confidence(self) -> Mapping[str, NDArray[np.float32]]:
        """Name of a measure -> (H, W) float32, higher is surer."""
        return self.details.confidence

    def to_depth(
        self,
        calibration: str | Path | Sequence[str | Path] | None = None,
        *,
        focal: float | None = None,
        baseline: float | None = None,
        doffs: float = 0.0,
        principal_point: tuple[float, float] | None = None,
        mask: Pixels = "all",
    ) -> Depth:
        """Return the metric depth of the map; its ``bound`` is the wider side, behind the value, of that of the map.

        ConfigError for neither or both of file and numbers; InputError for a calibration that cannot be used, or is
        for images of another shape.

        Parameters
        ----------
        calibration : calib.txt of Middlebury, ETH3D or ``depthcli rectify``, KITTI's projections, or a file, or two,
            that ``depthcli rectify`` takes; instead of the numbers below. Neither is needed where the pair was
            rectified by a calibration
        focal, baseline : focal length, pixels, and distance of the cameras, meters
        doffs : x of the right principal point minus that of the left one, pixels
        principal_point : x and y of the left camera's, pixels; None: the center of the image
        mask : ``all``, ``measured``, ``confident:0.8:NAME`` (the surest 80 % of the measured ones, by a measure of
            ``confidence``), or (H, W) bool: the pixels that get a depth

        Examples
        --------
        >>> import depthcli, numpy as np
        >>> left = np.random.default_rng(0).integers(0, 256, (48, 96), np.uint8)
        >>> right = np.roll(left, -8, axis=1)  # all is seen at a disparity of 8 pixels
        >>> depth = depthcli.stereo(left, right, 16, "fast").to_depth(focal=400.0, baseline=0.1)
        >>> float(np.median(depth.values))
        5.0
        """
        height, width = self.values.shape
        geometry = self.geometry
        if focal is not None and baseline is not None:
            x, y = principal_point or ((width - 1) / 2, (height - 1) / 2)
            geometry = None if calibration else PairGeometry(Intrinsics(focal, focal, x, y), baseline, doffs)
        elif calibration is not None:
            files = [calibration] if isinstance(calibration, str | Path) else calibration
            geometry = read_geometry([Path(file) for file in files], size=(width, height))
        if geometry is None:
            raise ConfigError("to_depth needs either a calibration file, or focal (pixels) and baseline (meters)")
        geometry = geometry.for_size(width, height)
        values = np.where(chosen_pixels(self, mask, self.confidence), self.values, np.float32(np.nan))
        bound = None if self.bound is None else geometry.depth_bound(values, self.bound)
        return Depth(geometry.depth(values), self.status, geometry.left, self.left, bound)

    def to_points(
        self, calibration: str | Path | None = None, *, focal: float | None = None, baseline: float | None = None
    ) -> PointCloud:
        """Return the colored points of the measured pixels; as ``to_depth(...).to_points()``, which has more choice."""
        return self.to_depth(calibration, focal=focal, baseline=baseline).to_points()

    def save(self, folder: str | Path) -> None:
        """Write the files that ``depthcli stereo`` and ``fuse`` write for a scene, with the same bytes.

        The folder is created where it is missing.
        """
        files = made(folder)
        write_disparity(self.values, self.status, self._preview(), files, self.bound, self.probability)
        write_details(self.details, files)
        if self.geometry is not None:
            write_png(files / "left.png", self.left)
            write_geometry(files / "calib.txt", self.geometry)

    def _preview(self) -> NDArray[np.uint8]:
        low, high = self.search.min_disparity, self.search.max_disparity
        return preview(self.values - np.float32(low), high - low)

    def _range(self) -> str:
        return f"searched {self.search.min_disparity} to {self.search.max_disparity} px"

"""Results of Python functions: disparity, depth that is made of it, and the refined depth of a sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.api import _save
from depthcli.api.points import PointCloud, chosen_pixels, described, points_of, shown_range
from depthcli.core.cameras.camera import Intrinsics, typical_intrinsics
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import ConfigError
from depthcli.core.frames import Image
from depthcli.core.maps import DepthMap, DisparityMap, MatchedMap
from depthcli.core.result import DepthResult
from depthcli.io.formats.depth import MILLIMETERS
from depthcli.io.formats.images import png_bytes, write_png
from depthcli.io.formats.pair_geometry import read_geometry, write_geometry
from depthcli.io.formats.pictures import preview_depth
from depthcli.methods.stereo.search_range import SearchRange
from depthcli.methods.stereo.volume import StereoResult


@dataclass(frozen=True, eq=False, repr=False)
class Depth(MatchedMap):
    """Metric depth of a disparity map.

    Attributes
    ----------
    values : (H, W) float32, meters, NaN = no value
    status : (H, W) uint8, bits of :class:`Status` of the disparity
    camera : the left camera
    left : its image
    """

    camera: Intrinsics
    left: Image

    def to_points(
        self, mask: str | NDArray[np.bool_] = "measured", near: float = 0.0, far: float = math.inf
    ) -> PointCloud:
        """Return the colored points of the map.

        Parameters
        ----------
        mask : ``measured``, ``all``, or (H, W) bool: the pixels that become points
        near, far : nearest and farthest depth of points, meters
        """
        chosen = chosen_pixels(mask, {"measured": self.measured, "all": self.valid}) & self.valid
        return points_of(self.values, self.camera, self.left, chosen, near, far)

    def save(self, folder: str | Path, scale: float = MILLIMETERS) -> None:
        """Write ``depth.pfm``, ``depth.png``, ``status.png`` and ``preview.png``, as ``depthcli depth`` does.

        Parameters
        ----------
        folder : created where it is missing
        scale : codes per meter of ``depth.png``
        """
        _save.save_metric_depth(self.values, self.status, _save.made(folder), scale)

    def __repr__(self) -> str:
        return described(self, shown_range(self.values, "m"))

    def _repr_png_(self) -> bytes:
        return png_bytes(preview_depth(self.values))


@dataclass(frozen=True, eq=False, repr=False)
class Disparity(DisparityMap):
    """The disparity map of a pair's left view.

    Attributes
    ----------
    values : (H, W) float32, pixels, NaN = no value
    status : (H, W) uint8, bits of :class:`Status`; ``measured``, ``filled``, ``occluded`` and ``mismatched`` read them
    left : the left image, not a copy
    search : the disparities that were searched
    details : what the method returns beside the map: confidence, tables, pictures, figures
    seconds : stage -> time
    warnings : what looks wrong, one line each
    key_points : number of matches, and the range of their disparities, where an end of the range was "auto"; else empty
    geometry : of the rectified views, where a calibration was given; ``left`` is the rectified image then
    """

    left: Image
    search: SearchRange
    details: StereoResult
    seconds: Mapping[str, float]
    warnings: tuple[str, ...] = ()
    key_points: Mapping[str, int] = field(default_factory=dict)
    geometry: PairGeometry | None = None

    @property
    def confidence(self) -> Mapping[str, NDArray[np.float32]]:
        """Name of a measure -> (H, W) float32, higher is surer."""
        return self.details.confidence

    def to_depth(
        self,
        calibration: str | Path | None = None,
        *,
        focal: float | None = None,
        baseline: float | None = None,
        doffs: float = 0.0,
        principal_point: tuple[float, float] | None = None,
        mask: str | NDArray[np.bool_] = "all",
    ) -> Depth:
        """Return the metric depth of the map.

        Parameters
        ----------
        calibration : calib.txt of Middlebury, ETH3D or ``depthcli rectify``, or KITTI's projections; instead of the
            numbers below. Neither is needed where the pair was rectified by a calibration
        focal, baseline : focal length, pixels, and distance of the cameras, meters
        doffs : x of the right principal point minus that of the left one, pixels
        principal_point : x and y of the left camera's, pixels; None: the center of the image
        mask : ``all``, ``measured``, or (H, W) bool: the pixels that get a depth

        Raises
        ------
        ConfigError
            Neither or both of file and numbers.
        InputError
            A calibration that cannot be used, or is for images of another shape.

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
        numbers = focal is not None and baseline is not None
        if (calibration is not None) + numbers > 1 or not (calibration or numbers or self.geometry):
            raise ConfigError("to_depth wants either a calibration file, or focal (pixels) and baseline (meters)")
        if calibration is not None:
            geometry = read_geometry(Path(calibration), (2, 3))
        elif focal is None or baseline is None:
            assert self.geometry is not None
            geometry = self.geometry
        else:
            x, y = principal_point or ((width - 1) / 2, (height - 1) / 2)
            geometry = PairGeometry(Intrinsics(focal, focal, x, y), baseline, doffs)
        geometry = geometry.for_size(width, height)
        kept = chosen_pixels(mask, {"measured": self.measured, "all": self.valid})
        depth = geometry.depth(np.where(kept, self.values, np.float32(np.nan)))
        return Depth(depth, self.status, geometry.left, self.left)

    def to_points(
        self, calibration: str | Path | None = None, *, focal: float | None = None, baseline: float | None = None
    ) -> PointCloud:
        """Return the colored points of the measured pixels; as ``to_depth(...).to_points()``, which has more choice."""
        return self.to_depth(calibration, focal=focal, baseline=baseline).to_points()

    def save(self, folder: str | Path) -> None:
        """Write the files that ``depthcli stereo`` and ``fuse`` write for a scene, with the same bytes.

        Parameters
        ----------
        folder : created where it is missing
        """
        result = replace(self.details, disparity=DisparityMap(self.values, self.status))
        made = _save.made(folder)
        _save.save_stereo(result, made, self.search.min_disparity, self.search.max_disparity)
        if self.geometry is not None:
            write_png(made / "left.png", self.left)
            write_geometry(made / "calib.txt", self.geometry)

    def __repr__(self) -> str:
        return described(self, f"searched {self.search.min_disparity} to {self.search.max_disparity} px")

    def _repr_png_(self) -> bytes:
        return png_bytes(_save.stereo_preview(self.values, self.search.min_disparity, self.search.max_disparity))


@dataclass(frozen=True, eq=False, repr=False)
class RefinedDepth(DepthMap):
    """The depth map of a sensor, cleaned and completed.

    Attributes
    ----------
    values : (H, W) float32, meters, NaN = no value
    status : (H, W) uint8, bits of :class:`DepthStatus`; ``kept``, ``filled`` and ``corrected`` read them
    color : (H, W, 3) uint8, the color image
    camera : of the color image; None: not known
    details : what the method returns beside the map: sigma, confidence, tables, pictures, figures
    seconds : stage -> time
    scale, rotate : codes per meter of ``depth.png``, and bits that they are rotated left by
    cloud : (H, W) bool, the pixels that :meth:`save` writes as ``points.ply``; None: none
    """

    color: NDArray[np.uint8]
    camera: Intrinsics | None
    details: DepthResult
    seconds: Mapping[str, float]
    scale: float = MILLIMETERS
    rotate: int = 0
    cloud: NDArray[np.bool_] | None = None

    @property
    def sigma(self) -> NDArray[np.float32]:
        """(H, W) float32, meters, NaN = none: standard deviation of the values, as the model estimates it."""
        return self.details.sigma

    @property
    def confidence(self) -> Mapping[str, NDArray[np.float32]]:
        """Name of a measure -> (H, W) float32, higher is surer."""
        return self.details.confidence

    def to_points(
        self,
        mask: str | NDArray[np.bool_] = "all",
        near: float = 0.0,
        far: float = math.inf,
        intrinsics: tuple[float, float, float, float] | None = None,
    ) -> PointCloud:
        """Return the colored points of the map.

        Parameters
        ----------
        mask : ``all``, ``measured`` (not those that were filled in), or (H, W) bool: the pixels that become points
        near, far : nearest and farthest depth of points, meters
        intrinsics : fx, fy, cx, cy, pixels; None: those of ``camera``, or of a typical Kinect where that is not known
        """
        camera = self._camera if intrinsics is None else Intrinsics(*intrinsics)
        chosen = chosen_pixels(mask, {"measured": ~self.filled, "all": self.valid}) & self.valid
        return points_of(self.values, camera, self.color, chosen, near, far)

    def save(self, folder: str | Path) -> None:
        """Write the files that ``depthcli refine-kinect`` and ``transparent`` write for a scene, with the same bytes.

        Parameters
        ----------
        folder : created where it is missing
        """
        cloud = None if self.cloud is None else (self._camera, self.color, self.cloud)
        _save.save_depth(self.details, _save.made(folder), self.scale, self.rotate, cloud)

    @property
    def _camera(self) -> Intrinsics:
        return self.camera or typical_intrinsics(self.values.shape[1], self.values.shape[0])

    def __repr__(self) -> str:
        return described(self, shown_range(self.values, "m"))

    def _repr_png_(self) -> bytes:
        return png_bytes(preview_depth(self.values))

"""Results of Python functions: maps with what they know about themselves, depth and point clouds made of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from depthcli.api import _save
from depthcli.core.cameras.camera import Intrinsics, typical_intrinsics
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import Image, color8
from depthcli.core.maps import DepthMap, DisparityMap, MatchedMap
from depthcli.core.result import RefinedDepth as RefinedDepthDetails
from depthcli.data.formats.depth import MILLIMETERS, write_points
from depthcli.data.formats.images import png_bytes
from depthcli.data.formats.pair_geometry import read_geometry
from depthcli.data.formats.pictures import preview_depth
from depthcli.methods.stereo.search_range import SearchRange
from depthcli.methods.stereo.volume import StereoResult


@dataclass(frozen=True, eq=False, repr=False)
class PointCloud:
    """Points in the frame of a camera: x right, y down, z forward.

    Attributes
    ----------
    points : (N, 3) float32, meters
    color : (N, 3) uint8, RGB
    """

    points: NDArray[np.float32]
    color: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        return f"PointCloud({len(self)} points)"

    def save(self, path: str | Path) -> None:
        """Write the points as PLY, binary little endian; OutputError where that cannot be."""
        write_points(path, self.points, self.color)


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
        chosen = _chosen(mask, {"measured": self.measured, "all": self.valid}) & self.valid
        return _points(self.values, self.camera, self.left, chosen, near, far)

    def save(self, folder: str | Path, scale: float = MILLIMETERS) -> None:
        """Write ``depth.pfm``, ``depth.png``, ``status.png`` and ``preview.png``, as ``depthcli depth`` does.

        Parameters
        ----------
        folder : created where it is missing
        scale : codes per meter of ``depth.png``
        """
        _save.save_metric_depth(self.values, self.status, _save.made(folder), scale)

    def __repr__(self) -> str:
        return _described(self, _range(self.values, "m"))

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
    """

    left: Image
    search: SearchRange
    details: StereoResult
    seconds: Mapping[str, float]
    warnings: tuple[str, ...] = ()
    key_points: Mapping[str, int] = field(default_factory=dict)

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
            numbers below
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
        if (calibration is None) == (focal is None or baseline is None):
            raise ConfigError("to_depth wants either a calibration file, or focal (pixels) and baseline (meters)")
        if calibration is not None:
            geometry = read_geometry(Path(calibration), (2, 3))
        else:
            assert focal is not None and baseline is not None
            x, y = principal_point or ((width - 1) / 2, (height - 1) / 2)
            geometry = PairGeometry(Intrinsics(focal, focal, x, y), baseline, doffs)
        geometry = geometry.for_size(width, height)
        kept = _chosen(mask, {"measured": self.measured, "all": self.valid})
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
        _save.save_stereo(result, _save.made(folder), self.search.min_disparity, self.search.max_disparity)

    def __repr__(self) -> str:
        return _described(self, f"searched {self.search.min_disparity} to {self.search.max_disparity} px")

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
    details: RefinedDepthDetails
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

    def to_points(self, mask: str | NDArray[np.bool_] = "all", near: float = 0.0, far: float = math.inf) -> PointCloud:
        """Return the colored points of the map; where the camera is not known, as a typical Kinect sees them.

        Parameters
        ----------
        mask : ``all``, ``measured`` (not those that were filled in), or (H, W) bool: the pixels that become points
        near, far : nearest and farthest depth of points, meters
        """
        chosen = _chosen(mask, {"measured": ~self.filled, "all": self.valid}) & self.valid
        return _points(self.values, self._camera, self.color, chosen, near, far)

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
        return _described(self, _range(self.values, "m"))

    def _repr_png_(self) -> bytes:
        return png_bytes(preview_depth(self.values))


def _chosen(mask: str | ArrayLike, named: Mapping[str, NDArray[np.bool_]]) -> NDArray[np.bool_]:
    if isinstance(mask, str):
        if mask not in named:
            raise ConfigError(f"mask: must be {', '.join(named)}, or an array of bool (got {mask!r})")
        return named[mask]
    pixels, shape = np.asarray(mask), next(iter(named.values())).shape
    if pixels.shape != shape or pixels.dtype != np.bool_:
        raise InputError(f"mask: want bool of shape {shape} (got {pixels.dtype} {pixels.shape})")
    return pixels


def _points(
    depth: NDArray[np.float32],
    camera: Intrinsics,
    image: Image,
    chosen: NDArray[np.bool_],
    near: float,
    far: float,
) -> PointCloud:
    chosen = chosen & (depth >= near) & (depth <= far)
    return PointCloud(camera.points(depth, chosen), color8(image)[chosen])


def _range(values: NDArray[np.float32], unit: str) -> str:
    known = values[np.isfinite(values)]
    return f"{known.min():.4g} to {known.max():.4g} {unit}" if known.size else "no value"


def _described(found: DisparityMap | Depth | DepthMap, text: str) -> str:
    height, width = found.values.shape
    return f"{type(found).__name__}({width} x {height}, {text}, {100 * found.density:.1f} % with a value)"

"""Results of matching: a disparity map, its metric depth and colored points; and the files of results."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import Image, color8
from depthcli.core.maps import DepthMap, DisparityMap, MatchedMap
from depthcli.core.result import Result
from depthcli.io.formats.calibrations import Reading, read_geometry
from depthcli.io.formats.depth import MILLIMETERS, write_depth_png, write_points
from depthcli.io.formats.disparity import write_disparity_png, write_pfm, write_status
from depthcli.io.formats.files import made, warn, write_text
from depthcli.io.formats.images import png_bytes, write_drawn, write_png
from depthcli.methods.stereo.search_range import SearchRange
from depthcli.methods.stereo.volume import StereoResult
from depthcli.problems.rectified import Rectified
from depthcli.show.table import to_csv
from depthcli.show.view import View, draw

Pixels = str | NDArray[np.bool_]
"""Name of a selection of pixels, or (H, W) bool."""
_MASK = re.compile(r"(all|measured)|confident:(0?\.0*[1-9][0-9]*|1(?:\.0*)?)(?::(.+))?")


def write_depth(
    depth: MatchedMap | DepthMap,
    folder: Path,
    scale: float,
    rotate: int = 0,
    bound: NDArray[np.float32] | None = None,
) -> None:
    """Write ``depth.pfm``, ``depth.png``, ``status.png``, ``preview.png`` and, if given, ``bound.pfm``."""
    write_pfm(folder / "depth.pfm", depth.values)
    write_depth_png(folder / "depth.png", depth.values, scale, rotate)
    write_status(folder / "status.png", depth.status)
    _write_preview(folder, View.of_depth(depth.values, bound))


def write_disparity(
    view: View, status: NDArray[np.uint8], folder: Path, probability: NDArray[np.float32] | None = None
) -> None:
    """Write ``disp_left.pfm``, ``disp_left.png``, ``status.png``, ``preview.png``; also any bound and probability."""
    write_pfm(folder / "disp_left.pfm", view.values)
    # The PNG has no codes for negative disparities, which become unknown there.
    write_disparity_png(folder / "disp_left.png", np.where(view.values < 0, np.float32(np.nan), view.values))
    write_status(folder / "status.png", status)
    _write_preview(folder, view)
    if probability is not None:
        write_pfm(folder / "probability.pfm", probability)


def _write_preview(folder: Path, view: View) -> None:
    if view.bound is not None:
        write_pfm(folder / "bound.pfm", view.bound)
    write_drawn(folder / "preview.png", partial(draw, view, "preview"))


def write_details(result: Result, folder: Path) -> None:
    """Write ``confidence_NAME.pfm`` and a picture of each confidence; tables as CSV; pictures as PNG or PFM."""
    for name, confidence in result.confidence.items():
        write_pfm(folder / f"confidence_{name}.pfm", confidence)
        write_drawn(folder / f"confidence_{name}.png", partial(draw, View(confidence), "confidence"))
    for name, rows in result.tables.items():
        write_text(folder / f"{name}.csv", to_csv(rows))
    for name, picture in result.pictures.items():
        if picture.dtype == np.float32:
            write_pfm(folder / f"{name}.pfm", picture)
        else:
            write_png(folder / f"{name}.png", picture)


def mask_parts(text: str) -> tuple[str, float, str]:
    """Return kind, share and name of a mask for :func:`chosen_pixels`. Raise ConfigError for other texts."""
    if match := _MASK.fullmatch(text):
        return match[1] or "confident", float(match[2] or 1), match[3] or ""
    raise ConfigError(f"mask: must be measured, all, or confident:0.8 (got {text!r})")


def chosen_pixels(
    found: MatchedMap | DepthMap, mask: Pixels, confidence: Mapping[str, NDArray[np.float32]] | None = None
) -> NDArray[np.bool_]:
    """Return the pixels of a map that a mask selects, (H, W) bool.

    ``confident:0.8:NAME`` selects the 80 % of measured pixels with the highest confidence; the name is optional if
    there is only one confidence. Raise ConfigError for other texts, and InputError for an array of another shape or
    dtype, an unknown name, or a missing name if there are several confidences.
    """
    if not isinstance(mask, str):
        if np.shape(mask) != found.values.shape or np.asarray(mask).dtype != np.bool_:
            got = f"{np.asarray(mask).dtype} of shape {np.shape(mask)}"
            raise InputError(f"mask: expected bool of shape {found.values.shape}, got {got}")
        return mask
    kind, share, name = mask_parts(mask)
    measured = found.measured
    if kind != "confident":
        return measured if kind == "measured" else found.valid
    maps = confidence or {}
    name = name or (next(iter(maps)) if len(maps) == 1 else "")
    if name not in maps:
        raise InputError(f"mask {mask}: which confidence map? there are: {', '.join(maps) or 'none'}")
    measured &= np.isfinite(maps[name])
    if measured.any():
        measured &= maps[name] >= np.quantile(maps[name][measured], 1 - share, method="higher")
    return measured


def check_limits(near: float, far: float | None) -> None:
    """Raise ConfigError if no depth is between ``--near`` and ``--far``, meters; ``far`` None is no limit."""
    if far is not None and near >= far:
        raise ConfigError(f"--near {near:g}, --far {far:g}: no depth is between them")


def cloud_pixels(
    found: MatchedMap | DepthMap,
    bound: NDArray[np.float32] | None,
    mask: Pixels,
    near: float = 0.0,
    far: float = math.inf,
    max_bound: float | None = None,
    confidence: Mapping[str, NDArray[np.float32]] | None = None,
) -> NDArray[np.bool_]:
    """Return the pixels that become points, (H, W) bool: those of a mask from ``near`` to ``far`` meters.

    If ``max_bound`` is given, they have a bound of at most ``max_bound`` meters. Raise ConfigError if the map has none.
    """
    chosen = chosen_pixels(found, mask, confidence) & (found.values >= near) & (found.values <= far)
    if max_bound is None or max_bound == math.inf:
        return chosen
    if bound is None:
        raise ConfigError("max_bound: the map has no bound; match with --bound, or bound=True")
    return chosen & (bound <= max_bound)


def empty_cloud(depth: NDArray[np.float32], cloud: NDArray[np.bool_]) -> list[str]:
    """Return a warning if no pixel in ``cloud`` has a depth, otherwise an empty list."""
    known = np.isfinite(depth)
    if np.any(known & cloud):
        return []
    if not known.any():
        return ["points.ply has no points: no depth is known"]
    low, high = float(depth[known].min()), float(depth[known].max())
    return [
        f"points.ply has no points, the depths are {low:.3g} to {high:.3g} m; see --near, --far, --mask, --max-bound"
    ]


@dataclass(frozen=True, eq=False, repr=False)
class PointCloud:
    """Points in a camera's frame: x right, y down, z forward."""

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
        """Return the colored points of a depth map's pixels, from ``near`` to ``far`` meters."""
        chosen = chosen_pixels(found, mask) & found.valid & (found.values >= near) & (found.values <= far)
        return cls(camera.points(found.values, chosen), color8(image)[chosen])

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        return f"PointCloud({len(self)} points)"

    def save(self, path: str | Path) -> None:
        """Write the points as binary little-endian PLY. Raise OutputError on failure."""
        write_points(path, self.points, self.color)


class MapRepr:
    """Text and picture of a map in meters, for the console and notebooks."""

    values: NDArray[np.float32]

    def _view(self) -> View:
        return View.of_depth(self.values)

    def _range(self) -> str:
        known = self.values[~np.isnan(self.values)]
        return f"{known.min():.4g} to {known.max():.4g} m" if known.size else "no value"

    def __repr__(self) -> str:
        (height, width), share = self.values.shape, np.mean(~np.isnan(self.values))
        return f"{type(self).__name__}({width} x {height}, {self._range()}, {100 * share:.1f} % with a value)"

    def _repr_png_(self) -> bytes:
        return png_bytes(draw(self._view(), "preview"))


@dataclass(frozen=True, eq=False, repr=False)
class Depth(MapRepr, MatchedMap):
    """Metric depth of a disparity map: ``values`` (H, W) float32, meters; ``status``, bits of :class:`Status`."""

    camera: Intrinsics  # the left camera
    left: Image
    bound: NDArray[np.float32] | None = None  # error bound, meters, if the disparity map has one

    def to_points(
        self, mask: Pixels = "measured", near: float = 0.0, far: float = math.inf, max_bound: float = math.inf
    ) -> PointCloud:
        """Return the colored points of the pixels that ``mask`` selects, from ``near`` to ``far`` meters.

        The mask is ``measured``, ``all``, or (H, W) bool. Points with a ``bound`` above ``max_bound`` meters are left
        out. Raise ConfigError for ``max_bound`` without a bound.
        """
        return PointCloud.of(self, self.camera, self.left, cloud_pixels(self, self.bound, mask, near, far, max_bound))

    def save(self, folder: str | Path, scale: float = MILLIMETERS) -> None:
        """Write the same files as ``depthcli depth``, with ``scale`` codes per meter; create the folder if needed.

        They are ``depth.pfm``, ``depth.png``, ``status.png``, ``preview.png`` and, with a bound, ``bound.pfm``.
        """
        write_depth(self, made(folder), scale, bound=self.bound)


@dataclass(frozen=True, eq=False, repr=False)
class Disparity(MapRepr, DisparityMap):
    """A disparity map of a pair's left view.

    ``values`` (H, W) are float32, pixels, NaN = no value; ``status`` (H, W) uint8 has bits of :class:`Status`, which
    ``measured``, ``filled``, ``occluded`` and ``mismatched`` read.
    """

    left: Image  # the left image, rectified if a calibration was given; not a copy
    search: SearchRange  # the searched disparities
    details: StereoResult  # the method's further results: confidence, tables, pictures, figures
    seconds: Mapping[str, float]  # stage -> time
    warnings: tuple[str, ...] = ()  # one line per warning
    key_points: Mapping[str, int] = field(default_factory=dict)  # matches and their range, if an end was "auto"
    rectified: Rectified | None = None  # the views, if a calibration rectified them
    # If requested, error bound (pixels) and probability of a small error, (H, W) float32.
    bound: NDArray[np.float32] | None = None
    probability: NDArray[np.float32] | None = None

    @property
    def confidence(self) -> Mapping[str, NDArray[np.float32]]:
        """Name of a measure -> (H, W) float32, higher is more certain."""
        return self.details.confidence

    @property
    def geometry(self) -> PairGeometry | None:
        """The cameras of the rectified views, or None without a calibration."""
        return None if self.rectified is None else self.rectified.rig.geometry

    def to_depth(
        self,
        calibration: str | Path | Sequence[str | Path] | None = None,
        *,
        focal: float | None = None,
        baseline: float | None = None,
        doffs: float = 0.0,
        principal_point: tuple[float, float] | None = None,
        mask: Pixels = "all",
        unit: str | None = None,
    ) -> Depth:
        """Return the metric depth of the map. Its ``bound`` is for errors behind the surface, which are larger.

        Raise ConfigError if both or neither of file and numbers are given; raise InputError for a calibration that is
        unusable or for images of another shape.

        Parameters
        ----------
        calibration : calib.txt of Middlebury, ETH3D or ``depthcli rectify``, KITTI's projections, or one or two files
            for ``depthcli rectify``; instead of the numbers below. Neither is needed if a calibration rectified the
            pair
        focal, baseline : focal length, pixels, and distance of the cameras, meters
        doffs : x of the right principal point minus x of the left one, pixels
        principal_point : x and y of the left camera's principal point, pixels; None: the image center
        mask : the pixels that get a depth: ``all``, ``measured``, ``confident:0.8:NAME`` (the 80 % of measured pixels
            with the highest ``confidence``), or (H, W) bool
        unit : unit of lengths in the file: m, cm, mm, or a length such as 24mm; None: the format's unit

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
        if (focal is None) != (baseline is None) or (focal is not None and calibration is not None):
            geometry = None
        elif focal is not None and baseline is not None:
            x, y = principal_point or ((width - 1) / 2, (height - 1) / 2)
            geometry = PairGeometry(Intrinsics(focal, focal, x, y), baseline, doffs)
        elif calibration is not None:
            files = [calibration] if isinstance(calibration, str | Path) else calibration
            geometry = read_geometry([Path(file) for file in files], Reading(unit), (width, height))
        if geometry is None:
            raise ConfigError("to_depth needs either a calibration file, or focal (pixels) and baseline (meters)")
        if doubt := geometry.doubts(width, height):
            warn(f"calibration: {doubt}")
        chosen = chosen_pixels(self, mask, self.confidence)
        return depth_of(self, geometry.for_size(width, height), self.left, chosen, self.bound)

    def to_points(
        self, calibration: str | Path | None = None, *, focal: float | None = None, baseline: float | None = None
    ) -> PointCloud:
        """Return the colored points of measured pixels; ``to_depth(...).to_points()`` has more options."""
        return self.to_depth(calibration, focal=focal, baseline=baseline).to_points()

    def save(self, folder: str | Path) -> None:
        """Write the same files as ``depthcli stereo`` and ``fuse``; create the folder if needed."""
        files = made(folder)
        write_disparity(replace(self._view(), bound=self.bound), self.status, files, self.probability)
        write_details(self.details, files)
        if self.rectified is not None:
            self.rectified.save(files)

    def _view(self) -> View:
        return View(self.values, "px", (self.search.min_disparity, self.search.max_disparity))

    def _range(self) -> str:
        return f"searched {self.search.min_disparity} to {self.search.max_disparity} px"


def depth_of(
    disparity: DisparityMap,
    geometry: PairGeometry,
    left: Image,
    mask: NDArray[np.bool_],
    bound: NDArray[np.float32] | None = None,
) -> Depth:
    """Return the depth of a disparity map's pixels in ``mask``; ``bound`` is its error bound, pixels."""
    values = np.where(mask, disparity.values, np.float32(np.nan))
    depth_bound = None if bound is None else geometry.depth_bound(values, bound)
    return Depth(geometry.depth(values), disparity.status, geometry.left, left, depth_bound)

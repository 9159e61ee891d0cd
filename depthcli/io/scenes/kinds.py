"""Scenes, the units that a command works on: names of files that belong together, and metadata.

Of the files only masks are loaded here; ``input_files`` looks into headers for further files. ``stereo_pairs``,
``rgbd_frames`` and ``volume_pairs`` load the others.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Place
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import InputError
from depthcli.io.formats.disparity import read_disparity, read_mask
from depthcli.io.formats.files import shown, warn
from depthcli.io.formats.volumes import transform_files, volume_files

MAX_DISPARITY = 1 << 20
"""Largest absolute disparity that a file may request, pixels; no image is as wide."""

LEFT_OUT = {"displacement": "transform", "transform": "displacement", "both": ""}
"""Value of ``apply`` -> file to ignore; ``both`` applies the displacement field first, as ANTs does."""

LEFT_RIGHT, TOP_BOTTOM, FRAMES = "left-right", "top-bottom", "frames"
"""How one file holds both views: as halves, or as the two images of an MPO file."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """The base class of all scenes; an instance of this class itself is a folder that cannot be used."""

    name: str  # unique in its listing; ``<data set>/<scene>`` if the scene is in a data set's folder
    folder: Path  # folder of the scene
    layout: str = ""  # name of its layout; empty for files named on the command line
    protocol: str = ""  # name of the evaluation protocol of its ground truth
    problem: str = ""  # why the scene cannot be used, or empty
    warnings: tuple[str, ...] = field(default=(), compare=False)  # one line about each doubtful file
    invalid: float | None = None  # value of unknown pixels in the ground truth; None: recognized, NaN: no such value

    roles: ClassVar[tuple[str, ...]] = ()  # fields of files that a method may read
    truth_role: ClassVar[str] = ""  # field of the ground truth

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file that a method may read; ground truth is not among them."""
        return {role: file for role in self.roles if (file := getattr(self, role)) is not None}

    @property
    def has_truth(self) -> bool:
        """True if the scene has ground truth to compare with."""
        return bool(self.truth_role) and getattr(self, self.truth_role) is not None

    @property
    def lacks_for_truth(self) -> str:
        """Return a message about files that the ground truth still needs, or an empty text."""
        return ""

    def check(self) -> None:
        """Raise InputError if the scene has a problem."""
        if self.problem:
            raise InputError(self.problem)


@dataclass(frozen=True, kw_only=True)
class StereoScene(Scene):
    """The files of a stereo pair, or of one view with its ground truth."""

    left: Path  # image, or video
    right: Path | None = None
    frame_number: int | None = None  # frame of the two videos, from 0; None: ``left`` and ``right`` are images
    # How ``left``, the same file as ``right``, holds both views: left-right, top-bottom or, of MPO, frames; "": one.
    halves: str = ""
    disparity_left: Path | None = None  # ground truth
    disparity_right: Path | None = None
    disparity_noc: Path | None = None  # ground truth of visible pixels only (KITTI)
    disparity_scale: float | None = None  # codes per pixel of the ground truth; None: by the file's format
    scale_by_width: bool = False  # compute the scale from the map's width (Middlebury 2005 and 2006)
    masks: dict[str, Path] = field(default_factory=dict, hash=False)  # name -> mask of the pixels to evaluate
    occluded: Path | None = None  # mask of pixels hidden in the right view (> 0); ``nonocc`` are the others
    ignored: Path | None = None  # mask of pixels to ignore (> 0); ``all`` are the others
    objects: Path | None = None  # KITTI 2015 object map (> 0: foreground)
    materials: Path | None = None  # map of the classes 0 to 3, each a mask ``class_<k>`` (Booster)
    # Reads a ground truth map, given its codes per pixel: (H, W) float32, pixels, NaN = unknown.
    decode: Callable[[Path, float | None], NDArray[np.float32]] = read_disparity
    max_disparity: int | None = None  # largest disparity to search, inclusive
    min_disparity: int = 0  # smallest disparity to search
    round_disparity: bool = False  # ground truth is whole pixels: round results before comparison (v3: ``isint``)
    calibration: Path | None = None  # file that converts disparity to depth
    cameras: tuple[int, int] = (2, 3)  # numbers of the left and right camera in a multi-camera calibration (KITTI)
    geometry: PairGeometry | None = None  # converts disparity to depth if there is no calibration file
    # First, middle and last frame of its sequence; empty for a single pair.
    sequence: tuple[StereoScene, ...] = ()

    roles: ClassVar[tuple[str, ...]] = ("left", "right")
    truth_role: ClassVar[str] = "disparity_left"

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file that a method may look at; one file that holds both views is named so."""
        return {f"both views, {self.halves}": self.left} if self.halves else super().input_files

    @property
    def is_first(self) -> bool:
        """True if this is a single pair or the first frame of a sequence."""
        return not self.sequence or self.sequence[0].name == self.name


@dataclass(frozen=True)
class GivenMap:
    """A disparity map of a run."""

    run: str  # name of the run
    path: Path
    scale: float | None = None  # codes per pixel; None: by the file's format
    invalid: float | None = None  # value of invalid pixels; None: recognized
    status: Path | None = None  # status map, if the run has one


@dataclass(frozen=True, kw_only=True)
class MapsScene(StereoScene):
    """A pair with given disparity maps of its left view."""

    pair: StereoScene  # without the maps
    maps: tuple[GivenMap, ...] = ()  # in the order of the command line
    right_map: GivenMap | None = None  # map of the right view
    absent: tuple[str, ...] = ()  # names of the runs without a map of this scene

    @property
    def input_files(self) -> dict[str, Path]:
        """The images and the maps."""
        files = {f"map_{k}_{one.run}": one.path for k, one in enumerate(self.maps)}
        files |= {f"status_{k}_{one.run}": one.status for k, one in enumerate(self.maps) if one.status is not None}
        more = {} if self.right_map is None else {"right_map": self.right_map.path}
        return super().input_files | files | more


@dataclass(frozen=True, kw_only=True)
class DisparityScene(Scene):
    """A disparity map from a run, with its related files."""

    disparity: Path
    status: Path | None = None  # status map
    confidence: dict[str, Path] = field(default_factory=dict)  # name -> map
    bound: Path | None = None  # map of error bounds
    left: Path | None = None  # image that the map describes
    calibration: Path | None = None
    cameras: tuple[int, int] = (2, 3)  # numbers of the left and right camera in a multi-camera calibration
    geometry: PairGeometry | None = None  # the data set's, in place of a calibration

    roles: ClassVar[tuple[str, ...]] = ("disparity", "status", "bound", "left", "calibration")

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file that a depth map can depend on."""
        return super().input_files | {f"confidence_{name}": file for name, file in self.confidence.items()}


@dataclass(frozen=True, kw_only=True)
class RgbdScene(Scene):
    """The files of an RGB-D frame."""

    color: Path | None  # None if there is only depth
    depth: Path
    depth_scale: float | None = None  # codes per meter of integer depth files; None: by the file's format
    scale_floats: bool = False  # the scale was given for these files and applies to floating-point values, too
    rotated: bool = False  # the codes' bits are rotated left by 3 (SUN RGB-D)
    raw: bool = False  # ``depth`` has raw codes of a first-generation Kinect, in the depth camera's frame
    calibration: Path | None = None  # Kinect calibration for raw codes; None: a typical one
    depth_true: Path | None = None  # ground truth depth, in the same codes
    masks: dict[str, Path] = field(default_factory=dict)  # name -> mask of the pixels to evaluate
    intrinsics: tuple[float, float, float, float] | None = None  # fx, fy, cx, cy of the color camera
    # fx, fy, cx, cy of the depth camera, to register its map to the color image; None: it is registered already.
    depth_intrinsics: tuple[float, float, float, float] | None = None
    depth_to_color: Place | None = None  # pose of the depth camera in the color camera's frame; None: identity
    fb: float | None = None  # focal length x baseline, pixel meters
    hidden: Path | None = None  # mask of pixels (255) to hide from the method: their sensor depth is the ground truth
    sparse: Path | None = None  # a second depth map in the same codes, known at some pixels
    sparse_confidence: Path | None = None  # confidence of ``sparse``
    sparse_source: str = ""  # source of ``sparse``, if readers must know it
    sequence: str = ""  # name of the frame's sequence, or empty
    number: int = 0  # position in the sequence
    pose: tuple[float, ...] | None = None  # (4, 4), row by row, from the color camera to the world, meters

    roles: ClassVar[tuple[str, ...]] = ("color", "depth", "hidden", "calibration")
    truth_role: ClassVar[str] = "depth_true"

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file that a method may read, with the distortion map of a Kinect calibration."""
        beta = distortion_map(self.calibration) if self.calibration is not None and self.raw else None
        return super().input_files | ({} if beta is None else {f"calibration: {beta.name}": beta})

    def with_scale(self, scale: float | None) -> Self:
        """Return the scene with this number of codes per meter; unchanged for None, or if it has raw codes."""
        return self if scale is None or self.raw else replace(self, depth_scale=scale, scale_floats=True)

    @property
    def image(self) -> Path:
        """The file that sets the frame's size: the color image, or the depth map without one."""
        return self.color or self.depth


@dataclass(frozen=True, kw_only=True)
class RgbIrScene(RgbdScene):
    """A frame with an infrared image; ``calibration`` describes both cameras, or marks the pair as rectified."""

    infrared: Path  # image file, 8 or 16 bit
    infrared_plain: Path | None = None  # the same view with the projector covered; replaces ``infrared``
    max_disparity: int | None = None  # largest disparity to search

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file that a method may read, with the infrared image in use."""
        return {**super().input_files, "infrared": self.infrared_plain or self.infrared}


@dataclass(frozen=True, kw_only=True)
class SequenceScene(Scene):
    """The frames of a sequence, in order."""

    frames: tuple[RgbdScene, ...]

    @property
    def input_files(self) -> dict[str, Path]:
        """Frame and role -> file."""
        return {f"{frame.name}: {role}": file for frame in self.frames for role, file in frame.input_files.items()}

    @property
    def has_truth(self) -> bool:
        """True if any frame has ground truth."""
        return any(frame.has_truth for frame in self.frames)


@dataclass(frozen=True, kw_only=True)
class VolumePairScene(Scene):
    """The files of a registered pair of volumes."""

    fixed: Path
    moving_warped: Path | None = None  # the moving volume after registration, on the fixed grid
    moving: Path | None = None  # the moving volume; ``transform`` or ``displacement`` map fixed points into it
    transform: Path | None = None  # see ``io/formats/fields.py``
    displacement: Path | None = None
    mask: Path | None = None  # region of interest in the fixed volume (not 0)
    regions: tuple[tuple[str, Path], ...] = ()  # (name, file) of masks and label maps of the fixed volume
    labels: tuple[tuple[str, tuple[tuple[str, int], ...]], ...] = ()  # (label map, ((region, its label), ...))
    landmarks_fixed: Path | None = None  # points that correspond to ``landmarks_moving``
    landmarks_moving: Path | None = None
    error_true: Path | None = None  # dense true error, mm

    roles: ClassVar[tuple[str, ...]] = (
        "fixed", "moving_warped", "moving", "transform", "displacement", "mask", "landmarks_fixed",
    )  # fmt: skip

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file that a method may read, with the files that its header names; folders are left out."""
        files = super().input_files | {f"mask_{name}": file for name, file in self.regions}
        for role, file in tuple(files.items()):
            behind = volume_files(file) + transform_files(file)
            files |= {f"{role}: {number}": each for number, each in enumerate(behind, 1)}
        return {role: file for role, file in files.items() if not os.path.isdir(file)}

    @property
    def has_truth(self) -> bool:
        """True if there are dense errors, or landmarks of both volumes with a transform that maps them."""
        landmarks = self.landmarks_fixed is not None and self.landmarks_moving is not None
        return self.error_true is not None or (landmarks and (self.transform or self.displacement) is not None)

    @property
    def lacks_for_truth(self) -> str:
        """Return a message about the file that ``landmarks_moving`` still needs, or an empty text."""
        if self.has_truth or self.landmarks_moving is None:
            return ""
        needed = "landmarks_fixed.*" if self.landmarks_fixed is None else "displacement.* or transform.*"
        return f"{self.landmarks_moving}: true errors at landmarks need {needed} beside it"


def distortion_map(calibration: Path) -> Path | None:
    """Return the file ``dc_beta.npy`` next to a Kinect calibration, or None."""
    beta = calibration.with_name("dc_beta.npy")
    return beta if beta.is_file() else None


def check_same_size(file: Path, shape: Sequence[int], other: Path, size: Sequence[int], why: str = "") -> None:
    """Raise InputError if the (height, width) of ``file`` differs from ``other``."""
    if tuple(shape[:2]) != tuple(size[:2]):
        found, expected = (f"{side[1]} x {side[0]}" for side in (shape, size))
        raise InputError(f"{file}: {found}, but {other.name} is {expected}{why}")


def read_masks(files: Mapping[str, Path], like: Path, shape: Sequence[int]) -> dict[str, NDArray[np.bool_]]:
    """Return name -> (H, W) mask. Raise InputError if a mask differs from ``shape``, the size of ``like``."""
    masks = {}
    for name, file in files.items():
        masks[name] = mask = read_mask(file)
        check_same_size(file, mask.shape, like, shape)
        if not mask.any():
            warn(f"{shown(file)}: no pixel is inside the mask")
    return masks


def sequences(scenes: Sequence[Scene]) -> list[Scene]:
    """Return the scenes sorted by name, with each sequence of frames merged into one scene."""
    groups: dict[tuple[Path, str], list[RgbdScene]] = {}
    grouped: list[Scene] = []
    for scene in scenes:
        if isinstance(scene, RgbdScene) and scene.sequence and not scene.problem:
            groups.setdefault((scene.folder, scene.sequence), []).append(scene)
        else:
            grouped.append(scene)
    for (folder, sequence), frames in groups.items():
        ordered = tuple(sorted(frames, key=lambda frame: frame.number))
        name = ordered[0].name.rpartition("/")[0] or sequence
        grouped.append(SequenceScene(name=name, folder=folder, frames=ordered))
    return sorted(grouped, key=lambda scene: scene.name)

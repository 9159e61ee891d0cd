"""Scenes: the units of a command's work, as names of files that belong together and facts about them.

No image or volume is loaded here; ``input_files`` alone looks into headers for further files. ``stereo_pairs``,
``rgbd_frames`` and ``volume_pairs`` load the files of the scenes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Place
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import InputError
from depthcli.io.formats.disparity import read_disparity
from depthcli.io.formats.files_behind import kinect_files, transform_files, volume_files

MAX_DISPARITY = 1 << 20
"""Largest disparity, of either sign, that a file may ask for, pixels; no image is as wide."""

LEFT_OUT = {"displacement": "transform", "transform": "displacement", "both": ""}
"""Which of a displacement field and a transform counts -> which does not; both: the field first, as in ANTs."""

LEFT_RIGHT, TOP_BOTTOM, FRAMES = "left-right", "top-bottom", "frames"
"""How one file holds both views: as halves, or as the two images of an MPO file."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """The base class of all kinds of scene; a scene of this class itself is a folder that cannot be used."""

    name: str  # unique in its listing, with ``/`` if the scene is in a data set's folder
    folder: Path  # the folder it was found in
    layout: str = ""  # name of the layout that found it; empty for files named on the command line
    protocol: str = ""  # name of the evaluation protocol that its ground truth asks for
    problem: str = ""  # why the scene cannot be used, or empty
    warnings: tuple[str, ...] = field(default=(), compare=False)  # what looks wrong with its files, a line each
    invalid: float | None = None  # number of a ground truth's map that means unknown; None: recognized, NaN: none

    roles: ClassVar[tuple[str, ...]] = ()  # fields with files that a method may look at

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file that a method may look at; ground truth is not among them."""
        return {role: file for role in self.roles if (file := getattr(self, role)) is not None}

    @property
    def has_truth(self) -> bool:
        """True where there is ground truth to compare with."""
        return False

    @property
    def lacks_for_truth(self) -> str:
        """Files that a truth still needs, in a line for people; empty: none."""
        return ""

    def check(self) -> None:
        """Raise the scene's problem, if it has one, as an InputError."""
        if self.problem:
            raise InputError(self.problem)


@dataclass(frozen=True, kw_only=True)
class StereoScene(Scene):
    """The files of one pair, or of one view with its ground truth."""

    left: Path  # image, or video
    right: Path | None = None
    frame_number: int | None = None  # of the videos' frames, from 0; None: ``left`` and ``right`` are images
    # How ``left``, the same file as ``right``, holds both views: left-right, top-bottom or, of MPO, frames; "": one.
    halves: str = ""
    disparity_left: Path | None = None  # ground truth
    disparity_right: Path | None = None
    disparity_noc: Path | None = None  # the truth of the visible pixels alone (KITTI)
    disparity_scale: float | None = None  # codes per pixel of the ground truth; None = by the file's kind
    scale_by_width: bool = False  # the scale follows from the map's width, as in the Middlebury 2005 and 2006 sets
    masks: dict[str, Path] = field(default_factory=dict, hash=False)  # name -> file; a pixel counts where it is inside
    occluded: Path | None = None  # mask of pixels that the right view does not show (> 0); ``nonocc`` are the others
    ignored: Path | None = None  # mask of pixels that do not count (> 0); ``all`` are the others
    objects: Path | None = None  # KITTI 2015 object map (> 0: foreground)
    materials: Path | None = None  # map of classes from 0 to 3, each a mask ``class_<k>`` (Booster)
    # Reads a truth map with a number of codes per pixel: (H, W) float32, pixels, NaN = unknown.
    decode: Callable[[Path, float | None], NDArray[np.float32]] = read_disparity
    max_disparity: int | None = None  # largest disparity to search, inclusive
    min_disparity: int = 0  # smallest disparity to search
    round_disparity: bool = False  # the truth is whole pixels, so that results are rounded first (v3: ``isint``)
    calibration: Path | None = None  # file by which disparities become depth
    cameras: tuple[int, int] = (2, 3)  # numbers of the pair's cameras in a calibration of several (KITTI)
    geometry: PairGeometry | None = None  # how disparities become depth, without a calibration file
    # First, middle and last frame of the sequence that this one belongs to; empty for a single pair.
    sequence: tuple[StereoScene, ...] = ()

    roles: ClassVar[tuple[str, ...]] = ("left", "right")

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file that a method may look at; one file that holds both views is named so."""
        return {f"both views, {self.halves}": self.left} if self.halves else super().input_files

    @property
    def is_first(self) -> bool:
        """True for a single pair and for the first frame of a sequence."""
        return not self.sequence or self.sequence[0].name == self.name

    @property
    def has_truth(self) -> bool:
        """True where the left view's disparity is known."""
        return self.disparity_left is not None


@dataclass(frozen=True)
class GivenMap:
    """One file of a run."""

    run: str  # name of the run
    path: Path
    scale: float | None = None  # codes per pixel; None: by the file's kind
    invalid: float | None = None  # value that means none; None: recognized
    status: Path | None = None  # status of its pixels, where it has one


@dataclass(frozen=True, kw_only=True)
class MapsScene(StereoScene):
    """A pair with given disparity maps of its left view."""

    pair: StereoScene  # without the maps
    maps: tuple[GivenMap, ...] = ()  # in the order of the command line
    right_map: GivenMap | None = None  # map of the right view
    absent: tuple[str, ...] = ()  # names of the runs that have no map of this scene

    @property
    def input_files(self) -> dict[str, Path]:
        """The images and the maps."""
        files = {f"map_{k}_{one.run}": one.path for k, one in enumerate(self.maps)}
        files |= {f"status_{k}_{one.run}": one.status for k, one in enumerate(self.maps) if one.status is not None}
        more = {} if self.right_map is None else {"right_map": self.right_map.path}
        return super().input_files | files | more


@dataclass(frozen=True, kw_only=True)
class DisparityScene(Scene):
    """A disparity map that a run made, with the files that belong to it."""

    disparity: Path
    status: Path | None = None  # status of its pixels
    confidence: dict[str, Path] = field(default_factory=dict)  # name -> map
    bound: Path | None = None  # of its errors
    left: Path | None = None  # the image that the map describes
    calibration: Path | None = None
    cameras: tuple[int, int] = (2, 3)  # numbers of the left and right camera in a calibration of several
    geometry: PairGeometry | None = None  # of the data set, in place of a calibration

    roles: ClassVar[tuple[str, ...]] = ("disparity", "status", "bound", "left", "calibration")

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file, for everything that a depth map can depend on."""
        return super().input_files | {f"confidence_{name}": file for name, file in self.confidence.items()}


@dataclass(frozen=True, kw_only=True)
class RgbdScene(Scene):
    """The files of one frame of color and depth."""

    color: Path | None  # None where there is depth alone
    depth: Path
    depth_scale: float | None = None  # codes a meter of integer depth files; None: by the file's kind
    scale_floats: bool = False  # the scale was given for these files, and holds for floating point, too
    rotated: bool = False  # the codes' bits are rotated left by 3 (SUN RGB-D)
    raw: bool = False  # ``depth`` has raw codes of a first-generation Kinect, in the depth camera's frame
    calibration: Path | None = None  # Kinect calibration for raw codes, or None for a typical one
    depth_true: Path | None = None  # true depth, in the same codes
    masks: dict[str, Path] = field(default_factory=dict)  # name -> file; a pixel counts where it is inside
    intrinsics: tuple[float, float, float, float] | None = None  # fx, fy, cx, cy of the color camera
    # Those of the depth camera, whose map is then registered to the color image; None: it is already.
    depth_intrinsics: tuple[float, float, float, float] | None = None
    depth_to_color: Place | None = None  # from the depth camera to the color camera; None: both are at one place
    fb: float | None = None  # focal length x baseline, pixel meters
    hidden: Path | None = None  # mask of pixels (255) that the sensor is made not to see: its depth there is the truth
    sparse: Path | None = None  # a second depth map in the same codes, known at some pixels
    sparse_confidence: Path | None = None  # how sure it is
    sparse_source: str = ""  # where it comes from, if readers must know
    sequence: str = ""  # name of the sequence that the frame belongs to, or empty
    number: int = 0  # the frame's place there
    pose: tuple[float, ...] | None = None  # (4, 4), row by row, from the color camera to the world, meters

    roles: ClassVar[tuple[str, ...]] = ("color", "depth", "hidden", "calibration")

    @property
    def input_files(self) -> dict[str, Path]:
        """``color``, ``depth`` and the known facts of the cameras."""
        behind = kinect_files(self.calibration) if self.calibration is not None and self.raw else ()
        return super().input_files | {f"calibration: {file.name}": file for file in behind}

    @property
    def has_truth(self) -> bool:
        """True where the true depth is known."""
        return self.depth_true is not None

    def with_scale(self, scale: float | None) -> Self:
        """Return the scene with a number of codes a meter that was given; None: as it is."""
        return self if scale is None or self.raw else replace(self, depth_scale=scale, scale_floats=True)

    @property
    def image(self) -> Path:
        """The image whose size the frame has: the color image, or else the depth map."""
        return self.color or self.depth


@dataclass(frozen=True, kw_only=True)
class RgbIrScene(RgbdScene):
    """A frame with an infrared image; ``calibration`` has both cameras, or marks the pair as rectified."""

    infrared: Path  # image file, 8 or 16 bit
    infrared_plain: Path | None = None  # the same view with the projector covered, which is used instead
    max_disparity: int | None = None  # largest disparity to search

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file that a method may look at, with the infrared image that is used."""
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
        """True where any frame has ground truth."""
        return any(frame.has_truth for frame in self.frames)


@dataclass(frozen=True, kw_only=True)
class VolumePairScene(Scene):
    """The files of one registered pair of volumes."""

    fixed: Path
    moving_warped: Path | None = None  # the moving volume after registration, on the fixed grid
    moving: Path | None = None  # the moving volume, for which ``transform`` or ``displacement`` map fixed points
    transform: Path | None = None  # see ``io/formats/fields.py``
    displacement: Path | None = None
    mask: Path | None = None  # where the fixed volume is of interest (not 0)
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
        """Volumes, transform and the landmarks of the fixed volume, each with the files that its header names."""
        files = super().input_files | {f"mask_{name}": file for name, file in self.regions}
        for role, file in tuple(files.items()):
            behind = volume_files(file) + transform_files(file)
            files |= {f"{role}: {number}": each for number, each in enumerate(behind, 1)}
        return {role: file for role, file in files.items() if not os.path.isdir(file)}

    @property
    def has_truth(self) -> bool:
        """Dense errors, or landmarks and the transform that they are carried over by."""
        landmarks = self.landmarks_fixed is not None and self.landmarks_moving is not None
        return self.error_true is not None or (landmarks and (self.transform or self.displacement) is not None)

    @property
    def lacks_for_truth(self) -> str:
        """Landmarks need each other, and the way from the fixed to the moving ones."""
        if self.has_truth or self.landmarks_moving is None:
            return ""
        needed = "landmarks_fixed.*" if self.landmarks_fixed is None else "displacement.* or transform.*"
        return f"{self.landmarks_moving}: true errors at landmarks need {needed} beside it"


def check_same_size(file: Path, shape: Sequence[int], other: Path, wanted: Sequence[int], why: str = "") -> None:
    """Raise an InputError if an image of ``file`` has another (height, width) than ``other``."""
    if tuple(shape[:2]) != tuple(wanted[:2]):
        have, want = (f"{size[1]} x {size[0]}" for size in (shape, wanted))
        raise InputError(f"{file}: {have}, but {other.name} is {want}{why}")


def sequences(scenes: Sequence[Scene]) -> list[Scene]:
    """Return the scenes by name, with the frames of every sequence as one scene; single frames stay as they are."""
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

"""Frames of color and depth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.color_and_depth import Place, registered
from depthcli.core.cameras.kinect import kinect_v1, sensor_fb
from depthcli.core.errors import InputError
from depthcli.core.frames import RgbdFrame, RgbIrFrame, SparseFrame, color8, infrared_image
from depthcli.io.formats.calibrations import kinect_files_beside, read_color_infrared_rig, read_kinect_calibration
from depthcli.io.formats.depth import MILLIMETERS, check_fb, read_depth, read_kinect_raw
from depthcli.io.formats.disparity import read_plane
from depthcli.io.formats.files import naming, warn
from depthcli.io.formats.images import image_size, read_grey, read_image
from depthcli.io.scenes import Scene, check_same_size, name_of, together

_METERS = (".pfm", ".npy")
_GENERIC_NAMES = ("color", "rgb", "image", "depth")


@dataclass(frozen=True)
class RgbdTruth:
    """True depth of one frame."""

    depth: NDArray[np.float32]  # (H, W) float32, meters, NaN = unknown
    masks: dict[str, NDArray[np.bool_]] = field(default_factory=dict)  # name -> (H, W) bool, True = evaluate
    fb: float | None = None  # focal length x baseline, pixel meters, or None where errors in pixels mean nothing


@dataclass(frozen=True, kw_only=True)
class RgbdScene(Scene):
    """The files of one frame.

    Attributes
    ----------
    color, depth : image files; color is None where there is depth alone
    depth_intrinsics : those of the depth camera, whose map is then registered to the color image; None: it is already
    depth_to_color : rotation (row by row) and translation (meters) from the depth camera's frame to the color
        camera's; None: both are at one place
    hidden : mask of pixels that the sensor is made not to see (255), where its depth is the true one; or None
    sparse, sparse_confidence : a second depth map in the same codes, known at some pixels, and how sure it is; or None
    sequence, number : the sequence that the frame belongs to, or empty, and its place there
    pose : (4, 4), row by row, from the color camera's coordinates to the world's, meters; or None
    """

    color: Path | None
    depth: Path
    depth_scale: float = 1000.0  # codes a meter of integer depth files
    rotated: bool = False  # the codes' bits are rotated left by 3 (SUN RGB-D)
    raw: bool = False  # ``depth`` holds raw codes of a first-generation Kinect, in the depth camera's frame
    calibration: Path | None = None  # Kinect calibration for raw codes, or None for a typical one
    depth_true: Path | None = None  # true depth, in the same codes, or None
    masks: dict[str, Path] = field(default_factory=dict)  # name -> file; a pixel counts where the value is 255
    intrinsics: tuple[float, float, float, float] | None = None  # fx, fy, cx, cy of the color camera, or None
    depth_intrinsics: tuple[float, float, float, float] | None = None
    depth_to_color: Place | None = None
    fb: float | None = None  # focal length x baseline, pixel meters; None where it is not known
    hidden: Path | None = None
    sparse: Path | None = None
    sparse_confidence: Path | None = None
    sequence: str = ""
    number: int = 0
    pose: tuple[float, ...] | None = None

    @classmethod
    def single(cls, values: Mapping[str, Any]) -> Self | None:
        """Return the frame of ``--color`` and ``--depth``, or of the latter alone."""
        color: Path | None = values.get("color")
        depth: Path | None = values.get("depth")
        if depth is None:
            together(values, "color", "depth")
            return None
        image = color or depth
        return cls(name=name_of(image, _GENERIC_NAMES), folder=image.parent, color=color, depth=depth)

    @property
    def input_files(self) -> dict[str, Path]:
        """``color``, ``depth`` and what is known of the cameras."""
        known = {"color": self.color, "depth": self.depth, "hidden": self.hidden, "calibration": self.calibration}
        files = {role: file for role, file in known.items() if file is not None}
        if self.calibration is not None and self.raw:
            files |= {f"calibration: {file.name}": file for file in kinect_files_beside(self.calibration)}
        return files

    @property
    def has_truth(self) -> bool:
        """True where the true depth is known."""
        return self.depth_true is not None

    @property
    def image(self) -> Path:
        """The image whose size the frame has: the color image, or else the depth map."""
        return self.color or self.depth

    def frame_size(self) -> tuple[int, int]:
        """Return (height, width) of the frame by an image's header alone; InputError where it cannot be read."""
        return image_size(self.image)

    def load(self) -> RgbdFrame:
        """Return color and depth of one size, depth in meters and registered to the color, or depth alone."""
        self.check()
        intrinsics, depth_camera = (
            None if each is None else Intrinsics(*each) for each in (self.intrinsics, self.depth_intrinsics)
        )
        if self.color is None:
            known = intrinsics or depth_camera
            frame = RgbdFrame.without_color(self._visible_depth(), self.fb or sensor_fb(known), known)
        elif self.raw:
            frame = _registered_raw(self, color8(read_image(self.color)))
        else:
            color, depth = color8(read_image(self.color)), self._visible_depth()
            with naming(self.depth):
                found = registered(depth, color.shape[:2], intrinsics, depth_camera, self.depth_to_color)
            if found.note:
                warn(f"{self.depth}: {found.note}")
            pose = None if self.pose is None else np.array(self.pose).reshape(4, 4)
            fb = self.fb or sensor_fb(intrinsics)
            frame = RgbdFrame(color, found.depth, fb, intrinsics, found.interpolated, pose)
        if not np.isfinite(frame.depth).any():
            raise InputError(f"{self.depth}: no pixel has a depth")
        if self.fb:
            check_fb(self.folder / "meta.json", self.fb, frame.depth)
        return frame

    def load_sparse(self) -> SparseFrame:
        """Return the frame with its second, sparse depth."""
        frame = self.load()
        if self.color is None:
            raise InputError(f"{self.depth}: no color image beside it, which transparent objects need")
        if self.sparse is None:
            raise InputError(f"{self.folder}: {self.name} has no sparse depth (sparse.*)")
        sparse, confidence = self._read_depth(self.sparse), None
        check_same_size(self.sparse, sparse.shape, self.image, frame.shape)
        if self.sparse_confidence is not None:
            plane = read_plane(self.sparse_confidence)
            check_same_size(self.sparse_confidence, plane.shape, self.image, frame.shape)
            confidence = (plane / (np.iinfo(plane.dtype).max if plane.dtype.kind in "iu" else 1)).astype(np.float32)
        if not np.isfinite(sparse).any():
            raise InputError(f"{self.sparse}: no pixel has a depth")
        return SparseFrame(
            frame.color, frame.depth, frame.fb, frame.intrinsics, frame.interpolated,
            sparse=sparse, sparse_confidence=confidence,
        )  # fmt: skip

    def truth(self) -> RgbdTruth:
        """Return true depth and masks; InputError where there is none or sizes differ."""
        self.check()
        if self.depth_true is None:
            raise InputError(f"{self.folder}: {self.name} has no true depth")
        depth = self._read_depth(self.depth_true)
        masks = {}
        for name, file in self.masks.items():
            mask = read_grey(file)
            check_same_size(file, mask.shape, self.depth_true, depth.shape)
            masks[name] = mask == 255
        if self.fb:
            check_fb(self.folder / "meta.json", self.fb, depth)
        return RgbdTruth(depth, masks, self.fb)

    def _read_depth(self, path: Path) -> NDArray[np.float32]:
        # The default scale is not passed on: 8-bit codes, which would hold no usable depth, need one of their own.
        scale = None if path.suffix in _METERS or self.depth_scale == MILLIMETERS else self.depth_scale
        return read_depth(path, scale, 3 if self.rotated else 0)

    def _visible_depth(self) -> NDArray[np.float32]:
        """The depth without the pixels that the sensor is made not to see."""
        depth = self._read_depth(self.depth)
        if self.hidden is None:
            return depth
        mask = read_grey(self.hidden)
        check_same_size(self.hidden, mask.shape, self.depth, depth.shape)
        return np.where(mask == 255, np.float32(np.nan), depth)


def _registered_raw(scene: RgbdScene, color: NDArray[np.uint8]) -> RgbdFrame:
    """Color at the depth camera's resolution, and the depth of raw codes registered to it."""
    raw = read_kinect_raw(scene.depth)
    calibration = kinect_v1() if scene.calibration is None else read_kinect_calibration(scene.calibration)
    if calibration.beta is not None and calibration.beta.shape != raw.shape:
        raise InputError(f"{scene.calibration}: its distortion map is not of the depth image's size")
    # Where the color image is finer than the depth, most of its pixels would meet no point.
    ratio = calibration.color.matrix[0, 0] / calibration.depth.matrix[0, 0]
    factor = 1.0 if ratio < 1.5 else 1.0 / round(ratio)
    if factor != 1:
        color = cv2.resize(color, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
    camera = calibration.color.scaled(factor)
    scaled = replace(calibration, color=camera)
    depth = scaled.register(scaled.depth_of_raw(raw), (color.shape[0], color.shape[1]))
    pose = None if scene.pose is None else np.array(scene.pose).reshape(4, 4)
    return RgbdFrame(color, depth, scene.fb or sensor_fb(camera.intrinsics), camera.intrinsics, False, pose)


@dataclass(frozen=True, kw_only=True)
class RgbIrScene(RgbdScene):
    """A frame with an infrared image; ``calibration`` holds both cameras, or says that the pair is rectified."""

    infrared: Path  # image file, 8 or 16 bit
    infrared_plain: Path | None = None  # the same view with the projector covered, which is used instead, or None
    max_disparity: int | None = None  # largest disparity to search, or None

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file that a method may look at, with the infrared image that is used."""
        return {**super().input_files, "infrared": self.infrared_plain or self.infrared}

    def load_pair(self) -> RgbIrFrame:
        """Return the frame with its infrared image and calibration."""
        frame = self.load()
        if self.calibration is None:
            raise InputError(f"{self.folder}: no calibration of the color and the infrared camera (calib.json)")
        infrared = infrared_image(read_image(self.infrared_plain or self.infrared))
        height, width = infrared.shape
        rig = read_color_infrared_rig(self.calibration, (frame.shape[1], frame.shape[0]), (width, height))
        if not isinstance(rig, float):
            return RgbIrFrame(frame.color, infrared, frame.depth, rig)
        check_same_size(self.infrared, infrared.shape, self.image, frame.shape, "; a rectified pair has one size")
        check_fb(self.calibration, rig, frame.depth)
        return RgbIrFrame(frame.color, infrared, frame.depth, None, rig)


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

    def load(self) -> None:
        """Raise InputError where the sequence cannot be used; its frames are loaded one by one."""
        self.check()


def sequences(scenes: Sequence[Scene]) -> list[Scene]:
    """Return the scenes by name, with the frames of every sequence as one scene; single frames stay as they are."""
    groups: dict[tuple[Path, str], list[RgbdScene]] = {}
    others: list[Scene] = []
    for scene in scenes:
        if isinstance(scene, RgbdScene) and scene.sequence and not scene.problem:
            groups.setdefault((scene.folder, scene.sequence), []).append(scene)
        else:
            others.append(scene)
    for (folder, sequence), frames in groups.items():
        ordered = tuple(sorted(frames, key=lambda frame: frame.number))
        name = ordered[0].name.rpartition("/")[0] or sequence
        others.append(SequenceScene(name=name, folder=folder, frames=ordered))
    return sorted(others, key=lambda scene: scene.name)

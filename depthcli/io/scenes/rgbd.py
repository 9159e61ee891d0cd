"""Frames of color and depth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from depthcli.core.errors import InputError
from depthcli.io.scenes import Scene, check_same_size, name_of, together

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.core.cameras.camera import Intrinsics
    from depthcli.core.cameras.color_and_depth import Place
    from depthcli.core.frames import RgbdFrame, SparseFrame

_METERS = (".pfm", ".npy")
_GENERIC_NAMES = ("color", "rgb", "image", "depth")


@dataclass(frozen=True)
class RgbdTruth:
    """True depth of one frame.

    Attributes
    ----------
    depth : (H, W) float32, meters, NaN = unknown
    masks : name -> (H, W) bool, True = evaluate
    fb : focal length x baseline, pixel meters, or None where errors in pixels mean nothing
    """

    depth: NDArray[np.float32]
    masks: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    fb: float | None = None


@dataclass(frozen=True, kw_only=True)
class RgbdScene(Scene):
    """The files of one frame.

    Attributes
    ----------
    color, depth : image files; color is None where there is depth alone
    depth_scale : codes a meter of integer depth files
    rotated : the codes' bits are rotated left by 3 (SUN RGB-D)
    raw : ``depth`` holds raw codes of a first-generation Kinect, in the depth camera's frame
    calibration : Kinect calibration for raw codes, or None for a typical one
    depth_true : true depth, in the same codes, or None
    masks : name -> file; a pixel counts where the value is 255
    intrinsics : fx, fy, cx, cy of the color camera, or None
    depth_intrinsics : those of the depth camera, whose map is then registered to the color image; None: it is already
    depth_to_color : rotation (row by row) and translation (meters) from the depth camera's frame to the color
        camera's; None: both are at one place
    fb : focal length x baseline, pixel meters; None where it is not known
    hidden : mask of pixels that the sensor is made not to see (255), where its depth is the true one; or None
    sparse, sparse_confidence : a second depth map in the same codes, known at some pixels, and how sure it is; or None
    sequence, number : the sequence that the frame belongs to, or empty, and its place there
    pose : (4, 4), row by row, from the color camera's coordinates to the world's, meters; or None
    """

    color: Path | None
    depth: Path
    depth_scale: float = 1000.0
    rotated: bool = False
    raw: bool = False
    calibration: Path | None = None
    depth_true: Path | None = None
    masks: dict[str, Path] = field(default_factory=dict)
    intrinsics: tuple[float, float, float, float] | None = None
    depth_intrinsics: tuple[float, float, float, float] | None = None
    depth_to_color: Place | None = None
    fb: float | None = None
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
        files = {"depth": self.depth} if self.color is None else {"color": self.color, "depth": self.depth}
        if self.hidden is not None:
            files["hidden"] = self.hidden
        if self.calibration is not None:
            from depthcli.io.formats.calibrations import kinect_files_beside

            files["calibration"] = self.calibration
            files |= {f"calibration: {file.name}": file for file in kinect_files_beside(self.calibration) if self.raw}
        return files

    @property
    def has_truth(self) -> bool:
        """True where the true depth is known."""
        return self.depth_true is not None

    def frame_size(self) -> tuple[int, int]:
        """Return (height, width) of the frame by an image's header alone; InputError where it cannot be read."""
        from depthcli.io.formats.images import image_size

        return image_size(self.image)

    def load(self) -> RgbdFrame:
        """Return color and depth of one size, depth in meters and registered to the color, or depth alone.

        Raises
        ------
        InputError
            Files that cannot be used, or without a known depth; sizes that differ while the cameras are not known.
        """
        from depthcli.core.cameras.camera import Intrinsics
        from depthcli.core.cameras.kinect import sensor_fb
        from depthcli.core.frames import RgbdFrame

        self.check()
        intrinsics = None if self.intrinsics is None else Intrinsics(*self.intrinsics)
        interpolated = False
        if self.color is None:
            intrinsics = intrinsics or (None if self.depth_intrinsics is None else Intrinsics(*self.depth_intrinsics))
            depth = self._without_hidden(self._depth(self.depth))
            frame = RgbdFrame.without_color(depth, self.fb or sensor_fb(intrinsics), intrinsics)
            return self._checked(frame)
        color = self._color(self.color)
        if self.raw:
            color, depth, intrinsics = self._registered_raw(color)
        else:
            depth, interpolated = self._registered(color, intrinsics)
        frame = RgbdFrame(color, depth, self.fb or sensor_fb(intrinsics), intrinsics, interpolated, self._pose())
        return self._checked(frame)

    def _pose(self) -> NDArray[np.float64] | None:
        import numpy as np

        return None if self.pose is None else np.array(self.pose).reshape(4, 4)

    def _checked(self, frame: RgbdFrame) -> RgbdFrame:
        import numpy as np

        from depthcli.io.formats.depth import check_fb

        if not np.isfinite(frame.depth).any():
            raise InputError(f"{self.depth}: no pixel has a depth")
        if self.fb:
            check_fb(self.folder / "meta.json", self.fb, frame.depth)
        return frame

    @property
    def image(self) -> Path:
        """The image whose size the frame has: the color image, or else the depth map."""
        return self.color or self.depth

    def load_sparse(self) -> SparseFrame:
        """Return the frame with its second, sparse depth.

        Raises
        ------
        InputError
            As for :meth:`load`; no sparse depth, one of another size, or without a single pixel.
        """
        import numpy as np

        from depthcli.core.frames import SparseFrame
        from depthcli.io.formats.disparity import read_plane

        frame = self.load()
        if self.color is None:
            raise InputError(f"{self.depth}: no color image beside it, which transparent objects need")
        if self.sparse is None:
            raise InputError(f"{self.folder}: {self.name} has no sparse depth (sparse.*)")
        sparse, confidence = self._depth(self.sparse), None
        if self.sparse_confidence is not None:
            plane = read_plane(self.sparse_confidence)
            top = np.iinfo(plane.dtype).max if plane.dtype.kind in "iu" else 1
            confidence = (plane / top).astype(np.float32)
        for file, values in ((self.sparse, sparse), (self.sparse_confidence, confidence)):
            if file is not None and values is not None:
                check_same_size(file, values.shape, self.image, frame.shape)
        if not np.isfinite(sparse).any():
            raise InputError(f"{self.sparse}: no pixel has a depth")
        return SparseFrame(
            frame.color,
            frame.depth,
            frame.fb,
            frame.intrinsics,
            frame.interpolated,
            sparse=sparse,
            sparse_confidence=confidence,
        )

    def truth(self) -> RgbdTruth:
        """Return true depth and masks; InputError where there is none or sizes differ."""
        from depthcli.io.formats.depth import check_fb
        from depthcli.io.formats.images import read_grey

        self.check()
        if self.depth_true is None:
            raise InputError(f"{self.folder}: {self.name} has no true depth")
        depth = self._depth(self.depth_true)
        masks = {}
        for name, file in self.masks.items():
            mask = read_grey(file)
            check_same_size(file, mask.shape, self.depth_true, depth.shape)
            masks[name] = mask == 255
        if self.fb:
            check_fb(self.folder / "meta.json", self.fb, depth)
        return RgbdTruth(depth, masks, self.fb)

    def _color(self, path: Path) -> NDArray[np.uint8]:
        from depthcli.core.frames import color8
        from depthcli.io.formats.images import read_image

        return color8(read_image(path))

    def _depth(self, path: Path) -> NDArray[np.float32]:
        from depthcli.io.formats.depth import MILLIMETERS, read_depth

        # The default scale is not passed on: 8-bit codes, which would hold no usable depth, need one of their own.
        scale = None if path.suffix in _METERS or self.depth_scale == MILLIMETERS else self.depth_scale
        return read_depth(path, scale, 3 if self.rotated else 0)

    def _without_hidden(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        import numpy as np

        from depthcli.io.formats.images import read_grey

        if self.hidden is None:
            return depth
        mask = read_grey(self.hidden)
        check_same_size(self.hidden, mask.shape, self.depth, depth.shape)
        return np.where(mask == 255, np.float32(np.nan), depth)

    def _registered(self, color: NDArray[np.uint8], intrinsics: Intrinsics | None) -> tuple[NDArray[np.float32], bool]:
        """The depth registered to the color image, and whether it is interpolated between samples of a smaller map."""
        from depthcli.core.cameras.camera import Intrinsics
        from depthcli.core.cameras.color_and_depth import registered
        from depthcli.io.formats.files import naming, warn

        depth = self._without_hidden(self._depth(self.depth))
        camera = None if self.depth_intrinsics is None else Intrinsics(*self.depth_intrinsics)
        shape = (color.shape[0], color.shape[1])
        with naming(self.depth):
            found = registered(depth, shape, intrinsics, camera, self.depth_to_color)
        if found.note:
            warn(f"{self.depth}: {found.note}")
        return found.depth, found.interpolated

    def _registered_raw(self, color: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.float32], Intrinsics]:
        """Color at the depth camera's resolution, and the depth registered to it."""
        import cv2

        from depthcli.core.cameras.kinect import kinect_v1
        from depthcli.io.formats.calibrations import read_kinect_calibration
        from depthcli.io.formats.depth import read_kinect_raw

        raw = read_kinect_raw(self.depth)
        calibration = kinect_v1() if self.calibration is None else read_kinect_calibration(self.calibration)
        if calibration.beta is not None and calibration.beta.shape != raw.shape:
            raise InputError(f"{self.calibration}: its distortion map is not of the depth image's size")
        # Where the color image is finer than the depth, most of its pixels would meet no point.
        ratio = calibration.color.matrix[0, 0] / calibration.depth.matrix[0, 0]
        factor = 1.0 if ratio < 1.5 else 1.0 / round(ratio)
        if factor != 1:
            color = cv2.resize(color, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
        camera = calibration.color.scaled(factor)
        scaled = replace(calibration, color=camera)
        depth = scaled.register(scaled.depth_of_raw(raw), (color.shape[0], color.shape[1]))
        return color, depth, camera.intrinsics

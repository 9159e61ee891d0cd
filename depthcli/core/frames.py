"""Inputs of the algorithms: a rectified pair; a frame of color and depth, possibly with a second measurement."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics

Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class StereoPair:
    """A rectified pair: left ``(y, x)`` matches right ``(y, x - d)`` with ``d >= 0``.

    The images are (H, W) grey or (H, W, 3) RGB, uint8 or uint16, of one shape and dtype. Their samples have ``bits``,
    such as 10 or 12 in a uint16 image (None: all of the dtype); larger samples count as the largest. ``light_trust``,
    (H, W) uint8, tells how comparable the grey level of a left pixel is with the right image; 255, or None: fully.
    """

    left: Image
    right: Image
    bits: int | None = None
    light_trust: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        if self.left.shape != self.right.shape:
            raise ValueError(f"left {self.left.shape} and right {self.right.shape} differ in size")
        if self.left.dtype != self.right.dtype or self.left.dtype not in (np.uint8, np.uint16):
            raise TypeError(f"expected two uint8 or two uint16 images, got {self.left.dtype}, {self.right.dtype}")
        if self.left.ndim not in (2, 3) or (self.left.ndim == 3 and self.left.shape[2] != 3):
            raise ValueError(f"expected (H, W) or (H, W, 3), got {self.left.shape}")
        if self.bits is not None and not 1 <= self.bits <= 8 * self.left.dtype.itemsize:
            raise ValueError(f"{self.left.dtype} samples cannot have {self.bits} bits")
        trust = self.light_trust
        if trust is not None and (trust.shape != self.shape or trust.dtype != np.uint8):
            raise ValueError(f"expected uint8 light_trust {self.shape}, got {trust.shape} {trust.dtype}")

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, pixels."""
        return self.left.shape[0], self.left.shape[1]

    @cached_property
    def grey(self) -> tuple[Image, Image]:
        """Both images as (H, W) luma over the full range of their dtype; 8-bit color images give uint16.

        Rounded to 8 bits, pixels of weak texture would become equal.
        """
        left, right = self.full_range
        if left.ndim == 3 and left.dtype == np.uint8:
            left, right = np.multiply(left, 257, dtype=np.uint16), np.multiply(right, 257, dtype=np.uint16)
        return luma(left), luma(right)

    @cached_property
    def color8(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Both images as (H, W, 3) uint8 RGB; 16-bit images are scaled, grey images repeated."""
        left, right = self.full_range
        return color8(left), color8(right)

    @cached_property
    def grey8(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Both images as (H, W) uint8 luma; 16-bit images are scaled."""
        left, right = self.full_range
        return _eight_bit(luma(left)), _eight_bit(luma(right))

    @property
    def top(self) -> int:
        """Largest value that a sample can have."""
        return (1 << (self.bits or 8 * self.left.itemsize)) - 1

    @property
    def clamped(self) -> tuple[Image, Image]:
        """Both images, with samples larger than ``top`` set to ``top``."""
        if self.top == np.iinfo(self.left.dtype).max:
            return self.left, self.right
        top = self.left.dtype.type(self.top)
        return cast(Image, np.minimum(self.left, top)), cast(Image, np.minimum(self.right, top))

    @cached_property
    def full_range(self) -> tuple[Image, Image]:
        """Both images, scaled to the full range of their dtype."""
        return _full_range(self.left, self.bits), _full_range(self.right, self.bits)


def _full_range(image: Image, bits: int | None) -> Image:
    """Return an image whose samples have ``bits`` (None: all of its dtype), scaled to the full range of its dtype."""
    full = int(np.iinfo(image.dtype).max)
    top = full if bits is None else (1 << bits) - 1
    if top == full:
        return image
    clamped = np.minimum(image, image.dtype.type(top)).astype(np.uint32)
    return cast(Image, ((clamped * full + top // 2) // top).astype(image.dtype))


def luma(image: Image) -> Image:
    """Return the (H, W) luma of a grey or an RGB image, in its dtype."""
    return image if image.ndim == 2 else cast(Image, cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


def _eight_bit(image: Image) -> NDArray[np.uint8]:
    if image.dtype == np.uint8:
        return image.view(np.uint8)
    return ((image.astype(np.uint32) + 128) // 257).astype(np.uint8)


def color8(image: Image, bits: int | None = None) -> NDArray[np.uint8]:
    """Return any image as (H, W, 3) uint8 RGB; 16-bit images are scaled by their ``bits``, grey images repeated."""
    image = _eight_bit(_full_range(image, bits))
    return np.repeat(image[:, :, None], 3, axis=2) if image.ndim == 2 else image


def infrared_image(image: Image) -> NDArray[np.uint8]:
    """Return the first channel as (H, W) uint8.

    Few 16-bit images use their whole range, so their quantile of 99.9 % becomes 255.
    """
    if image.ndim == 3:
        image = image[..., 0]
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image, np.uint8)
    top = max(float(np.quantile(image, 0.999)), 1.0)
    return np.asarray(np.clip(np.rint(image * (255.0 / top)), 0, 255), np.uint8)


@dataclass(frozen=True)
class RgbdFrame:
    """A color image and the depth that a sensor measured for its pixels.

    The sensor's disparity is ``fb / depth`` pixels; the default ``fb`` is the Kinect v1's, 580 pixels x 75 mm.
    """

    color: NDArray[np.uint8]  # (H, W, 3) RGB
    depth: NDArray[np.float32]  # (H, W), meters, NaN = unknown; registered to ``color``
    fb: float = 43.5  # focal length x baseline, pixel meters
    intrinsics: Intrinsics | None = None  # the color camera's
    interpolated: bool = False  # the sensor's map is smaller than ``color``, ``depth`` is interpolated
    pose: NDArray[np.float64] | None = None  # (4, 4), from the camera's coordinates to the world's, meters
    has_color: bool = True  # False: there is no color image, and ``color`` is grey everywhere

    def __post_init__(self) -> None:
        if self.color.ndim != 3 or self.color.shape[2] != 3 or self.color.dtype != np.uint8:
            raise ValueError(f"expected (H, W, 3) uint8 color, got {self.color.shape} {self.color.dtype}")
        if self.depth.shape != self.color.shape[:2] or self.depth.dtype != np.float32:
            raise ValueError(f"expected float32 depth {self.shape}, got {self.depth.shape} {self.depth.dtype}")

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, pixels."""
        return self.color.shape[0], self.color.shape[1]

    @classmethod
    def without_color(cls, depth: NDArray[np.float32], fb: float, intrinsics: Intrinsics | None) -> RgbdFrame:
        """Return the frame of a depth map alone."""
        return cls(np.full((*depth.shape, 3), 128, np.uint8), depth, fb, intrinsics, has_color=False)

    @cached_property
    def disparity(self) -> NDArray[np.float32]:
        """(H, W) float32, ``fb / depth``: affine in (x, y) on planes; pixels, NaN = unknown."""
        return (np.float32(self.fb) / self.depth).astype(np.float32)


@dataclass(frozen=True)
class SparseFrame(RgbdFrame):
    """A frame with a second, sparse depth from another source, for surfaces that the sensor misses or sees through.

    ``sparse``, (H, W) float32, meters, NaN = none, is registered to ``color``; its confidence is higher at more
    reliable samples; ``dense`` is the estimate of the same source at every pixel, reliable or not. ``objects``, (H, W)
    bool, are the pixels of transparent objects, None: not known.
    """

    sparse: NDArray[np.float32] = field(kw_only=True)
    sparse_confidence: NDArray[np.float32] | None = field(default=None, kw_only=True)
    dense: NDArray[np.float32] | None = field(default=None, kw_only=True)
    objects: NDArray[np.bool_] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        for values in (self.sparse, self.sparse_confidence, self.dense):
            if values is not None and (values.shape != self.shape or values.dtype != np.float32):
                raise ValueError(f"expected float32 sparse maps {self.shape}, got {values.shape} {values.dtype}")

"""What the stages of a stereo pipeline hand to each other."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from depthcli.core.maps import DisparityMap

Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class StereoPair:
    """A rectified pair: left ``(y, x)`` matches right ``(y, x - d)`` with ``d >= 0``.

    Attributes
    ----------
    left, right : (H, W) grey or (H, W, 3) RGB, uint8 or uint16, same shape and dtype
    """

    left: Image
    right: Image

    def __post_init__(self) -> None:
        if self.left.shape != self.right.shape:
            raise ValueError(f"left {self.left.shape} and right {self.right.shape} differ in size")
        if self.left.dtype != self.right.dtype or self.left.dtype not in (np.uint8, np.uint16):
            raise TypeError(f"want two uint8 or two uint16 images, got {self.left.dtype}, {self.right.dtype}")
        if self.left.ndim not in (2, 3) or (self.left.ndim == 3 and self.left.shape[2] != 3):
            raise ValueError(f"want (H, W) or (H, W, 3), got {self.left.shape}")

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.left.shape[0], self.left.shape[1]

    @cached_property
    def grey(self) -> tuple[Image, Image]:
        """Both images as (H, W) luma in their own dtype."""
        return _grey(self.left), _grey(self.right)

    @cached_property
    def color8(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Both images as (H, W, 3) uint8 RGB; 16-bit images are scaled, grey ones repeated."""
        return _color8(self.left), _color8(self.right)

    @cached_property
    def grey8(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Both images as (H, W) uint8."""
        left, right = self.grey
        return _eight_bit(left), _eight_bit(right)

    def mirrored(self) -> StereoPair:
        """The pair seen from the right camera: matching it yields the right view's disparities, mirrored."""
        left, right = (np.ascontiguousarray(view[:, ::-1]) for view in (self.right, self.left))
        return StereoPair(cast(Image, left), cast(Image, right))


def _grey(image: Image) -> Image:
    if image.ndim == 2:
        return image
    return cast(Image, cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


def _eight_bit(image: Image) -> NDArray[np.uint8]:
    if image.dtype == np.uint8:
        return image.view(np.uint8)
    return ((image.astype(np.uint32) + 128) // 257).astype(np.uint8)


def _color8(image: Image) -> NDArray[np.uint8]:
    image = _eight_bit(image)
    return np.repeat(image[:, :, None], 3, axis=2) if image.ndim == 2 else image


@dataclass(frozen=True)
class CostVolume:
    """Matching costs of every pixel and disparity; lower is better.

    Attributes
    ----------
    costs : (H, W, D) C-contiguous uint8, uint16 or float32; ``costs[y, x, d]`` compares left (y, x)
        with right (y, x - d). Every cell is finite. Cells with d > x lie outside the right image:
        they hold a neutral cost, and whoever selects or counts disparities skips them.
    scale : stored units per unit of the measure, so that ``costs / scale`` is the measure's cost
    """

    costs: NDArray[Any]
    scale: float = 1.0

    def __post_init__(self) -> None:
        if self.costs.ndim != 3 or not self.costs.flags.c_contiguous:
            raise ValueError("costs must be C-contiguous (H, W, D)")
        if self.costs.dtype not in (np.uint8, np.uint16, np.float32):
            raise TypeError(f"costs must be uint8, uint16 or float32, got {self.costs.dtype}")

    @property
    def disparities(self) -> int:
        """D, the number of disparities searched: 0 .. D - 1."""
        return int(self.costs.shape[2])


@dataclass
class StereoResult:
    """What a stereo pipeline gives back.

    Attributes
    ----------
    disparity : the left view's map
    seconds : time by stage, in order
    confidence : name -> (H, W) float32, higher is surer
    tables : name -> list of rows (dicts), written as CSV
    pictures : name -> (H, W), (H, W, 3) uint8 or (H, W) uint16, written as PNG
    figures : name -> number, added to the scene's row of the report
    """

    disparity: DisparityMap
    seconds: dict[str, float] = field(default_factory=dict)
    confidence: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    tables: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    pictures: dict[str, NDArray[Any]] = field(default_factory=dict)
    figures: dict[str, float] = field(default_factory=dict)

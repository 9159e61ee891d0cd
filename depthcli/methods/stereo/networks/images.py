"""Images as networks take them: range of values, order of channels, layout of the array, padding."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, Tag, model_validator

from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.core.method import ConfigModel
from depthcli.methods.stereo.networks.runtime import Port

ColorOrder = Literal["rgb", "bgr"]

_CHANNELS = (1, 2, 3, 6)

_Moment = Annotated[float, Field(ge=-1e6, le=1e6)]


class MeanDeviation(ConfigModel):
    """Values ``(v - mean) / deviation`` of samples v in [0, 1], with one number for all channels or three, in RGB."""

    mean: tuple[_Moment, ...] = Field(min_length=1, max_length=3, description="of all channels, or of red, green, blue")
    deviation: tuple[_Moment, ...] = Field(min_length=1, max_length=3, description="standard deviations, as mean")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if {len(self.mean), len(self.deviation)} - {1, 3} or min(self.deviation) <= 0:
            raise ValueError("mean and deviation: want one number or three; deviations are above 0")
        return self


def _kind(value: object) -> str:
    return "moments" if isinstance(value, dict | MeanDeviation) else "name"


# With a tag, an error speaks of the one that was meant.
Normalization = Annotated[
    Annotated[Literal["0-255", "0-1", "imagenet", "image"], Tag("name")] | Annotated[MeanDeviation, Tag("moments")],
    Discriminator(_kind),
]
"""Range of the values that a network takes; ``image``: minus their mean over the image, divided by their deviation."""

_IMAGENET = MeanDeviation(mean=(0.485, 0.456, 0.406), deviation=(0.229, 0.224, 0.225))


@dataclass(frozen=True)
class ImageInput:
    """An input that takes images.

    Attributes
    ----------
    channels : 1, 2, 3 or 6; None: any
    channels_last : whether channels are the last axis, (H, W, C), not the first one, (C, H, W)
    size : (H, W); None: any
    """

    port: Port
    channels: int | None
    channels_last: bool
    size: tuple[int | None, int | None]

    @classmethod
    def of(cls, port: Port, model: str) -> ImageInput:
        """Read the layout from the shape of an input: (H, W), (C, H, W), (H, W, C), or four axes with the batch first.

        Raises
        ------
        InputError
            The shape has none of these forms.
        """
        if len(port.shape) == 2:
            return cls(port, 1, False, (port.shape[0], port.shape[1]))
        axes = port.shape[-3:]
        if not 3 <= len(port.shape) <= 4 or (len(port.shape) == 4 and port.shape[0] not in (None, 1)):
            raise InputError(f"{model}: input {port.name} has shape {_shown(port.shape)}; want one image")
        if axes[0] in _CHANNELS or (axes[0] is None and axes[2] not in _CHANNELS):
            return cls(port, axes[0], False, (axes[1], axes[2]))
        if axes[2] in _CHANNELS:
            return cls(port, axes[2], True, (axes[0], axes[1]))
        raise InputError(f"{model}: input {port.name} has shape {_shown(port.shape)}; want 1, 2, 3 or 6 channels")

    def array(self, planes: NDArray[np.float32]) -> NDArray[Any]:
        """Return (C, H, W) ``planes`` in the layout and type of the input."""
        if np.issubdtype(self.port.dtype, np.integer):
            planes = np.clip(np.rint(planes), 0, 255)
        if len(self.port.shape) == 2:
            planes = planes[0]
        elif self.channels_last:
            planes = planes.transpose(1, 2, 0)
        if len(self.port.shape) == 4:
            planes = planes[None]
        return np.ascontiguousarray(planes, self.port.dtype)


def samples(pair: StereoPair, channels: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return both images as (H, W, 1) luma or (H, W, 3) RGB float32 from 0 to 255; grey ones are repeated for 3."""
    if channels == 1:
        images, axes = pair.grey, 1
        top = float(np.iinfo(images[0].dtype).max)
    else:
        top, images, axes = float(pair.top), pair.clamped, 3
    left, right = (np.repeat(image[..., None], axes, axis=2) if image.ndim == 2 else image for image in images)
    factor = np.float32(255.0 / top)
    return left.astype(np.float32) * factor, right.astype(np.float32) * factor


def planes(image: NDArray[np.float32], normalization: Normalization, order: ColorOrder) -> NDArray[np.float32]:
    """Return an (H, W, C) RGB image with values from 0 to 255 as (C, H, W), normalized, in the given order."""
    if normalization == "image":
        deviation = float(image.std(dtype=np.float64))
        values = (image - np.float32(image.mean(dtype=np.float64))) / np.float32(deviation or 1.0)
    elif normalization == "0-255":
        values = image
    elif normalization == "0-1":
        values = image / np.float32(255)
    else:
        moments = _IMAGENET if normalization == "imagenet" else normalization
        mean, deviation_of = (np.array(m, np.float32) for m in (moments.mean, moments.deviation))
        if image.shape[2] == 1:
            mean, deviation_of = mean.mean(keepdims=True), deviation_of.mean(keepdims=True)
        values = (image / np.float32(255) - mean) / deviation_of
    if order == "bgr":
        values = values[..., ::-1]
    return np.ascontiguousarray(values.transpose(2, 0, 1), np.float32)


def resized(image: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    """Return an (H, W) or (H, W, C) image with ``size`` rows and columns: averaged where it shrinks, else linear."""
    if image.shape[:2] == size:
        return image
    shrinks = size[0] <= image.shape[0] and size[1] <= image.shape[1]
    result = cv2.resize(image, (size[1], size[0]), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    return np.asarray(result.reshape(*size, *image.shape[2:]), np.float32)


def padded(image: NDArray[np.float32], multiple: int, margin: int = 0) -> NDArray[np.float32]:
    """Return an (H, W, C) image whose border is repeated outwards.

    Parameters
    ----------
    multiple : which rows and columns then are a multiple of; what is missing is added below and on the right
    margin : pixels added on all sides before
    """
    missing = [-(side + 2 * margin) % multiple for side in image.shape[:2]]
    if not (margin or any(missing)):
        return image
    return np.pad(image, ((margin, margin + missing[0]), (margin, margin + missing[1]), (0, 0)), mode="edge")


def _shown(shape: tuple[int | None, ...]) -> str:
    return " x ".join("?" if size is None else str(size) for size in shape)

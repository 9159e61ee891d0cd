"""Images in messages of ROS: ``sensor_msgs/Image`` and ``sensor_msgs/CompressedImage``, color and depth."""

from __future__ import annotations

import struct
from typing import Any, NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.frames import Image
from depthcli.core.yaml_source import short
from depthcli.io.formats.headers import image_kind
from depthcli.io.formats.images import decode_grey, decode_image, png_bytes

_CONFIG = struct.Struct("<iff")  # of compressedDepth: kind, and two numbers of the quantization of inverse depth


class _Encoding(NamedTuple):
    """Type and number of a pixel's samples; what OpenCV makes RGB of it by, None for nothing."""

    sample: str
    channels: int
    to_rgb: int | None = None


_BAYER = {
    "rggb": cv2.COLOR_BayerRGGB2RGB, "bggr": cv2.COLOR_BayerBGGR2RGB,
    "gbrg": cv2.COLOR_BayerGBRG2RGB, "grbg": cv2.COLOR_BayerGRBG2RGB,
}  # fmt: skip
_ENCODINGS = {
    "mono8": _Encoding("u1", 1), "8uc1": _Encoding("u1", 1),
    "mono16": _Encoding("u2", 1), "16uc1": _Encoding("u2", 1),
    "rgb8": _Encoding("u1", 3), "rgb16": _Encoding("u2", 3),
    "bgr8": _Encoding("u1", 3, cv2.COLOR_BGR2RGB), "8uc3": _Encoding("u1", 3, cv2.COLOR_BGR2RGB),
    "bgr16": _Encoding("u2", 3, cv2.COLOR_BGR2RGB),
    "rgba8": _Encoding("u1", 4, cv2.COLOR_RGBA2RGB), "rgba16": _Encoding("u2", 4, cv2.COLOR_RGBA2RGB),
    "bgra8": _Encoding("u1", 4, cv2.COLOR_BGRA2RGB), "8uc4": _Encoding("u1", 4, cv2.COLOR_BGRA2RGB),
    "bgra16": _Encoding("u2", 4, cv2.COLOR_BGRA2RGB),
    "yuv422": _Encoding("u1", 2, cv2.COLOR_YUV2RGB_UYVY), "uyvy": _Encoding("u1", 2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": _Encoding("u1", 2, cv2.COLOR_YUV2RGB_YUY2), "yuyv": _Encoding("u1", 2, cv2.COLOR_YUV2RGB_YUY2),
    **{f"bayer_{name}8": _Encoding("u1", 1, code) for name, code in _BAYER.items()},
    **{f"bayer_{name}16": _Encoding("u2", 1, code) for name, code in _BAYER.items()},
}  # fmt: skip
_DEPTH_ENCODINGS = {
    "16uc1": _Encoding("u2", 1), "mono16": _Encoding("u2", 1),
    "32fc1": _Encoding("f4", 1), "64fc1": _Encoding("f8", 1),
}  # fmt: skip


class StoredImage(NamedTuple):
    """The file that holds what a message shows.

    Attributes
    ----------
    data : bytes of the file
    suffix : its ending
    shape : (height, width)
    """

    data: bytes
    suffix: str
    shape: tuple[int, int]


def stored_image(message: Any) -> StoredImage:
    """Return the image of a message as a file: as it is where it is compressed already, else as PNG.

    Raises
    ------
    InputError
        The message is damaged, or its encoding is not known.
    """
    pixels = image_of(message)
    shape = (pixels.shape[0], pixels.shape[1])
    if _is_compressed(message) and _mosaic(message) is None:
        data = bytes(message.data)
        suffix = {"jpeg": ".jpg", "png": ".png"}.get(image_kind(data))
        if suffix is not None:
            return StoredImage(data, suffix, shape)
    return StoredImage(png_bytes(pixels), ".png", shape)


def image_of(message: Any) -> Image:
    """Return the image of a message: (H, W) grey or (H, W, 3) RGB, uint8 or uint16.

    Color is made of Bayer patterns and of YUV 4:2:2 by OpenCV; transparency is dropped.

    Raises
    ------
    InputError
        The message is damaged, or its encoding is not known.
    """
    if not _is_compressed(message):
        encoding = _encoding(message, _ENCODINGS)
        return _color(_samples(message, encoding), encoding.to_rgb)
    if "compresseddepth" in str(message.format).lower():
        raise InputError("holds depth (compressedDepth), not an image")
    pixels = decode_image(bytes(message.data))
    mosaic = _mosaic(message)
    return pixels if mosaic is None or pixels.ndim == 3 else _color(pixels[..., None], mosaic)


def depth_of(message: Any) -> NDArray[np.uint16] | NDArray[np.float32]:
    """Return the depth map of a message: (H, W) uint16 codes, 0 = unknown, or (H, W) float32 meters, NaN = unknown.

    Raises
    ------
    InputError
        The message is damaged, or its encoding is none of depth.
    """
    if not _is_compressed(message):
        samples = _samples(message, _encoding(message, _DEPTH_ENCODINGS))[..., 0]
        return samples if samples.dtype == np.uint16 else _meters(samples)
    data, form = bytes(message.data), str(message.format).lower()
    if "compresseddepth" not in form:
        return _codes(data)
    if len(data) < _CONFIG.size:
        raise InputError("truncated: no header of compressedDepth")
    if "rvl" in form:
        raise InputError("depth compressed by RVL cannot be read; record it as compressedDepth with PNG")
    _, scale, offset = _CONFIG.unpack_from(data)
    codes = _codes(data[_CONFIG.size :])
    if "32fc1" not in form:
        return codes
    if not (np.isfinite(scale) and np.isfinite(offset)):
        raise InputError("damaged header of compressedDepth")
    # As compressed_depth_image_transport quantizes: code = scale / depth + offset, 0 = unknown.
    with np.errstate(all="ignore"):
        depth = np.float32(scale) / (codes.astype(np.float32) - np.float32(offset))
    return _meters(np.where(codes > 0, depth, np.float32(np.nan)))


def _codes(data: bytes) -> NDArray[np.uint16]:
    pixels = decode_grey(data)
    if pixels.dtype != np.uint16:
        raise InputError("8-bit samples, want depth of 16 bit")
    return cast("NDArray[np.uint16]", pixels)


def _meters(values: NDArray[Any]) -> NDArray[np.float32]:
    with np.errstate(all="ignore"):
        depth = values.astype(np.float32)
    depth[~((depth > 0) & np.isfinite(depth))] = np.nan
    return depth


def _is_compressed(message: Any) -> bool:
    return not hasattr(message, "encoding")


def _mosaic(message: Any) -> int | None:
    """Return how color is made of a compressed Bayer pattern: ``bayer_rggb8; png compressed bayer_rggb8``."""
    encoding = _ENCODINGS.get(str(message.format).lower().rpartition(" ")[2])
    return None if encoding is None or encoding.channels != 1 else encoding.to_rgb


def _encoding(message: Any, known: dict[str, _Encoding]) -> _Encoding:
    name = str(message.encoding)
    if name.lower() not in known:
        raise InputError(f"encoding {short(name)} cannot be read; known: {', '.join(known)}")
    return known[name.lower()]


def _samples(message: Any, encoding: _Encoding) -> NDArray[Any]:
    """Return the samples of an uncompressed image, (H, W, channels), in the byte order of this machine."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    sample = np.dtype(encoding.sample).newbyteorder(">" if message.is_bigendian else "<")
    row = width * encoding.channels * sample.itemsize
    data = np.asarray(message.data, np.uint8)
    if height < 1 or width < 1:
        raise InputError(f"an image of {width} x {height} pixels")
    if step < row or data.size < step * (height - 1) + row:
        raise InputError(
            f"truncated: {data.size} bytes in rows of {step}, {width} x {height} pixels of {message.encoding} have "
            f"{height} rows of {row}"
        )
    if data.size < step * height:  # the last row may end with its last pixel
        data = np.concatenate([data, np.zeros(step * height - data.size, np.uint8)])
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :row])
    samples = rows.view(sample).reshape(height, width, encoding.channels)
    return samples.astype(sample.newbyteorder("="))


def _color(samples: NDArray[Any], to_rgb: int | None) -> Image:
    if to_rgb is None:
        return cast(Image, np.ascontiguousarray(samples[..., 0] if samples.shape[2] == 1 else samples))
    height, width, channels = samples.shape
    if channels < 3 and (width % 2 or height % 2 or min(height, width) < 2):
        raise InputError(f"{width} x {height} pixels, want even numbers of a color pattern")
    return cast(Image, np.ascontiguousarray(cv2.cvtColor(samples[..., 0] if channels == 1 else samples, to_rgb)))

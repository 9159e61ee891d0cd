"""Format of scenes on the page: arrays as deflated 16-bit codes in base64, pictures as data URIs, one file per scene.

``page.js`` unpacks the arrays.
"""

from __future__ import annotations

import base64
import json
import math
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.io.formats.files import write_text

Packed = dict[str, Any]

_JPEG_QUALITY = 88  # at which artifacts are not visible beneath a map
_DEFLATE_LEVEL = 4  # of zlib; higher ones take several times as long for a few percent
_MAX_CODE = 65535


def pack(values: NDArray[np.floating[Any]], low: float, high: float, levels: int = _MAX_CODE) -> Packed:
    """Return (H, W) numbers as 16-bit codes: ``value = origin + code * step``, and code 0 for NaN.

    Values in [low, high] span at most ``levels`` codes. Values outside have the same step down to code 1 and up to
    code 65535, where they are clipped. The step is a power of two, so that disparities in 256ths of a pixel, or depths
    in millimeters, are exact if the range allows it.

    Returns
    -------
    ``height``, ``width``, ``data`` (base64 of deflated codes), ``bits`` (16), ``origin``, ``step``
    """
    step = 2.0 ** math.ceil(math.log2(max(high - low, 1e-6) / (levels - 8)))
    return _packed(values, (math.floor(low / step) - 3) * step, step)


def _packed(values: NDArray[np.floating[Any]], origin: float, step: float) -> Packed:
    known = ~np.isnan(values)
    # Codes of infinite values are clipped; NaN is overwritten.
    with np.errstate(invalid="ignore", over="ignore"):
        scaled = np.clip(np.rint((values.astype(np.float64) - origin) / step), 1, _MAX_CODE)
    codes = np.where(known, scaled, 0).astype(np.uint16)
    # Differences have small high bytes, and alike bytes together deflate well.
    steps = np.diff(codes.ravel(), prepend=np.uint16(0))
    data = np.concatenate([(steps & 255).astype(np.uint8), (steps >> 8).astype(np.uint8)])
    return {**_deflated(data, values.shape), "bits": 16, "origin": origin, "step": step}


def pack_bytes(values: NDArray[np.uint8] | NDArray[np.bool_]) -> Packed:
    """Return an (H, W) array of small integers, unchanged in value."""
    return {**_deflated(values.astype(np.uint8).ravel(), values.shape), "bits": 8}


def _deflated(data: NDArray[np.uint8], shape: tuple[int, ...]) -> Packed:
    text = base64.b64encode(zlib.compress(data.tobytes(), _DEFLATE_LEVEL)).decode("ascii")
    return {"height": shape[0], "width": shape[1], "data": text}


def unpack(packed: Packed) -> NDArray[Any]:
    """Return the array as the page's script unpacks it: float64 with NaN, or uint8."""
    data = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"])), np.uint8)
    shape = (packed["height"], packed["width"])
    if packed["bits"] == 8:
        return data.reshape(shape)
    codes = np.cumsum(data[: data.size // 2] + data[data.size // 2 :].astype(np.uint16) * 256, dtype=np.uint16)
    values = np.where(codes > 0, packed["origin"] + codes * packed["step"], np.nan)
    return values.reshape(shape)


def thinned(value: Any, factor: int) -> Any:
    """Return packed arrays, alone or in dictionaries, of every ``factor``-th pixel; anything else as it is."""
    if not isinstance(value, dict):
        return value
    if "data" not in value:
        return {name: thinned(inner, factor) for name, inner in value.items()}
    values = unpack(value)[::factor, ::factor]
    return value | (pack_bytes(values) if value["bits"] == 8 else _packed(values, value["origin"], value["step"]))


def smaller(data: dict[str, Any], factor: int) -> dict[str, Any]:
    """Return the data of a scene with every ``factor``-th pixel."""
    views = []
    for view in data["views"]:
        height, width = (-(-view[side] // factor) for side in ("height", "width"))
        views.append(thinned(view, factor) | {"height": height, "width": width, "factor": factor})
        if view["image"] is not None:
            code = np.frombuffer(base64.b64decode(view["image"].partition(",")[2]), np.uint8)
            picture = cv2.imdecode(code, cv2.IMREAD_COLOR)
            assert picture is not None  # it was written here
            views[-1]["image"] = jpeg(np.asarray(cv2.resize(picture, (width, height))[..., ::-1], np.uint8))
    return {**data, "views": views}


def jpeg(picture: NDArray[np.uint8]) -> str:
    """Return an (H, W, 3) RGB picture as the data URI of a JPEG."""
    code = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
    return f"data:image/jpeg;base64,{base64.b64encode(code.tobytes()).decode('ascii')}"


def png(picture: NDArray[np.uint8]) -> str:
    """Return an (H, W, 3) RGB picture, or (H, W) grey levels, as the data URI of a PNG of three channels."""
    code = cv2.imencode(".png", picture[..., ::-1] if picture.ndim == 3 else np.dstack([picture] * 3))[1]
    return f"data:image/png;base64,{base64.b64encode(code.tobytes()).decode('ascii')}"


class PackedScene(NamedTuple):
    """The data of a scene in a script, which the page loads if they do not fit into the page."""

    file: Path
    size: int  # characters

    @classmethod
    def write(cls, file: Path, data: dict[str, Any]) -> PackedScene:
        text = f'depthcli("{file.stem}", {script_json(json.dumps(data))});\n'
        write_text(file, text)
        return cls(file, len(text))

    def embedded(self, factor: int) -> str:
        """Return the data with every ``factor``-th pixel, as JSON for a script element."""
        text = self.file.read_text("utf-8")
        data = text[text.index("{") : text.rindex("}") + 1]
        return data if factor == 1 else script_json(json.dumps(smaller(json.loads(data), factor)))


def script_json(text: str) -> str:
    r"""Return JSON that cannot end its script element: ``<``, which only strings have, is written as ``\u003c``."""
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")

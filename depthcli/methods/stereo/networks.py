"""Networks in ONNX files, run by onnxruntime: the common parts of ``pipeline: onnx`` and ``cost: onnx``.

A :class:`Network` names a file, which its ``session`` opens. The :func:`samples` of a pair are :func:`normalized` and
:func:`padded` as (H, W, C); :meth:`ImageInput.array` gives them the network's layout, :meth:`Session.run` runs it.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import re
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Discriminator, Field, PrivateAttr, Tag, model_validator

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Floats
from depthcli.core.method import ConfigModel, Method, parts_of
from depthcli.kernels.jit import n_threads

_TYPES = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(uint8)": np.uint8,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
}
# A tensor's external data in a protocol buffer: "location", then the size of a path, then the path.
_LOCATION = re.compile(rb"\n\x08location\x12([\x80-\xff]?[\x01-\x7f])")
_CUDA = "CUDAExecutionProvider"
_CHANNELS = (1, 2, 3, 6)


class Network(Method):
    """A method that runs a network: its file, and the device that it runs on."""

    model: str = Field(min_length=1, description="file of the network, .onnx; from the current folder")
    _device: str = PrivateAttr("cpu")

    @property
    def session(self) -> Session:
        """The network, opened once per process and content. Raise InputError if it cannot run on its device."""
        try:
            changed = tuple(os.stat(file).st_mtime_ns for file in self.used_files().values())
        except OSError as error:
            raise InputError(f"{error.filename}: network cannot be read ({error.strerror})") from error
        return _open_session(self.model, changed, self._device, n_threads())

    def prepare(self, device: str) -> None:
        """Choose the network's device, ``cpu`` or ``cuda:N``, and check it there. Raise InputError if it cannot run."""
        self._device = device
        self.check()

    def used_files(self) -> dict[str, Path]:
        """Return role -> file: the network, and the weight files that it names (ONNX: external data)."""
        path, names = Path(self.model), tuple[str, ...]()
        with contextlib.suppress(OSError):  # opening it raises the error
            names = _weight_files(path, os.stat(path).st_mtime_ns)
        return {"model": path} | {f"model/{name}": path.parent / name for name in names}

    @abstractmethod
    def check(self) -> None:
        """Raise InputError if the network cannot be used."""


@lru_cache(maxsize=4)
def _weight_files(model: Path, changed: int) -> tuple[str, ...]:
    """Return the names of the weight files that a network names, relative to its folder, sorted."""
    if not model.stat().st_size:
        return ()
    with open(model, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        ends = [(found.end(), found[1]) for found in _LOCATION.finditer(data)]
        sizes = [sum((byte & 127) << 7 * k for k, byte in enumerate(varint)) for _, varint in ends]
        return tuple(sorted({os.fsdecode(data[end : end + n]) for (end, _), n in zip(ends, sizes, strict=True)}))


def networks_in(config: BaseModel) -> list[Network]:
    """Return all networks of a config, at any depth."""
    return [part for part in parts_of(config) if isinstance(part, Network)]


def network_device(name: str) -> str:
    """Return the networks' device, ``cpu`` or ``cuda:N``, from ``--device``. Raise ConfigError for other kinds."""
    if name == "auto":
        return "cuda:0" if _CUDA in _onnxruntime().get_available_providers() else "cpu"
    kind, _, number = name.partition(":")
    if name != "cpu" and (kind != "cuda" or not (number.isdigit() or name == kind)):
        raise ConfigError(f"--device {name}: networks run on cpu, cuda or cuda:N; auto takes cuda if it is there")
    return f"cuda:{number or 0}" if kind == "cuda" else "cpu"


class ImageInput(NamedTuple):
    """An input for images of 1, 2, 3 or 6 ``channels`` and (H, W) ``size``; None: any."""

    name: str
    dtype: np.dtype[Any]
    n_axes: int  # 2: (H, W); 3: channels first or last; 4: a batch of one
    channels: int | None
    channels_last: bool
    size: tuple[int | None, int | None]

    def array(self, image: Floats) -> NDArray[Any]:
        """Return an (H, W, C) image in the layout and type of the input."""
        if np.issubdtype(self.dtype, np.integer):
            image = np.clip(np.rint(image), 0, 255)
        image = image[..., 0] if self.n_axes == 2 else image if self.channels_last else image.transpose(2, 0, 1)
        return np.ascontiguousarray(image[None] if self.n_axes == 4 else image, self.dtype)


@dataclass(frozen=True, eq=False)
class Session:
    """A network that is ready to run; several threads may use it at a time."""

    model: str  # its file
    images: tuple[ImageInput, ...]
    counts: dict[str, NDArray[Any]]  # scalar integer inputs: name -> 1 in their shape and type
    inference: Any

    def run(self, values: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return output name -> array, without a batch of one, in the network's order. Raise InputError if it fails."""
        names = [output.name for output in self.inference.get_outputs()]
        try:
            arrays = self.inference.run(names, dict(values))
        except Exception as error:  # onnxruntime has one exception for each code of its C interface
            shapes = ", ".join(f"{name} {value.shape}" for name, value in values.items())
            raise InputError(f"{self.model}: the network fails for {shapes}: {_first_line(error)}") from error
        arrays = [array[0] if array.ndim == 4 and len(array) == 1 else array for array in arrays]
        return dict(zip(names, arrays, strict=True))


@lru_cache(maxsize=4)
def _open_session(model: str, changed: tuple[int, ...], device: str, threads: int) -> Session:
    # In all networks that were measured (32-bit and 8-bit convolutions), outputs had the same bytes at any number of
    # threads; onnxruntime does not promise it for every operation.
    runtime = _onnxruntime()
    providers: list[Any] = ["CPUExecutionProvider"]
    if device != "cpu":
        if _CUDA not in runtime.get_available_providers():
            raise InputError(f"--device {device}: this onnxruntime has no CUDA; install onnxruntime-gpu instead of it")
        providers.insert(0, (_CUDA, {"device_id": int(device.partition(":")[2])}))
    options = runtime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.log_severity_level = 4  # failures are raised anyway
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # leaves the CPU to other workers
    try:
        inference = runtime.InferenceSession(model, options, providers=providers)
    except Exception as error:  # as above
        raise InputError(f"{model}: not a network that onnxruntime can run ({_first_line(error)})") from error
    if device != "cpu" and _CUDA not in inference.get_providers():
        raise InputError(f"--device {device}: onnxruntime cannot use it; are CUDA and cuDNN of its version installed?")
    images, counts = [], {}
    for port in inference.get_inputs():
        dtype = np.dtype(_TYPES.get(port.type, object))
        shape = tuple(size if isinstance(size, int) and size > 0 else None for size in port.shape)
        if dtype in (np.int32, np.int64) and len(shape) < 2:
            counts[port.name] = np.ones([1] * len(shape), dtype)
        elif port.type not in _TYPES or (layout := _layout(shape)) is None:
            shown = " x ".join("?" if size is None else str(size) for size in shape)
            raise InputError(
                f"{model}: input {port.name}, {port.type} {shown}, takes no image; expected 1, 2, 3 or 6 channels"
            )
        else:
            images.append(ImageInput(port.name, dtype, len(shape), *layout))
    return Session(model, tuple(images), counts, inference)


def _layout(shape: tuple[int | None, ...]) -> tuple[int | None, bool, tuple[int | None, int | None]] | None:
    """Return channels, whether they are last, and size of (H, W), (C, H, W), (H, W, C) or a batch of one; or None."""
    if len(shape) == 2:
        return 1, False, (shape[0], shape[1])
    if len(shape) != 3 and (len(shape) != 4 or shape[0] not in (None, 1)):
        return None
    first, middle, last = shape[-3:]
    if first in _CHANNELS or (first is None and last not in _CHANNELS):
        return first, False, (middle, last)
    return (last, True, (first, middle)) if last in _CHANNELS else None


def _onnxruntime() -> Any:
    try:
        import onnxruntime
    except ImportError as error:
        raise InputError("networks need the package onnxruntime: pip install 'depthcli[onnx]'") from error
    return onnxruntime


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0][:300]


ColorOrder = Literal["rgb", "bgr"]
_Moment = Annotated[float, Field(ge=-1e6, le=1e6)]


class MeanDeviation(ConfigModel):
    """Values ``(v - mean) / deviation`` of samples v in [0, 1], with one number for all channels or three, in RGB."""

    mean: tuple[_Moment, ...] = Field(
        min_length=1, max_length=3, description="mean of all channels, or of red, green, blue"
    )
    deviation: tuple[_Moment, ...] = Field(
        min_length=1, max_length=3, description="standard deviation of all channels, or of red, green, blue"
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if {len(self.mean), len(self.deviation)} - {1, 3} or min(self.deviation) <= 0:
            raise ValueError("mean and deviation: expected one number or three; deviations are above 0")
        return self


Normalization = Annotated[
    Annotated[Literal["0-255", "0-1", "imagenet", "image"], Tag("name")] | Annotated[MeanDeviation, Tag("moments")],
    Discriminator(lambda value: "moments" if isinstance(value, dict | MeanDeviation) else "name"),
]
"""Range of the values that a network takes; ``image``: their mean over the image is 0, their deviation 1."""

_MOMENTS = {
    "0-1": MeanDeviation(mean=(0.0,), deviation=(1.0,)),
    "imagenet": MeanDeviation(mean=(0.485, 0.456, 0.406), deviation=(0.229, 0.224, 0.225)),
}


def samples(pair: StereoPair, view: int, channels: int) -> Floats:
    """Return the left (0) or right (1) image as (H, W, 1) luma or (H, W, 3) RGB from 0 to 255; grey is repeated."""
    image, top = (pair.clamped if channels == 3 else pair.grey)[view], pair.top
    if channels == 1:
        top = int(np.iinfo(image.dtype).max)
    levels = np.repeat(image[..., None], channels, axis=2) if image.ndim == 2 else image
    return levels.astype(np.float32) * np.float32(255.0 / top)


def normalized(image: Floats, normalization: Normalization, order: ColorOrder) -> Floats:
    """Return an (H, W, C) RGB image with values from 0 to 255 normalized, its channels in the given order."""
    if normalization == "image":
        deviation = float(image.std(dtype=np.float64))
        image = (image - np.float32(image.mean(dtype=np.float64))) / np.float32(deviation or 1.0)
    elif normalization != "0-255":
        moments = _MOMENTS[normalization] if isinstance(normalization, str) else normalization
        mean, deviations = (np.array(m, np.float32) for m in (moments.mean, moments.deviation))
        if image.shape[2] == 1:
            mean, deviations = mean.mean(keepdims=True), deviations.mean(keepdims=True)
        image = (image / np.float32(255) - mean) / deviations
    return image[..., ::-1] if order == "bgr" else image


def padded(image: Floats, multiple: int, margin: int = 0) -> Floats:
    """Return an (H, W, C) image with ``margin`` more pixels on all sides, and sides that are a ``multiple``.

    The border is repeated outwards; pixels that complete the multiple are added below and on the right.
    """
    missing = [-(side + 2 * margin) % multiple for side in image.shape[:2]]
    return np.pad(image, ((margin, margin + missing[0]), (margin, margin + missing[1]), (0, 0)), mode="edge")

"""Devices beside the processor that run kernels: GPUs, through OpenCL or CUDA.

Kernels are written once, in OpenCL C with about ten macros (``dialect.py``); ``opencl.py`` builds that text with
pyopencl, ``cuda.py`` with CuPy. Both are optional and imported only where a device is asked for.
"""

from __future__ import annotations

import importlib.resources
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from depthcli.core.errors import ConfigError, DepthcliError

KINDS = ("opencl", "cuda")
"""Ways to reach a device, in the order in which ``auto`` tries them."""


class DeviceError(DepthcliError):
    """A device is missing, or failed."""


@dataclass(frozen=True)
class DeviceInfo:
    """What is known of a device without using it.

    Attributes
    ----------
    address : how ``--device`` names it, such as ``opencl:0``
    name : by its driver
    memory : bytes
    is_gpu : rather than a processor behind a driver
    driver : platform and version
    """

    address: str
    name: str
    memory: int
    is_gpu: bool
    driver: str


@dataclass(frozen=True)
class DeviceArray:
    """A C-contiguous array in the memory of a device.

    Attributes
    ----------
    handle : the back end's own buffer
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    handle: Any

    @property
    def size(self) -> int:
        """Number of elements."""
        return int(np.prod(self.shape, dtype=np.int64))

    @property
    def nbytes(self) -> int:
        """Bytes of the elements."""
        return self.size * self.dtype.itemsize


class Kernels:
    """The kernels of one or more files of C text, with macros of their own.

    Parameters
    ----------
    package : of the files
    files : names, in the order in which they are joined
    macros : name -> value, defined before the text
    """

    def __init__(self, package: str, *files: str, **macros: str | int) -> None:
        self._package = package
        self._files = files
        self._macros = macros
        self._variants: dict[tuple[tuple[str, str | int], ...], Kernels] = {}

    def with_macros(self, **macros: str | int) -> Kernels:
        """The same text with other macros beside those that it has: one object for one set of macros."""
        key = tuple(sorted(macros.items()))
        if key not in self._variants:
            self._variants[key] = Kernels(self._package, *self._files, **{**self._macros, **macros})
        return self._variants[key]

    @cached_property
    def text(self) -> str:
        """Macros and files."""
        from depthcli.device.dialect import COMMON

        folder = importlib.resources.files(self._package)
        lines = [f"#define {name} {value}\n" for name, value in sorted(self._macros.items())]
        return "".join([*lines, COMMON, *(folder.joinpath(name).read_text("utf-8") for name in self._files)])


@dataclass(frozen=True)
class Launch:
    """A kernel that ran.

    Attributes
    ----------
    seconds : on the device
    nbytes : of the arrays that it was given, each counted once: what it moves at least
    """

    name: str
    seconds: float
    nbytes: int


class Device(ABC):
    """A device with one queue: what is asked of it happens in order."""

    def __init__(self, info: DeviceInfo) -> None:
        self.info = info
        self.profile: list[Launch] | None = None
        """Where a list, ``finish`` adds to it what was launched since the last one."""

    @abstractmethod
    def upload(self, array: NDArray[Any]) -> DeviceArray:
        """A copy of ``array`` on the device."""

    @abstractmethod
    def download(self, array: DeviceArray) -> NDArray[Any]:
        """A copy of ``array`` on the host; waits for it."""

    @abstractmethod
    def empty(self, shape: Sequence[int], dtype: DTypeLike) -> DeviceArray:
        """An uninitialized array. DeviceError where there is no room."""

    @abstractmethod
    def launch(self, kernels: Kernels, name: str, size: Sequence[int], group: Sequence[int], *arguments: Any) -> None:
        """Run a kernel.

        Parameters
        ----------
        size : threads wanted in up to three dimensions, the fastest first; rounded up to whole groups
        group : threads of a group in the same dimensions
        arguments : arrays of this device; int (32 bit), float (32 bit) or NumPy scalars
        """

    @abstractmethod
    def finish(self) -> None:
        """Wait until all is done."""

    @property
    @abstractmethod
    def local_memory(self) -> int:
        """Bytes that a group's threads share."""

    @property
    @abstractmethod
    def has_double(self) -> bool:
        """Kernels may use double precision."""

    def bandwidth(self) -> float:
        """Bytes a second that a kernel moves which copies a large array (both ways counted)."""
        from depthcli.device.dialect import COPY

        count = min(32 << 20, self.info.memory // 64)
        source, target = self.empty((count,), np.uint32), self.empty((count,), np.uint32)
        before, self.profile = self.profile, []
        for _ in range(4):
            self.launch(COPY, "copy", (count,), (256,), source, target, count)
        self.finish()
        seconds = min(launch.seconds for launch in self.profile)
        self.profile = before
        return 2 * source.nbytes / seconds


def bytes_of(arguments: Sequence[Any]) -> int:
    """Of the arrays among a kernel's arguments."""
    return sum(argument.nbytes for argument in arguments if isinstance(argument, DeviceArray))


def devices() -> list[DeviceInfo]:
    """All devices that the installed packages and drivers show, GPUs first."""
    found = [info for kind in KINDS for info in _backend(kind).list_devices()]
    return sorted(found, key=lambda info: not info.is_gpu)


def why_none() -> str:
    """Why a kind shows no device, for each that shows none."""
    return "; ".join(f"{kind}: {_backend(kind).why_none()}" for kind in KINDS if not _backend(kind).list_devices())


def find_device(wanted: str) -> DeviceInfo | None:
    """The device that ``wanted`` names, None for the processor.

    Parameters
    ----------
    wanted : cpu; auto (the first GPU, else the processor); opencl or cuda (the first of the kind, GPUs first), or
        with a number, such as ``opencl:1``

    Raises
    ------
    ConfigError
        No such kind.
    DeviceError
        There is no such device.
    """
    if wanted == "cpu":
        return None
    if wanted == "auto":
        return next((info for info in devices() if info.is_gpu), None)
    kind, _, number = wanted.partition(":")
    if kind not in KINDS or not (number.isdigit() or wanted == kind):
        raise ConfigError(f"--device {wanted}: want cpu, auto, opencl or cuda, or one of several by opencl:N, cuda:N")
    found: list[DeviceInfo] = _backend(kind).list_devices()
    for info in sorted(found, key=lambda info: not info.is_gpu):
        if info.address == wanted or wanted == kind:
            return info
    if found:
        raise DeviceError(f"--device {wanted}: there is none; there are {', '.join(i.address for i in found)}")
    raise DeviceError(f"--device {wanted}: no device: {_backend(kind).why_none()}")


_open: dict[str, Device] = {}


def open_device(wanted: str) -> Device | None:
    """The device that ``wanted`` names, opened once in a process; None for the processor.

    Raises
    ------
    ConfigError, DeviceError
        As :func:`find_device`; the driver fails.
    """
    info = find_device(wanted)
    if info is None:
        return None
    if info.address not in _open:
        _open[info.address] = _backend(info.address.partition(":")[0]).open_device(info)
    return _open[info.address]


def _backend(kind: str) -> Any:
    return importlib.import_module(f"depthcli.device.{kind}")

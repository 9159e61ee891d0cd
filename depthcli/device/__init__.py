"""Devices beside the processor that run kernels: GPUs, through OpenCL or CUDA.

Start at :func:`open_device`: the text of ``--device`` -> a :class:`Device`, to and from which arrays are copied
(``upload``, ``download``) and on which kernels run (``launch``; ``finish`` waits for them). Without opening any,
:func:`devices` lists all and :func:`find_device` says which one a text names, as :class:`DeviceInfo`.

| module | what it holds |
|---|---|
| ``dialect`` | ``Kernels``: C text that is written once, in OpenCL C, and macros by which CUDA understands it |
| ``opencl``, ``cuda`` | one back end each, through pyopencl or CuPy: optional packages, imported at the first request |
"""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from depthcli.core.errors import ConfigError, DepthcliError
from depthcli.device.dialect import Kernels as Kernels

KINDS = ("opencl", "cuda")
"""Ways to reach a device, in the order in which ``auto`` tries them."""
_BENCHMARKS = Kernels("depthcli.device", "benchmarks.cl")


class DeviceError(DepthcliError):
    """A device is missing, or failed."""


@dataclass(frozen=True)
class DeviceInfo:
    """What is known of a device without using it."""

    address: str  # how ``--device`` names it, such as ``opencl:0``
    name: str  # what its driver calls it
    memory: int  # size of its memory, bytes
    is_gpu: bool  # False for a processor that a driver shows as a device (PoCL)
    driver: str  # its platform and version, for the user


@dataclass(frozen=True)
class DeviceArray:
    """A C-contiguous array in the memory of a device."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    handle: Any  # the back end's own buffer

    @property
    def size(self) -> int:
        """Return the number of elements."""
        return int(np.prod(self.shape, dtype=np.int64))

    @property
    def nbytes(self) -> int:
        """Return the size of all elements together, bytes."""
        return self.size * self.dtype.itemsize


@dataclass(frozen=True)
class Launch:
    """The timing of one run of a kernel."""

    name: str
    seconds: float  # on the device
    nbytes: int  # of all arrays among its arguments, each counted once: a lower bound of the memory traffic


class Driver(ABC):
    """A back end's way to one device. Methods raise whatever the package behind it raises, or DeviceError."""

    errors: tuple[type[Exception], ...] = (Exception,)  # of the package; they become DeviceError
    has_double = True  # whether kernels may use double precision

    @abstractmethod
    def allocate(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Any:
        """Return the back end's own uninitialized buffer."""

    @abstractmethod
    def copy_to_device(self, target: Any, array: NDArray[Any]) -> None: ...

    @abstractmethod
    def copy_to_host(self, target: NDArray[Any], source: Any) -> None: ...

    @abstractmethod
    def compile(self, kernels: Kernels, name: str) -> Any:
        """Return the back end's own kernel."""

    @abstractmethod
    def enqueue(
        self, kernel: Any, n_groups: tuple[int, ...], group: tuple[int, ...], arguments: list[Any], timed: bool
    ) -> Any:
        """Enqueue the kernel; return what :meth:`seconds` needs where it is ``timed``."""

    @abstractmethod
    def wait(self) -> None: ...

    @abstractmethod
    def seconds(self, event: Any) -> float:
        """Return how long a finished kernel ran."""

    def message(self, error: Exception) -> str:
        """Return the rest of a sentence about the device that failed."""
        return f"failed: {first_line(error)}"


class Device:
    """A device with one queue: commands run in the order in which they are given.

    Every method raises DeviceError where the driver fails, or the device has too little memory.
    """

    def __init__(self, info: DeviceInfo, driver: Driver) -> None:
        self.info = info
        self.has_double = driver.has_double
        self.launches: list[Launch] | None = None
        """Timings of the kernels that ran. None: no timings are taken. To take them, assign a list: every call of
        :meth:`finish` appends the kernels since the last one."""
        self._driver = driver
        self._kernels: dict[tuple[Kernels, str], Any] = {}
        self._events: list[tuple[str, Any, int]] = []

    def upload(self, array: NDArray[Any]) -> DeviceArray:
        """Return a copy of ``array`` on the device."""
        array = np.ascontiguousarray(array)
        target = self.empty(array.shape, array.dtype)
        if array.size:
            self._guarded(self._driver.copy_to_device, target.handle, array)
        return target

    def download(self, array: DeviceArray) -> NDArray[Any]:
        """Return a copy of ``array`` on the host; waits for the kernels that compute it."""
        target: NDArray[Any] = np.empty(array.shape, array.dtype)
        if array.size:
            self._guarded(self._driver.copy_to_host, target, array.handle)
        return target

    def empty(self, shape: Sequence[int], dtype: DTypeLike) -> DeviceArray:
        """Return an uninitialized array."""
        sizes, kind = tuple(int(n) for n in shape), np.dtype(dtype)
        return DeviceArray(sizes, kind, self._guarded(self._driver.allocate, sizes, kind))

    def launch(self, kernels: Kernels, name: str, size: Sequence[int], group: Sequence[int], *arguments: Any) -> None:
        """Enqueue a kernel and return at once; its first launch compiles it.

        ``size`` is the number of threads along up to three dimensions, the fastest first, rounded up to whole groups;
        ``group`` that of a group. Arguments are arrays of this device, int (passed as 32 bits), float (as 32 bits) or
        NumPy scalars.
        """
        kernel = self._kernels.get((kernels, name))
        if kernel is None:
            kernel = self._kernels[kernels, name] = self._guarded(self._driver.compile, kernels, name)
        n_groups = tuple(-(-int(n) // g) for n, g in zip(size, group, strict=True))
        if 0 in n_groups:
            return
        values, timed = [_argument(a) for a in arguments], self.launches is not None
        event = self._guarded(self._driver.enqueue, kernel, n_groups, tuple(group), values, timed)
        if timed:
            nbytes = sum(argument.nbytes for argument in arguments if isinstance(argument, DeviceArray))
            self._events.append((name, event, nbytes))

    def finish(self) -> None:
        """Wait until all commands are done, and take the timings that :attr:`launches` asks for."""
        events, self._events = self._events, []
        self._guarded(self._driver.wait)
        if self.launches is not None:
            for name, event, nbytes in events:
                self.launches.append(Launch(name, self._guarded(self._driver.seconds, event), nbytes))

    def measure_bandwidth(self) -> float:
        """Measure the bandwidth of the device's memory by copying a large array: bytes read and written per second."""
        count = min(32 << 20, self.info.memory // 64)
        source, target = self.empty((count,), np.uint32), self.empty((count,), np.uint32)
        return 2 * source.nbytes / self._shortest("copy", count, source, target)

    def measure_operations(self) -> float:
        """Measure the rate of 32-bit multiplications and additions by chains of both: operations per second."""
        count = 1 << 20
        return 64 * 8 * 4 * 2 * count / self._shortest("multiply_add", count, self.empty((count,), np.float32), 0.5)

    def _shortest(self, name: str, count: int, *arguments: Any) -> float:
        launches_before, self.launches = self.launches, []
        for _ in range(4):
            self.launch(_BENCHMARKS, name, (count,), (256,), *arguments, count)
        self.finish()
        seconds = min(launch.seconds for launch in self.launches)
        self.launches = launches_before
        return seconds

    def _guarded(self, action: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return action(*arguments)
        except DeviceError as error:
            raise DeviceError(f"{self.info.address} ({self.info.name}) {error}") from error
        except self._driver.errors as error:
            raise DeviceError(f"{self.info.address} ({self.info.name}) {self._driver.message(error)}") from error


def first_line(error: Exception) -> str:
    """Return the first line of a driver's message."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def _argument(value: Any) -> Any:
    if isinstance(value, DeviceArray):
        return value.handle
    if isinstance(value, int):
        return np.int32(value)
    return np.float32(value) if isinstance(value, float) else value


def devices() -> list[DeviceInfo]:
    """Return all devices that the installed packages and drivers know, GPUs first."""
    found = [info for kind in KINDS for info in _backend(kind).list_devices()]
    return sorted(found, key=lambda info: not info.is_gpu)


def why_no_device() -> str:
    """Return, for each of OpenCL and CUDA that has no device here, the reason; "" where both have one."""
    return "; ".join(f"{kind}: {_backend(kind).why_no_device()}" for kind in KINDS if not _backend(kind).list_devices())


def find_device(wanted: str) -> DeviceInfo | None:
    """Return the device that ``wanted`` names; None for the processor.

    ``cpu``; ``auto``: the first GPU, else the processor; ``opencl`` or ``cuda``: the first device of this kind, GPUs
    first; ``opencl:1``: the device with this address. ConfigError where it is none of these, DeviceError where no such
    device is there.
    """
    if wanted == "cpu":
        return None
    if wanted == "auto":
        return next((info for info in devices() if info.is_gpu), None)
    kind, _, number = wanted.partition(":")
    if kind not in KINDS or not (number.isdigit() or wanted == kind):
        raise ConfigError(f"device {wanted}: want cpu, auto, opencl or cuda, or one of several by opencl:N, cuda:N")
    found: list[DeviceInfo] = _backend(kind).list_devices()
    for info in sorted(found, key=lambda info: not info.is_gpu):
        if info.address == wanted or wanted == kind:
            return info
    if found:
        raise DeviceError(f"device {wanted}: there is none; there are {', '.join(i.address for i in found)}")
    raise DeviceError(f"device {wanted}: no device: {_backend(kind).why_no_device()}")


_open: dict[str, Device] = {}


def open_device(wanted: str) -> Device | None:
    """Open the device that ``wanted`` names, see :func:`find_device`, once per process; None for the processor."""
    info = find_device(wanted)
    if info is None:
        return None
    if info.address not in _open:
        _open[info.address] = Device(info, _backend(info.address.partition(":")[0]).open_driver(info))
    return _open[info.address]


def _backend(kind: str) -> Any:
    return importlib.import_module(f"depthcli.device.{kind}")

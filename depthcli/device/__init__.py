"""Devices other than the CPU that run kernels: GPUs, through OpenCL or CUDA.

:func:`open_device` returns the :class:`Device` for the value of ``--device``; :func:`devices` lists all devices without
opening them. Kernels are written once, in OpenCL C with macros for CUDA (``dialect``). The back ends are ``opencl`` and
``cuda``; their packages are imported at the first request.
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
    """Raised if a device is missing or fails."""


@dataclass(frozen=True)
class DeviceInfo:
    """Properties of a device that are known without using it."""

    address: str  # its value of ``--device``, e.g. ``opencl:0``
    name: str  # its name in the driver
    memory: int  # size of its memory, bytes
    is_gpu: bool  # False for a CPU that a driver shows as a device (PoCL)
    driver: str  # platform and version, for the user


@dataclass(frozen=True)
class DeviceArray:
    """A C-contiguous array in the memory of a device."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    handle: Any  # the back end's buffer

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
    nbytes: int  # size of all array arguments, each counted once: a lower bound of the memory traffic


class Device(ABC):
    """A device with one queue, which runs commands in their order.

    Every public method raises DeviceError if the driver fails or the device has too little memory. A back end
    implements the abstract methods; the exceptions of its package (``errors``) are translated here.
    """

    errors: tuple[type[Exception], ...] = (Exception,)
    has_double = True
    """Whether kernels may use double precision."""

    def __init__(self, info: DeviceInfo) -> None:
        self.info = info
        self.launches: list[Launch] | None = None
        """Timings of kernels; None: no timings are taken.

        To take timings, assign a list. Every call of :meth:`finish` appends the kernels since the previous call.
        """
        self._kernels: dict[tuple[Kernels, str], Any] = {}
        self._events: list[tuple[str, Any, int]] = []

    @abstractmethod
    def _allocate(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Any: ...

    @abstractmethod
    def _write(self, target: Any, array: NDArray[Any]) -> None: ...

    @abstractmethod
    def _read(self, target: NDArray[Any], source: Any) -> None: ...

    @abstractmethod
    def _compile(self, kernels: Kernels, name: str) -> Any: ...

    @abstractmethod
    def _enqueue(
        self, kernel: Any, n_groups: tuple[int, ...], group: tuple[int, ...], arguments: list[Any], timed: bool
    ) -> Any:
        """Enqueue the kernel; if ``timed``, return the event for :meth:`_seconds`."""

    @abstractmethod
    def _wait(self) -> None: ...

    @abstractmethod
    def _seconds(self, event: Any) -> float: ...

    def _message(self, error: Exception) -> str:
        return f"failed: {first_line(error)}"

    def upload(self, array: NDArray[Any]) -> DeviceArray:
        """Return a copy of ``array`` on the device."""
        array = np.ascontiguousarray(array)
        target = self.empty(array.shape, array.dtype)
        if array.size:
            self._guarded(self._write, target.handle, array)
        return target

    def download(self, array: DeviceArray) -> NDArray[Any]:
        """Return a copy of ``array`` on the host; waits for the kernels that compute it."""
        target: NDArray[Any] = np.empty(array.shape, array.dtype)
        if target.size:
            self._guarded(self._read, target, array.handle)
        return target

    def empty(self, shape: Sequence[int], dtype: DTypeLike) -> DeviceArray:
        """Return an uninitialized array."""
        sizes, kind = tuple(int(n) for n in shape), np.dtype(dtype)
        return DeviceArray(sizes, kind, self._guarded(self._allocate, sizes, kind))

    def launch(self, kernels: Kernels, name: str, size: Sequence[int], group: Sequence[int], *arguments: Any) -> None:
        """Enqueue a kernel and return at once; its first launch compiles it.

        ``size`` is the number of threads along up to three dimensions, the fastest first, rounded up to whole groups;
        ``group`` is the size of a group. Arguments are arrays of this device, int and float (passed as 32 bits), or
        NumPy scalars.
        """
        kernel = self._kernels.get((kernels, name))
        if kernel is None:
            kernel = self._kernels[kernels, name] = self._guarded(self._compile, kernels, name)
        n_groups = tuple(-(-int(n) // g) for n, g in zip(size, group, strict=True))
        if 0 in n_groups:
            return
        values = list(arguments)
        for k, argument in enumerate(arguments):
            if isinstance(argument, DeviceArray):
                values[k] = argument.handle
            elif isinstance(argument, int | float):
                values[k] = np.int32(argument) if isinstance(argument, int) else np.float32(argument)
        timed = self.launches is not None
        event = self._guarded(self._enqueue, kernel, n_groups, tuple(group), values, timed)
        if timed:
            nbytes = sum(argument.nbytes for argument in arguments if isinstance(argument, DeviceArray))
            self._events.append((name, event, nbytes))

    def finish(self) -> None:
        """Wait until all commands are done, and append timings to :attr:`launches` if it is a list."""
        events, self._events = self._events, []
        self._guarded(self._wait)
        if self.launches is not None:
            for name, event, nbytes in events:
                self.launches.append(Launch(name, self._guarded(self._seconds, event), nbytes))

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
        except self.errors as error:
            raise DeviceError(f"{self.info.address} ({self.info.name}) {self._message(error)}") from error


def first_line(error: Exception) -> str:
    """Return the first line of a driver's message."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def devices() -> list[DeviceInfo]:
    """Return all devices of the installed packages and drivers, GPUs first."""
    return sorted((info for kind in KINDS for info in _found(kind)[0]), key=lambda info: not info.is_gpu)


def why_no_device() -> str:
    """Return why OpenCL or CUDA has no device here; "" if both have one."""
    return "; ".join(f"{kind}: {_found(kind)[1]}" for kind in KINDS if not _found(kind)[0])


def find_device(address: str) -> DeviceInfo | None:
    """Return the device that ``address`` names; None for the CPU.

    ``cpu``: the CPU; ``auto``: the first GPU, otherwise the CPU; ``opencl`` or ``cuda``: the first device of this kind,
    GPUs first; ``opencl:1``: the device with this address. Raise ConfigError for any other text, DeviceError if there
    is no such device.
    """
    if address == "cpu":
        return None
    if address == "auto":
        return next((info for info in devices() if info.is_gpu), None)
    kind, _, number = address.partition(":")
    if kind not in KINDS or not (number.isdigit() or address == kind):
        raise ConfigError(
            f"device {address}: expected cpu, auto, opencl or cuda, or one of several by opencl:N, cuda:N"
        )
    found, why_none = _found(kind)
    for info in sorted(found, key=lambda info: not info.is_gpu):
        if address in (info.address, kind):
            return info
    if found:
        raise DeviceError(f"device {address}: there is none; there are {', '.join(i.address for i in found)}")
    raise DeviceError(f"device {address}: no device: {why_none}")


_open: dict[str, Device] = {}


def open_device(address: str) -> Device | None:
    """Open the device that ``address`` names (see :func:`find_device`), once per process; None for the CPU."""
    info = find_device(address)
    if info is None:
        return None
    if info.address not in _open:
        _open[info.address] = _backend(info.address.partition(":")[0]).open_device(info)
    return _open[info.address]


def _backend(kind: str) -> Any:
    return importlib.import_module(f"depthcli.device.{kind}")


def _found(kind: str) -> tuple[list[DeviceInfo], str]:
    """Return the devices of a back end, in its driver's order, and the reason if there is none."""
    found: tuple[list[DeviceInfo], str] = _backend(kind).find_devices()
    return found

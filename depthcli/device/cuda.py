"""NVIDIA devices through CUDA (package ``cupy``, extra ``cuda``), where no OpenCL driver is installed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from depthcli.device import Device, DeviceArray, DeviceError, DeviceInfo, Kernels, Launch, bytes_of
from depthcli.device.dialect import CUDA

OPTIONS = ("--std=c++14", "--fmad=false")
"""Of the compiler: sums and products apart, division and square root rounded correctly (its default)."""


@cache
def _found() -> tuple[list[DeviceInfo], str]:
    try:
        import cupy
    except ImportError:
        return [], "cupy is not installed; pip install 'depthcli[cuda]'"
    try:
        count = cupy.cuda.runtime.getDeviceCount()
        version = cupy.cuda.runtime.runtimeGetVersion()
        found = []
        for number in range(count):
            facts = cupy.cuda.runtime.getDeviceProperties(number)
            name = facts["name"].decode()
            driver = f"CUDA {version // 1000}.{version % 1000 // 10}"
            found.append(DeviceInfo(f"cuda:{number}", name, int(facts["totalGlobalMem"]), True, driver))
    except Exception as error:  # CuPy has a type of its own for every library that can fail
        return [], f"no CUDA device answers ({str(error).splitlines()[0]})"
    return found, "" if found else "there is no CUDA device"


def list_devices() -> list[DeviceInfo]:
    """In the driver's order."""
    return _found()[0]


def why_none() -> str:
    """Why the list is empty."""
    return _found()[1]


def open_device(info: DeviceInfo) -> Device:
    """The device of ``info``."""
    return CudaDevice(info)


class CudaDevice(Device):
    """One NVIDIA device."""

    def __init__(self, info: DeviceInfo) -> None:
        import cupy

        super().__init__(info)
        self._cupy = cupy
        self._number = int(info.address.partition(":")[2])
        self._modules: dict[Kernels, Any] = {}
        self._kernels: dict[tuple[Kernels, str], Any] = {}
        self._events: list[tuple[str, Any, Any, int]] = []
        self._guarded(cupy.cuda.Device(self._number).use)

    def _guarded(self, action: Any, *arguments: Any, **options: Any) -> Any:
        try:
            return action(*arguments, **options)
        except self._cupy.cuda.memory.OutOfMemoryError as error:
            raise DeviceError(f"{self.info.address} ({self.info.name}) has no room: {error}") from error
        except Exception as error:  # CuPy has a type of its own for every library that can fail
            raise DeviceError(f"{self.info.address} ({self.info.name}) failed: {str(error).splitlines()[0]}") from error

    def upload(self, array: NDArray[Any]) -> DeviceArray:
        """A copy of ``array`` on the device."""
        handle = self._guarded(self._cupy.asarray, np.ascontiguousarray(array))
        return DeviceArray(array.shape, array.dtype, handle)

    def download(self, array: DeviceArray) -> NDArray[Any]:
        """A copy of ``array`` on the host."""
        copied: NDArray[Any] = self._guarded(self._cupy.asnumpy, array.handle)
        return copied

    def empty(self, shape: Sequence[int], dtype: DTypeLike) -> DeviceArray:
        """From CuPy's pool."""
        kind = np.dtype(dtype)
        handle = self._guarded(self._cupy.empty, tuple(shape), kind)
        return DeviceArray(tuple(int(n) for n in shape), kind, handle)

    def launch(self, kernels: Kernels, name: str, size: Sequence[int], group: Sequence[int], *arguments: Any) -> None:
        """Enqueue the kernel."""
        kernel = self._kernels.get((kernels, name))
        if kernel is None:
            if kernels not in self._modules:
                made = self._cupy.RawModule(code=CUDA + kernels.text, options=OPTIONS, backend="nvrtc")
                self._modules[kernels] = made
            kernel = self._kernels[kernels, name] = self._guarded(self._modules[kernels].get_function, name)
        blocks = tuple(-(-int(n) // g) for n, g in zip(size, group, strict=True))
        if 0 in blocks:
            return
        events = None
        if self.profile is not None:
            events = (self._cupy.cuda.Event(), self._cupy.cuda.Event())
            events[0].record()
        self._guarded(kernel, blocks, tuple(group), tuple(_argument(a) for a in arguments))
        if events is not None:
            events[1].record()
            self._events.append((name, *events, bytes_of(arguments)))

    def finish(self) -> None:
        """Wait for the queue."""
        self._guarded(self._cupy.cuda.get_current_stream().synchronize)
        if self.profile is not None:
            elapsed = self._cupy.cuda.get_elapsed_time
            for name, start, stop, nbytes in self._events:
                self.profile.append(Launch(name, elapsed(start, stop) * 1e-3, nbytes))
        self._events.clear()

    @property
    def local_memory(self) -> int:
        """Bytes that a group's threads share."""
        return int(self._cupy.cuda.Device(self._number).attributes["MaxSharedMemoryPerBlock"])

    @property
    def has_double(self) -> bool:
        """Kernels may use double precision."""
        return True


def _argument(value: Any) -> Any:
    if isinstance(value, DeviceArray):
        return value.handle
    if isinstance(value, int):
        return np.int32(value)
    return np.float32(value) if isinstance(value, float) else value

"""NVIDIA devices through CUDA (package ``cupy``, extra ``cuda``), where no OpenCL driver is installed."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.device import DeviceError, DeviceInfo, Driver, Kernels, first_line
from depthcli.device.dialect import CUDA

OPTIONS = ("--std=c++14", "--fmad=false")
"""Options of the compiler: no fused sums and products. Division and square root are rounded correctly by default."""


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
        return [], f"no CUDA device answers ({first_line(error)})"
    return found, "" if found else "there is no CUDA device"


def list_devices() -> list[DeviceInfo]:
    """Return the NVIDIA devices, in the driver's order."""
    return _found()[0]


def why_no_device() -> str:
    """Return the reason, for the user, why :func:`list_devices` returns none; "" where it returns some."""
    return _found()[1]


def open_driver(info: DeviceInfo) -> Driver:
    """Open the device of ``info``."""
    return CudaDriver(int(info.address.partition(":")[2]))


class CudaDriver(Driver):
    """One NVIDIA device through CuPy, which has an exception of its own for every library that can fail."""

    def __init__(self, number: int) -> None:
        import cupy

        self._cupy = cupy
        self._modules: dict[Kernels, Any] = {}
        try:
            cupy.cuda.Device(number).use()
        except Exception as error:
            raise DeviceError(f"cuda:{number} {self.message(error)}") from error

    def message(self, error: Exception) -> str:
        if isinstance(error, self._cupy.cuda.memory.OutOfMemoryError):
            return f"has no room: {error}"
        return super().message(error)

    def allocate(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Any:
        return self._cupy.empty(shape, dtype)

    def copy_to_device(self, target: Any, array: NDArray[Any]) -> None:
        target.set(array)

    def copy_to_host(self, target: NDArray[Any], source: Any) -> None:
        source.get(out=target)

    def compile(self, kernels: Kernels, name: str) -> Any:
        if kernels not in self._modules:
            text = CUDA + kernels.text
            self._modules[kernels] = self._cupy.RawModule(code=text, options=OPTIONS, backend="nvrtc")
        return self._modules[kernels].get_function(name)

    def enqueue(
        self, kernel: Any, n_groups: tuple[int, ...], group: tuple[int, ...], arguments: list[Any], timed: bool
    ) -> Any:
        if not timed:
            return kernel(n_groups, group, tuple(arguments))
        start, stop = self._cupy.cuda.Event(), self._cupy.cuda.Event()
        start.record()
        kernel(n_groups, group, tuple(arguments))
        stop.record()
        return start, stop

    def wait(self) -> None:
        self._cupy.cuda.get_current_stream().synchronize()

    def seconds(self, event: Any) -> float:
        return float(self._cupy.cuda.get_elapsed_time(*event)) * 1e-3

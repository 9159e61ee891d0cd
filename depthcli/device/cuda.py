"""NVIDIA devices through CUDA (package ``cupy``, extra ``cuda``), for machines without an OpenCL driver."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.device import Device, DeviceError, DeviceInfo, Kernels, first_line
from depthcli.device.dialect import CUDA

OPTIONS = ("--std=c++14", "--fmad=false")
"""Compiler options: no fused sums and products. Division and square root are correctly rounded by default."""


@cache
def find_devices() -> tuple[list[DeviceInfo], str]:
    """Return the NVIDIA devices, in the driver's order, and the reason if there is none."""
    try:
        import cupy
    except ImportError:
        return [], "cupy is not installed; pip install 'depthcli[cuda]'"
    runtime, found = cupy.cuda.runtime, []
    try:
        version = runtime.runtimeGetVersion()
        for number in range(runtime.getDeviceCount()):
            facts = runtime.getDeviceProperties(number)
            name, memory = facts["name"].decode(), int(facts["totalGlobalMem"])
            driver = f"CUDA {version // 1000}.{version % 1000 // 10}"
            found.append(DeviceInfo(f"cuda:{number}", name, memory, True, driver))
    except Exception as error:  # CuPy has a separate exception type for every library
        return [], f"no CUDA device answers ({first_line(error)})"
    return found, "there is no CUDA device"


def open_device(info: DeviceInfo) -> Device:
    """Open the device of ``info``."""
    return _CudaDevice(info)


class _CudaDevice(Device):
    def __init__(self, info: DeviceInfo) -> None:
        import cupy

        super().__init__(info)
        self._cupy = cupy
        self._modules: dict[Kernels, Any] = {}
        try:
            cupy.cuda.Device(int(info.address.partition(":")[2])).use()
        except Exception as error:
            raise DeviceError(f"{info.address} {self._message(error)}") from error

    def _message(self, error: Exception) -> str:
        if isinstance(error, self._cupy.cuda.memory.OutOfMemoryError):
            return f"has no room: {error}"
        return super()._message(error)

    def _allocate(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Any:
        return self._cupy.empty(shape, dtype)

    def _write(self, target: Any, array: NDArray[Any]) -> None:
        target.set(array)

    def _read(self, target: NDArray[Any], source: Any) -> None:
        source.get(out=target)

    def _compile(self, kernels: Kernels, name: str) -> Any:
        if kernels not in self._modules:
            text = CUDA + kernels.text
            self._modules[kernels] = self._cupy.RawModule(code=text, options=OPTIONS, backend="nvrtc")
        return self._modules[kernels].get_function(name)

    def _enqueue(
        self, kernel: Any, n_groups: tuple[int, ...], group: tuple[int, ...], arguments: list[Any], timed: bool
    ) -> Any:
        if not timed:
            return kernel(n_groups, group, tuple(arguments))
        start, stop = self._cupy.cuda.Event(), self._cupy.cuda.Event()
        start.record()
        kernel(n_groups, group, tuple(arguments))
        stop.record()
        return start, stop

    def _wait(self) -> None:
        self._cupy.cuda.get_current_stream().synchronize()

    def _seconds(self, event: Any) -> float:
        return float(self._cupy.cuda.get_elapsed_time(*event)) * 1e-3

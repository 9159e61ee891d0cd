"""Devices through OpenCL (package ``pyopencl``, extra ``opencl``): GPUs of all vendors, and processors by PoCL."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from depthcli.device import Device, DeviceArray, DeviceError, DeviceInfo, Kernels, Launch, bytes_of
from depthcli.device.dialect import OPENCL


@cache
def _handles() -> tuple[list[tuple[DeviceInfo, Any]], str]:
    try:
        import pyopencl as cl
    except ImportError:
        return [], "pyopencl is not installed; pip install 'depthcli[opencl]'"
    try:
        platforms = cl.get_platforms()
    except cl.Error as error:
        return [], f"no OpenCL driver is installed ({_short(error)})"
    found: list[tuple[DeviceInfo, Any]] = []
    why = "the OpenCL drivers here show no device"
    for platform in platforms:
        try:
            handles = platform.get_devices()
        except cl.Error:
            continue
        for handle in handles:
            if _compiles_nothing(handle.version):
                why = f"PoCL {handle.driver_version}'s compiler does not know this processor; a newer PoCL may"
                continue
            info = DeviceInfo(
                address=f"opencl:{len(found)}",
                name=handle.name.strip(),
                memory=handle.global_mem_size,
                is_gpu=bool(handle.type & cl.device_type.GPU),
                driver=f"{platform.name.strip()}, {handle.version.strip()}",
            )
            found.append((info, handle))
    return found, "" if found else why


def _compiles_nothing(version: str) -> bool:
    """A processor newer than PoCL's compiler is shown as "generic", for which the compiler then refuses all kernels.

    https://github.com/pocl/pocl/issues/1049
    """
    return "pocl" in version.lower() and version.rstrip().endswith("-generic")


def list_devices() -> list[DeviceInfo]:
    """Those of all OpenCL drivers, in their order."""
    return [info for info, _ in _handles()[0]]


def why_none() -> str:
    """Why the list is empty."""
    return _handles()[1]


def open_device(info: DeviceInfo) -> Device:
    """The device of ``info``."""
    return OpenClDevice(info, next(handle for own, handle in _handles()[0] if own == info))


def _short(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    told = [line.strip() for line in lines if "error:" in line]  # a compiler's, after what it was asked to do
    return (told or lines or [type(error).__name__])[0]


class OpenClDevice(Device):
    """One device behind an OpenCL driver."""

    def __init__(self, info: DeviceInfo, handle: Any) -> None:
        import pyopencl as cl
        import pyopencl.tools

        super().__init__(info)
        self._cl = cl
        self._handle = handle
        # The compiler's own cache of programs would print its messages.
        os.environ.setdefault("PYOPENCL_COMPILER_OUTPUT", "0")
        try:
            self._context = cl.Context([handle])
            self._queue = cl.CommandQueue(self._context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        except cl.Error as error:
            raise self._failed(error) from error
        self._pool = pyopencl.tools.MemoryPool(pyopencl.tools.ImmediateAllocator(self._queue))
        self._programs: dict[Kernels, Any] = {}
        self._kernels: dict[tuple[Kernels, str], Any] = {}
        self._events: list[tuple[str, Any, int]] = []

    def _failed(self, error: Exception) -> DeviceError:
        return DeviceError(f"{self.info.address} ({self.info.name}) failed: {_short(error)}")

    def upload(self, array: NDArray[Any]) -> DeviceArray:
        """A copy of ``array`` on the device."""
        array = np.ascontiguousarray(array)
        target = self.empty(array.shape, array.dtype)
        if array.size:
            self._do(self._cl.enqueue_copy, target.handle, array, is_blocking=True)
        return target

    def download(self, array: DeviceArray) -> NDArray[Any]:
        """A copy of ``array`` on the host."""
        target: NDArray[Any] = np.empty(array.shape, array.dtype)
        if array.size:
            self._do(self._cl.enqueue_copy, target, array.handle, is_blocking=True)
        return target

    def empty(self, shape: Sequence[int], dtype: DTypeLike) -> DeviceArray:
        """From a pool: what is freed serves again."""
        kind = np.dtype(dtype)
        count = int(np.prod(tuple(shape), dtype=np.int64))
        try:
            handle = self._pool.allocate(max(1, count * kind.itemsize))
        except (self._cl.Error, MemoryError) as error:
            raise DeviceError(
                f"{self.info.address} ({self.info.name}) has no room for {count * kind.itemsize >> 20} MiB more"
            ) from error
        return DeviceArray(tuple(int(n) for n in shape), kind, handle)

    def launch(self, kernels: Kernels, name: str, size: Sequence[int], group: Sequence[int], *arguments: Any) -> None:
        """Enqueue the kernel."""
        kernel = self._kernel(kernels, name)
        whole = tuple(-(-int(n) // g) * g for n, g in zip(size, group, strict=True))
        if 0 in whole:
            return
        given = [_argument(a) for a in arguments]
        event = self._do(kernel, whole, tuple(group), *given)
        if self.profile is not None:
            self._events.append((name, event, bytes_of(arguments)))

    def finish(self) -> None:
        """Wait for the queue."""
        try:
            self._queue.finish()
            if self.profile is not None:
                for name, event, nbytes in self._events:
                    self.profile.append(Launch(name, (event.profile.end - event.profile.start) * 1e-9, nbytes))
        except self._cl.Error as error:
            raise self._failed(error) from error
        finally:
            self._events.clear()

    @property
    def local_memory(self) -> int:
        """Bytes that a group's threads share."""
        return int(self._handle.local_mem_size)

    @property
    def has_double(self) -> bool:
        """Kernels may use double precision."""
        return "cl_khr_fp64" in self._handle.extensions

    def _do(self, action: Any, *arguments: Any, **options: Any) -> Any:
        try:
            return action(self._queue, *arguments, **options)
        except self._cl.Error as error:
            raise self._failed(error) from error

    def _kernel(self, kernels: Kernels, name: str) -> Any:
        known = self._kernels.get((kernels, name))
        if known is None:
            if kernels not in self._programs:
                self._programs[kernels] = self._built(OPENCL + kernels.text, name)
            known = self._kernels[kernels, name] = self._cl.Kernel(self._programs[kernels], name)
        return known

    def _built(self, text: str, name: str) -> Any:
        exact = self._cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT
        options = ["-cl-std=CL1.2"]
        if self._handle.single_fp_config & exact:
            options.append("-cl-fp32-correctly-rounded-divide-sqrt")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return self._cl.Program(self._context, text).build(options)
        except self._cl.Error as error:
            raise DeviceError(
                f"{self.info.address} ({self.info.name}): its compiler refuses {name}: {_short(error)}"
            ) from error


def _argument(value: Any) -> Any:
    if isinstance(value, DeviceArray):
        return value.handle
    if isinstance(value, int):
        return np.int32(value)
    return np.float32(value) if isinstance(value, float) else value

"""Devices through OpenCL (package ``pyopencl``, extra ``opencl``): GPUs of all vendors, and CPUs through PoCL."""

from __future__ import annotations

import os
import warnings
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.device import Device, DeviceError, DeviceInfo, Kernels, first_line
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
        return [], f"no OpenCL driver is installed ({_message(error)})"
    found: list[tuple[DeviceInfo, Any]] = []
    why = "the OpenCL drivers here show no device"
    for platform in platforms:
        try:
            handles = platform.get_devices()
        except cl.Error:
            continue
        for handle in handles:
            name, driver = handle.name.strip(), platform.name.strip()
            try:
                _try_out(cl, handle)
            except (cl.Error, MemoryError) as error:
                # PoCL shows CPUs that its compiler does not support: https://github.com/pocl/pocl/issues/1049
                why = f"{name} ({driver}) runs no kernel: {_message(error)}"
                continue
            address, is_gpu = f"opencl:{len(found)}", bool(handle.type & cl.device_type.GPU)
            driver = f"{driver}, {handle.version.strip()}"
            found.append((DeviceInfo(address, name, handle.global_mem_size, is_gpu, driver), handle))
    return found, why


def _try_out(cl: Any, handle: Any) -> None:
    """Compile and run a kernel; raise the driver's error if the device cannot."""
    context = cl.Context([handle])
    with warnings.catch_warnings(), cl.CommandQueue(context) as queue:
        warnings.simplefilter("ignore")  # compiler messages
        program = cl.Program(context, "__kernel void one(__global int *a) { a[0] = 1; }").build()
        program.one(queue, (1,), None, cl.Buffer(context, cl.mem_flags.READ_WRITE, 4))
        queue.finish()


def find_devices() -> tuple[list[DeviceInfo], str]:
    """Return the devices of all OpenCL drivers, in the drivers' order, and the reason if there is none."""
    found, why = _handles()
    return [info for info, _ in found], why


def open_device(info: DeviceInfo) -> Device:
    """Open the device of ``info``."""
    return _OpenClDevice(info, next(handle for own, handle in _handles()[0] if own == info))


class _OpenClDevice(Device):
    def __init__(self, info: DeviceInfo, handle: Any) -> None:
        import pyopencl as cl
        import pyopencl.tools

        super().__init__(info)
        self.errors = (cl.Error, MemoryError)
        self.has_double = "cl_khr_fp64" in handle.extensions  # an optional extension of OpenCL 1.2
        self._cl = cl
        self._options = ["-cl-std=CL1.2"]
        if handle.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT:
            self._options.append("-cl-fp32-correctly-rounded-divide-sqrt")
        # Without this, pyopencl's program cache would print the compiler's messages.
        os.environ.setdefault("PYOPENCL_COMPILER_OUTPUT", "0")
        try:
            self._context = cl.Context([handle])
            profiling = cl.command_queue_properties.PROFILING_ENABLE
            self._queue = cl.CommandQueue(self._context, properties=profiling)
        except self.errors as error:
            raise DeviceError(f"{info.name} {self._message(error)}") from error
        self._pool = pyopencl.tools.MemoryPool(pyopencl.tools.ImmediateAllocator(self._queue))
        self._programs: dict[Kernels, Any] = {}

    def _message(self, error: Exception) -> str:
        return f"failed: {_message(error)}"

    def _allocate(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Any:
        size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        try:
            return self._pool.allocate(max(1, size))
        except self.errors as error:
            raise DeviceError(f"has no room for {size >> 20} MiB more") from error

    def _write(self, target: Any, array: NDArray[Any]) -> None:
        self._cl.enqueue_copy(self._queue, target, array, is_blocking=True)

    def _read(self, target: NDArray[Any], source: Any) -> None:
        self._cl.enqueue_copy(self._queue, target, source, is_blocking=True)

    def _compile(self, kernels: Kernels, name: str) -> Any:
        if kernels not in self._programs:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    program = self._cl.Program(self._context, OPENCL + kernels.text).build(self._options)
            except self._cl.Error as error:
                raise DeviceError(f"fails: its compiler refuses {name}: {_message(error)}") from error
            self._programs[kernels] = program
        return self._cl.Kernel(self._programs[kernels], name)

    def _enqueue(
        self, kernel: Any, n_groups: tuple[int, ...], group: tuple[int, ...], arguments: list[Any], timed: bool
    ) -> Any:
        size = tuple(n * g for n, g in zip(n_groups, group, strict=True))
        return kernel(self._queue, size, group, *arguments)

    def _wait(self) -> None:
        self._queue.finish()

    def _seconds(self, event: Any) -> float:
        return float(event.profile.end - event.profile.start) * 1e-9


def _message(error: Exception) -> str:
    # A compiler's error follows the command line, so return the first line with "error:".
    errors = [line.strip() for line in str(error).splitlines() if "error:" in line]
    return errors[0] if errors else first_line(error)

"""Networks opened by onnxruntime, an optional package that is imported at the first use."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import ConfigError, InputError
from depthcli.kernels.jit import n_threads

_TYPES = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(uint8)": np.uint8,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
}
_CUDA = "CUDAExecutionProvider"


@dataclass(frozen=True)
class Port:
    """An input of a network.

    Attributes
    ----------
    shape : sizes; None: any
    """

    name: str
    shape: tuple[int | None, ...]
    dtype: np.dtype[Any]


@dataclass(frozen=True, eq=False)
class Session:
    """A network that is ready to run; several threads may use it at a time.

    Attributes
    ----------
    model : file of the network, as the user wrote it
    """

    model: str
    inputs: tuple[Port, ...]
    _inference: Any

    def run(self, values: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return output's name -> array, in the order of the network.

        Raises
        ------
        InputError
            The network fails, for instance at images of this size.
        """
        names = [output.name for output in self._inference.get_outputs()]
        try:
            outputs = self._inference.run(names, dict(values))
        except Exception as error:  # onnxruntime has an exception of its own for each code of its C interface
            shapes = ", ".join(f"{name} {value.shape}" for name, value in values.items())
            raise InputError(f"{self.model}: the network fails for {shapes}: {_first_line(error)}") from error
        return dict(zip(names, outputs, strict=True))


def open_session(model: str, device: str) -> Session:
    """Open a network; a file that has not changed is opened once.

    It uses as many threads as kernels do. Its outputs had the same bytes at any number of threads in all networks that
    were measured (convolutions of 32 bits and of 8 bits); onnxruntime does not promise it for every operation.

    Parameters
    ----------
    model : file
    device : ``cpu`` or ``cuda:N``

    Raises
    ------
    InputError
        onnxruntime or the device is missing, or the file is not a network that it can run.
    """
    try:
        changed = os.stat(model).st_mtime_ns
    except OSError as error:
        raise InputError(f"{model}: network cannot be read ({error.strerror or error})") from error
    return _opened(model, os.path.abspath(model), changed, device, n_threads())


def network_device(wanted: str) -> str:
    """Return where networks run, ``cpu`` or ``cuda:N``, for the text of ``--device``.

    Raises
    ------
    ConfigError
        It names another kind of device.
    """
    if wanted == "auto":
        return "cuda:0" if _CUDA in _onnxruntime().get_available_providers() else "cpu"
    kind, _, number = wanted.partition(":")
    if wanted != "cpu" and (kind != "cuda" or not (number.isdigit() or wanted == kind)):
        raise ConfigError(f"device {wanted}: networks run on cpu, cuda or cuda:N; auto takes cuda if it is there")
    return f"cuda:{number or 0}" if kind == "cuda" else "cpu"


@lru_cache(maxsize=4)
def _opened(model: str, path: str, changed: int, device: str, threads: int) -> Session:
    runtime = _onnxruntime()
    providers: list[Any] = ["CPUExecutionProvider"]
    if device != "cpu":
        if _CUDA not in runtime.get_available_providers():
            raise InputError(f"device {device}: this onnxruntime has no CUDA; install onnxruntime-gpu instead of it")
        providers.insert(0, (_CUDA, {"device_id": int(device.partition(":")[2])}))
    options = runtime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.log_severity_level = 4  # what fails is raised as well
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # other workers need the processor
    try:
        inference = runtime.InferenceSession(path, options, providers=providers)
    except Exception as error:  # as above
        raise InputError(f"{model}: not a network that onnxruntime can run ({_first_line(error)})") from error
    if device != "cpu" and _CUDA not in inference.get_providers():
        raise InputError(f"device {device}: onnxruntime cannot use it; are CUDA and cuDNN of its version installed?")
    ports = []
    for port in inference.get_inputs():
        if port.type not in _TYPES:
            raise InputError(f"{model}: input {port.name} is of type {port.type}; want images")
        shape = tuple(size if isinstance(size, int) and size > 0 else None for size in port.shape)
        ports.append(Port(port.name, shape, np.dtype(_TYPES[port.type])))
    return Session(model, tuple(ports), inference)


def _onnxruntime() -> Any:
    try:
        import onnxruntime
    except ImportError as error:
        raise InputError("networks need the package onnxruntime: pip install 'depthcli[onnx]'") from error
    return onnxruntime


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:300]

"""NVIDIA's run-time compiler, which needs no device: does it take the kernels' text?"""

import ctypes
import glob
import importlib.util
from pathlib import Path


def library() -> ctypes.CDLL | None:
    """From the package ``nvidia-cuda-nvrtc-cu12``, where that is installed."""
    try:
        found = importlib.util.find_spec("nvidia.cuda_nvrtc")
    except ModuleNotFoundError:
        return None
    for folder in (found.submodule_search_locations or []) if found else []:
        for file in glob.glob(str(Path(folder) / "lib" / "libnvrtc.so*")):
            return ctypes.CDLL(file)
    return None


def messages(nvrtc: ctypes.CDLL, text: str, options: tuple[str, ...]) -> str:
    """What the compiler has to say about CUDA C; empty where it takes it."""
    program = ctypes.c_void_p()
    assert nvrtc.nvrtcCreateProgram(ctypes.byref(program), text.encode(), b"kernels.cu", 0, None, None) == 0
    given = [option.encode() for option in options]
    failed = nvrtc.nvrtcCompileProgram(program, len(given), (ctypes.c_char_p * len(given))(*given))
    size = ctypes.c_size_t()
    nvrtc.nvrtcGetProgramLogSize(program, ctypes.byref(size))
    log = ctypes.create_string_buffer(size.value)
    nvrtc.nvrtcGetProgramLog(program, log)
    nvrtc.nvrtcDestroyProgram(ctypes.byref(program))
    return log.value.decode() if failed else ""

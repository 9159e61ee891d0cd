"""Devices: what a user reads of them; tests of device implementations in a process of their own (drivers crash)."""

import ctypes
import importlib.resources
import importlib.util
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

import depthcli.device.cuda
import depthcli.device.opencl
from depthcli.core.errors import ConfigError
from depthcli.device import DeviceError, DeviceInfo, Kernels, Launch, find_device, open_device
from depthcli.device.cuda import OPTIONS
from depthcli.device.dialect import COMMON, CUDA
from tests.command_line import ended, rows
from tests.golden import refused

_LIMIT = 400  # seconds


@pytest.mark.system
def test_device_implementations_in_a_process_of_their_own():
    found, why = depthcli.device.opencl.find_devices()
    if not found:
        pytest.skip(why)
    tests = Path(__file__).with_name("implementations.py")
    command = (sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", tests)
    ended(0, *command, cwd=tests.parents[2], timeout=_LIMIT)


FILES = sorted(Path(str(importlib.resources.files("depthcli"))).rglob("*.cl"))
MACROS = {
    "adaptive_weight.cl": ("COST=ushort OUT=ushort SQUARED=0", "COST=float OUT=float SQUARED=1"),
    "constant_window.cl": ("COST=ushort SUM=uint", "COST=uchar SUM=ushort"),
    "cross.cl": ("SHIFT=3",),
    "features.cl": ("GREY=ushort",),
    "fill.cl": ("CHANNELS=3", "FEATURE=short CHANNELS=2"),
    "medians.cl": ("WINDOW=5",),
    "scanline.cl": ("COST=ushort ROOM=256 THREADS=256",),
    "selection.cl": ("COST=float",),
}
"""The macros of files that have some, as the program sets them besides their defaults."""


def compiler() -> ctypes.CDLL | None:
    """NVIDIA's run-time compiler of the package ``nvidia-cuda-nvrtc-cu12``, which needs no device."""
    try:
        found = importlib.util.find_spec("nvidia.cuda_nvrtc")
    except ModuleNotFoundError:
        return None
    for folder in (found.submodule_search_locations or []) if found else []:
        for file in Path(folder, "lib").glob("libnvrtc.so*"):
            return ctypes.CDLL(str(file))
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


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_cuda_takes_the_kernels(file):
    """To machine code, so that registers and shared memory of a group suffice, too."""
    library = compiler()
    if library is None:
        pytest.skip("nvidia-cuda-nvrtc-cu12, which compiles for CUDA, is not installed")
    for macros in ("", *MACROS.get(file.name, ())):
        defined = "".join(f"#define {macro.replace('=', ' ')}\n" for macro in macros.split())
        text = defined + CUDA + COMMON + file.read_text("utf-8")
        assert messages(library, text, (*OPTIONS, "--gpu-architecture=sm_75")) == "", macros


def test_files_with_macros_are_compiled_with_others_than_their_defaults():
    assert {file.name for file in FILES if "\n#ifndef " in file.read_text("utf-8")} == {*MACROS}


GPU = DeviceInfo("opencl:1", "a card", 1 << 33, True, "somebody's")
SLOW = DeviceInfo("opencl:0", "a processor", 1 << 34, False, "somebody else's")


def test_what_names_mean(monkeypatch):
    monkeypatch.setattr(depthcli.device.opencl, "find_devices", lambda: ([SLOW, GPU], ""))
    monkeypatch.setattr(depthcli.device.cuda, "find_devices", lambda: ([], "nothing there"))
    assert find_device("cpu") is None
    assert find_device("auto") == GPU
    assert find_device("opencl") == GPU
    assert find_device("opencl:0") == SLOW
    refused(DeviceError, find_device, "opencl:2")
    refused(DeviceError, find_device, "cuda")
    for name in ("gpu", "opencl:", "opencl:x", "cuda:-1"):
        refused(ConfigError, find_device, name)
    monkeypatch.setattr(depthcli.device.opencl, "find_devices", lambda: ([SLOW], ""))
    assert find_device("auto") is None  # without a card the processor


def test_without_a_device_its_reason_is_told_before_anything_is_written(tool, tmp_path, made_scenes, monkeypatch):
    for kind in (depthcli.device.opencl, depthcli.device.cuda):
        monkeypatch.setattr(kind, "find_devices", lambda: ([], "no driver"))
    tool.told(2, "stereo", "fast", "-i", made_scenes, "-o", tmp_path / "run", "--device", "opencl")
    assert not (tmp_path / "run").exists()
    out, err = tool.both(0, "stereo", "--device", "list")
    assert out == "" and "opencl: no driver; cuda: no driver" in err


class Small:
    """Stands for a card; what runs on it fails like a driver."""

    info = DeviceInfo("opencl:1", "a card", 1 << 20, True, "somebody's")

    def __getattr__(self, name):
        raise DeviceError(f"{self.info.address} ({self.info.name}) failed: the driver is gone")


def test_what_a_device_costs_a_scene(tmp_path, tool, made_scenes, monkeypatch):
    device = Small()
    monkeypatch.setattr(depthcli.device, "find_device", lambda wanted: device.info)
    monkeypatch.setattr(depthcli.device, "open_device", lambda wanted: device)
    scene = ("-i", made_scenes, "--scenes", "planes_0", "--device", "auto", "-o")
    said = tool.err(3, "stereo", "fast", *scene, tmp_path / "small")
    assert "planes_0: needs about" in said and "on opencl:1 (a card), which has 1 MiB" in said
    assert "device: opencl:1\n" in (tmp_path / "small" / "run.yaml").read_text()
    device.info = replace(device.info, memory=1 << 33)
    said = tool.err(3, "stereo", "fast", *scene, tmp_path / "failing")
    assert "planes_0: opencl:1 (a card) failed: the driver is gone" in said
    tool.err(0, "stereo", "opencv-bm", *scene, tmp_path / "none")
    assert rows(tmp_path / "none")["planes_0"]["device"] == "cpu: opencv_bm has no kernels for opencl:1, a card"


class Stored(np.ndarray):
    """An array of the host that stands for one on a device."""

    def set(self, array):
        self[...] = array

    def get(self, out):
        out[...] = self


def add_one(groups, group, arguments):
    assert (groups, group) == ((3, 2), (4, 8))
    arguments[0][...] += np.uint8(1)


def fail(*_):
    raise RuntimeError("out of resources")


def cupy() -> MagicMock:
    """Stands for the package cupy with one card, whose kernels add one, or move data in half a millisecond."""
    module = MagicMock()
    module.cuda.memory.OutOfMemoryError = MemoryError
    module.cuda.runtime.runtimeGetVersion.return_value = 12040
    module.cuda.runtime.getDeviceCount.return_value = 1
    module.cuda.runtime.getDeviceProperties.return_value = {"name": b"a card", "totalGlobalMem": 1 << 20}
    module.cuda.get_elapsed_time.return_value = 0.5
    module.empty = lambda shape, dtype: np.empty(shape, dtype).view(Stored)
    functions = {"add_one": add_one, "fail": fail, "copy": lambda *_: None, "multiply_add": lambda *_: None}
    module.RawModule.return_value.get_function = lambda name: functions[name]
    return module


def pyopencl() -> MagicMock:
    """Stands for the package pyopencl with one card, as :func:`cupy`."""
    module = MagicMock(Error=RuntimeError, device_type=SimpleNamespace(GPU=4))
    card = MagicMock(version="OpenCL 1.2", type=4, global_mem_size=1 << 20, extensions="cl_khr_fp64")
    card.name = "a card"
    platform = MagicMock(get_devices=lambda: [card])
    platform.name = "a platform"
    module.get_platforms.return_value = [platform]
    module.tools.MemoryPool.return_value.allocate = lambda size: np.empty(size, np.uint8)

    def copy(queue, target, source, is_blocking):
        target.reshape(-1).view(np.uint8)[...] = source.reshape(-1).view(np.uint8)

    def kernel(program, name):
        def run(queue, size, group, *arguments):
            if name == "fail":
                fail()
            elif name == "add_one":
                add_one(tuple(n // g for n, g in zip(size, group, strict=True)), group, arguments)
            return SimpleNamespace(profile=SimpleNamespace(start=0, end=500_000))

        return run

    module.enqueue_copy, module.Kernel = copy, kernel
    return module


@pytest.fixture(params=["cuda", "opencl"])
def card(request, monkeypatch):
    """Kind, package, and what forgets the devices that it found."""
    kind = request.param
    name, module = {"cuda": ("cupy", cupy), "opencl": ("pyopencl", pyopencl)}[kind]
    module = module()
    for part, value in ((name, module), (f"{name}.tools", module.tools)):
        monkeypatch.setitem(sys.modules, part, value)
    monkeypatch.setattr(depthcli.device, "_open", {})
    forget = {"cuda": depthcli.device.cuda.find_devices, "opencl": depthcli.device.opencl._handles}[kind].cache_clear
    forget()
    yield kind, module, forget
    forget()


def test_a_card_copies_runs_and_is_timed_by_either_package(card):
    kind = card[0]
    info = find_device(kind)
    assert (info.address, info.name, info.memory, info.is_gpu) == (f"{kind}:0", "a card", 1 << 20, True)
    assert info.driver == {"cuda": "CUDA 12.4", "opencl": "a platform, OpenCL 1.2"}[kind]
    device = open_device(kind)
    assert open_device(kind) is device and device.has_double
    there = device.upload(np.arange(12, dtype=np.uint8)[::2].reshape(2, 3))
    kernels = Kernels("depthcli.device", "benchmarks.cl")
    device.launch(kernels, "add_one", (9, 16), (4, 8), there)
    device.launch(kernels, "add_one", (0, 16), (4, 8), there)  # nothing to do
    refused(DeviceError, device.launch, kernels, "fail", (9, 16), (4, 8), there)
    device.launches = []
    device.launch(kernels, "add_one", (9, 16), (4, 8), there)
    device.finish()
    assert device.launches == [Launch("add_one", 0.5e-3, 6)]
    np.testing.assert_array_equal(device.download(there), 2 + 2 * np.arange(6).reshape(2, 3))
    count = (1 << 20) // 64
    assert device.measure_bandwidth() == pytest.approx(2 * 4 * count / 0.5e-3)
    assert device.measure_operations() == pytest.approx(64 * 8 * 4 * 2 * (1 << 20) / 0.5e-3)


def test_what_goes_wrong_with_a_card_is_said(card):
    kind, module, forget = card
    device, kernels = open_device(kind), Kernels("depthcli.device", "benchmarks.cl")

    def full(*_):
        raise MemoryError("all of it is in use")

    def fail_from_now_on(message, *functions):
        for function in functions:
            function.side_effect = RuntimeError(message)

    message = "clBuildProgram failed\n<kernel>:1: error: unknown type name 'x'"
    fail_from_now_on(message, module.Program.return_value.build, module.RawModule)
    refused(DeviceError, device.launch, kernels, "add_one", (9, 16), (4, 8))
    module.empty = module.tools.MemoryPool.return_value.allocate = full
    refused(DeviceError, device.empty, (4, 5), np.float32)
    depthcli.device._open.clear()
    fail_from_now_on("lost", module.cuda.Device.return_value.use, module.CommandQueue)
    refused(DeviceError, open_device, kind)
    forget()
    fail_from_now_on("driver is too old\nmore", module.cuda.runtime.getDeviceCount, module.get_platforms)
    found, why = getattr(depthcli.device, kind).find_devices()
    assert found == [] and "driver is too old" in why and "more" not in why


@pytest.mark.parametrize("card", ["opencl"], indirect=True)
@pytest.mark.parametrize("error", ["", "clBuildProgram failed\n\nerror: unknown target CPU 'generic'"])
def test_what_is_no_device_of_opencl(card, error, monkeypatch):
    """A platform that fails, a processor that PoCL does not know, and none at all without the package."""
    _, module, forget = card
    (device,) = module.get_platforms()[0].get_devices()
    device.version, device.type = "OpenCL 3.0 PoCL", 2
    module.Program.return_value.build.side_effect = RuntimeError(error) if error else None
    module.get_platforms.return_value.insert(0, MagicMock(get_devices=fail))
    found, why = depthcli.device.opencl.find_devices()
    assert len(found) == (0 if error else 1)
    assert ("unknown target CPU 'generic'" in why) == bool(error)
    forget()
    monkeypatch.setitem(sys.modules, "pyopencl", None)
    assert depthcli.device.opencl.find_devices() == ([], "pyopencl is not installed; pip install 'depthcli[opencl]'")

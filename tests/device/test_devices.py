"""Devices: what a user reads of them; tests of device implementations in a process of their own (drivers crash)."""

import importlib.resources
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

import depthcli.device.cuda
import depthcli.device.opencl
from depthcli.cli import main
from depthcli.core.errors import ConfigError
from depthcli.device import Device, DeviceError, DeviceInfo, Kernels, Launch, find_device
from depthcli.device.cuda import OPTIONS
from depthcli.device.dialect import COMMON, CUDA
from tests.device import nvrtc

_LIMIT = 400  # seconds


@pytest.mark.system
def test_device_implementations_in_a_process_of_their_own():
    found, why = depthcli.device.opencl.find_devices()
    if not found:
        pytest.skip(why)
    tests = Path(__file__).with_name("implementations.py")
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", str(tests)],
        cwd=tests.parents[2], capture_output=True, text=True, timeout=_LIMIT, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-3000:]


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


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_cuda_takes_the_kernels(file):
    """To machine code, so that registers and shared memory of a group suffice, too."""
    library = nvrtc.library()
    if library is None:
        pytest.skip("nvidia-cuda-nvrtc-cu12, which compiles for CUDA, is not installed")
    for macros in ("", *MACROS.get(file.name, ())):
        defined = "".join(f"#define {macro.replace('=', ' ')}\n" for macro in macros.split())
        text = defined + CUDA + COMMON + file.read_text("utf-8")
        assert nvrtc.messages(library, text, (*OPTIONS, "--gpu-architecture=sm_75")) == "", macros


def test_files_with_macros_are_compiled_with_others_than_their_defaults():
    assert {file.name for file in FILES if "\n#ifndef " in file.read_text("utf-8")} == {*MACROS}


def pocl(error: str) -> MagicMock:
    """Stands for the package pyopencl with PoCL, whose compiler may not know the processor."""
    module = MagicMock(Error=RuntimeError, device_type=SimpleNamespace(GPU=4))
    device = SimpleNamespace(version="OpenCL 3.0 PoCL", name="a processor", type=2, global_mem_size=1 << 33)
    module.get_platforms.return_value = [SimpleNamespace(name="PoCL", get_devices=lambda: [device])]
    module.Program.return_value.build.side_effect = RuntimeError(error) if error else None
    return module


@pytest.mark.parametrize("error", ["", "clBuildProgram failed\n\nerror: unknown target CPU 'generic'"])
def test_a_processor_that_pocl_does_not_know_is_no_device(monkeypatch, error):
    monkeypatch.setitem(sys.modules, "pyopencl", pocl(error))
    depthcli.device.opencl._handles.cache_clear()
    try:
        found, why = depthcli.device.opencl.find_devices()
        assert len(found) == (0 if error else 1)
        assert ("unknown target CPU 'generic'" in why) == bool(error)
    finally:
        depthcli.device.opencl._handles.cache_clear()


@pytest.mark.system
def test_without_devices_all_that_needs_one_is_skipped_with_the_reason(tmp_path):
    for name in ("pyopencl", "cupy"):
        (tmp_path / f"{name}.py").write_text("raise ImportError('hidden')")
    root = Path(__file__).parents[2]
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{root}", "PATH": path}
    tests = ["tests/device/test_devices.py", "tests/test_scripts.py", "-k", "process_of_their_own or gpu_is_measured"]
    command = [sys.executable, "-m", "pytest", "-q", "-rs", "-n0", "-p", "no:cacheprovider", *tests]
    run = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, timeout=_LIMIT)
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-3000:]
    assert "pyopencl is not installed" in run.stdout + run.stderr


class Memory(Device):
    """The memory of the host as a device; its only kernel adds one."""

    errors = (ZeroDivisionError,)

    def _allocate(self, shape, dtype):
        return np.empty(shape, dtype)

    def _write(self, target, array):
        target[...] = array

    _read = _write

    def _compile(self, kernels, name):
        return {"add_one": lambda array: array.__iadd__(1), "fail": lambda array: 1 // 0}[name]

    def _enqueue(self, kernel, n_groups, group, arguments, timed):
        assert (n_groups, group) == ((3, 2), (4, 8))
        kernel(*arguments)
        return 0.5 if timed else None

    def _wait(self):
        pass

    def _seconds(self, event):
        return event


def test_arrays_go_to_a_device_and_kernels_run_and_are_timed_there():
    device = Memory(DeviceInfo("opencl:0", "memory", 1 << 30, True, "none"))
    kernels, there = Kernels("depthcli.device", "benchmarks.cl"), device.upload(np.arange(6, dtype=np.uint8)[::2])
    device.launch(kernels, "add_one", (9, 16), (4, 8), there)
    device.launch(kernels, "add_one", (0, 16), (4, 8), there)  # nothing to do
    device.launches = []
    device.launch(kernels, "add_one", (9, 16), (4, 8), there)
    device.finish()
    assert device.launches == [Launch("add_one", 0.5, 3)]
    np.testing.assert_array_equal(device.download(there), [2, 4, 6])
    with pytest.raises(DeviceError, match=r"opencl:0 \(memory\) failed: .*zero"):
        device.launch(kernels, "fail", (9, 16), (4, 8), there)


GPU = DeviceInfo("opencl:1", "a card", 1 << 33, True, "somebody's")
SLOW = DeviceInfo("opencl:0", "a processor", 1 << 34, False, "somebody else's")


@pytest.fixture
def two_devices(monkeypatch):
    monkeypatch.setattr(depthcli.device.opencl, "find_devices", lambda: ([SLOW, GPU], ""))
    monkeypatch.setattr(depthcli.device.cuda, "find_devices", lambda: ([], "nothing there"))


def test_what_names_mean(two_devices, monkeypatch):
    assert find_device("cpu") is None
    assert find_device("auto") == GPU
    assert find_device("opencl") == GPU
    assert find_device("opencl:0") == SLOW
    with pytest.raises(DeviceError, match="there are opencl:0, opencl:1"):
        find_device("opencl:2")
    with pytest.raises(DeviceError, match="nothing there"):
        find_device("cuda")
    for name in ("gpu", "opencl:", "opencl:x", "cuda:-1"):
        with pytest.raises(ConfigError, match="expected cpu, auto"):
            find_device(name)
    monkeypatch.setattr(depthcli.device.opencl, "find_devices", lambda: ([SLOW], ""))
    assert find_device("auto") is None  # without a card the processor


def test_no_device_is_one_line_before_anything_is_written(tmp_path, capsys, made_scenes, monkeypatch):
    monkeypatch.setattr(depthcli.device.opencl, "find_devices", lambda: ([], "no driver"))
    code = main(["stereo", "fast", "-i", str(made_scenes), "-o", str(tmp_path / "run"), "--device", "opencl"])
    assert code == 2
    assert capsys.readouterr().err.strip() == "depthcli: device opencl: no device: no driver"
    assert not (tmp_path / "run").exists()


def test_devices_says_why_there_is_none(capsys, monkeypatch):
    for kind in (depthcli.device.opencl, depthcli.device.cuda):
        monkeypatch.setattr(kind, "find_devices", lambda: ([], "no driver"))
    assert main(["stereo", "--device", "list"]) == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert "opencl: no driver; cuda: no driver" in err


@pytest.fixture
def small_device(monkeypatch):
    """Stands for a card of 1 MiB; what runs on it fails like a driver."""

    class Small:
        info = DeviceInfo("opencl:1", "a small card", 1 << 20, True, "somebody's")

        def __getattr__(self, name):
            raise DeviceError(f"{self.info.address} ({self.info.name}) failed: the driver is gone")

    device = Small()
    monkeypatch.setattr(depthcli.device, "find_device", lambda wanted: device.info)
    monkeypatch.setattr(depthcli.device, "open_device", lambda wanted: device)
    return device


@pytest.mark.parametrize(
    ("memory", "messages"),
    [
        (1 << 20, ("planes_0: needs about", "on opencl:1 (a card), which has 1 MiB")),
        (1 << 33, ("planes_0: opencl:1 (a card) failed: the driver is gone",)),
    ],
)
def test_too_little_memory_or_a_driver_that_fails_costs_the_scene(
    tmp_path, capsys, made_scenes, small_device, memory, messages
):
    small_device.info = DeviceInfo("opencl:1", "a card", memory, True, "somebody's")
    scene = ["-i", str(made_scenes), "-o", str(tmp_path / "run"), "--scenes", "planes_0"]
    assert main(["stereo", "fast", *scene, "--device", "auto"]) == 3
    said = capsys.readouterr().err
    assert all(message in said for message in messages)
    assert "device: opencl:1\n" in (tmp_path / "run" / "run.yaml").read_text()


def test_a_pipeline_without_kernels_says_that_it_ran_on_the_processor(tmp_path, made_scenes, small_device):
    output = tmp_path / "run"
    scene = ["-i", str(made_scenes), "-o", str(output), "--scenes", "planes_0"]
    assert main(["stereo", "opencv-bm", *scene, "--device", "auto", "-q"]) == 0
    (row,) = json.loads((output / "report.json").read_text())["scenes"]
    assert row["device"] == "cpu: opencv_bm has no kernels for opencl:1, a small card"

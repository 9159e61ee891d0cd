"""Devices: what a user reads of them; tests of device implementations in a process of their own (drivers crash)."""

from __future__ import annotations

import importlib.resources
import json
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import depthcli.device.cuda
import depthcli.device.opencl
from depthcli.cli import main
from depthcli.core.errors import ConfigError
from depthcli.device import DeviceError, DeviceInfo, find_device
from depthcli.device.cuda import OPTIONS
from depthcli.device.dialect import COMMON, CUDA
from tests.device import nvrtc

_LIMIT = 400  # seconds


@pytest.mark.system
def test_device_implementations_in_a_process_of_their_own():
    pytest.importorskip("pyopencl", reason="pyopencl is not installed")
    if shutil.which("ld") is None:
        pytest.skip("PoCL links its kernels with ld, which is not installed (package binutils)")
    if not depthcli.device.opencl.list_devices():
        pytest.skip(depthcli.device.opencl.why_no_device())
    tests = Path(__file__).with_name("implementations.py")
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", str(tests)],
        cwd=tests.parents[2], capture_output=True, text=True, timeout=_LIMIT, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-3000:]


FILES = sorted(Path(str(importlib.resources.files("depthcli"))).rglob("*.cl"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_cuda_takes_the_kernels(file):
    library = nvrtc.library()
    if library is None:
        pytest.skip("nvidia-cuda-nvrtc-cu12, which compiles for CUDA, is not installed")
    assert nvrtc.messages(library, CUDA + COMMON + file.read_text("utf-8"), OPTIONS) == ""


@pytest.mark.parametrize(("processor", "count"), [("znver3", 1), ("generic", 0)])
def test_a_processor_that_pocl_does_not_know_is_no_device(monkeypatch, processor, count):
    device = SimpleNamespace(
        version=f"OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-{processor}", driver_version="3.0",
        name="pthread", type=2, global_mem_size=1 << 33,
    )  # fmt: skip
    platform = SimpleNamespace(name="PoCL", get_devices=lambda: [device])
    known = {"get_platforms": lambda: [platform], "device_type": SimpleNamespace(GPU=4), "Error": RuntimeError}
    monkeypatch.setitem(sys.modules, "pyopencl", SimpleNamespace(**known))
    depthcli.device.opencl._handles.cache_clear()
    try:
        assert len(depthcli.device.opencl.list_devices()) == count
        assert ("does not know this processor" in depthcli.device.opencl.why_no_device()) == (count == 0)
    finally:
        depthcli.device.opencl._handles.cache_clear()


GPU = DeviceInfo("opencl:1", "a card", 1 << 33, True, "somebody's")
SLOW = DeviceInfo("opencl:0", "a processor", 1 << 34, False, "somebody else's")


@pytest.fixture
def two_devices(monkeypatch):
    monkeypatch.setattr(depthcli.device.opencl, "list_devices", lambda: [SLOW, GPU])
    monkeypatch.setattr(depthcli.device.cuda, "list_devices", list)
    monkeypatch.setattr(depthcli.device.cuda, "why_no_device", lambda: "nothing there")


def test_what_names_mean(two_devices):
    assert find_device("cpu") is None
    assert find_device("auto") == GPU
    assert find_device("opencl") == GPU
    assert find_device("opencl:0") == SLOW
    with pytest.raises(DeviceError, match="there are opencl:0, opencl:1"):
        find_device("opencl:2")
    with pytest.raises(DeviceError, match="nothing there"):
        find_device("cuda")
    for name in ("gpu", "opencl:", "opencl:x", "cuda:-1"):
        with pytest.raises(ConfigError, match="want cpu, auto"):
            find_device(name)


def test_auto_without_a_card_is_the_processor(two_devices, monkeypatch):
    monkeypatch.setattr(depthcli.device.opencl, "list_devices", lambda: [SLOW])
    assert find_device("auto") is None


def test_no_device_is_one_line_before_anything_is_written(tmp_path, capsys, made_scenes, monkeypatch):
    monkeypatch.setattr(depthcli.device.opencl, "list_devices", list)
    monkeypatch.setattr(depthcli.device.opencl, "why_no_device", lambda: "no driver")
    code = main(["stereo", "fast", "-i", str(made_scenes), "-o", str(tmp_path / "run"), "--device", "opencl"])
    assert code == 2
    assert capsys.readouterr().err.strip() == "depthcli: device opencl: no device: no driver"
    assert not (tmp_path / "run").exists()


def test_devices_says_why_there_is_none(capsys, monkeypatch):
    for kind in (depthcli.device.opencl, depthcli.device.cuda):
        monkeypatch.setattr(kind, "list_devices", list)
        monkeypatch.setattr(kind, "why_no_device", lambda: "no driver")
    assert main(["devices", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == []
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


def test_what_does_not_fit_on_the_device_fails_before_it_starts(tmp_path, capsys, made_scenes, small_device):
    output = tmp_path / "run"
    code = main(
        ["stereo", "fast", "-i", str(made_scenes), "-o", str(output), "--scenes", "planes_0", "--device", "auto"]
    )
    assert code == 3
    assert "planes_0: needs about" in (said := capsys.readouterr().err)
    assert "on opencl:1 (a small card), which has 1 MiB" in said
    assert "device: opencl:1\n" in (output / "run.yaml").read_text()


def test_a_driver_that_fails_costs_the_scene(tmp_path, capsys, made_scenes, small_device):
    small_device.info = DeviceInfo("opencl:1", "a card", 1 << 33, True, "somebody's")
    output = tmp_path / "run"
    code = main(
        ["stereo", "fast", "-i", str(made_scenes), "-o", str(output), "--scenes", "planes_0", "--device", "auto"]
    )
    assert code == 3
    assert "planes_0: opencl:1 (a card) failed: the driver is gone" in capsys.readouterr().err


def test_a_pipeline_without_kernels_says_that_it_ran_on_the_processor(tmp_path, made_scenes, small_device):
    output = tmp_path / "run"
    scene = ["-i", str(made_scenes), "-o", str(output), "--scenes", "planes_0"]
    assert main(["stereo", "opencv-bm", *scene, "--device", "auto", "-q"]) == 0
    (row,) = json.loads((output / "report.json").read_text())["scenes"]
    assert row["device"] == "cpu: opencv_bm has no kernels for opencl:1, a small card"

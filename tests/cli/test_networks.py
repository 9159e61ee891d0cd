"""Networks and volumes of costs from the command line: what a user sees of right and of wrong ones."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

import depthcli
from depthcli.core.errors import ConfigError
from depthcli.core.frames import StereoPair
from depthcli.io.formats.disparity import read_pfm
from depthcli.io.formats.networks import network_path
from depthcli.methods.stereo.cost.census import Census
from depthcli.testing.inputs import shifted_pair
from tests.command_line import Tool, run
from tests.files import laid
from tests.golden import refused
from tests.methods.stereo._networks import block_matcher, has_onnx, local_features

needs_onnx = pytest.mark.skipif(not has_onnx(), reason="onnxruntime or onnx is not installed")


def write_pair(folder: Path, pair: StereoPair) -> None:
    laid(folder, {"left.png": pair.left, "right.png": pair.right})


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    for name, shift in (("a", 5), ("b", 7)):
        write_pair(tmp_path / "in" / name, shifted_pair(40, 90, shift))
    return tmp_path / "in"


def config(tmp_path: Path, **fields: object) -> Path:
    fields = {"pipeline": "onnx", "model": str(tmp_path / "net.onnx"), "max_disparity": 12, **fields}
    return laid(tmp_path, {"net.yaml": yaml.safe_dump(fields)}) / "net.yaml"


@needs_onnx
def test_a_batch_in_workers_and_python_and_what_makes_it_run_again(scenes: Path, tmp_path: Path):
    block_matcher(tmp_path / "net.onnx")
    command, made = ("stereo", config(tmp_path), "-i", scenes, "-o", tmp_path / "run", "-q"), tmp_path / "run"
    assert run(*command, "--jobs", "2") == 0
    for name, shift in (("a", 5), ("b", 7)):
        assert np.mean(read_pfm(made / name / "disp_left.pfm")[:, 12:] == shift) > 0.98
        assert (made / name / "confidence_lrc.pfm").is_file()
    pair = shifted_pair(40, 90, 7)
    found = depthcli.stereo(pair.left, pair.right, preset=command[1])
    np.testing.assert_array_equal(found.values, read_pfm(made / "b" / "disp_left.pfm"))
    record = made / "a" / "record.json"
    before = record.stat().st_mtime_ns
    assert run(*command) == 0
    assert record.stat().st_mtime_ns == before and "model" in json.loads(record.read_text())["inputs"]
    block_matcher(tmp_path / "net.onnx", disparities=20)  # another network in the same file is another input
    assert run(*command) == 0
    assert record.stat().st_mtime_ns != before


@needs_onnx
def test_fuse_takes_networks_as_measures(scenes: Path, tmp_path: Path):
    network = {"method": "onnx", "model": str(local_features(tmp_path / "features.onnx")), "normalization": "0-1"}
    file = fuse_config(tmp_path, measures=["census", network], max_disparity=12)
    assert run("fuse", file, "-i", scenes, "-o", tmp_path / "run", "-q") == 0
    assert np.mean(read_pfm(tmp_path / "run" / "a" / "disp_left.pfm")[:, 12:] == 5) > 0.98
    assert "model" in json.loads((tmp_path / "run" / "a" / "record.json").read_text())["inputs"]


def _refused(file: Path, scenes: Path, output: Path, tool: Tool, *options: str) -> None:
    assert tool.told(2, "stereo", file, "-i", scenes, "-o", output, *options).count("\n") == 1
    assert not output.exists()


@needs_onnx
def test_networks_that_cannot_be_used_are_refused_before_the_batch(scenes: Path, tmp_path: Path, tool):
    block_matcher(tmp_path / "net.onnx", factor=-1)
    file, output = config(tmp_path), tmp_path / "run"
    for options in ((), ("--device", "opencl"), ("--device", "cuda"), ("--set", "normalization=0..1")):
        _refused(file, scenes, output, tool, *options)
    (tmp_path / "net.onnx").write_bytes(b"no network")
    assert "not a network that onnxruntime can run" in tool.err(2, "stereo", file, "-i", scenes, "-o", output)
    (tmp_path / "net.onnx").unlink()
    _refused(file, scenes, output, tool)


def test_what_to_install_is_said_in_one_line(scenes: Path, tmp_path: Path, tool, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    (tmp_path / "net.onnx").write_bytes(b"network")
    _refused(config(tmp_path), scenes, tmp_path / "run", tool)
    left = shifted_pair(20, 40, 2).left
    refused(ConfigError, depthcli.stereo, left, left, preset=config(tmp_path))


@needs_onnx
def test_a_scene_at_which_the_network_fails_is_a_failed_row(scenes: Path, tmp_path: Path, tool):
    block_matcher(tmp_path / "net.onnx", multiple=40)  # scenes have 40 rows, one here 41; the self-check is left out
    write_pair(scenes / "b", shifted_pair(41, 90, 5))
    file = config(tmp_path, multiple=1, self_check=False)
    err = tool.err(3, "stereo", file, "-i", scenes, "-o", tmp_path / "run")
    assert "the network fails for left (1, 3, 41, 90)" in err
    assert (tmp_path / "run" / "a" / "disp_left.pfm").is_file()


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    wide = np.kron(np.random.default_rng(0).integers(0, 256, (20, 40)), np.ones((2, 2))).astype(np.uint8)
    folder, pair = tmp_path / "data" / "shifted", StereoPair(wide[:, :70].copy(), wide[:, 5:75].copy())
    write_pair(folder, pair)
    np.save(folder / "learned.npy", Census()(pair, 12).costs.astype(np.float32))
    return folder


def fuse_config(tmp_path: Path, **fields: object) -> Path:
    fields = {"measures": ["census", {"volume": "learned.npy"}], "max_disparity": 11, **fields}
    return laid(tmp_path, {"fuse.yaml": yaml.safe_dump(fields)}) / "fuse.yaml"


def test_a_volume_from_the_scene_folder_and_confidence_maps(scene: Path, tmp_path: Path):
    made, command = tmp_path / "run" / "shifted", ("-i", scene.parent, "-o", tmp_path / "run", "-q")
    file = fuse_config(tmp_path, confidence=["pkr", "consensus"])
    assert run("fuse", file, *command) == 0
    assert np.mean(read_pfm(made / "disp_left.pfm")[:, 12:] == 5) > 0.98
    share = read_pfm(made / "confidence_consensus.pfm")
    assert 0 <= np.nanmin(share) <= np.nanmax(share) <= 1 and (made / "confidence_pkr.pfm").is_file()
    before = (made / "disp_left.pfm").stat().st_mtime_ns
    np.save(scene / "learned.npy", np.load(scene / "learned.npy")[:, :, ::-1])  # another volume is another input
    assert run("fuse", file, *command) == 0
    assert (made / "disp_left.pfm").stat().st_mtime_ns != before


def test_edited_weights_are_another_input(scene: Path, tmp_path: Path, tool):
    network, record = tmp_path / "net.json", tmp_path / "run" / "shifted" / "record.json"
    shutil.copyfile(network_path("accurate"), network)
    command = ("fuse", "accurate", "-i", scene.parent, "-o", tmp_path / "run", "-q", "--set", "max_disparity=11")

    def stamp() -> int:
        assert run(*command, "--set", f"maps.choice.weights={network}") == 0
        return record.stat().st_mtime_ns

    before = stamp()
    assert stamp() == before
    network.write_text(network.read_text().replace('"mean":[', '"mean":[ '))
    assert stamp() != before
    network.write_text("{}")
    for name in (network, "x"):
        assert tool.told(2, *command, "--set", f"maps.choice.weights={name}").count("\n") == 1


def test_a_scene_whose_volume_is_missing_or_damaged_fails_alone(scene: Path, tmp_path: Path, tool):
    missing, damaged, flat = (
        Path(shutil.copytree(scene, scene.parent / name)) for name in ("missing", "damaged", "flat")
    )
    (missing / "learned.npy").unlink()
    laid(damaged, {"learned.npy": b"\x93NUMPY no"})
    laid(flat, {"learned.npy": np.zeros((40, 70))})
    for folder in scene.parent.glob("*/learned.npy"):
        folder.rename(folder.with_name(f"{folder.parent.name}_costs.npy"))
    file = fuse_config(tmp_path, measures=[{"volume": "{scene}_costs.npy"}])  # a name may hold the scene
    err = tool.err(3, "fuse", file, "-i", scene.parent, "-o", tmp_path / "run", "-q")
    assert all(word in err for word in ("no such file", "damaged/damaged_costs.npy", "(H, W, D)"))
    lower = ("--scenes", "shifted", "--min-disparity", "1", "-o", tmp_path / "lower", "-q")
    tool.told(3, "fuse", file, "-i", scene.parent, *lower)
    assert np.mean(read_pfm(tmp_path / "run" / "shifted" / "disp_left.pfm")[:, 12:] == 5) > 0.98

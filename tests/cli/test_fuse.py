from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from depthcli.core.frames import StereoPair
from depthcli.io.formats.disparity import read_pfm
from depthcli.io.formats.images import write_png
from depthcli.io.formats.networks import network_path
from depthcli.methods.stereo.cost.census import Census
from tests.command_line import run


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    wide = np.kron(rng.integers(0, 256, (20, 40)), np.ones((2, 2))).astype(np.uint8)
    folder = tmp_path / "data" / "shifted"
    folder.mkdir(parents=True)
    left, right = np.ascontiguousarray(wide[:, :70]), np.ascontiguousarray(wide[:, 5:75])
    write_png(folder / "left.png", left)
    write_png(folder / "right.png", right)
    np.save(folder / "learned.npy", Census()(StereoPair(left, right), 12).costs.astype(np.float32))
    return folder


def config(tmp_path: Path, **fields: object) -> Path:
    path = tmp_path / "fuse.yaml"
    path.write_text(yaml.safe_dump({"measures": ["census", {"volume": "learned.npy"}], **fields}), "utf-8")
    return path


def test_a_volume_from_the_scene_folder_and_confidence_maps(scene: Path, tmp_path: Path):
    file = config(tmp_path, max_disparity=11, confidence=["pkr", "consensus"])
    assert run("fuse", file, "-i", scene.parent, "-o", tmp_path / "run", "-q") == 0
    made = tmp_path / "run" / "shifted"
    assert np.mean(read_pfm(made / "disp_left.pfm")[:, 12:] == 5) > 0.98
    share = read_pfm(made / "confidence_consensus.pfm")
    assert 0 <= np.nanmin(share) <= np.nanmax(share) <= 1
    assert (made / "confidence_pkr.pfm").is_file()
    # run.yaml is a config again: the same run, nothing to do.
    before = (made / "disp_left.pfm").stat().st_mtime_ns
    assert run("fuse", tmp_path / "run" / "run.yaml", "-i", scene.parent, "-o", tmp_path / "run", "-q") == 0
    assert (made / "disp_left.pfm").stat().st_mtime_ns == before
    # Another volume is another input.
    np.save(scene / "learned.npy", np.load(scene / "learned.npy")[:, :, ::-1])
    assert run("fuse", file, "-i", scene.parent, "-o", tmp_path / "run", "-q") == 0
    assert (made / "disp_left.pfm").stat().st_mtime_ns != before


def test_edited_weights_are_another_input(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    network = tmp_path / "net.json"
    shutil.copyfile(network_path("accurate"), network)
    command = ("fuse", "accurate", "-i", scene.parent, "-o", tmp_path / "run", "-q", "--set", "max_disparity=11")
    weights = ("--set", f"maps.choice.weights={network}")
    assert run(*command, *weights) == 0
    record = tmp_path / "run" / "shifted" / "record.json"
    before = record.stat().st_mtime_ns
    assert run(*command, *weights) == 0
    assert record.stat().st_mtime_ns == before
    network.write_text(network.read_text().replace('"mean":[', '"mean":[ '))
    assert run(*command, *weights) == 0
    assert record.stat().st_mtime_ns != before
    network.write_text("{}")
    capsys.readouterr()
    for name, message in ((network, "net.json: not a network that depthcli wrote"), ("x", "no network called 'x'")):
        assert run(*command, "--set", f"maps.choice.weights={name}") == 2
        lines = capsys.readouterr().err.strip().splitlines()
        assert len(lines) == 1 and message in lines[0] and "maps.choice.weights" in lines[0]


def test_the_name_of_a_volume_may_hold_the_scene(scene: Path, tmp_path: Path):
    (scene / "learned.npy").rename(scene / "shifted_costs.npy")
    file = config(tmp_path, measures=[{"volume": "{scene}_costs.npy"}], max_disparity=11)
    assert run("fuse", file, "-i", scene.parent, "-o", tmp_path / "run", "-q") == 0
    assert np.mean(read_pfm(tmp_path / "run" / "shifted" / "disp_left.pfm")[:, 12:] == 5) > 0.98


def test_a_scene_whose_volume_is_missing_or_damaged_fails_alone(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for name, data in (("missing", None), ("damaged", b"\x93NUMPY no"), ("flat", np.zeros((40, 70)))):
        other = scene.parent / name
        other.mkdir()
        for file in ("left.png", "right.png"):
            (other / file).write_bytes((scene / file).read_bytes())
        if isinstance(data, bytes):
            (other / "learned.npy").write_bytes(data)
        elif data is not None:
            np.save(other / "learned.npy", data)
    file = config(tmp_path, max_disparity=11)
    assert run("fuse", file, "-i", scene.parent, "-o", tmp_path / "run", "-q") == 3
    err = capsys.readouterr().err
    assert "no such file" in err
    assert "npy" in err
    assert "(H, W, D)" in err
    assert (tmp_path / "run" / "shifted" / "disp_left.pfm").is_file()

"""Pairs whose cameras stand one above the other: the same maps as those of the pair turned by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import depthcli
from depthcli.cli import main
from depthcli.io.formats.disparity import read_pfm, write_pfm
from depthcli.io.formats.images import read_image, write_png


@pytest.fixture(scope="module")
def scene(made_scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A generated scene with truth, turned clockwise: the left view becomes the upper one."""
    folder = tmp_path_factory.mktemp("vertical") / "wall"
    for side in ("left", "right"):
        image = read_image(made_scenes / "planes_0" / f"{side}.png")
        write_png(folder / f"{side}.png", np.ascontiguousarray(np.rot90(image, -1)))
    truth = read_pfm(made_scenes / "planes_0" / "disp_left.pfm")
    write_pfm(folder / "disp_left.pfm", np.ascontiguousarray(np.rot90(truth, -1)))
    (folder / "meta.json").write_text(json.dumps({"max_disparity": 12}))
    return folder


@pytest.mark.parametrize("command", ["stereo", "fuse"])
def test_the_map_is_that_of_the_turned_pair(made_scenes: Path, scene: Path, command: str) -> None:
    lying = [read_image(made_scenes / "planes_0" / f"{side}.png") for side in ("left", "right")]
    standing = [read_image(scene / f"{side}.png") for side in ("left", "right")]
    match = getattr(depthcli, command)
    fields = {"confidence": ["lrc"]} if command == "stereo" else {}
    wanted, found = match(*lying, 12, **fields), match(*standing, 12, axis="vertical", **fields)
    np.testing.assert_array_equal(found.values, np.rot90(wanted.values, -1))
    np.testing.assert_array_equal(found.status, np.rot90(wanted.status, -1))
    assert set(found.confidence) == set(wanted.confidence)
    for name, values in wanted.confidence.items():
        np.testing.assert_array_equal(found.confidence[name], np.rot90(values, -1))
    assert found.left.shape == standing[0].shape


def test_a_run_of_vertical_pairs_is_evaluated_and_says_so(scene: Path, tmp_path: Path) -> None:
    arguments = ["stereo", "accurate", "-i", str(scene.parent), "-o", str(tmp_path / "run"), "--axis", "vertical", "-q"]
    assert main([*arguments, "--evaluate"]) == 0
    found, truth = read_pfm(tmp_path / "run" / "wall" / "disp_left.pfm"), read_pfm(scene / "disp_left.pfm")
    assert found.shape == truth.shape
    assert np.nanmean(np.abs(found - truth) > 1) < 0.1
    assert (tmp_path / "run" / "evaluation").is_dir()
    assert "axis: vertical" in (tmp_path / "run" / "run.yaml").read_text()
    assert yaml.safe_load((tmp_path / "run" / "run.yaml").read_text())
    saved = depthcli.stereo(read_image(scene / "left.png"), read_image(scene / "right.png"), 12, axis="vertical")
    saved.save(tmp_path / "python")
    assert (tmp_path / "python" / "disp_left.pfm").read_bytes() == (
        tmp_path / "run" / "wall" / "disp_left.pfm"
    ).read_bytes()  # fmt: skip


def test_vertical_pairs_are_not_rectified(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pair = ["--left", str(scene / "left.png"), "--right", str(scene / "right.png"), "-o", str(tmp_path / "out")]
    assert main(["stereo", "fast", *pair, "--axis", "vertical", "--calibration", "rig.yml"]) == 2
    assert "vertical pairs have to be rectified" in capsys.readouterr().err
    assert main(["stereo", "fast", *pair, "--axis", "diagonal"]) == 2
    assert "axis" in capsys.readouterr().err

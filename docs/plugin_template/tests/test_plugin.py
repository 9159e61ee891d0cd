"""Tests of everything that this package adds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from depthcli_example.cost import SquaredDifference
from depthcli_example.layout import TwoFiles
from depthcli_example.map_format import Table
from depthcli_example.protocol import EighthPixel

from depthcli.cli import main
from depthcli.io.scenes import Folder, Scene
from depthcli.io.stereo_pairs import load_pair
from depthcli.testing import check_cost_measure


def scene_in(folder: Path) -> Scene:
    """Return the one scene of a folder."""
    (scene,) = TwoFiles().scenes(Folder(folder, folder.name, ""))
    return scene


def test_cost():
    check_cost_measure(SquaredDifference())


def test_layout(scenes: Path):
    near = scene_in(scenes / "near")
    assert near.layout == "two-files" and near.has_truth and not near.problem
    assert load_pair(near).shape == (48, 64)
    assert not TwoFiles().scenes(Folder(scenes, "scenes", ""))


def test_format(scenes: Path):
    np.testing.assert_array_equal(Table().read(scenes / "near" / "first_truth.table"), np.full((48, 64), 9))


def test_protocol(scenes: Path):
    protocol, scene = EighthPixel(), scene_in(scenes / "near")
    truth = protocol.truth(scene)
    best = protocol.read(scenes / "near" / "first_truth.table", scene, truth)
    assert not protocol.wrong(best, truth).any()
    assert next(score.value for score in protocol.scores(best, truth) if score.metric == protocol.headline) == 0


def test_command(scenes: Path, tmp_path: Path):
    (tmp_path / "five.yaml").write_text("disparity: 5\n")
    run = ["constant", str(tmp_path / "five.yaml"), "--input", str(scenes), "--output", str(tmp_path / "run")]
    assert main(run) == 0
    assert (tmp_path / "run" / "near" / "disp_left.pfm").is_file()

"""What depthcli asks of everything that this package adds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from depthcli_example.command import constant
from depthcli_example.cost import SquaredDifference
from depthcli_example.layout import TwoFiles
from depthcli_example.map_format import Table
from depthcli_example.protocol import EighthPixel

from depthcli.io.layouts import Folder
from depthcli.testing import check_command, check_cost_measure, check_format, check_layout, check_protocol


def test_cost():
    check_cost_measure(SquaredDifference())


def test_layout(scenes: Path):
    check_layout(TwoFiles(), scenes)


def test_format(scenes: Path):
    check_format(Table(), scenes / "near" / "first_truth.table", np.full((48, 64), 9, np.float32))


def test_protocol(scenes: Path):
    (scene,) = TwoFiles().scenes(Folder(scenes / "near", "near", ""))
    check_protocol(EighthPixel(), scene, scenes / "near" / "first_truth.table")


def test_command(scenes: Path, tmp_path: Path):
    config = tmp_path / "five.yaml"
    config.write_text("disparity: 5\n")
    check_command(constant, [config, "--input", scenes], tmp_path / "runs")

"""The tests that plug-ins are given: our own classes pass them, and what is wrong is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from depthcli.commands.rectify import COMMAND as RECTIFY
from depthcli.commands.stereo import COMMAND as STEREO
from depthcli.evaluation.protocols import Protocol, load
from depthcli.io.formats.map_format import MapFormat
from depthcli.io.layouts.scenes import Scenes
from depthcli.io.walk import discover_scenes
from depthcli.testing import check_command, check_format, check_layout, check_protocol

STEREO_PROTOCOLS = ("middlebury-v2", "eth3d", "kitti-2012", "kitti-2015")


@pytest.mark.parametrize("name", STEREO_PROTOCOLS)
def test_protocols(name: str, made_scenes: Path):
    scene = discover_scenes(made_scenes)[0]
    check_protocol(load(name)(), scene, scene.disparity_left)  # type: ignore[attr-defined]


def test_a_protocol_without_its_headline(made_scenes: Path):
    class Silent(load("eth3d")):  # type: ignore[misc]
        def scores(self, estimate, truth):
            return [score for score in super().scores(estimate, truth) if score.metric != self.headline]

    scene = discover_scenes(made_scenes)[0]
    assert issubclass(Silent, Protocol)
    with pytest.raises(AssertionError, match="scores lack the headline"):
        check_protocol(Silent(), scene, scene.disparity_left)  # type: ignore[attr-defined]


def test_layouts(made_scenes: Path):
    check_layout(Scenes(), made_scenes)

    class Greedy(Scenes):
        def scenes(self, folder):
            return [self.scene(folder, left=folder.path / "left.png")]

    with pytest.raises(AssertionError, match=r"names files that are not there|fits|cannot be used|notes\.txt"):
        check_layout(Greedy(), made_scenes)


def test_formats(tmp_path: Path):
    class Lines(MapFormat):
        suffixes = (".lines",)

        def read(self, path):
            return np.loadtxt(path, ndmin=2) if path.exists() else np.zeros((2, 2))

    (tmp_path / "a.lines").write_text("1 2\n3 4\n")
    with pytest.raises(AssertionError, match="a file that is not there is read"):
        check_format(Lines(), tmp_path / "a.lines", np.array([[1, 2], [3, 4]]))
    with pytest.raises(AssertionError, match="Mismatched elements"):
        check_format(Lines(), tmp_path / "a.lines", np.array([[1, 2], [3, 5]]))


@pytest.mark.slow
def test_commands(made_scenes: Path, tmp_path: Path):
    check_command(STEREO, ["opencv-bm", "-i", made_scenes, "--scenes", "planes_*"], tmp_path)
    with pytest.raises(AssertionError, match="rectify exits with 2"):
        check_command(RECTIFY, ["-i", tmp_path / "nowhere"], tmp_path / "other")

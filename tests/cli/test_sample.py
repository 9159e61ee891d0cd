"""``depthcli sample``: generated scenes, through the loop of every other command."""

import json
from pathlib import Path

import numpy as np
import pytest
from skimage.data import stereo_motorcycle

from depthcli.io.formats.calibrations import read_geometry
from depthcli.io.scenes import StereoScene
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.pairs import PAIRS
from depthcli.simulate import samples
from depthcli.simulate.stereo_scenes import Radiometry, make_scene
from tests.command_line import run
from tests.scenes import load, true

SMALL = ("--width", "64", "--height", "48", "--max-disparity", "10")


def sample(output: Path, *options: str | Path) -> int:
    return run("sample", "-o", output, "-q", *SMALL, *options)


def scenes(folder: Path) -> dict[str, StereoScene]:
    return {scene.name: scene for scene in discover_scenes(folder, PAIRS) if isinstance(scene, StereoScene)}


@pytest.mark.slow
def test_scenes_are_what_the_generator_made(tmp_path: Path):
    assert sample(tmp_path, "-n", "5", "--noise", "2", "--radiometric", "0.5") == 0
    assert sorted(scenes(tmp_path)) == ["curved_0", "foreground_0", "planes_0", "planes_1", "repetitive_0"]
    stored = scenes(tmp_path)["planes_1"]
    made = make_scene("planes", 1, 64, 48, 10, noise=2.0, radiometry=Radiometry.of_strength(0.5))
    pair, truth = load(stored), true(stored)
    np.testing.assert_array_equal(pair.left, made.left)
    np.testing.assert_array_equal(pair.right, made.right)
    np.testing.assert_array_equal(truth.masks["disc"], made.disc)
    assert (stored.max_disparity, stored.protocol) == (10, "middlebury_v2")
    meta = json.loads((tmp_path / "planes_1" / "meta.json").read_text())
    assert set(meta) == {"protocol", "disp_scale", "max_disparity", "width", "height", "masks", "source", "notes"}
    assert sample(tmp_path / "street", "-n", "2", "--kind", "street", "--kind", "planes") == 0  # where it is requested
    assert sorted(scenes(tmp_path / "street")) == ["planes_0", "street_0"]


def test_the_real_pair_is_written_with_its_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tool):
    assert run("sample", "--real", "-o", tmp_path, "-q") == 0
    stored = scenes(tmp_path)["Motorcycle"]
    left, _, disparity = stereo_motorcycle()
    np.testing.assert_array_equal(load(stored).left, left)
    np.testing.assert_array_equal(np.isnan(true(stored).disparity), ~np.isfinite(disparity))
    assert "GCPR 2014" in json.loads((tmp_path / "Motorcycle" / "meta.json").read_text())["citation"]
    assert stored.max_disparity == 70 and stored.calibration is not None
    geometry = read_geometry(stored.calibration)
    assert (geometry.left.fx, geometry.left.cx, geometry.left.cy) == (994.978, 311.193, 254.877)
    assert (geometry.baseline, geometry.offset, geometry.size) == (0.193001, 31.086, (741, 500))
    monkeypatch.setitem(samples._REAL_FILES, "left", "missing.png")  # in a build of scikit-image without the pair
    error = tool.err(2, "sample", "--real", "-o", tmp_path / "out")
    assert "missing.png" in error and "--real" in error and error.count("\n") == 1


def test_cross_modal_keeps_the_truth(tmp_path: Path, tool):
    given, made = tmp_path / "in", tmp_path / "out"
    assert sample(given, "-n", "4") == 0
    (given / "curved_0" / "right.png").write_bytes(b"not a picture")
    line = ("sample", "--cross-modal", "-q", *SMALL)
    tool.told(3, *line, "-o", made, "--from", given, "--speckles", "0.01")
    before, after = (scenes(folder)["planes_0"] for folder in (given, made))
    assert sorted(scenes(made)) == ["foreground_0", "planes_0", "repetitive_0"]
    np.testing.assert_array_equal(true(before).disparity, true(after).disparity)
    np.testing.assert_array_equal(true(before).masks["nonocc"], true(after).masks["nonocc"])
    assert after.max_disparity == 10 and load(after).right.ndim == 2
    for folder, source in ((given, given), (tmp_path / "x", tmp_path / "missing")):
        assert run(*line, "-o", folder, "--from", source) == 2

"""``refine_depth`` and ``complete_transparent`` from Python: bytes of saved files, sequences, inputs, errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import depthcli
from depthcli.cli import main
from depthcli.io.formats.disparity import read_pfm
from depthcli.io.formats.images import read_image
from tests.api.test_stereo import assert_same_files


@pytest.fixture(scope="module")
def kinect(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kinect")
    size = ["--width", "96", "--height", "72", "--frames", "3"]
    assert main(["sample", "--kinect", *size, "-o", str(folder), "-q"]) == 0
    return folder


@pytest.fixture(scope="module")
def glass(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("glass")
    size = ["--width", "128", "--height", "96", "--share", "0.1"]
    assert main(["sample", "--transparent", *size, "-o", str(folder), "-q"]) == 0
    return folder


def frame(folder: Path, number: str = "") -> tuple[Any, Any]:
    return read_image(folder / f"color{number}.png"), read_pfm(folder / f"depth{number}.pfm")


@pytest.mark.parametrize("preset", ["accurate", "dsrm"])
def test_refined_files_are_those_of_the_command(tmp_path: Path, kinect: Path, preset: str):
    color, depth = frame(kinect / "planes")
    found = depthcli.refine_depth(color, depth, preset, fb=43.5, ply=True, mask="measured", far=50)
    found.save(tmp_path / "python")
    cloud = ["--ply", "--mask", "measured", "--far", "50"]
    run = str(tmp_path / "run")
    assert main(["refine-kinect", preset, "-i", str(kinect), "--scenes", "planes", *cloud, "-o", run, "-q"]) == 0
    assert_same_files(tmp_path / "python", tmp_path / "run" / "planes")
    found.to_points("measured", far=50).save(tmp_path / "own.ply")
    assert (tmp_path / "own.ply").read_bytes() == (tmp_path / "python" / "points.ply").read_bytes()


def test_a_sequence_is_refined_as_by_the_command(tmp_path: Path, kinect: Path):
    frames = [frame(kinect / "moving", f"_{k:05}") for k in range(3)]
    colors, depths = zip(*frames, strict=True)
    for k, found in enumerate(depthcli.refine_depth(list(colors), list(depths), "sequence", fb=43.5)):
        found.save(tmp_path / "python" / f"{k:05}")
    run = str(tmp_path / "run")
    assert main(["refine-kinect", "sequence", "-i", str(kinect), "--scenes", "moving*", "-o", run, "-q"]) == 0
    for k in range(3):
        assert_same_files(tmp_path / "python" / f"{k:05}", tmp_path / "run" / "moving" / f"{k:05}", ())


def test_a_result_describes_itself_and_codes_are_depths_by_their_scale(kinect: Path):
    color, depth = frame(kinect / "planes")
    codes = np.where(np.isfinite(depth), np.rint(depth * 5000), 0).clip(0, 65535).astype(np.uint16)
    by_codes = depthcli.refine_depth(color, codes, "nearest", depth_scale=5000)
    by_meters = depthcli.refine_depth(color, np.where(codes > 0, codes / 5000, np.nan), "nearest")
    assert np.array_equal(by_codes.values, by_meters.values, equal_nan=True)
    found = depthcli.refine_depth(color, depth, "fast", intrinsics=(80, 80, 47.5, 35.5))
    assert np.array_equal(found.filled | found.kept | found.corrected, found.valid)
    assert not (found.filled & found.kept).any()
    assert not np.isfinite(depth[found.filled]).any()
    assert found.sigma.shape == found.values.shape == (72, 96)
    assert "other" in found.seconds and repr(found).startswith("RefinedDepth(96 x 72, ")
    assert found._repr_png_().startswith(b"\x89PNG")
    points = found.to_points()
    again = found.to_points(intrinsics=(80, 80, 47.5, 35.5))
    assert len(points) == found.valid.sum() and np.array_equal(points.points, again.points)
    assert points.points[:, 2] == pytest.approx(found.values[found.valid])


@pytest.mark.parametrize("preset", ["sparse", "kinect"])
def test_completed_files_are_those_of_the_command(tmp_path: Path, glass: Path, preset: str):
    scene = glass / "glass_0"
    more: dict[str, Any] = {"sparse": read_pfm(scene / "sparse.pfm"), "fb": 24.0}
    if preset == "kinect":
        more = {"infrared": read_image(scene / "ir.png"), "calibration": scene / "calib.json"}
        more["overrides"] = {"stereo.max_disparity": 16}
    found = depthcli.complete_transparent(*frame(scene), **more)
    found.save(tmp_path / "python")
    run = str(tmp_path / "run")
    limit = ["--set", "stereo.max_disparity=16"] if preset == "kinect" else []
    assert main(["transparent", preset, "-i", str(glass), "--scenes", "glass_0", *limit, "-o", run, "-q"]) == 0
    assert_same_files(tmp_path / "python", tmp_path / "run" / "glass_0")
    assert ("stereo" in found.confidence) == (preset == "kinect")


COLOR, DEPTH = np.full((8, 9, 3), 100, np.uint8), np.ones((8, 9), np.float32)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((COLOR, np.zeros((8, 9), np.uint16)), "depth: no pixel has a depth"),
        (([COLOR], DEPTH), "two lists of as many"),
        (([COLOR, COLOR[:5]], [DEPTH, DEPTH[:5]]), "frame 1: 9 x 5, but frame 0 is 9 x 8"),
    ],
)
def test_wrong_frames_are_refused(arguments: tuple[Any, Any], message: str):
    with pytest.raises(depthcli.InputError, match=message):
        depthcli.refine_depth(*arguments, "nearest")


def test_what_a_preset_needs_is_said():
    with pytest.raises(depthcli.InputError, match="wants sparse depth"):
        depthcli.complete_transparent(COLOR, DEPTH, preset="sparse")
    with pytest.raises(depthcli.InputError, match="wants an infrared image"):
        depthcli.complete_transparent(COLOR, DEPTH)
    with pytest.raises(depthcli.ConfigError, match="either the calibration of both cameras, or fb"):
        depthcli.complete_transparent(COLOR, DEPTH, infrared=COLOR[..., 0])
    with pytest.raises(depthcli.ConfigError, match="override depth_scale"):
        depthcli.refine_depth(COLOR, DEPTH, depth_scale=-1)


def test_depth_of_its_own_camera_is_registered():
    color, depth = np.zeros((60, 80, 3), np.uint8), np.full((15, 24), 2.0, np.float32)
    cameras = {"intrinsics": (80, 80, 39.5, 29.5), "depth_intrinsics": [20, 20, 11.5, 7]}
    found = depthcli.refine_depth(color, depth, "nearest", **cameras)
    assert found.values.shape == (60, 80)
    assert (found.values == 2).all()
    assert found.kept.all()
    assert (found.status == depthcli.DepthStatus.SMOOTHED).all()
    moved = depthcli.refine_depth(color, depth, "nearest", **cameras, depth_to_color=(np.eye(3), [0.5, 0, 0]))
    # Half of the 24 - 20 columns that the depth camera sees more on either side, and 80 x 0.5 / 2 pixels.
    assert moved.filled.sum() == (20 - 8) * 60


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"depth_intrinsics": (1, 2, 3)}, "depth_intrinsics: want 4 finite numbers"),
        ({"depth_to_color": np.eye(4)}, "depth_to_color: want rotation and translation .got 4 parts"),
    ],
)
def test_wrong_depth_cameras_are_refused(keywords: dict[str, Any], message: str):
    with pytest.raises(depthcli.InputError, match=message):
        depthcli.refine_depth(COLOR, DEPTH, "nearest", **keywords)

"""Files of calibrations in which one thing cannot be: each is refused for it, and read without it."""

import re
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.io.calibration_photos import find_photos
from depthcli.io.formats.calibrations import read_color_infrared_rig, read_geometry, read_rig
from tests.boards import opencv
from tests.calibrations import RIGS, SIZE, geometries, rig
from tests.files import laid
from tests.golden import refused, told, warned

VGA = (672, 376)  # by which the cameras of ZED's file are chosen


def calibration(kind: str, folder: Path) -> list[Path]:
    if kind in RIGS:
        return RIGS[kind](folder, rig())[0]
    name, text, _ = geometries(rig().rectified(SIZE, SIZE))[kind]
    return [laid(folder, {name: text}) / name]


@pytest.mark.parametrize(("kind", "old", "new"), [
    ("ros", "plumb_bob", "omni"), ("ros2 topic echo", "binning_x: 0", "binning_x: 2"),
    ("ros2 topic echo", "y_offset: 0", "y_offset: 8"), ("kalibr", "cam1:(.|\n)*", ""), ("kalibr", "pinhole", "omni"),
    ("kalibr", "radtan", "fov"), ("zed", r"\A", "CALIBRATION\n"), ("zed", "STEREO", "PAIR"),
    ("zed", "RIGHT_CAM", "RIGHT"), ("zed", "VGA", "HD"), ("opencv yml", "---(.|\n)*", "---\n- 1\n"),
    ("booster", r"<data>\S+ \S+", "<data>"), ("kitti, color", r"P2: \S+", "P2: 0"),
    ("foundation stereo", r" 0.0 ", " 1.0 "), ("foundation stereo", "1.0\n", "2.0\n"),
])  # fmt: skip
def test_one_wrong_part_is_refused(kind: str, old: str, new: str, tmp_path: Path):
    files = calibration(kind, tmp_path)
    geometry, _ = warned(read_geometry, files, None, VGA)
    assert geometry.baseline == pytest.approx(rig().baseline)
    for file in files:
        text = file.read_text()
        file.write_text(re.sub(old, new, text))
        assert file.read_text() != text
    refused(InputError, warned, read_geometry, files, None, VGA)


def test_two_whole_calibrations_and_the_left_camera_twice_are_refused(tmp_path: Path):
    for kind in ("kalibr", "zed", "middlebury", "kitti, color", "booster", "foundation stereo"):
        refused(InputError, read_geometry, calibration(kind, tmp_path) * 2)
    refused(InputError, read_geometry, calibration("ros", tmp_path)[:1] * 2)


def test_a_rotation_may_be_a_vector_and_of_messages_the_first_one_counts(tmp_path: Path):
    file = opencv(tmp_path / "a.yml", rig())
    file.write_text(re.sub(r"R: !!(.|\n)*?]", f"R: [0, 0, {np.pi / 2}]", file.read_text()))
    np.testing.assert_allclose(read_rig([file]).rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    left, right = calibration("ros2 topic echo", tmp_path)
    right.write_text(right.read_text() + left.read_text())
    geometry, lines = warned(read_geometry, [left, right])
    assert geometry.baseline == pytest.approx(rig().baseline)
    assert any("4 parts that differ" in told(line) for line in lines)


def test_color_and_infrared_cameras_of_other_images(tmp_path: Path):
    """A file without a size is doubted by its principal points, one with a size is refused."""
    file, double = opencv(tmp_path / "a.yml", rig()), (2 * SIZE[0], 2 * SIZE[1])
    found, lines = warned(read_color_infrared_rig, file, SIZE, SIZE)
    assert not lines and found.left.size == found.right.size == SIZE
    _, lines = warned(read_color_infrared_rig, file, double, SIZE)
    assert len(lines) == 1 and "a.yml: color: " in told(lines[0])
    file = opencv(tmp_path / "a.yml", rig(), "K1 D1 K2 D2 R T imageSize")
    assert read_color_infrared_rig(file, SIZE, SIZE).baseline == pytest.approx(rig().baseline)
    refused(InputError, read_color_infrared_rig, file, double, double)
    assert read_color_infrared_rig(file, double, SIZE).left.size == double  # such a file has only one size
    for fb in (0, -3, 1e9):
        laid(tmp_path, {"a.json": {"rectified": True, "fb": fb}})
        refused(InputError, read_color_infrared_rig, tmp_path / "a.json", SIZE, SIZE)


@pytest.mark.parametrize(("folders", "files"), [
    (("a", "a"), ["1.png"]), (("a", "b"), ["1.png", "../b/2.png"]), (("a",), ["left1.png", "left_1.png", "right1.png"]),
    (("a",), ["left1.png", "right2.png"]), (("a",), ["notes.txt"]), (("none",), []),
])  # fmt: skip
def test_photos_that_are_no_pairs(folders: tuple[str, ...], files: list[str], tmp_path: Path):
    laid(tmp_path / "a", dict.fromkeys(files, b""))
    refused(InputError, find_photos, [tmp_path / folder for folder in folders])

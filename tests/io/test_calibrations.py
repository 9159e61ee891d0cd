"""Files of calibrations in which one thing cannot be: each is refused for it, and read without it."""

import re
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.io.calibration_photos import find_photos
from depthcli.io.formats.calibrations import read_color_infrared_rig, read_geometry, read_rig
from tests.files import laid
from tests.golden import refused, told, warned

SIZE = (672, 376)
ROS = """image_width: 672
image_height: 376
distortion_model: plumb_bob
camera_matrix: {data: [400, 0, 336, 0, 400, 188, 0, 0, 1]}
distortion_coefficients: {data: [0, 0, 0, 0, 0]}
rectification_matrix: {data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {data: [400, 0, 336, SHIFT, 0, 400, 188, 0, 0, 0, 1, 0]}
"""
ECHO = """height: 376
width: 672
distortion_model: plumb_bob
d: []
k: [400, 0, 336, 0, 400, 188, 0, 0, 1]
r: [1, 0, 0, 0, 1, 0, 0, 0, 1]
p: [400, 0, 336, SHIFT, 0, 400, 188, 0, 0, 0, 1, 0]
binning_x: 0
roi: {x_offset: 0, y_offset: 0}
---
"""
KALIBR = """cam0:
  camera_model: pinhole
  distortion_model: none
  intrinsics: [400, 400, 336, 188]
  resolution: [672, 376]
cam1:
  camera_model: pinhole
  distortion_model: radtan
  distortion_coeffs: [0, 0, 0, 0]
  intrinsics: [400, 400, 336, 188]
  resolution: [672, 376]
  T_cn_cnm1: [[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""
ZED = "".join(f"[{side}_CAM_VGA]\nfx=400\nfy=400\ncx=336\ncy=188\n" for side in ("LEFT", "RIGHT")) + (
    "[STEREO]\nBaseline=100\n"
)
OPENCV = """%YAML:1.0
---
K1: [400, 0, 336, 0, 400, 188, 0, 0, 1]
D1: [0, 0, 0, 0]
K2: [400, 0, 336, 0, 400, 188, 0, 0, 1]
D2: [0, 0, 0, 0]
R: [1, 0, 0, 0, 1, 0, 0, 0, 1]
T: [-0.1, 0, 0]
"""
BOOSTER = (
    "<a><proj_matL>400 0 336 0 0 400 188 0 0 0 1 0</proj_matL><proj_matR>400 0 336 0 0 400 188 0 0 0 1 0</proj_matR>"
    "<baselineLR>100</baselineLR></a>"
)
MIDDLEBURY = "cam0=[400 0 336; 0 400 188; 0 0 1]\ncam1=[400 0 336; 0 400 188; 0 0 1]\nbaseline=100\n"
KITTI = "P2: 400 0 336 0 0 400 188 0 0 0 1 0\nP3: 400 0 336 -40 0 400 188 0 0 0 1 0\n"
FILES = {  # of a baseline of 0.1 m
    "ros": [ROS.replace("SHIFT", "0"), ROS.replace("SHIFT", "-40")],
    "echo": [ECHO.replace("SHIFT", "0"), ECHO.replace("SHIFT", "-40")],
    "kalibr": [KALIBR], "zed": [ZED], "opencv": [OPENCV], "booster": [BOOSTER], "middlebury": [MIDDLEBURY],
    "kitti": [KITTI], "foundation": ["400 0 336 0 400 188 0 0 1\n0.1\n"],
}  # fmt: skip


def written(folder: Path, texts: list[str]) -> list[Path]:
    laid(folder, {f"{k}.txt": text for k, text in enumerate(texts)})
    return [folder / f"{k}.txt" for k in range(len(texts))]


@pytest.mark.parametrize(("kind", "old", "new"), [
    ("ros", "plumb_bob", "omnidirectional"), ("ros", "-40", "0"), ("ros", r"\[400, 0, 336, -40", "[-400, 0, 336, -40"),
    ("echo", "binning_x: 0", "binning_x: 2"), ("echo", "y_offset: 0", "y_offset: 8"),
    ("kalibr", "cam1:(.|\n)*", ""), ("kalibr", "pinhole", "omni"), ("kalibr", "radtan", "fov"),
    ("zed", r"\A", "CALIBRATION\n"), ("zed", "STEREO", "PAIR"), ("zed", "RIGHT_CAM_VGA", "RIGHT_CAM_HD"),
    ("zed", "VGA", "FHD"), ("opencv", "(K1|D1|K2|D2|R|T): ", "- "), ("booster", "400 0 336 0 0", "336 0 0"),
    ("kitti", "P2: 400", "P2: 0"), ("foundation", "336 0 400", "336 1 400"), ("foundation", "0 0 1\n", "0 0 2\n"),
])  # fmt: skip
def test_one_wrong_part_is_refused(kind: str, old: str, new: str, tmp_path: Path):
    geometry, _ = warned(read_geometry, written(tmp_path, FILES[kind]), None, SIZE)
    assert geometry.baseline == pytest.approx(0.1)
    changed = [re.sub(old, new, text) for text in FILES[kind]]
    assert changed != FILES[kind]
    refused(InputError, warned, read_geometry, written(tmp_path, changed), None, SIZE)


@pytest.mark.parametrize("kind", ["kalibr", "zed", "middlebury", "kitti", "booster", "foundation"])
def test_two_whole_calibrations_are_refused(kind: str, tmp_path: Path):
    refused(InputError, read_geometry, written(tmp_path, FILES[kind] * 2))


def test_a_rotation_may_be_a_vector_and_of_messages_the_first_one_counts(tmp_path: Path):
    (file,) = written(tmp_path, [OPENCV.replace("R: [1, 0, 0, 0, 1, 0, 0, 0, 1]", f"R: [0, 0, {np.pi / 2}]")])
    np.testing.assert_allclose(read_rig([file]).rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    left, right = FILES["echo"]
    again = right.replace("-40", "-80")
    geometry, lines = warned(read_geometry, written(tmp_path, [left, right + again]))
    assert geometry.baseline == pytest.approx(0.1)
    assert any("2 parts that differ" in told(line) for line in lines)


def test_color_and_infrared_cameras_of_other_images(tmp_path: Path):
    """A file without a size is doubted by its principal points, one with a size is refused."""
    (file,) = written(tmp_path, [OPENCV])
    rig, lines = warned(read_color_infrared_rig, file, SIZE, SIZE)
    assert not lines and rig.left.size == rig.right.size == SIZE
    _, lines = warned(read_color_infrared_rig, file, (1344, 752), SIZE)
    assert len(lines) == 1 and "0.txt: color: " in told(lines[0])
    (file,) = written(tmp_path, [OPENCV + "image_width: 672\nimage_height: 376\n"])
    assert read_color_infrared_rig(file, SIZE, SIZE).baseline == pytest.approx(0.1)
    refused(InputError, read_color_infrared_rig, file, (640, 480), (640, 480))
    assert read_color_infrared_rig(file, (640, 480), SIZE).left.size == (640, 480)  # such a file has only one size
    for fb in (0, -3, 1e9):
        (file,) = written(tmp_path, [f'{{"rectified": true, "fb": {fb}}}'])
        refused(InputError, read_color_infrared_rig, file, SIZE, SIZE)


@pytest.mark.parametrize(("folders", "files"), [
    (("a", "a"), ["1.png"]), (("a", "b"), ["1.png", "../b/2.png"]), (("a",), ["left1.png", "left_1.png", "right1.png"]),
    (("a",), ["left1.png", "right2.png"]), (("a",), ["notes.txt"]), (("none",), []),
])  # fmt: skip
def test_photos_that_are_no_pairs(folders: tuple[str, ...], files: list[str], tmp_path: Path):
    laid(tmp_path / "a", dict.fromkeys(files, b""))
    refused(InputError, find_photos, [tmp_path / folder for folder in folders])

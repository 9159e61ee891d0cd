"""Numbers that are too large, names that are too long or stand twice: one clear line, and no other time than usual."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from depthcli.cli import main
from depthcli.core.config_file import parse_config
from depthcli.core.errors import ConfigError, InputError
from depthcli.io.formats.calibrations import read_geometry, read_rig
from depthcli.io.formats.disparity import map_npy
from depthcli.io.formats.files import naming
from depthcli.io.formats.images import read_image, write_png
from depthcli.io.formats.networks import network_path, read_network
from depthcli.io.pairs import read_table
from depthcli.io.scenes.stereo import StereoScene
from depthcli.io.walk import chosen_scenes, discover_scenes

IMAGE = np.arange(48, dtype=np.uint8).reshape(6, 8)
# Lines of numpy about a cast in a reader are not for users.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
HUGE = ["1e305", "1e999", "9" * 400, "9" * 5000]
CALIB = "cam0=[9 0 4; 0 9 3; 0 0 1]\ncam1=[9 0 4; 0 9 3; 0 0 1]\ndoffs=0\nbaseline=100\n"


@pytest.mark.parametrize("number", HUGE)
def test_calib_txt_with_numbers_too_large(tmp_path: Path, number: str):
    for name in ("im0", "im1"):
        write_png(tmp_path / f"{name}.png", IMAGE)
    (tmp_path / "calib.txt").write_text(f"{CALIB}ndisp={number}\n")
    with pytest.raises(InputError, match="ndisp"):
        discover_scenes(tmp_path)
    (tmp_path / "calib.txt").write_text(f"{CALIB}width={number}\nheight=6\n")
    with pytest.raises(InputError, match="width"):
        read_geometry(tmp_path / "calib.txt")


@pytest.mark.parametrize("number", [*HUGE, "-99999999999", "1.5", "nan", "0x10", "1_0"])
@pytest.mark.parametrize("column", ["min_disparity", "max_disparity"])
def test_lists_with_numbers_too_large(tmp_path: Path, column: str, number: str):
    (tmp_path / "pairs.csv").write_text(f"left,right,{column}\na.png,b.png,{number}\n")
    (scene,) = StereoScene.of_table(tmp_path / "pairs.csv")
    assert column in scene.problem and len(scene.problem) < 400


@pytest.mark.parametrize("number", ["1.0e+300", ".inf", "-5", "9" * 400])
def test_sizes_of_rigs(tmp_path: Path, number: str):
    camera = (
        f"image_width: {number}\nimage_height: 6\ncamera_matrix: {{data: [9, 0, 4, 0, 9, 3, 0, 0, 1]}}\n"
        "distortion_coefficients: {data: [0, 0, 0, 0, 0]}\nrectification_matrix: {data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\n"
        "projection_matrix: {data: [9, 0, 4, -1, 0, 9, 3, 0, 0, 0, 1, 0]}\n"
    )
    for name in ("l.yaml", "r.yaml"):
        (tmp_path / name).write_text(camera)
    with pytest.raises(InputError):
        read_rig([tmp_path / "l.yaml", tmp_path / "r.yaml"])


def test_what_overflows_in_a_reader_blames_the_file():
    for raising in (lambda: int(float("inf")), lambda: np.array([10**400], np.float64)):
        with pytest.raises(InputError, match="some file: damaged"), naming("some file"):
            raising()


@pytest.mark.parametrize(
    "text", ["0x" + "f" * 5000, "0b" + "1" * 20000, "1:" * 9000 + "1", "9" * 5000, "1" * 9000 + ".5"]
)
def test_long_numbers_of_configs_in_any_base(text: str):
    started = time.monotonic()
    assert (
        main(["stereo", "fast", "--left", "a.png", "--right", "b.png", "-o", "x", "--set", f"max_disparity={text}"])
        == 2
    )
    assert time.monotonic() - started < 2


def test_networks_with_odd_heads(tmp_path: Path):
    content = json.loads(network_path("accurate").read_text())
    nested: list[object] = []
    for _ in range(60):
        nested = [nested]
    path = tmp_path / "n.json"
    odd: tuple[object, ...] = (nested, 10**400, [10**400], "x", None, {}, [[1], [1, 2]], [1e300], [None], True)
    for key in content:
        for value in odd:
            path.write_text(json.dumps({**content, key: value}))
            if key == "trained_on":
                continue  # text of any kind
            with pytest.raises(InputError) as caught:
                read_network(path)
            assert len(str(caught.value)) < 900
    for text in ("[" * 100_000, "9" * 5000, "[]", "null", '{"format":' + "[" * 5000):
        path.write_text(text)
        with pytest.raises(InputError):
            read_network(path)


def test_arrays_that_announce_terabytes(tmp_path: Path):
    header = "{'descr': '<f4', 'fortran_order': False, 'shape': (20000, 20000, 10000), }".ljust(117) + "\n"
    path = tmp_path / "a.npy"
    path.write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(64))
    with pytest.raises(InputError, match="file size"):
        map_npy(path, 3)


def test_names_of_lists_are_unique(tmp_path: Path):
    table = tmp_path / "pairs.csv"
    table.write_text("left,right,name\na.png,b.png,2_left\nleft.png,b.png,\nleft.png,c.png,\n")
    assert [pair.name for pair in read_table(table)] == ["2_left", "2_left_", "3_left"]
    table.write_text("left,right,name\na.png,b.png,same\nleft.png,b.png,\nc.png,c.png,same\n")
    with pytest.raises(InputError, match="'same'"):
        read_table(table)
    for columns in ("left,right,right", "left,right,LEFT", "left,right,name,name"):
        table.write_text(f"{columns}\na.png,b.png,c,d\n")
        with pytest.raises(InputError, match="two columns"):
            read_table(table)
    scenes = [StereoScene(name="a", folder=tmp_path / folder, left=tmp_path) for folder in ("x", "y")]
    with pytest.raises(InputError, match="two scenes are called 'a'"):
        chosen_scenes(scenes, ["*"], tmp_path)


def test_two_endings_of_one_image_are_not_chosen_from(tmp_path: Path):
    for name in ("1_L.png", "1_R.png"):
        write_png(tmp_path / name, IMAGE)
    cv2.imwrite(str(tmp_path / "1_L.jpg"), IMAGE)
    with pytest.raises(InputError, match="keep one"):
        discover_scenes(tmp_path)


def test_long_lists_with_a_name_twice_take_no_longer(tmp_path: Path):
    rows = "".join(f"{n}.png,{n}.png,n{n}\n" for n in range(20_000))
    (tmp_path / "pairs.csv").write_text(f"left,right,name\n{rows}a.png,a.png,n19999\n")
    started = time.process_time()
    with pytest.raises(InputError, match="n19999"):
        read_table(tmp_path / "pairs.csv")
    assert time.process_time() - started < 3


@pytest.mark.parametrize(
    "arguments",
    [
        ("stereo", "fast", "-i", "LONG"), ("stereo", "fast", "--left", "LONG", "--right", "LONG"), ("depth", "LONG"),
        ("stereo", "LONG", "-i", "."), ("evaluate", "LONG"), ("evaluate", ".", "--truth", "LONG"),
        ("register-confidence", "mind", "--fixed", "LONG", "--warped", "LONG"),
        ("register-confidence", "mind", "--fixed", "LONG", "--moving", "LONG", "--transform", "LONG.tfm"),
        ("fuse", "accurate", "-i", ".", "--set", "maps.choice.weights=LONG.json"), ("merge", "LONG"),
    ],
)  # fmt: skip
def test_names_that_no_file_can_have(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    words = [word.replace("LONG", "n" * 300) for word in arguments]
    assert main([*words, "-o", "out"] if words[0] != "merge" else words) in (2, 3)
    error = capsys.readouterr().err
    assert "Traceback" not in error and "a bug" not in error


@pytest.mark.parametrize("length", [241, 242, 250, 255])
def test_names_as_long_as_a_file_system_takes(tmp_path: Path, length: int):
    from depthcli.run.task import Task

    scene = StereoScene(name="n" * length, folder=tmp_path, left=tmp_path)
    task = Task(scene, tmp_path, tmp_path, 0, "", {}, "")
    task.trace.touch()
    assert len(os.listdir(tmp_path)[0]) <= 255


@pytest.mark.parametrize(("shape", "dtype"), [((6, 8, 3), np.float32), ((6, 8), np.float32), ((6, 8, 3), np.float64)])
def test_tiff_of_another_kind_is_not_damaged(tmp_path: Path, shape: tuple[int, ...], dtype: type):
    path = tmp_path / "a.tif"
    assert cv2.imwrite(str(path), np.ones(shape, dtype))
    with pytest.raises(InputError, match="floating point") as caught:
        read_image(path)
    assert "damaged" not in str(caught.value)


def test_yaml_numbers_that_fit_stay():
    config = parse_config("a: 0xff\nb: 1e-3\nc: 1.5\nd: 123456789012345678901234567890\n", "a.yaml")
    assert config.data == {"a": 255, "b": 1e-3, "c": 1.5, "d": 123456789012345678901234567890}
    with pytest.raises(ConfigError):
        parse_config("", "a.yaml")

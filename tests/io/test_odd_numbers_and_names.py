"""Numbers that are too large, names that are too long or stand twice: one clear line, and no other time than usual."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.io.formats.calibrations import read_geometry
from depthcli.io.formats.disparity import map_npy
from depthcli.io.formats.images import write_png
from depthcli.io.layouts.all_kinds import ALL_KINDS
from depthcli.io.named_files import scenes_of_table
from depthcli.io.scenes import StereoScene
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
        discover_scenes(tmp_path, ALL_KINDS)
    (tmp_path / "calib.txt").write_text(f"{CALIB}width={number}\nheight=6\n")
    with pytest.raises(InputError, match="width"):
        read_geometry(tmp_path / "calib.txt")


@pytest.mark.parametrize("number", [*HUGE, "-99999999999", "1.5", "nan", "0x10", "1_0"])
def test_lists_with_numbers_too_large(tmp_path: Path, number: str):
    (tmp_path / "pairs.csv").write_text(f"left,right,max_disparity\na.png,b.png,{number}\n")
    (scene,) = scenes_of_table(tmp_path / "pairs.csv")
    assert "max_disparity" in scene.problem and len(scene.problem) < 400


def test_arrays_that_announce_terabytes(tmp_path: Path):
    header = "{'descr': '<f4', 'fortran_order': False, 'shape': (20000, 20000, 10000), }".ljust(117) + "\n"
    path = tmp_path / "a.npy"
    path.write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(64))
    with pytest.raises(InputError, match="file size"):
        map_npy(path, 3)


def test_names_of_lists_are_unique(tmp_path: Path):
    table = tmp_path / "pairs.csv"
    table.write_text("left,right,name\na.png,b.png,2_left\nleft.png,b.png,\nleft.png,c.png,\n")
    assert [pair.name for pair in scenes_of_table(table)] == ["2_left", "2_left_", "3_left"]
    table.write_text("left,right,name\na.png,b.png,same\nleft.png,b.png,\nc.png,c.png,same\n")
    with pytest.raises(InputError, match="'same'"):
        scenes_of_table(table)
    for columns in ("left,right,right", "left,right,LEFT", "left,right,name,name"):
        table.write_text(f"{columns}\na.png,b.png,c,d\n")
        with pytest.raises(InputError, match="two columns"):
            scenes_of_table(table)
    scenes = [StereoScene(name="a", folder=tmp_path / folder, left=tmp_path) for folder in ("x", "y")]
    with pytest.raises(InputError, match="two scenes are called 'a'"):
        chosen_scenes(scenes, ["*"], tmp_path)

"""Inputs as people have them: patterns, folders, tables, videos, pairs side by side."""

import io
import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from depthcli.core.errors import ConfigError, InputError
from depthcli.io.formats.images import write_png
from depthcli.io.formats.videos import read_frame
from depthcli.io.scenes import StereoScene
from depthcli.io.scenes.find import discover_scenes, find_scenes, named_scenes
from depthcli.io.scenes.frames import FRAMES
from depthcli.io.scenes.pairs import PAIRS, pairs_of_patterns, scenes_of_table
from depthcli.io.stereo_pairs import load_views
from tests.command_line import run
from tests.files import laid
from tests.golden import refused
from tests.scenes import load

IMAGE = np.arange(48, dtype=np.uint8).reshape(6, 8)


def put(folder: Path, *names: str) -> None:
    laid(folder, dict.fromkeys(names, IMAGE))


def named(left: Path, right: Path) -> dict[str, str]:
    """Name of a pair -> names of its images; - is none."""
    images = {}
    for scene in pairs_of_patterns(left, right):
        image = "-" if "no left image" in scene.problem else scene.left.name
        images[scene.name] = f"{image} {scene.right.name if scene.right else '-'}"
    return images


def test_patterns(tmp_path: Path):
    left, right = tmp_path / "left", tmp_path / "right"
    put(left, "0001.png", "0002.png", "0004.png")
    put(right, "0001.png", "0002.png", "0003.png")
    (left / "notes.txt").touch()
    both = {"0001": "0001.png 0001.png", "0002": "0002.png 0002.png", "0003": "- 0003.png", "0004": "0004.png -"}
    assert named(left / "*.png", right / "*.png") == both
    assert named(left, right) == both
    # Patterns that differ: the whole names count.
    assert set(named(left / "000[12].png", right / "*.png")) == {"0001", "0002", "0003"}
    strange = [side.rename(f"{side}[1]") for side in (left, right)]  # a folder's name is no pattern
    assert named(*strange) == both
    put(tmp_path, "a/left/1.png", "b/left/1.png", "a/right/1.png")
    found = named(tmp_path / "?/left/*.png", tmp_path / "?/right/*.png")
    assert found == {"a/1": "1.png 1.png", "b/1": "1.png -"}


def test_names_that_say_the_view(tmp_path: Path):
    put(tmp_path, *(f"shot_{view}_{number}.png" for view in ("left", "right") for number in ("01", "02")))
    put(tmp_path, "b_L.png", "b_R.png", "l/cam_a_7.png", "l/cam_a_8.png", "r/other_7.png", "r/other_8.png")
    assert named(tmp_path / "*left*.png", tmp_path / "*right*.png") == {
        "shot_01": "shot_left_01.png shot_right_01.png", "shot_02": "shot_left_02.png shot_right_02.png"}  # fmt: skip
    assert named(tmp_path / "*_L.png", tmp_path / "*_R.png") == {"b": "b_L.png b_R.png"}
    assert named(tmp_path / "l", tmp_path / "r") == {"7": "cam_a_7.png other_7.png", "8": "cam_a_8.png other_8.png"}
    put(tmp_path, "x/cat.png", "y/dog.png")
    refused(ConfigError, pairs_of_patterns, tmp_path / "x", tmp_path / "y")
    (tmp_path / "empty").mkdir()
    for place in ("x/*.jpg", "empty"):
        refused(ConfigError, pairs_of_patterns, tmp_path / place, tmp_path / "y")
    put(tmp_path, "x/1.png", "x/2.png", "x/2.jpg", "y/1.png", "y/2.png")
    assert named(tmp_path / "x", tmp_path / "y")["2"] == "- 2.png"  # no pair is made up


def test_tables(tmp_path: Path, monkeypatch):
    table = tmp_path / "pairs.csv"
    table.write_text("# our pairs\na.png,b.png\nsub dir/b.png , c.png\n")
    pairs = [(p.name, p.left, p.right) for p in scenes_of_table(table)]
    a, b, c, other = (tmp_path / name for name in ("a.png", "b.png", "c.png", "sub dir/b.png"))
    assert pairs == [("a", a, b), ("b", other, c)]
    table.write_text("right,left,max_disparity,name,calibration\nb.png,a.png,40,one,calib.txt\nc.png,a.png,,two,\n")
    one, two = scenes_of_table(table)
    assert (one.name, one.left.name, one.max_disparity, one.calibration) == ("one", "a.png", 40, tmp_path / "calib.txt")
    assert (two.name, two.max_disparity, two.calibration) == ("two", None, None)
    for text, names in (
        ("a.png,b.png\na.png,c.png\n", ["1_a", "2_a"]),
        ("left,right,name\na.png,b.png,2_left\nleft.png,b.png,\nleft.png,c.png,\n", ["2_left", "2_left_", "3_left"]),
    ):
        table.write_text(text)
        assert [pair.name for pair in scenes_of_table(table)] == names
    for text in (
        "left,right,depht\na,b,c\n", "a.png\n", "", "left,right,name\na,b,x\nleft,b,\nc,d,x\n",
        *(f"left,right,{more}\na,b,c,d\n" for more in ("right", "LEFT", "name,name")),
    ):  # fmt: skip
        table.write_text(text)
        refused(InputError, scenes_of_table, table)
    text = b"left\tright\tname\na.png\tb.png\tfirst\nc.png\td.png\tsecond\n"
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text)))
    pairs = [(p.name, p.left, p.right) for p in scenes_of_table(Path("-"))]
    assert pairs == [("first", Path("a.png"), Path("b.png")), ("second", Path("c.png"), Path("d.png"))]


def video(path: Path, shift: int, count: int = 5, rate: float = 10) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), rate, (96, 64))
    assert writer.isOpened()
    noise = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (64, 160, 3)).astype(np.uint8), (0, 0), 2) * 3
    for number in range(count):
        writer.write(np.ascontiguousarray(noise[:, number + shift : number + shift + 96]))
    writer.release()
    return path


@pytest.mark.slow
def test_videos(tmp_path: Path, tool):
    left, right = video(tmp_path / "l.avi", 0), video(tmp_path / "r.avi", 6)
    scenes = named_scenes(StereoScene, {"left": left, "right": right})
    assert [scene.name for scene in scenes] == [f"{k:06}" for k in range(5)]
    reader = cv2.VideoCapture(str(left))
    frames = [reader.read()[1][..., ::-1] for _ in range(5)]
    for number in (0, 1, 3, 2, 4):  # in any order
        assert scenes[number].frame_number == number
        np.testing.assert_array_equal(load_views(scenes[number])[0], frames[number])
    words = ("stereo", "opencv-bm", "--left", left, "--right", right, "--max-disparity", "12", "-q", "-o")
    assert run(*words, tmp_path / "run") == 0
    assert run(*words, tmp_path / "again", "--scenes", "00000[24]", "--jobs", "2") == 0
    one, other = (tmp_path / folder / "000004/disp_left.pfm" for folder in ("run", "again"))
    assert one.read_bytes() == other.read_bytes()
    (tmp_path / "bad.avi").write_bytes(left.read_bytes()[:90])
    tool.told(2, "stereo", "opencv-bm", "--left", tmp_path / "bad.avi", "--right", right, "-o", tmp_path / "x")


def test_videos_of_two_rates_are_refused_and_of_two_lengths_warned_of(tmp_path: Path):
    left = video(tmp_path / "l.avi", 0, 3, rate=30)
    refused(InputError, read_frame, left, 3)
    assert read_frame(left, 2).shape == (64, 96, 3)
    for rate, is_refused in ((29.97, False), (30, False), (15, True), (25, True)):
        files = {"left": left, "right": video(tmp_path / "r.avi", 6, 3, rate=rate)}
        if is_refused:
            refused(ConfigError, named_scenes, StereoScene, files)
        else:
            assert [scene.warnings for scene in named_scenes(StereoScene, files)] == [()] * 3
    pair = ("--left", left, "--right", video(tmp_path / "r.avi", 6, 2, rate=30))
    assert run("stereo", "opencv-bm", *pair, "--max-disparity", "12", "-o", tmp_path / "run", "-q") == 0
    report = json.loads((tmp_path / "run/report.json").read_text())["scenes"]
    assert [any("l.avi has 3 frames" in line for line in row["warnings"]) for row in report] == [True, True]


@pytest.mark.parametrize(("rights", "warned"), [
    (range(6), 0), (range(1, 7), 5),
    (range(5), 5),  # one dropped, the others numbered anew
    ((0, 1, 3, 4, 5), 0),  # the gap tells which one
    (range(3), 3),  # half the rate
])  # fmt: skip
def test_numbered_folders_of_two_lengths_are_warned_of(tmp_path: Path, rights: Sequence[int], warned: int):
    """Named by patterns, found in folders, and color with depth."""
    put(tmp_path, *(f"{side}/f{k:03}.png" for side in ("left", "rgb") for k in range(6)))
    put(tmp_path, *(f"{side}/f{k:03}.png" for side in ("right", "depth") for k in rights))
    by_name = pairs_of_patterns(tmp_path / "left", tmp_path / "right")
    for scenes in (by_name, discover_scenes(tmp_path, PAIRS), discover_scenes(tmp_path, FRAMES)):
        told = [any("if one was dropped" in line for line in scene.warnings) for scene in scenes]
        assert sum(told) == warned


@pytest.mark.parametrize("halves", ["left-right", "top-bottom", "mpo"])
def test_both_views_in_one_file(tmp_path: Path, halves: str, tool):
    """As an image, as files of a folder, by --left alone: the map of the two files."""
    noise = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (40, 90, 3), np.uint8), (0, 0), 1.5) * 2
    left, right = (np.ascontiguousarray(noise[:, k : k + 80]) for k in (0, 6))
    end = "mpo" if halves == "mpo" else "png"
    (tmp_path / "in").mkdir()
    both, how = tmp_path / "in" / f"a.{end}", [] if halves == "mpo" else ["--halves", halves]
    if halves == "mpo":
        one, other = map(Image.fromarray, (left, right))
        one.save(both, "MPO", save_all=True, append_images=[other], quality=100, subsampling=0)
        with Image.open(both) as file:
            left = np.asarray(file.convert("RGB"))
            file.seek(1)
            right = np.asarray(file.convert("RGB"))
    else:
        write_png(both, np.concatenate([left, right], axis=1 if halves == "left-right" else 0))
    laid(tmp_path, {"l.png": left, "r.png": right})
    line = ["stereo", "opencv-bm", "--max-disparity", "16", "-q"]
    pair = ["--left", tmp_path / "l.png", "--right", tmp_path / "r.png", "--name", "a"]
    inputs = {"o": pair, "p": ["--left", both, *how]} | ({"q": ["--left", tmp_path / "in", *how]} if how else {})
    for output, words in inputs.items():
        assert run(*line, *words, "-o", tmp_path / output) == 0
        maps = [tmp_path / each / "a/disp_left.pfm" for each in ("o", output)]
        assert maps[0].read_bytes() == maps[1].read_bytes()
    if how:
        laid(tmp_path, {"sets/b/a.png": left, "sets/c/a.png": left})  # whose names repeat
        found = named_scenes(StereoScene, {"left": tmp_path / "sets/*/a.png", "halves": halves})
        assert [(scene.name, scene.halves) for scene in found] == [("b_a", halves), ("c_a", halves)]
        for wrong in (("--halves", "right-left"), ("--right", both, *how)):
            tool.told(2, *line, "--left", both, *wrong, "-o", tmp_path / "r")
        write_png(both, np.zeros((41, 81), np.uint8))
        tool.told(3, *line, "--left", both, *how, "-o", tmp_path / "r")


def test_files_are_named_in_four_ways_that_do_not_go_together(tmp_path: Path, tool):
    """By a folder, a table and patterns the same pairs are found, each with its files."""
    table = laid(tmp_path, {"t.csv": "in/left/1.png,in/right/1.png\nin/left/2.png,in/right/2.png\n"}) / "t.csv"
    put(tmp_path / "in", "left/1.png", "left/2.png", "right/1.png", "right/2.png")
    folder = {"input": tmp_path / "in", "layout": None, "name": None}
    globs = folder | {"input": None} | {side: tmp_path / "in" / side / "*.png" for side in ("left", "right")}
    pair = globs | {side: tmp_path / "in" / side / "1.png" for side in ("left", "right")}
    files = [(str(k), tmp_path / f"in/left/{k}.png", tmp_path / f"in/right/{k}.png") for k in (1, 2)]
    for options, expected in (
        (folder, files), (folder | {"input": table}, files), (globs, files), (pair, files[:1]),
        (pair | {"name": "a"}, [("a", *files[0][1:])]),
    ):  # fmt: skip
        found = find_scenes(PAIRS, options, "--left")
        assert [(scene.name, scene.left, scene.right) for scene in found] == expected
    for options in (pair | {"input": table}, folder | {"name": "a"}, globs | {"name": "a"}, folder | {"input": None}):
        refused(ConfigError, find_scenes, PAIRS, options, "--left")
    for options in (pair, folder | {"input": table}, folder | {"input": Path("-")}):
        refused(ConfigError, find_scenes, PAIRS, options, "--left", with_truth=True)
    refused(ConfigError, find_scenes, FRAMES, folder | {"input": table}, "--depth")
    refused(InputError, find_scenes, PAIRS, globs, "--left", ["absent*"])
    tool.told(2, "stereo", "opencv-bm", "-i", table, "-o", "-")


def find(folder: Path) -> dict[str, StereoScene]:
    return {scene.name: scene for scene in discover_scenes(folder, PAIRS)}  # type: ignore[misc]


def test_layouts_of_many_pairs_in_a_folder(tmp_path: Path):
    put(tmp_path / "views/left", "0001.png", "0002.png")
    put(tmp_path / "views/right", "0001.png", "0003.png")
    (tmp_path / "views/calib.txt").write_text("baseline=100\n")
    (tmp_path / "views/meta.json").write_text(json.dumps({"max_disparity": 9, "min_disparity": -3}))
    scenes = find(tmp_path / "views")
    assert sorted(scenes) == ["0001", "0002", "0003"]
    assert load(scenes["0001"]).shape == (6, 8)
    assert (scenes["0001"].max_disparity, scenes["0001"].min_disparity) == (9, -3)
    assert scenes["0001"].calibration == tmp_path / "views/calib.txt"
    assert "no right/0002.*" in scenes["0002"].problem and "no left/0003.*" in scenes["0003"].problem
    put(tmp_path / "views/left", "0001.bmp")
    refused(InputError, find, tmp_path / "views")
    put(tmp_path / "pairs", "0001_L.png", "0001_R.png", "0002_L.png", "notes.png")
    put(tmp_path / "both", "left/0001_L.png", "right/0001_R.png", "left/0002_L.png")
    for folder in ("pairs", "both"):
        found = {name: bool(scene.problem) for name, scene in find(tmp_path / folder).items()}
        assert found == {"0001": False, "0002": True}
    put(tmp_path, "cameras/camera_left/a.png", "cameras/camera_right/a.png", "starts/left_a.png", "starts/right_a.png")
    for right in ("cameras/camera_right/a.png", "starts/right_a.png"):
        assert find(tmp_path / right.partition("/")[0])["a"].right == tmp_path / right
    sequences = tmp_path / "image_0/sequences"  # the name above them says nothing
    put(sequences / "00", *(f"image_{view}/00000{k}.png" for view in (0, 1) for k in (0, 1)))
    put(sequences / "01", "image_2/000000.png", "image_3/000000.png")
    (sequences / "00/calib.txt").write_text("P0: 1\n")
    scenes = find(sequences)
    assert sorted(scenes) == ["00/000000", "00/000001", "01/000000"]
    assert (scenes["00/000001"].cameras, scenes["01/000000"].cameras) == ((0, 1), (2, 3))
    assert {scene.layout for scene in scenes.values()} == {"kitti-odometry"}
    # What a scene or a run holds are no pairs.
    put(tmp_path / "a", *(f"{start}{view}.png" for start in ("", "mask_all_", "disp_") for view in ("left", "right")))
    assert [scene.layout for scene in find(tmp_path / "a").values()] == ["scenes"]
    put(tmp_path / "b", "disp_left.png", "disp_right.png")
    refused(InputError, find, tmp_path / "b")


def test_patterns_are_suggested_where_no_layout_fits(tmp_path: Path, tool) -> None:
    put(tmp_path / "my rig", "port/1.jpg", "port/2.jpg", "starboard/1.jpg", "thumbs/a.png")
    arguments = "stereo", "opencv-bm", "-o", tmp_path / "run", "--dry-run"
    tool.told(2, *arguments, "-i", tmp_path / "my rig")
    left, right = tmp_path / "my rig/port/*.jpg", tmp_path / "my rig/starboard/*.jpg"
    assert run(*arguments, "--left", left, "--right", right) == 0
    put(tmp_path / "other", "a/1.jpg", "b/x.jpg")
    tool.told(2, *arguments, "-i", tmp_path / "other")

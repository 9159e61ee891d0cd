"""``depthcli refine-kinect``: files, reports, sequences that are killed, bad frames beside good ones."""

import json
import shutil
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from depthcli.io.formats.depth import read_depth
from depthcli.io.formats.disparity import read_pfm, read_plane, read_status, write_pfm
from depthcli.io.formats.images import write_png
from tests.command_line import contents, rows, run
from tests.golden import told
from tests.rendered import COLOR, COLOR_SHAPE, DEPTH, DEPTH_SHAPE, ROTATION, TRANSLATION, near_edges, noisy, rendered


def test_bounds_at_another_level_are_evaluated_and_limit_clouds(made_kinect: Path, tmp_path: Path):
    one = ("refine-kinect", "nearest", "-i", made_kinect, "--scenes", "planes", "-q")
    assert run(*one, "-o", tmp_path / "a") == 0
    cloud = ("--ply", "--mask", "all", "--max-bound", "0.05", "--level", "0.6", "--within", "0.1", "--evaluate")
    assert run(*one, "-o", tmp_path / "b", *cloud) == 0
    (bound, sure), (low, likely) = (
        [read_pfm(tmp_path / name / "planes" / f"{file}.pfm") for file in ("bound", "probability")] for name in "ab"
    )
    assert (low < bound).all() and (likely >= sure).all()
    assert (tmp_path / "b" / "status.txt").is_file()
    assert "Depth: mean absolute error, mm" in (tmp_path / "b" / "evaluation" / "report.md").read_text()
    header = (tmp_path / "b" / "planes" / "points.ply").read_bytes().partition(b"end_header")[0]
    assert f"element vertex {np.count_nonzero(low <= 0.05)}\n".encode() in header
    scored = json.loads((tmp_path / "b" / "evaluation" / "scores.json").read_text())["results"][0]["bounds"]
    coverage = {row["mask"]: row for row in scored if row["metric"] == "bound coverage"}
    truth = read_pfm(made_kinect / "planes" / "depth_true.pfm")
    inside = np.abs(read_pfm(tmp_path / "b" / "planes" / "depth.pfm") - truth) <= low
    assert coverage["all"]["value"] == pytest.approx(100 * inside[np.isfinite(truth)].mean(), abs=0.1)
    assert coverage["all"]["threshold"] == 60 and {"said kept", "said filled"} <= set(coverage)


def test_a_sequence_is_one_item_and_resumes_with_the_same_bytes(made_kinect: Path, tmp_path: Path):
    one = ("refine-kinect", "sequence", "-i", made_kinect, "--scenes", "moving/*", "-q")
    assert run(*one, "-o", tmp_path / "a") == 0
    assert run(*one, "-o", tmp_path / "b", "--threads", "1") == 0
    whole = contents(tmp_path / "a")
    assert whole == contents(tmp_path / "b")
    assert {f"moving/0000{k}/depth.pfm" for k in range(4)} < set(whole)
    assert rows(tmp_path / "a")["moving"]["frames"] == 4
    # A lost file of one frame makes the sequence anew.
    (tmp_path / "b" / "moving" / "00002" / "depth.pfm").unlink()
    assert run(*one, "-o", tmp_path / "b") == 0
    assert contents(tmp_path / "b") == whole


def test_single_frames_and_frames_of_sequences_are_evaluated(made_kinect: Path, tmp_path: Path):
    scenes = ("--scenes", "planes", "--scenes", "moving/*", "--scenes", "static/*")
    assert run("refine-kinect", "realsense", "-i", made_kinect, *scenes, "-o", tmp_path / "r", "--evaluate", "-q") == 0
    assert set(rows(tmp_path / "r")) == {"moving", "planes", "static"}
    scored = json.loads((tmp_path / "r" / "evaluation" / "scores.json").read_text())["results"]
    frames = {f"{kind}/0000{k}" for kind in ("moving", "static") for k in range(4)}
    assert {row["scene"] for row in scored if not row["missing"]} == frames | {"planes"}


def test_frames_of_a_sequence_are_items_for_methods_without_memory(made_kinect: Path, tmp_path: Path):
    assert run("refine-kinect", "nearest", "-i", made_kinect / "static", "-o", tmp_path / "r", "-q") == 0
    assert set(rows(tmp_path / "r")) == {f"0000{k}" for k in range(4)}


def test_bad_frames_beside_good_ones(tmp_path: Path, tool):
    color = np.zeros((20, 30, 3), np.uint8)
    depth = np.full((20, 30), 1500, np.uint16)
    for name, bad in {
        "eight": depth.astype(np.uint8), "empty": depth * 0, "size": depth[:10], "good": depth, "far": depth * 5,
    }.items():  # fmt: skip
        write_png(tmp_path / "in" / name / "color.png", color)
        write_png(tmp_path / "in" / name / "depth.png", bad)
    shutil.copytree(tmp_path / "in" / "good", tmp_path / "in" / "cut")
    whole = (tmp_path / "in" / "good" / "depth.png").read_bytes()
    (tmp_path / "in" / "cut" / "depth.png").write_bytes(whole[:-20])
    tool.told(3, "refine-kinect", "nearest", "-i", tmp_path / "in", "-o", tmp_path / "r")
    assert {name for name, row in rows(tmp_path / "r").items() if row["status"] == "done"} == {"good", "far"}
    far = ("-i", tmp_path / "in" / "far", "--depth-scale", "5000")
    assert "warning" not in tool.err(0, "refine-kinect", "nearest", *far, "-o", tmp_path / "s")
    np.testing.assert_array_equal(read_plane(tmp_path / "s" / "far" / "depth.png"), depth * np.uint16(5))
    (tmp_path / "in" / "far" / "depth.png").unlink()
    write_pfm(tmp_path / "in" / "far" / "depth.pfm", np.full(depth.shape, 8.12, np.float32))  # has no scale
    assert "warning" not in tool.err(0, "refine-kinect", "nearest", *far[:2], "-o", tmp_path / "t")


def test_points_are_chosen_and_placed_by_options(made_kinect: Path, tmp_path: Path):
    def points(name: str, *options: str) -> np.ndarray:
        one = ("refine-kinect", "joint-bilateral", "-i", made_kinect, "--scenes", "planes", "--ply", "-q")
        assert run(*one, "-o", tmp_path / name, *options) == 0
        header, _, data = (tmp_path / name / "planes/points.ply").read_bytes().partition(b"end_header\n")
        vertices = np.frombuffer(data, [("p", "<f4", 3), ("color", "u1", 3)])
        assert f"element vertex {len(vertices)}\n".encode() in header
        return vertices["p"]

    whole, measured, sure = points("a", "--mask", "all"), points("m"), points("s", "--mask", "confident:0.5")
    status = read_status(tmp_path / "m/planes/status.png")
    assert (len(whole), len(measured)) == (status.size, status.measured.sum())
    assert len(whole) > len(measured) > len(sure) >= len(measured) // 2 > 0
    assert set(map(tuple, sure)) < set(map(tuple, measured)) < set(map(tuple, whole))
    assert sure[:, 2].max() < measured[:, 2].max()  # far depths have a larger deviation
    middle = float(np.median(whole[:, 2]))
    near, far = (points(name, f"--{name}", f"{middle}", "--mask", "all") for name in ("near", "far"))
    assert near[:, 2].min() >= middle >= far[:, 2].max()
    assert len(near) + len(far) >= len(whole)
    wide = points("w", "--intrinsics", "20,20,47.5,35.5", "--mask", "all")
    np.testing.assert_array_equal(wide[:, 2], whole[:, 2])
    assert np.abs(wide[:, 0]).max() > 2 * np.abs(whole[:, 0]).max()
    assert rows(tmp_path / "w")["planes"]["intrinsics"] == "of the camera"


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_warning_of_all_frames_is_printed_once(tmp_path: Path, tool, jobs: str):
    for k in range(3):
        write_png(tmp_path / "in" / f"f{k}" / "color.png", np.zeros((20, 30, 3), np.uint8))
        write_png(tmp_path / "in" / f"f{k}" / "depth.png", np.full((20, 30), 7500 + k, np.uint16))
    one = ("refine-kinect", "nearest", "-i", tmp_path / "in", "--ply", "--jobs", jobs)
    err = tool.err(0, *one, "-o", tmp_path / "r")
    assert err.count("the median depth is 7.5 m at 1000 codes per meter") == 2
    assert "see depth_scale (3 scenes;" in err and err.count("3 of 3 frames have no intrinsics") == 1
    assert {row["intrinsics"] for row in rows(tmp_path / "r").values()} == {"typical"}
    assert tool.err(0, *one, "-o", tmp_path / "v", "-v").count("the median depth is 7.5 m at 1000 codes per meter") == 4


def test_single_frames_and_point_clouds(tmp_path: Path, capsys: pytest.CaptureFixture[str], tool):
    write_png(tmp_path / "x" / "color.png", np.full((20, 30, 3), 90, np.uint8))
    write_png(tmp_path / "x" / "depth.png", np.full((20, 30), 1000, np.uint16))
    one = ("refine-kinect", "nearest", "--color", tmp_path / "x/color.png", "--depth", tmp_path / "x/depth.png")

    def cloud(name: str, *options: str) -> bytes:
        assert run(*one, "-o", tmp_path / name, "--ply", *options) == 0
        assert list(rows(tmp_path / name)) == ["x"]
        return (tmp_path / name / "x" / "points.ply").read_bytes()

    typical = cloud("p")
    assert typical.startswith(b"ply\nformat binary_little_endian 1.0\nelement vertex 600\n")
    assert capsys.readouterr().err.count("1 of 1 frames have no intrinsics") == 1
    assert b"element vertex 0\n" in cloud("far", "--near", "1.5")
    told(capsys.readouterr().err)
    tool.told(2, *one, "-o", tmp_path / "none", "--ply", "--near", "1.5", "--far", "1", "-q")
    given = cloud("given", "--intrinsics", "50,50,15,10")
    capsys.readouterr()
    (tmp_path / "x" / "meta.json").write_text('{"fx": 50, "fy": 50, "cx": 15, "cy": 10}')
    assert typical != given == cloud("meta", "--mask", "measured")
    assert "intrinsics" not in capsys.readouterr().err


@pytest.fixture(scope="module")
def phone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A frame whose depth has 1 / 7.5 of the color image's size and its own camera, in millimeters, with a gap."""
    folder = tmp_path_factory.mktemp("phone") / "room"
    truth, plane = rendered(COLOR, COLOR_SHAPE)
    sensed = noisy(rendered(DEPTH, DEPTH_SHAPE, ROTATION, TRANSLATION)[0], 0.003)
    sensed[20:24, 5:9] = np.nan
    write_png(folder / "color.png", np.array([[70, 80, 90], [160, 120, 80], [60, 160, 60]], np.uint8)[plane])
    write_png(folder / "depth.png", np.nan_to_num(1000 * sensed).round().astype(np.uint16))
    write_pfm(folder / "depth_true.pfm", truth.astype(np.float32))
    place = {"rotation": ROTATION.tolist(), "translation": TRANSLATION.tolist()}
    meta = {"intrinsics": asdict(COLOR), "depth_intrinsics": asdict(DEPTH), "depth_to_color": place}
    (folder / "meta.json").write_text(json.dumps(meta))
    return folder.parent


@pytest.mark.parametrize("preset", ["nearest", "fast", pytest.param("accurate", marks=pytest.mark.slow)])
def test_depth_smaller_than_color_is_refined_at_the_size_of_color(phone: Path, tmp_path: Path, preset: str):
    assert run("refine-kinect", preset, "-i", phone, "-o", tmp_path / "r", "--evaluate", "-q") == 0
    made, truth = tmp_path / "r" / "room", read_pfm(phone / "room" / "depth_true.pfm")
    depth, status = read_depth(made / "depth.png"), read_status(made / "status.png")
    assert depth.shape == COLOR_SHAPE
    inside = np.zeros(COLOR_SHAPE, bool)
    inside[40:-40, 50:-50] = True
    inside &= ~near_edges(rendered(COLOR, COLOR_SHAPE)[1], 16)
    assert np.median(np.abs(depth / truth - 1)[inside]) < 0.003
    row = rows(tmp_path / "r")["room"]
    assert row["registered"] == "by both cameras"
    assert (row["width"], row["height"]) == (480, 360)
    # Values between samples count as kept, those in the gap are filled.
    assert status.measured.mean() == pytest.approx(row["kept"], abs=1e-5)
    assert row["known"] < 0.99


def test_cameras_come_from_options_beside_meta_json(
    phone: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], tool
):
    shutil.copytree(phone / "room", tmp_path / "in" / "room")
    (tmp_path / "in" / "room" / "meta.json").unlink()
    one = ("refine-kinect", "nearest", "-i", tmp_path / "in")
    tool.told(0, *one, "-o", tmp_path / "plain")
    assert rows(tmp_path / "plain")["room"]["registered"] == "assumed"
    given = ("--depth-intrinsics", "49,48.5,31,24")
    tool.told(3, *one, *given, "-o", tmp_path / "r")
    assert run(*one, *given, "--intrinsics", "362,360,238.5,180", "-o", tmp_path / "r") == 0
    assert "taken as registered" not in capsys.readouterr().err
    first = (tmp_path / "r" / "room" / "depth.pfm").read_bytes()
    # Another camera makes the frame anew.
    other = ("--depth-intrinsics", "60,60,31,24", "--intrinsics", "362,360,238.5,180")
    assert run(*one, *other, "-o", tmp_path / "r") == 0
    assert (tmp_path / "r" / "room" / "depth.pfm").read_bytes() != first


@pytest.mark.parametrize("numbers", ["0,1,2,3", "nan,1,2,3", "1,2,3", "a,b,c,d", "1,-1,2,3", ""])
@pytest.mark.parametrize("option", ["--intrinsics", "--depth-intrinsics"])
def test_wrong_cameras_are_refused(phone: Path, tmp_path: Path, tool, option: str, numbers: str):
    (line,) = tool.err(2, "refine-kinect", "nearest", "-i", phone, option, numbers, "-o", tmp_path / "r").splitlines()
    assert f"{option}: " in line

"""``depthcli refine-kinect``: files, reports, sequences that are killed, bad frames beside good ones."""

import json
import shutil
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from depthcli.io.formats.depth import read_depth
from depthcli.io.formats.disparity import read_pfm, read_plane, read_status
from tests.command_line import contents, rows, run, vertices
from tests.files import laid
from tests.golden import told
from tests.rendered import COLOR, COLOR_SHAPE, DEPTH, DEPTH_SHAPE, ROTATION, TRANSLATION, near_edges, noisy, rendered
from tests.report.test_page import Reader


def test_bounds_at_another_level_are_evaluated_and_limit_clouds(made_kinect: Path, tmp_path: Path):
    one = ("refine-kinect", "nearest", "-i", made_kinect, "--scenes", "planes", "-q", "-o")
    cloud = ("--ply", "--mask", "all", "--max-bound", "0.05", "--level", "0.6", "--within", "0.1", "--evaluate")
    a, b, report = tmp_path / "a" / "planes", tmp_path / "b" / "planes", tmp_path / "b" / "evaluation"
    assert run(*one, a.parent) == 0 and run(*one, b.parent, *cloud) == 0
    bound, sure, low, likely = (read_pfm(at / f"{name}.pfm") for at in (a, b) for name in ("bound", "probability"))
    assert (low < bound).all() and (likely >= sure).all()
    assert (b.parent / "status.txt").is_file()
    assert "Depth: mean absolute error, mm" in (report / "report.md").read_text()
    assert len(vertices(b / "points.ply")) == np.count_nonzero(low <= 0.05)
    scored = json.loads((report / "scores.json").read_text())["results"][0]["bounds"]
    coverage = {row["mask"]: row for row in scored if row["metric"] == "bound coverage"}
    truth = read_pfm(made_kinect / "planes" / "depth_true.pfm")
    inside = np.abs(read_pfm(b / "depth.pfm") - truth) <= low
    assert coverage["all"]["value"] == pytest.approx(100 * inside[np.isfinite(truth)].mean(), abs=0.1)
    assert coverage["all"]["threshold"] == 60 and {"said kept", "said filled"} <= set(coverage)


def test_a_sequence_is_one_item_and_resumes_with_the_same_bytes(made_kinect: Path, tmp_path: Path):
    one = ("refine-kinect", "sequence", "-i", made_kinect, "--scenes", "moving/*", "-q", "-o")
    a, b = tmp_path / "a", tmp_path / "b"
    assert run(*one, a) == 0 and run(*one, b, "--threads", "1") == 0
    whole = contents(a)
    assert whole == contents(b)
    assert {f"moving/0000{k}/depth.pfm" for k in range(4)} < set(whole) and rows(a)["moving"]["frames"] == 4
    (b / "moving" / "00002" / "depth.pfm").unlink()  # a lost file of one frame makes the sequence anew
    assert run(*one, b) == 0
    assert contents(b) == whole


def test_a_frame_that_cannot_be_read_is_left_out_of_its_sequence(made_kinect: Path, tmp_path: Path, tool):
    no_truth = shutil.ignore_patterns("*true*")
    given = Path(shutil.copytree(made_kinect / "moving", tmp_path / "in" / "moving", ignore=no_truth))
    command = ("refine-kinect", "sequence", "-i", tmp_path / "in", "-o", tmp_path / "r", "--html")
    for numbers, code, left in (("1", 0, {"00000", "00002", "00003"}), ("0123", 3, set())):
        for number in numbers:
            (given / f"depth_0000{number}.pfm").write_bytes(b"damaged")
        tool.told(code, *command)
        assert {path.name for path in (tmp_path / "r" / "moving").glob("0*")} == left
        row = rows(tmp_path / "r")["moving"]
        assert (row.get("frames"), row.get("frames_failed")) == ((3, 1) if left else (None, None))
        page = Reader(tmp_path / "r" / "evaluation")  # shows each frame, or why it does not
        assert {scene["name"] for scene in page.scenes()} == {f"moving/{number}" for number in left}
        told("\n".join(row[1] for row in page.tables[0][1:]))


def test_single_frames_and_frames_of_sequences_are_evaluated(made_kinect: Path, tmp_path: Path):
    scenes = ("--scenes", "planes", "--scenes", "moving/*", "--scenes", "static/*")
    assert run("refine-kinect", "realsense", "-i", made_kinect, *scenes, "-o", tmp_path / "r", "--evaluate", "-q") == 0
    assert set(rows(tmp_path / "r")) == {"moving", "planes", "static"}
    scored = json.loads((tmp_path / "r" / "evaluation" / "scores.json").read_text())["results"]
    frames = {f"{kind}/0000{k}" for kind in ("moving", "static") for k in range(4)}
    assert {row["scene"] for row in scored if not row["missing"]} == frames | {"planes"}
    # Frames of a sequence are items for methods without memory.
    assert run("refine-kinect", "nearest", "-i", made_kinect / "static", "-o", tmp_path / "s", "-q") == 0
    assert set(rows(tmp_path / "s")) == {f"0000{k}" for k in range(4)}


def frame(depth: np.ndarray, color: int = 0) -> dict[str, np.ndarray]:
    return {"color.png": np.full((20, 30, 3), color, np.uint8), "depth.png": depth}


def test_bad_frames_beside_good_ones(tmp_path: Path, tool):
    depth, given = np.full((20, 30), 1500, np.uint16), tmp_path / "in"
    bad = {"eight": depth.astype(np.uint8), "empty": depth * 0, "size": depth[:10], "cut": depth}
    for name, values in {**bad, "good": depth, "far": depth * 5}.items():
        laid(given / name, frame(values))
    laid(given, {"cut/depth.png": (given / "good/depth.png").read_bytes()[:-20]})
    line = ("refine-kinect", "nearest", "-i")
    tool.told(3, *line, given, "-o", tmp_path / "r")
    assert {name for name, row in rows(tmp_path / "r").items() if row["status"] == "done"} == {"good", "far"}
    far = given / "far"
    assert "warning" not in tool.err(0, *line, far, "--depth-scale", "5000", "-o", tmp_path / "s")
    np.testing.assert_array_equal(read_plane(tmp_path / "s" / "far" / "depth.png"), depth * np.uint16(5))
    (far / "depth.png").unlink()
    laid(far, {"depth.pfm": np.full(depth.shape, 8.12, np.float32)})  # has no scale
    assert "warning" not in tool.err(0, *line, far, "-o", tmp_path / "t")


def test_points_are_chosen_and_placed_by_options(made_kinect: Path, tmp_path: Path):
    def points(name: str, *options: str) -> np.ndarray:
        one = ("refine-kinect", "joint-bilateral", "-i", made_kinect, "--scenes", "planes", "--ply", "-q")
        assert run(*one, "-o", tmp_path / name, *options) == 0
        return vertices(tmp_path / name / "planes" / "points.ply")["xyz"]

    whole, measured, sure = points("a", "--mask", "all"), points("m"), points("s", "--mask", "confident:0.5")
    status = read_status(tmp_path / "m/planes/status.png")
    assert (len(whole), len(measured)) == (status.size, status.measured.sum())
    assert len(whole) > len(measured) > len(sure) >= len(measured) // 2 > 0
    assert set(map(tuple, sure)) < set(map(tuple, measured)) < set(map(tuple, whole))
    assert sure[:, 2].max() < measured[:, 2].max()  # far depths have a larger deviation
    wide = points("w", "--intrinsics", "20,20,47.5,35.5", "--mask", "all")
    np.testing.assert_array_equal(wide[:, 2], whole[:, 2])
    assert np.abs(wide[:, 0]).max() > 2 * np.abs(whole[:, 0]).max()
    assert rows(tmp_path / "w")["planes"]["intrinsics"] == "of the camera"


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_warning_of_all_frames_is_printed_once(tmp_path: Path, tool, jobs: str):
    for k in range(3):
        laid(tmp_path / "in" / f"f{k}", frame(np.full((20, 30), 7500 + k, np.uint16)))
    one, far = ("refine-kinect", "nearest", "-i", tmp_path / "in", "--ply", "--jobs", jobs, "-o"), tmp_path / "r"
    said = "the median depth is 7.5 m at 1000 codes per meter"
    err = tool.err(0, *one, far)
    assert err.count(said) == 2 and "see depth_scale (3 scenes;" in err
    assert err.count("3 of 3 frames have no intrinsics") == 1
    assert {row["intrinsics"] for row in rows(far).values()} == {"typical"}
    assert tool.err(0, *one, tmp_path / "v", "-v").count(said) == 4


def test_single_frames_and_point_clouds(tmp_path: Path, tool):
    x = laid(tmp_path / "x", frame(np.full((20, 30), 1000, np.uint16), color=90))
    one = ("refine-kinect", "nearest", "--color", x / "color.png", "--depth", x / "depth.png", "--ply")

    def cloud(name: str, *options: str) -> tuple[bytes, str]:
        err = tool.err(0, *one, "-o", tmp_path / name, *options)
        assert list(rows(tmp_path / name)) == ["x"]
        return (tmp_path / name / "x" / "points.ply").read_bytes(), err

    typical, err = cloud("p")
    assert typical.startswith(b"ply\nformat binary_little_endian 1.0\nelement vertex 600\n")
    assert err.count("1 of 1 frames have no intrinsics") == 1
    empty, err = cloud("far", "--near", "1.5")
    assert b"element vertex 0\n" in empty
    told(err)
    tool.told(2, *one, "-o", tmp_path / "none", "--near", "1.5", "--far", "1", "-q")
    given, _ = cloud("given", "--intrinsics", "50,50,15,10")
    laid(x, {"meta.json": {"fx": 50, "fy": 50, "cx": 15, "cy": 10}})
    meta, err = cloud("meta", "--mask", "measured")
    assert typical != given == meta and "intrinsics" not in err


@pytest.fixture(scope="module")
def phone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A frame whose depth has 1 / 7.5 of the color image's size and its own camera, in millimeters, with a gap."""
    truth, plane = rendered(COLOR, COLOR_SHAPE)
    sensed = noisy(rendered(DEPTH, DEPTH_SHAPE, ROTATION, TRANSLATION)[0], 0.003)
    sensed[20:24, 5:9] = np.nan
    place = {"rotation": ROTATION.tolist(), "translation": TRANSLATION.tolist()}
    return laid(tmp_path_factory.mktemp("phone"), {
        "room/color.png": np.array([[70, 80, 90], [160, 120, 80], [60, 160, 60]], np.uint8)[plane],
        "room/depth.png": np.nan_to_num(1000 * sensed).round().astype(np.uint16),
        "room/depth_true.pfm": truth.astype(np.float32),
        "room/meta.json": {"intrinsics": asdict(COLOR), "depth_intrinsics": asdict(DEPTH), "depth_to_color": place},
    })  # fmt: skip


@pytest.mark.parametrize("preset", ["nearest", "fast", pytest.param("accurate", marks=pytest.mark.slow)])
def test_depth_smaller_than_color_is_refined_at_the_size_of_color(phone: Path, tmp_path: Path, preset: str):
    assert run("refine-kinect", preset, "-i", phone, "-o", tmp_path / "r", "--evaluate", "-q") == 0
    made, truth, row = tmp_path / "r/room", read_pfm(phone / "room/depth_true.pfm"), rows(tmp_path / "r")["room"]
    depth, status = read_depth(made / "depth.png"), read_status(made / "status.png")
    assert depth.shape == COLOR_SHAPE and (row["width"], row["height"]) == (480, 360)
    inside = ~near_edges(rendered(COLOR, COLOR_SHAPE)[1], 16)[40:-40, 50:-50]
    assert np.median(np.abs(depth / truth - 1)[40:-40, 50:-50][inside]) < 0.003
    assert row["registered"] == "by both cameras"
    # Values between samples count as kept, those in the gap are filled.
    assert status.measured.mean() == pytest.approx(row["kept"], abs=1e-5) and row["known"] < 0.99


def test_cameras_come_from_options_beside_meta_json(phone: Path, tmp_path: Path, tool):
    shutil.copytree(phone, tmp_path / "in", ignore=shutil.ignore_patterns("meta.json"))
    one, made = ("refine-kinect", "nearest", "-i", tmp_path / "in", "-o"), tmp_path / "r" / "room" / "depth.pfm"
    tool.told(0, *one, tmp_path / "plain")
    assert rows(tmp_path / "plain")["room"]["registered"] == "assumed"
    color, given = ("--intrinsics", "362,360,238.5,180"), ("--depth-intrinsics", "49,48.5,31,24")
    tool.told(3, *one, tmp_path / "r", *given)
    assert "taken as registered" not in tool.err(0, *one, tmp_path / "r", *given, *color)
    first = made.read_bytes()
    # Another camera makes the frame anew.
    assert run(*one, tmp_path / "r", "--depth-intrinsics", "60,60,31,24", *color) == 0
    assert made.read_bytes() != first


@pytest.mark.parametrize("numbers", ["0,1,2,3", "nan,1,2,3", "1,2,3", "a,b,c,d", "1,-1,2,3", ""])
@pytest.mark.parametrize("option", ["--intrinsics", "--depth-intrinsics"])
def test_wrong_cameras_are_refused(phone: Path, tmp_path: Path, tool, option: str, numbers: str):
    (line,) = tool.err(2, "refine-kinect", "nearest", "-i", phone, option, numbers, "-o", tmp_path / "r").splitlines()
    assert f"{option}: " in line

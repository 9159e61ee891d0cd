"""From disparities to meters: ``depthcli depth`` against the formulas and OpenCV's reprojection."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import depthcli
from depthcli.core.errors import InputError
from depthcli.core.maps import Status
from depthcli.io.formats.calibrations import Reading, read_geometry, write_geometry
from depthcli.io.formats.depth import read_depth
from depthcli.io.formats.disparity import read_pfm, read_status, write_disparity_png, write_pfm
from depthcli.io.formats.images import read_image, write_png
from tests.command_line import rows, run
from tests.golden import refused, told

V3 = """cam0=[713.189 0 56.021; 0 713.189 38.263; 0 0 1]
cam1=[713.189 0 87.361; 0 713.189 38.263; 0 0 1]
doffs=31.34
baseline=178.089
width=96
height=64
ndisp=12
"""
KITTI = """P0: 700 0 600 0 0 700 170 0 0 0 1 0
P1: 700 0 600 -371 0 700 170 0 0 0 1 0
P2: 710 0 610 42.6 0 710 172 0 0 0 1 0
P3: 710 0 612 -340.8 0 710 172 0 0 0 1 0
"""


@pytest.fixture(scope="module")
def matched(two_scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A folder of two scenes of the layout middlebury-v3 and a run on them, with a confidence map and filled pixels."""
    place = tmp_path_factory.mktemp("depth")
    for scene in two_scenes.glob("*/left.png"):
        folder = place / "scenes" / scene.parent.name
        folder.mkdir(parents=True)
        (folder / "im0.png").write_bytes(scene.read_bytes())
        (folder / "im1.png").write_bytes(scene.with_name("right.png").read_bytes())
        (folder / "calib.txt").write_text(V3)
    extra = ("--set", "confidence=[apkr, msm]")
    assert run("stereo", "fast", "-i", place / "scenes", "-o", place / "run", *extra, "-q") == 0
    return place / "scenes", place / "run"


def vertices(path: Path) -> np.ndarray:
    """(N, 3) positions and colors of a cloud, as its header describes them."""
    head, _, data = path.read_bytes().partition(b"end_header\n")
    assert b"format binary_little_endian" in head
    table = np.frombuffer(data, [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    assert f"element vertex {len(table)}\n".encode() in head
    return table


def test_depth_is_that_of_the_formula_and_of_opencv(matched: tuple[Path, Path], tmp_path: Path):
    scenes, made = matched
    assert run("depth", made, "-o", tmp_path / "d", "--ply", "--mask", "all", "-q") == 0
    scene = "planes_0"
    disparity = read_pfm(made / scene / "disp_left.pfm")
    known = np.isfinite(disparity)
    depth = read_pfm(tmp_path / "d" / scene / "depth.pfm")
    np.testing.assert_allclose(depth[known], 0.178089 * 713.189 / (disparity[known] + 31.34), rtol=1e-6)
    assert not np.isfinite(depth[~known]).any()
    q = np.float64([[1, 0, 0, -56.021], [0, 1, 0, -38.263], [0, 0, 0, 713.189], [0, 0, 1 / 0.178089, 31.34 / 0.178089]])
    points = cv2.reprojectImageTo3D(disparity, q)
    cloud = vertices(tmp_path / "d" / scene / "points.ply")
    np.testing.assert_allclose(cloud["xyz"], points[known], rtol=1e-4, atol=1e-6)
    color = cv2.imread(str(scenes / scene / "im0.png"))[..., ::-1]
    np.testing.assert_array_equal(cloud["rgb"], color[known])
    codes = cv2.imread(str(tmp_path / "d" / scene / "depth.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(codes[known], np.rint(depth[known].astype(np.float64) * 1000))
    np.testing.assert_allclose(read_depth(tmp_path / "d" / scene / "depth.png")[known], depth[known], atol=0.0006)
    row = rows(tmp_path / "d")[scene]
    assert (row["focal"], row["doffs"], row["points"]) == (713.189, 31.34, int(known.sum()))


def test_bounds_in_meters_and_the_points_within_one(matched: tuple[Path, Path], tmp_path: Path, tool):
    scenes, made = matched
    one = scenes / "planes_0"
    assert run("stereo", "fast", "-i", scenes, "-o", tmp_path / "run", "--bound", "-q") == 0
    assert (
        run("depth", tmp_path / "run", "-o", tmp_path / "d", "--ply", "--mask", "all", "--max-bound", "0.1", "-q") == 0
    )
    disparity, bound = (read_pfm(tmp_path / "run" / "planes_0" / f"{name}.pfm") for name in ("disp_left", "bound"))
    depth, wide = (read_pfm(tmp_path / "d" / "planes_0" / f"{name}.pfm") for name in ("depth", "bound"))
    far = 713.189 * 0.178089 / np.maximum(disparity + 31.34 - bound, 1e-9)
    finite = disparity + 31.34 - bound > 1
    np.testing.assert_allclose(wide[finite], (far - depth)[finite], rtol=1e-3, atol=1e-5)
    assert (wide[disparity + 31.34 <= bound] == np.inf).all()
    assert len(vertices(tmp_path / "d" / "planes_0" / "points.ply")) == np.count_nonzero(wide <= 0.1) > 100
    assert rows(tmp_path / "d")["planes_0"]["median_bound"] == pytest.approx(np.median(wide), abs=1e-3)
    left, right = (read_image(one / f"im{k}.png") for k in (0, 1))
    found = depthcli.stereo(left, right, 12, "fast", bound=True).to_depth(one / "calib.txt")
    np.testing.assert_array_equal(found.bound, wide)
    assert len(found.to_points("all", max_bound=0.1)) == np.count_nonzero(wide <= 0.1)
    tool.told(3, "depth", made, "-o", tmp_path / "e", "--max-bound", "0.1", "-q")


def test_masks(matched: tuple[Path, Path], tmp_path: Path, tool):
    _, made = matched
    one = (made, "--ply", "--scenes", "planes_0", "-q")
    disparity = read_pfm(made / "planes_0" / "disp_left.pfm")
    measured = np.isfinite(disparity) & ((read_status(made / "planes_0" / "status.png") & Status.FILLED) == 0)
    assert 0.3 < measured.mean() < 1
    # By default the maps hold everything, the cloud what was measured.
    assert run("depth", *one, "-o", tmp_path / "a") == 0
    assert np.isfinite(read_pfm(tmp_path / "a/planes_0/depth.pfm")).sum() == np.isfinite(disparity).sum()
    assert len(vertices(tmp_path / "a/planes_0/points.ply")) == measured.sum()
    middle = float(np.nanmedian(read_pfm(tmp_path / "a/planes_0/depth.pfm")[measured]))
    assert run("depth", *one, "-o", tmp_path / "near", "--far", str(middle)) == 0
    assert 0 < len(vertices(tmp_path / "near/planes_0/points.ply")) < measured.sum()
    np.testing.assert_array_equal(
        read_status(tmp_path / "a/planes_0/status.png"), read_status(made / "planes_0/status.png")
    )
    assert run("depth", *one, "-o", tmp_path / "b", "--mask", "measured") == 0
    np.testing.assert_array_equal(np.isfinite(read_pfm(tmp_path / "b/planes_0/depth.pfm")), measured)
    assert run("depth", *one, "-o", tmp_path / "c", "--mask", "confident:0.6:apkr") == 0
    kept = np.isfinite(read_pfm(tmp_path / "c/planes_0/depth.pfm"))
    assert not (kept & ~measured).any()
    assert abs(kept.sum() / measured.sum() - 0.6) < 0.02
    confidence = read_pfm(made / "planes_0" / "confidence_apkr.pfm")
    assert confidence[kept].min() > confidence[measured & ~kept].max()
    tool.told(3, "depth", *one, "-o", tmp_path / "e", "--mask", "confident:0.6")
    assert run("depth", *one, "-o", tmp_path / "f", "--mask", "confident:2") == 2


def test_where_the_calibration_comes_from(matched: tuple[Path, Path], tmp_path: Path, tool):
    _, made = matched
    one = (made, "--scenes", "planes_0", "-q")
    by_hand = ("--focal", "713.189", "--baseline", "0.178089", "--doffs", "31.34")
    (tmp_path / "calib.txt").write_text(V3)
    for name, how in (("a", ()), ("b", by_hand), ("c", ("--calibration", tmp_path / "calib.txt"))):
        assert run("depth", *one, *how, "-o", tmp_path / name) == 0
    maps = [(tmp_path / name / "planes_0/depth.pfm").read_bytes() for name in "abc"]
    assert maps[0] == maps[1] == maps[2]
    # Another calibration is another result; a wrong one is the scene's failure.
    (tmp_path / "calib.txt").write_text(V3.replace("178.089", "89"))
    assert run("depth", *one, "--calibration", tmp_path / "calib.txt", "-o", tmp_path / "c") == 0
    assert (tmp_path / "c/planes_0/depth.pfm").read_bytes() != maps[0]
    (tmp_path / "calib.txt").write_text(V3.replace("178.089", "wide"))
    tool.told(3, "depth", *one, "--calibration", tmp_path / "calib.txt", "-o", tmp_path / "c", "--overwrite")


def test_other_cameras_of_a_calibration_give_another_depth(tmp_path: Path):
    scenes = tmp_path / "scenes"
    scenes.mkdir()
    (scenes / "calib.txt").write_text(KITTI)
    write_pfm(tmp_path / "run/000000/disp_left.pfm", np.full((20, 30), 7, np.float32))
    for first, depth in ((0, 371 / 7), (2, 383.4 / (7 + 2))):  # the same images as of the grey, then the color cameras
        for side in (0, 1):
            write_png(scenes / f"image_{first + side}/000000.png", np.zeros((20, 30), np.uint8))
        assert run("depth", tmp_path / "run", "-i", scenes, "-o", tmp_path / "d", "-q") == 0
        np.testing.assert_allclose(read_pfm(tmp_path / "d/000000/depth.pfm"), depth, rtol=1e-6)
        shutil.rmtree(scenes / "image_0", ignore_errors=True)


def test_a_single_map_of_far_things(tmp_path: Path, capsys):
    values = np.full((20, 30), 0.5, np.float32)
    values[:, :10] = 20
    values[0, 0] = np.nan
    write_pfm(tmp_path / "map.pfm", values)
    write_disparity_png(tmp_path / "map.png", values)
    write_png(tmp_path / "left.png", np.full((20, 30), 90, np.uint8))
    (tmp_path / "calib.txt").write_text(KITTI)
    known = ("--calibration", tmp_path / "calib.txt", "--left", tmp_path / "left.png", "--ply")
    for name, scale in (("map.pfm", ()), ("map.png", ("--scale", "256"))):
        assert run("depth", tmp_path / name, *known, *scale, "-o", tmp_path / name[-3:]) == 0
        depth = read_pfm(tmp_path / name[-3:] / "map/depth.pfm")
        np.testing.assert_allclose(depth[5, [0, 20]], [710 * 0.54 / 22, 710 * 0.54 / 2.5], rtol=1e-6)
        codes = cv2.imread(str(tmp_path / name[-3:] / "map/depth.png"), cv2.IMREAD_UNCHANGED)
        assert codes[0, 0] == 0
        assert codes[5, 20] == 0
        told(capsys.readouterr().err)
    assert run("depth", tmp_path / "map.pfm", *known, "-o", tmp_path / "k", "--depth-scale", "256") == 0
    assert "beyond" not in capsys.readouterr().err
    by_hand = ("--focal", "50", "--baseline", "0.1", *known[2:])
    assert run("depth", tmp_path / "map.pfm", *by_hand, "-o", tmp_path / "h") == 0
    cloud = vertices(tmp_path / "h/map/points.ply")["xyz"]
    ends = (cloud[:, :2] / cloud[:, 2:] * 50).max(axis=0)  # the principal point is the center of the image
    np.testing.assert_allclose(ends, (14.5, 9.5), rtol=1e-5)


def test_the_run_has_moved(matched: tuple[Path, Path], tmp_path: Path, tool):
    scenes, made = matched
    copy = tmp_path / "run"
    shutil.copytree(made / "planes_0", copy / "planes_0", ignore=shutil.ignore_patterns("record.json"))
    tool.told(3, "depth", copy, "-o", tmp_path / "a", "-q")
    assert run("depth", copy, "-o", tmp_path / "b", "-i", scenes, "--ply", "-q") == 0
    assert run("depth", tmp_path / "absent", "-o", tmp_path / "c") == 2
    assert run("depth", scenes, "-o", tmp_path / "c") == 2


def test_a_scene_whose_map_is_gone_fails(matched, tmp_path: Path, tool):
    made = shutil.copytree(matched[1], tmp_path / "run")
    (first, second) = sorted(folder.parent.name for folder in made.glob("*/disp_left.pfm"))
    (made / first / "disp_left.pfm").unlink()
    tool.told(3, "depth", made, "-o", tmp_path / "d", "-q")
    assert not (tmp_path / "d" / first / "depth.pfm").exists() and (tmp_path / "d" / second / "depth.pfm").exists()
    assert run("depth", made, "-o", tmp_path / "e", "-q", "--scenes", second) == 0
    (made / second / "disp_left.pfm").unlink()
    tool.told(2, "depth", made, "-o", tmp_path / "f", "-q")


def test_kitti_by_camera(tmp_path: Path):
    (tmp_path / "calib.txt").write_text(KITTI)
    grey, color = read_geometry(tmp_path / "calib.txt", Reading(cameras=(0, 1))), read_geometry(tmp_path / "calib.txt")
    assert (grey.fb, grey.offset) == (pytest.approx(371), 0)
    assert (color.fb, color.offset, color.left.cx) == (pytest.approx(383.4), 2, 610)
    refused(InputError, read_geometry, tmp_path / "calib.txt", Reading(cameras=(3, 2)))
    half = color.for_size(500, 100)
    assert half.size == (500, 100)  # KITTI's projections say no size: taken as they are
    write_geometry(tmp_path / "own.txt", half, 63)
    again = read_geometry(tmp_path / "own.txt")
    assert again.fb == pytest.approx(half.fb)
    assert (again.offset, again.size) == (2, (500, 100))
    scaled = again.for_size(250, 50)
    assert (scaled.left.fx, scaled.left.cx, scaled.left.cy) == (355, 304.75, 85.75)  # corners of pixels stay
    assert scaled.offset == 1
    # A point's depth stays when its image is halved.
    np.testing.assert_allclose(scaled.depth(np.float32([[4.0]])), again.depth(np.float32([[8.0]])))
    refused(InputError, again.for_size, 250, 100)


def test_maps_of_other_programs(matched: tuple[Path, Path], tmp_path: Path, tool):
    """A rig of 400 px x 0.1 m sees 20 px at 2 m; -1 marks what has no value."""
    disparity = np.full((60, 100), 20, np.float32)
    disparity[:, ::2] += np.float32(0.5)
    disparity[:, :20] = -1
    write_pfm(tmp_path / "float.pfm", disparity)
    np.save(tmp_path / "sgbm.npy", np.rint(disparity * 16).astype(np.int16))
    write_png(tmp_path / "codes.png", np.rint(np.maximum(disparity, 0) * 64).astype(np.uint16))
    np.save(tmp_path / "raft.npy", -disparity)

    def depth(name: str, *options: object) -> tuple[np.ndarray, str]:
        out = tmp_path / "out" / name
        line = ("depth", tmp_path / name, "--focal", "400", "--baseline", "0.1", "-o", out, "--overwrite", *options)
        said = tool.err(0, *line)
        return read_pfm(next(out.glob("*/depth.pfm"))), said

    for name, options, says in (
        ("float.pfm", (), "20 % of the pixels are -1: taken as no value"),
        ("float.pfm", ("--invalid", "-1"), ""),
        ("sgbm.npy", (), "int16 disparities are divided by 16, as OpenCV's"),
        ("sgbm.npy", ("--scale", "16"), ""),
        ("codes.png", ("--scale", "64"), ""),
    ):
        found, said = depth(name, *options)
        assert np.isfinite(found).mean() == 0.8 and found[0, 51] == pytest.approx(2)
        assert (says in said) if says else ("warning" not in said)
    by_hand = ("--focal", "400", "--baseline", "0.1", "-o", tmp_path / "none", "-q")
    tool.told(3, "depth", tmp_path / "codes.png", *by_hand)
    tool.told(3, "depth", tmp_path / "raft.npy", *by_hand)
    tool.told(2, "depth", matched[1], "--scale", "16", "-o", tmp_path / "none", "-q")


def test_a_map_of_a_run_alone_keeps_its_status_and_bound(tmp_path: Path):
    folder = tmp_path / "run" / "a"
    folder.mkdir(parents=True)
    for name, value in (("disp_left", 20.0), ("bound", 0.5)):
        write_pfm(folder / f"{name}.pfm", np.full((6, 8), value, np.float32))
    status = np.zeros((6, 8), np.uint8)
    status[2:4] = Status.OCCLUDED | Status.FILLED
    write_png(folder / "status.png", status)
    line = ("depth", folder / "disp_left.pfm", "--focal", 400, "--baseline", 0.1, "--mask", "measured", "-q", "-o")
    assert run(*line, tmp_path / "foreign") == 0  # without a record the files beside may be of another map
    assert np.isfinite(read_pfm(tmp_path / "foreign" / "disp_left" / "depth.pfm")).all()
    (folder / "record.json").write_text("{}")
    assert run(*line, tmp_path / "own") == 0
    found = tmp_path / "own" / "disp_left"
    np.testing.assert_array_equal(np.isfinite(read_pfm(found / "depth.pfm")), status == 0)
    assert (found / "bound.pfm").is_file()

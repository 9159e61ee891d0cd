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
from depthcli.io.formats.disparity import read_pfm, read_status, write_disparity_png
from depthcli.io.formats.images import read_image
from tests.command_line import contents, rows, run, vertices
from tests.files import laid
from tests.golden import refused, told, warned

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


SCENE = "planes_0"


@pytest.fixture(scope="module")
def matched(two_scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A folder of two scenes of the layout middlebury-v3 and a run on them, with a confidence map and filled pixels."""
    place = tmp_path_factory.mktemp("depth")
    for scene in two_scenes.glob("*/left.png"):
        left, right = (scene.with_name(f"{side}.png").read_bytes() for side in ("left", "right"))
        laid(place / "scenes" / scene.parent.name, {"im0.png": left, "im1.png": right, "calib.txt": V3})
    extra = ("--set", "confidence=[apkr, msm]")
    assert run("stereo", "fast", "-i", place / "scenes", "-o", place / "run", *extra, "-q") == 0
    return place / "scenes", place / "run"


def test_depth_is_that_of_the_formula_and_of_opencv(matched: tuple[Path, Path], tmp_path: Path):
    scenes, made = matched[0] / SCENE, matched[1] / SCENE
    assert run("depth", matched[1], "-o", tmp_path, "--ply", "--mask", "all", "-q") == 0
    disparity, depth = read_pfm(made / "disp_left.pfm"), read_pfm(tmp_path / SCENE / "depth.pfm")
    known = np.isfinite(disparity)
    np.testing.assert_allclose(depth[known], 0.178089 * 713.189 / (disparity[known] + 31.34), rtol=1e-6)
    assert not np.isfinite(depth[~known]).any()
    q = np.float64([[1, 0, 0, -56.021], [0, 1, 0, -38.263], [0, 0, 0, 713.189], [0, 0, 1 / 0.178089, 31.34 / 0.178089]])
    cloud = vertices(tmp_path / SCENE / "points.ply")
    np.testing.assert_allclose(cloud["xyz"], cv2.reprojectImageTo3D(disparity, q)[known], rtol=1e-4, atol=1e-6)
    np.testing.assert_array_equal(cloud["rgb"], cv2.imread(str(scenes / "im0.png"))[..., ::-1][known])
    codes = cv2.imread(str(tmp_path / SCENE / "depth.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(codes[known], np.rint(depth[known].astype(np.float64) * 1000))
    np.testing.assert_allclose(read_depth(tmp_path / SCENE / "depth.png")[known], depth[known], atol=0.0006)
    row = rows(tmp_path)[SCENE]
    assert (row["focal"], row["doffs"], row["points"]) == (713.189, 31.34, int(known.sum()))


def test_a_single_pair_has_the_calibration_beside_it(matched: tuple[Path, Path], tmp_path: Path):
    photos = {
        f"{to}.png": (matched[0] / SCENE / f"{name}.png").read_bytes() for to, name in (("a", "im0"), ("b", "im1"))
    }
    laid(tmp_path, photos | {"calib.txt": V3})
    pair = ("--left", tmp_path / "a.png", "--right", tmp_path / "b.png", "--max-disparity", "12")
    assert run("stereo", "fast", *pair, "-o", tmp_path / "run", "-q") == 0
    assert run("depth", tmp_path / "run", "-o", tmp_path / "out", "-q") == 0
    assert [row["focal"] for row in rows(tmp_path / "out").values()] == [713.189]


def test_bounds_in_meters_and_the_points_within_one(matched: tuple[Path, Path], tmp_path: Path, tool):
    one, made, limited = matched[0] / SCENE, tmp_path / "run" / SCENE, ("--max-bound", "0.1", "-q")
    assert run("stereo", "fast", "-i", matched[0], "-o", made.parent, "--bound", "-q") == 0
    assert run("depth", made.parent, "-o", tmp_path / "d", "--ply", "--mask", "all", *limited) == 0
    disparity, bound = (read_pfm(made / f"{name}.pfm") for name in ("disp_left", "bound"))
    depth, wide = (read_pfm(tmp_path / "d" / SCENE / f"{name}.pfm") for name in ("depth", "bound"))
    least = disparity + 31.34 - bound
    far = 713.189 * 0.178089 / np.maximum(least, 1e-9)
    np.testing.assert_allclose(wide[least > 1], (far - depth)[least > 1], rtol=1e-3, atol=1e-5)
    assert (wide[disparity + 31.34 <= bound] == np.inf).all()
    assert len(vertices(tmp_path / "d" / SCENE / "points.ply")) == np.count_nonzero(wide <= 0.1) > 100
    assert rows(tmp_path / "d")[SCENE]["median_bound"] == pytest.approx(np.median(wide), abs=1e-3)
    left, right = (read_image(one / f"im{k}.png") for k in (0, 1))
    again = depthcli.stereo(left, right, 12, "fast", bound=True)
    found = again.to_depth(one / "calib.txt")
    found.save(tmp_path / "py")
    found.to_points("all", max_bound=0.1).save(tmp_path / "py" / "points.ply")
    assert contents(tmp_path / "py") == contents(tmp_path / "d" / SCENE)
    by_hand = again.to_depth(focal=713.189, baseline=0.178089, doffs=31.34)
    np.testing.assert_allclose(by_hand.values, found.values, rtol=1e-6)
    np.testing.assert_array_equal(again.to_points(one / "calib.txt").points, found.to_points().points)
    assert repr(found.to_points()) == f"PointCloud({np.count_nonzero(found.measured)} points)"
    (tmp_path / "far.txt").write_text(V3.replace("width=96\nheight=64\n", "").replace(" 56.021;", " 9000;"))
    told("\n".join(warned(again.to_depth, tmp_path / "far.txt")[1]))
    tool.told(3, "depth", matched[1], "-o", tmp_path / "e", *limited)


def test_masks(matched: tuple[Path, Path], tmp_path: Path, tool):
    made, one = matched[1] / SCENE, ("depth", matched[1], "--ply", "--scenes", SCENE, "-q", "-o")
    disparity, status = read_pfm(made / "disp_left.pfm"), read_status(made / "status.png")
    measured = np.isfinite(disparity) & ((status & Status.FILLED) == 0)
    assert 0.3 < measured.mean() < 1

    def depth(name: str, *options: str) -> np.ndarray:
        assert run(*one, tmp_path / name, *options) == 0
        return read_pfm(tmp_path / name / SCENE / "depth.pfm")

    # By default the maps hold everything, the cloud what was measured.
    whole, cloud = depth("a"), vertices(tmp_path / "a" / SCENE / "points.ply")
    assert (np.isfinite(whole).sum(), len(cloud)) == (np.isfinite(disparity).sum(), measured.sum())
    np.testing.assert_array_equal(read_status(tmp_path / "a" / SCENE / "status.png"), status)
    depth("near", "--far", str(float(np.nanmedian(whole[measured]))))
    assert 0 < len(vertices(tmp_path / "near" / SCENE / "points.ply")) < measured.sum()
    np.testing.assert_array_equal(np.isfinite(depth("b", "--mask", "measured")), measured)
    kept = np.isfinite(depth("c", "--mask", "confident:0.6:apkr"))
    assert not (kept & ~measured).any() and abs(kept.sum() / measured.sum() - 0.6) < 0.02
    confidence = read_pfm(made / "confidence_apkr.pfm")
    assert confidence[kept].min() > confidence[measured & ~kept].max()
    tool.told(3, *one, tmp_path / "e", "--mask", "confident:0.6")
    assert run(*one, tmp_path / "f", "--mask", "confident:2") == 2


def test_where_the_calibration_comes_from(matched: tuple[Path, Path], tmp_path: Path, tool):
    one, file = ("depth", matched[1], "--scenes", SCENE, "-q", "-o"), tmp_path / "calib.txt"

    def depth(name: str, *options: str | Path) -> bytes:
        assert run(*one, tmp_path / name, *options) == 0
        return (tmp_path / name / SCENE / "depth.pfm").read_bytes()

    file.write_text(V3)
    by_hand = ("--focal", "713.189", "--baseline", "0.178089", "--doffs", "31.34")
    assert depth("a") == depth("b", *by_hand) == depth("c", "--calibration", file)
    # Another calibration is another result; a wrong one is the scene's failure.
    file.write_text(V3.replace("178.089", "89"))
    assert depth("c", "--calibration", file) != depth("a")
    file.write_text(V3.replace("178.089", "wide"))
    tool.told(3, *one, tmp_path / "c", "--calibration", file, "--overwrite")


def test_other_cameras_of_a_calibration_give_another_depth(tmp_path: Path):
    scenes, out = tmp_path / "scenes", tmp_path / "d"
    laid(tmp_path, {"run/000000/disp_left.pfm": np.full((20, 30), 7, np.float32)})
    for first, depth in ((0, 371 / 7), (2, 383.4 / (7 + 2))):  # the same images as of the grey, then the color cameras
        names = (f"image_{first + side}/000000.png" for side in (0, 1))
        laid(scenes, {**dict.fromkeys(names, np.zeros((20, 30), np.uint8)), "calib.txt": KITTI})
        assert run("depth", tmp_path / "run", "-i", scenes, "-o", out, "-q") == 0
        np.testing.assert_allclose(read_pfm(out / "000000/depth.pfm"), depth, rtol=1e-6)
        shutil.rmtree(scenes / "image_0", ignore_errors=True)
    # A data set without a file of calibration: TartanAir's 320 px at 640 x 480, and 0.25 m.
    laid(tmp_path, {f"P/image_{side}/000000_{side}.png": np.zeros((48, 64), np.uint8) for side in ("left", "right")})
    laid(tmp_path, {"run/000000/disp_left.pfm": np.full((48, 64), 4, np.float32)})
    for more, depth in (((), 32 * 0.25 / 4), (("--focal", "10", "--baseline", "2"), 10 * 2 / 4)):
        assert run("depth", tmp_path / "run", "-i", tmp_path / "P", "-o", out, "-q", "--overwrite", *more) == 0
        np.testing.assert_allclose(read_pfm(out / "000000/depth.pfm"), depth, rtol=1e-6)


def test_a_single_map_of_far_things(tmp_path: Path, tool):
    values = np.full((20, 30), 0.5, np.float32)
    values[:, :10], values[0, 0] = 20, np.nan
    laid(tmp_path, {"map.pfm": values, "left.png": np.full((20, 30), 90, np.uint8), "calib.txt": KITTI})
    write_disparity_png(tmp_path / "map.png", values)
    known = ("--calibration", tmp_path / "calib.txt", "--left", tmp_path / "left.png", "--ply")
    for name, *scale in (("map.pfm",), ("map.png", "--scale", "256")):
        made = tmp_path / name[-3:] / "map"
        tool.told(0, "depth", tmp_path / name, *known, *scale, "-o", made.parent)
        depth, codes = read_pfm(made / "depth.pfm"), cv2.imread(str(made / "depth.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_allclose(depth[5, [0, 20]], [710 * 0.54 / 22, 710 * 0.54 / 2.5], rtol=1e-6)
        assert codes[0, 0] == codes[5, 20] == 0
    line = ("depth", tmp_path / "map.pfm", *known[2:], "-o")
    laid(tmp_path, {"empty.pfm": values * np.nan})
    tool.told(0, "depth", tmp_path / "empty.pfm", *known, "-o", tmp_path / "e")
    assert "beyond" not in tool.err(0, *line, tmp_path / "k", *known[:2], "--depth-scale", "256")
    assert run(*line, tmp_path / "h", "--focal", "50", "--baseline", "0.1") == 0
    cloud = vertices(tmp_path / "h/map/points.ply")["xyz"]
    ends = (cloud[:, :2] / cloud[:, 2:] * 50).max(axis=0)  # the principal point is the center of the image
    np.testing.assert_allclose(ends, (14.5, 9.5), rtol=1e-5)


def test_a_run_that_has_moved_and_a_scene_whose_map_is_gone(matched, tmp_path: Path, tool):
    (scenes, run_folder), copy, made = matched, tmp_path / "moved", tmp_path / "run"
    shutil.copytree(run_folder / SCENE, copy / SCENE, ignore=shutil.ignore_patterns("record.json"))
    tool.told(3, "depth", copy, "-o", tmp_path / "a", "-q")
    tool.told(3, "depth", copy, "-o", tmp_path / "p", "-q", "--ply", "--focal", "50", "--baseline", "0.1")
    assert run("depth", copy, "-o", tmp_path / "b", "-i", scenes, "--ply", "-q") == 0
    for nothing in (tmp_path / "absent", scenes):
        assert run("depth", nothing, "-o", tmp_path / "c") == 2
    shutil.copytree(run_folder, made)
    first, second = sorted(folder.parent.name for folder in made.glob("*/disp_left.pfm"))
    (made / first / "disp_left.pfm").unlink()
    tool.told(3, "depth", made, "-o", tmp_path / "d", "-q")
    assert [path.parent.name for path in (tmp_path / "d").glob("*/depth.pfm")] == [second]
    assert run("depth", made, "-o", tmp_path / "e", "-q", "--scenes", second) == 0
    (made / second / "disp_left.pfm").unlink()
    tool.told(2, "depth", made, "-o", tmp_path / "f", "-q")


def test_kitti_by_camera(tmp_path: Path):
    file = tmp_path / "calib.txt"
    file.write_text(KITTI)
    grey, color = read_geometry(file, Reading(cameras=(0, 1))), read_geometry(file)
    assert (grey.fb, grey.offset) == (pytest.approx(371), 0)
    assert (color.fb, color.offset, color.left.cx) == (pytest.approx(383.4), 2, 610)
    refused(InputError, read_geometry, file, Reading(cameras=(3, 2)))
    half = color.for_size(500, 100)  # KITTI's projections say no size: taken as they are
    write_geometry(tmp_path / "own.txt", half, 63)
    again, words = read_geometry(tmp_path / "own.txt"), (tmp_path / "own.txt").read_text().split()
    assert words[2] == f"{half.left.cx:g};" and words[11] == f"{half.left.cx + 2:g};"  # of cam0 and cam1
    assert (again.fb, again.offset, again.size, half.size) == (pytest.approx(half.fb), 2, (500, 100), (500, 100))
    scaled = again.for_size(250, 50)  # corners of pixels stay
    assert (scaled.left.fx, scaled.left.cx, scaled.left.cy, scaled.offset) == (355, 304.75, 85.75, 1)
    # A point's depth stays when its image is halved.
    np.testing.assert_allclose(scaled.depth(np.float32([[4.0]])), again.depth(np.float32([[8.0]])))
    refused(InputError, again.for_size, 250, 100)


def test_maps_of_other_programs(matched: tuple[Path, Path], tmp_path: Path, tool):
    """A rig of 400 px x 0.1 m sees 20 px at 2 m; -1 marks what has no value."""
    disparity = np.full((60, 100), 20, np.float32)
    disparity[:, ::2] += np.float32(0.5)
    disparity[:, :20] = -1
    codes = np.rint(np.maximum(disparity, 0) * 64).astype(np.uint16)
    laid(tmp_path, {"float.pfm": disparity, "codes.png": codes, "raft.npy": -disparity,
                    "sgbm.npy": np.rint(disparity * 16).astype(np.int16)})  # fmt: skip
    by_hand = ("--focal", "400", "--baseline", "0.1", "-o", tmp_path / "out", "--overwrite")
    for name, options, says in (
        ("float.pfm", (), "20 % of the pixels are -1: taken as no value"),
        ("float.pfm", ("--invalid", "-1"), ""),
        ("sgbm.npy", (), "int16 disparities are divided by 16, as OpenCV's"),
        ("sgbm.npy", ("--scale", "16"), ""),
        ("codes.png", ("--scale", "64"), ""),
    ):
        said = tool.err(0, "depth", tmp_path / name, *by_hand, *options)
        found = read_pfm(tmp_path / "out" / Path(name).stem / "depth.pfm")
        assert np.isfinite(found).mean() == 0.8 and found[0, 51] == pytest.approx(2)
        assert (says in said) if says else ("warning" not in said)
    for name in ("codes.png", "raft.npy"):
        tool.told(3, "depth", tmp_path / name, *by_hand, "-q")
    tool.told(2, "depth", matched[1], "--scale", "16", "-o", tmp_path / "none", "-q")


def test_a_map_of_a_run_alone_keeps_its_status_and_bound(tmp_path: Path):
    folder, status = tmp_path / "run" / "a", np.zeros((6, 8), np.uint8)
    status[2:4] = Status.OCCLUDED | Status.FILLED
    plane = np.ones((6, 8), np.float32)
    laid(folder, {"disp_left.pfm": 20 * plane, "bound.pfm": plane / 2, "status.png": status})
    line = ("depth", folder / "disp_left.pfm", "--focal", 400, "--baseline", 0.1, "--mask", "measured", "-q", "-o")
    assert run(*line, tmp_path / "foreign") == 0  # without a record the files beside may be of another map
    assert np.isfinite(read_pfm(tmp_path / "foreign/disp_left/depth.pfm")).all()
    (folder / "record.json").write_text("{}")
    assert run(*line, tmp_path / "own") == 0
    np.testing.assert_array_equal(np.isfinite(read_pfm(tmp_path / "own/disp_left/depth.pfm")), status == 0)
    assert (tmp_path / "own/disp_left/bound.pfm").is_file()

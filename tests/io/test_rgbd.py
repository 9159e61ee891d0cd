"""Frames of color and depth, and with infrared, in every layout; raw Kinect codes become registered depth."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import depthcli
from depthcli.core.cameras.camera import Camera
from depthcli.core.cameras.rig import Rig
from depthcli.core.cameras.triangulation import depth_of_disparity, disparity_of_depth
from depthcli.core.errors import InputError
from depthcli.evaluation.protocols import Settings
from depthcli.evaluation.protocols.depth import DepthProtocol
from depthcli.evaluation.protocols.eth3d import Eth3dProtocol
from depthcli.io.formats.depth import write_depth_png
from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.images import read_grey, write_png
from depthcli.io.rgbd_frames import (
    KinectCalibration,
    frame_size,
    load_infrared_frame,
    load_sparse_frame,
    read_kinect_calibration,
    read_kinect_raw,
)
from depthcli.io.scenes import RgbdScene, RgbIrScene, SequenceScene, sequences
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.frames import FRAMES
from depthcli.io.scenes.pairs import PAIRS
from depthcli.problems.inputs import load_config
from depthcli.problems.kinect import RefineKinect
from depthcli.problems.transparent import Transparent
from tests.boards import opencv
from tests.command_line import run
from tests.contracts.layouts import check_layout
from tests.golden import refused, warned
from tests.scenes import DATA, load, needs_data, true

COLOR = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)
DEPTH = np.full((6, 8), 2000, np.uint16)
DEPTH[0] = 0


def find(folder: Path) -> list[RgbdScene]:
    scenes = discover_scenes(folder, FRAMES)
    assert all(isinstance(scene, RgbdScene) for scene in scenes)
    return scenes  # type: ignore[return-value]


def write(folder: Path, color: np.ndarray = COLOR, depth: np.ndarray = DEPTH, end: str = "", **meta: object) -> Path:
    write_png(folder / f"color{end}.png", color)
    write_png(folder / f"depth{end}.png", depth)
    if meta:
        (folder / "meta.json").write_text(json.dumps(meta))
    return folder


def test_our_layout(tmp_path: Path):
    write(tmp_path / "a", depth_scale=2000, intrinsics={"fx": 500, "fy": 510, "cx": 4, "cy": 3}, fb=40)
    write_png(tmp_path / "a" / "depth_true.png", DEPTH * np.uint16(2))
    write_png(tmp_path / "a" / "mask_gap.png", DEPTH == 0)
    (scene,) = find(tmp_path)
    assert (scene.name, scene.layout, scene.protocol, scene.has_truth) == ("a", "rgbd", "depth", True)
    frame, truth = load(scene), true(scene)
    assert np.isnan(frame.depth[0]).all()
    assert (frame.depth[1:] == 1).all()
    assert (frame.fb, frame.intrinsics.fy if frame.intrinsics else None) == (40, 510)
    assert (truth.depth[1:] == 2).all()
    np.testing.assert_array_equal(truth.masks["gap"], DEPTH == 0)
    np.testing.assert_array_equal(load(replace(scene, depth_scale=1000)).depth[1:], 2)


def test_frames_in_folders_of_color_and_depth(tmp_path: Path):
    for number in (7, 8):
        write_png(tmp_path / "a/rgb" / f"frame_{number}.png", np.zeros((4, 4, 3), np.uint8))
        write_png(tmp_path / "b/rgb" / f"rgb_cup{number}.png", np.zeros((4, 4, 3), np.uint8))
    for name in ("a/depth/frame_7", "a/mask_transparent/frame_7", "b/depth/depth_cup7", "b/depth/depth_cup8"):
        write_png(tmp_path / f"{name}.png", np.ones((4, 4), np.uint16))
    first, second = discover_scenes(tmp_path / "a", FRAMES)
    assert (first.name, first.layout, first.sequence, first.number) == ("frame_7", "rgb-depth", "a", 7)
    assert list(first.masks) == ["transparent"] and not first.problem and second.problem
    assert [(s.name, s.depth.name, s.sequence) for s in discover_scenes(tmp_path / "b", FRAMES)] == [
        ("cup7", "depth_cup7.png", ""), ("cup8", "depth_cup8.png", ""),
    ]  # fmt: skip
    (tmp_path / "a/rgb.txt").touch()
    refused(InputError, discover_scenes, tmp_path / "a", FRAMES)


@pytest.mark.parametrize(
    ("meta", "texts"),
    [
        ({"depth_scale": 2000, "fb": 6}, []),
        ({"depth_scale": 2000, "fb": 60000}, ["meta.json: fb 60000 makes the median disparity 6e+04 px"]),
        ({"depth_scale": 5e5}, ["depth.png: the median depth is 0.004 m at 500000 codes per meter"]),
    ],
)
def test_implausible_inputs_are_warned_of(tmp_path: Path, meta: dict[str, float], texts: list[str]):
    write_png(write(tmp_path / "a", **meta) / "depth_true.png", DEPTH)
    (scene,) = find(tmp_path)
    for read, end in ((load, "depth.png"), (true, "depth_true.png")):
        _, lines = warned(read, scene)
        assert len(lines) == len(texts)
        for line, text in zip(lines, texts, strict=True):
            assert text.replace("depth.png", end) in line


@pytest.mark.parametrize("key", ["intrinsics", "depth_intrinsics"])
@pytest.mark.parametrize(("center", "is_said"), [((29.5, 19.5), False), ((60, 40), True), ((14.5, 9.5), True)])
def test_intrinsics_of_another_size_are_warned_of(tmp_path: Path, key: str, center: tuple[float, float], is_said: bool):
    """Of meta.json and of options, of color and of depth, with a color image and without; from Python, too."""
    own = {"fx": 60.0, "fy": 60.0, "cx": 29.5, "cy": 19.5}
    cameras = {"intrinsics": own, key: own | {"cx": center[0], "cy": center[1]}}
    color, depth = np.full((40, 60, 3), 90, np.uint8), np.full((40, 60), 1000, np.uint16)
    write(tmp_path / "in/a", color, depth, **cameras)

    def said(*words: str | Path) -> bool:
        assert run("refine-kinect", "nearest", *words, "-o", tmp_path / "out", "--overwrite", "-q") == 0
        (row,) = json.loads((tmp_path / "out/report.json").read_text())["scenes"]
        return any(f"{key}: the principal point" in line for line in row["warnings"] or [])

    assert said("-i", tmp_path / "in") is is_said
    camera = f"60,60,{center[0]},{center[1]}"
    option = ["--intrinsics", camera] if key == "intrinsics" else ["--depth-intrinsics", camera]
    option += [] if key == "intrinsics" else ["--intrinsics", "60,60,29.5,19.5"]
    (tmp_path / "in/a/meta.json").unlink()
    assert said("-i", tmp_path / "in", *option) is is_said
    if key == "intrinsics":
        assert said("--depth", tmp_path / "in/a/depth.png", *option) is is_said
    fields = {name: tuple(value.values()) for name, value in cameras.items()}
    result = depthcli.refine_depth(color, depth, preset="nearest", **fields)
    assert is_said is any(f"{key}: the principal point" in line for line in result.warnings)
    _, lines = warned(result.to_points, intrinsics=(60, 60, *center))
    assert is_said is bool(lines)


def test_meters_and_a_missing_fb(tmp_path: Path):
    write_png(tmp_path / "color.png", COLOR[..., 0])
    write_pfm(tmp_path / "depth.pfm", np.where(DEPTH > 0, np.float32(1.5), np.float32(np.nan)))
    (scene,) = find(tmp_path)
    frame = load(scene)
    assert (frame.depth[1:] == 1.5).all()
    assert frame.color.shape == (6, 8, 3)
    assert frame.fb == pytest.approx(43.5)


@pytest.mark.parametrize("split", [False, True])
def test_sequences_are_frames_by_number(tmp_path: Path, split: bool):
    for number in (0, 1, 3):
        where = ("color/", "depth/") if split else ("color_", "depth_")
        if number != 1:
            write_png(tmp_path / "s" / f"{where[0]}{number:05d}.png", COLOR)
        write_png(tmp_path / "s" / f"{where[1]}{number:05d}.png", DEPTH)
    scenes = find(tmp_path)
    assert [(i.name, i.sequence, i.number, bool(i.problem)) for i in scenes] == [
        ("s/00000", "s", 0, False), ("s/00001", "s", 1, True), ("s/00003", "s", 3, False),
    ]  # fmt: skip
    refused(InputError, load, scenes[1])
    assert load(scenes[2]).shape == (6, 8)


def test_tum_pairs_by_time(tmp_path: Path):
    for name in ("rgb/1.png", "rgb/2.png"):
        write_png(tmp_path / "t" / name, COLOR)
    write_png(tmp_path / "t" / "depth/a.png", DEPTH)
    (tmp_path / "t" / "rgb.txt").write_text("# color\n1.000 rgb/1.png\n1.040 rgb/2.png\n")
    (tmp_path / "t" / "depth.txt").write_text("1.019 depth/a.png\n")
    near, far = find(tmp_path)
    assert load(near).depth[1, 0] == pytest.approx(0.4)  # 5000 codes a meter
    assert "0.021 s off" in refused(InputError, load, far)
    for line in ("2.0 rgb/2.png 2.001 depth/a.png\n", "2.001 depth/a.png 2.0 rgb/2.png\n"):
        (tmp_path / "t" / "associations.txt").write_text(line)
        assert [(i.name, i.problem) for i in find(tmp_path)] == [("t/2.000000", "")]
    (tmp_path / "t" / "associations.txt").write_text("2.0 rgb/2.png nonsense\n")
    (broken,) = discover_scenes(tmp_path, FRAMES)
    assert "associations.txt:1: expected time file time file" in broken.problem


def poses_of(folder: Path) -> list:
    return [None if scene.pose is None else np.array(scene.pose).reshape(4, 4) for scene in find(folder)]


def test_names_of_other_layouts_spoil_none(tmp_path: Path):
    for second in (3, 4):  # one fraction of a second, which is no number of a frame
        write_png(tmp_path / "tum" / "rgb" / f"{second}.25.png", COLOR)
        write_png(tmp_path / "tum" / "depth" / f"{second}.24.png", DEPTH)
        for folder in ("image", "depth"):
            write_png(tmp_path / "other" / folder / f"{second}.png", DEPTH)
    for folder, name in (("rgb", "25"), ("depth", "24")):
        lines = [f"{second}.{name} {folder}/{second}.{name}.png" for second in (3, 4)]
        (tmp_path / "tum" / f"{folder}.txt").write_text("\n".join(lines))
    assert [scene.depth.name for scene in find(tmp_path / "tum")] == ["3.24.png", "4.24.png"]
    assert {scene.depth_scale for scene in find(tmp_path / "tum")} == {5000}
    (tmp_path / "tum" / "meta.json").write_text('{"depth_scale": 1000}')
    assert {scene.depth_scale for scene in find(tmp_path / "tum")} == {1000}
    refused(InputError, find, tmp_path / "other")  # as SUN RGB-D, but for intrinsics.txt


@pytest.mark.parametrize("color", ["color", "rgb"])
def test_names_that_are_times_are_in_the_order_of_time(tmp_path: Path, color: str):
    times = ["1305031101.900000", "1305031102.100000", "1305031103.100000"]
    for time in times:
        write_png(tmp_path / "s" / color / f"{time}.png", COLOR)
        write_png(tmp_path / "s" / "depth" / f"{time}.png", DEPTH)
    (sequence,) = sequences(find(tmp_path))
    assert isinstance(sequence, SequenceScene)
    assert [frame.name for frame in sequence.frames] == [f"s/{time}" for time in times]


def test_tum_frames_have_the_pose_of_their_time(tmp_path: Path):
    place = tmp_path / "t"
    for k in range(4):
        write_png(place / f"rgb/{k}.png", COLOR)
        write_png(place / f"depth/{k}.png", DEPTH)
    pairs = (f"{time} rgb/{k}.png {time} depth/{k}.png\n" for k, time in enumerate((1.0, 1.015, 1.09, 2.0)))
    (place / "associations.txt").write_text("".join(pairs))
    assert poses_of(tmp_path) == [None] * 4
    quarter = "0 0 .7071068 .7071068"
    (place / "groundtruth.txt").write_text(
        f"# timestamp tx ty tz qx qy qz qw\n1.0 1 2 3 0 0 0 1\n1.02 2 2 3 {quarter}\n1.08 4 0 0 0 0 0 1\n"
    )
    exact, between, nearest, none = poses_of(tmp_path)
    np.testing.assert_array_equal(exact[:3], np.c_[np.eye(3), (1, 2, 3)])
    np.testing.assert_allclose(between[:3, 3], (1.75, 2, 3))
    turn = Rotation.from_euler("z", 67.5, degrees=True)
    np.testing.assert_allclose(between[:3, :3], turn.as_matrix(), atol=1e-6)
    assert nearest[0, 3] == 4 and none is None
    np.testing.assert_array_equal(load(find(tmp_path)[0]).pose, exact)


@pytest.mark.parametrize("lines", [1, 4])
def test_numbered_frames_have_poses_by_order_or_by_number(tmp_path: Path, lines: int):
    place = tmp_path / "s"
    for k in (3, 4, 7):
        write(place, end=f"_{k:05}")
    rows = ["1 0 0 5", "0 1 0 6", "0 0 1 7", "0 0 0 1"]
    matrix = (" " if lines == 1 else "\n").join(rows) + "\n"
    (place / "poses.txt").write_text(matrix + "\n" + matrix.replace("5", "8"))  # fewer than frames
    first, second, third = poses_of(tmp_path)
    assert first[:3, 3].tolist() == [5, 6, 7] and second[0, 3] == 8 and third is None
    (place / "poses.txt").write_text("3 1 2 3 0 0 0 1\n7 4 2 3 .1 .3 .5 .8\n")
    first, second, third = poses_of(tmp_path)
    np.testing.assert_allclose(third[:3, :3], Rotation.from_quat((0.1, 0.3, 0.5, 0.8)).as_matrix())
    assert first[0, 3] == 1 and second is None and third[0, 3] == 4


@pytest.mark.parametrize(("text", "said"), [
    ("", "poses.txt: holds no pose"),
    ("0 1 2 3 0 0 0 1\n1 x 2 3 0 0 0 1\n", "line 2: expected"),
    ("0 1 2 3 0 0 0 2\n", "quaternion"),
    ("1 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n", "two poses of one time"),
    ("1 0 0 0\n0 1 0 0\n0 0 1 0\n", "not 4 rows"),
    ("2 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n", "not the matrix of a pose"),
])  # fmt: skip
def test_wrong_poses_are_one_line(tmp_path: Path, text: str, said: str):
    (write(tmp_path / "s", end="_0") / "poses.txt").write_text(text)
    (broken,) = discover_scenes(tmp_path, FRAMES)
    assert said in broken.problem and "\n" not in broken.problem


def test_sun_rotates_its_bits(tmp_path: Path):
    write_png(tmp_path / "s" / "image" / "x.png", COLOR)
    codes = (DEPTH << np.uint16(3)) | (DEPTH >> np.uint16(13))
    write_png(tmp_path / "s" / "depth" / "y.png", codes)
    (tmp_path / "s" / "intrinsics.txt").write_text("500 0 4\n0 510 3\n0 0 1\n")
    (scene,) = find(tmp_path)
    assert scene.layout == "sun-rgbd"
    assert (load(scene).depth[1:] == 2).all()
    assert run("refine-kinect", "nearest", "-i", tmp_path / "s", "-o", tmp_path / "r", "-q") == 0
    assert (read_grey(tmp_path / "r" / "s" / "depth.png") == codes)[1:].all()  # rotated again


def test_depth_alone_is_a_frame_without_color(tmp_path: Path):
    write_png(tmp_path / "a" / "depth.png", DEPTH)
    (scene,) = find(tmp_path)
    frame = load(scene)
    assert not frame.has_color and (frame.color == 128).all() and frame.shape == DEPTH.shape
    assert frame_size(scene) == DEPTH.shape and set(scene.input_files) == {"depth"}
    refused(InputError, load_sparse_frame, scene)


WIDE, SMALLER = np.zeros((90, 120, 3), np.uint8), np.full((20, 30), 2000, np.uint16)
DEPTH_CAMERA = {"fx": 20, "fy": 20, "cx": 15, "cy": 10}


@pytest.mark.parametrize(
    "meta",
    [
        {"depth_intrinsics": DEPTH_CAMERA},
        {"depth_intrinsics": {**DEPTH_CAMERA, "fx": 0}},
        {"depth_intrinsics": {"fx": 3}},
        {"depth_to_color": 3},
        {"depth_to_color": {"rotation": np.eye(3).tolist()}},
    ],
)
def test_cameras_of_meta_json_that_cannot_be(tmp_path: Path, meta: dict[str, object]):
    write(tmp_path, WIDE, SMALLER, **meta)
    refused(InputError, lambda: load(find(tmp_path)[0]))


def test_triangulation_is_its_own_inverse():
    depth = np.array([[0.5, 2.0, np.nan, -1.0, 0.0]], np.float32)
    disparity = disparity_of_depth(depth, 43.5, 2.0)
    np.testing.assert_allclose(disparity, [[85.0, 19.75, np.nan, np.nan, np.nan]])
    np.testing.assert_allclose(depth_of_disparity(disparity, 43.5, 2.0), [[0.5, 2, np.nan, np.nan, np.nan]])


def test_raw_codes_follow_the_thesis_s_formula():
    """Eq. 1.1, Z = Zr / (1 + Zr / (f b) d): d counts from the code of the reference plane."""
    camera = Camera(np.eye(3))
    model = KinectCalibration(camera, camera, np.eye(3), np.zeros(3), offset=1090.0, factor=350.0)
    raw = np.array([[390, 740, 1089, 1090, 2047]], np.uint16)
    reference = 350.0 / (1090 - 740)
    shift = (740 - raw[0, :3].astype(float)) / 350.0
    np.testing.assert_allclose(model.depth_of_raw(raw)[0, :3], reference / (1 + reference * shift), rtol=1e-6)
    assert np.isnan(model.depth_of_raw(raw)[0, 3:]).all()
    # Herrera et al.: raw + beta(x, y) exp(alpha_0 - alpha_1 raw).
    codes = raw[0, :3] + 2 * np.exp(0.3 - 0.002 * raw[0, :3])
    distorted = replace(model, beta=np.full(raw.shape, 2.0), alpha=(0.3, 0.002))
    np.testing.assert_allclose(distorted.depth_of_raw(raw)[0, :3], 350 / (1090 - codes), rtol=1e-6)


_MATRIX = "{0} 0 {1} 0\n0 {0} {2} 0\n0 0 1 0\n0 0 0 1\n"


def scannet(folder: Path, names: str) -> Path:
    color = np.dstack([np.full((24, 32), 100, np.uint8)] * 3)
    for number in (0, 10):
        write_png(folder / "color" / f"{number}.jpg", color)
        write_png(folder / "depth" / f"{number}.png", np.full((12, 16), 1500, np.uint16))
    for kind, values in (("color", (40, 15.5, 11.5)), ("depth", (20, 7.5, 5.5))):
        path = folder / names.format(kind)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_MATRIX.format(*values))
    return folder


@pytest.mark.parametrize("names", ["intrinsic/intrinsic_{}.txt", "intrinsics_{}.txt"])
def test_scannet(tmp_path: Path, names: str):
    folder = scannet(tmp_path / "scene0000_00", names)
    first, second = find(tmp_path)
    assert [scene.name for scene in (first, second)] == ["scene0000_00/0", "scene0000_00/10"]
    assert (first.layout, second.number, second.sequence) == ("scannet", 10, "scene0000_00")
    assert first.intrinsics == (40, 40, 15.5, 11.5)
    assert first.depth_intrinsics == (20, 20, 7.5, 5.5)
    frame = load(first)
    assert frame.depth.shape == (24, 32)
    np.testing.assert_allclose(frame.depth[8:16, 8:24], 1.5)
    check_layout("scannet", tmp_path)
    (folder / "depth" / "10.png").unlink()
    refused(InputError, load, find(tmp_path)[1])


@pytest.mark.parametrize("text", ["1 2 3", "a", _MATRIX.format(-1, 2, 3)])
def test_broken_cameras_of_scannet(tmp_path: Path, text: str):
    folder = scannet(tmp_path / "a", "intrinsic/intrinsic_{}.txt")
    (folder / "intrinsic" / "intrinsic_color.txt").write_text(text)
    refused(InputError, find, folder)
    (folder / "intrinsic" / "intrinsic_color.txt").unlink()
    refused(InputError, find, folder)


FLAT = np.full((4, 6), 0.75, np.float32)


def test_sparse_depth_has_the_codes_of_the_depth(tmp_path: Path):
    sparse = np.where(np.eye(4, 6, dtype=bool), np.float32(0.5), np.float32(np.nan))
    write_png(tmp_path / "color.png", np.zeros((4, 6, 3), np.uint8))
    write_depth_png(tmp_path / "depth.png", FLAT)
    write_depth_png(tmp_path / "sparse.png", sparse)
    frame = load_sparse_frame(find(tmp_path)[0])
    np.testing.assert_allclose(frame.depth, FLAT)
    np.testing.assert_allclose(frame.sparse, sparse)
    assert frame.sparse_confidence is None
    write_png(tmp_path / "sparse_confidence.png", np.full((4, 6), 51, np.uint8))
    np.testing.assert_allclose(load_sparse_frame(find(tmp_path)[0]).sparse_confidence, 0.2)


def test_sparse_depth_that_cannot_be_used(tmp_path: Path):
    write_png(tmp_path / "color.png", np.zeros((4, 6, 3), np.uint8))
    write_pfm(tmp_path / "depth.pfm", FLAT)
    for sparse in (None, np.full((4, 6), np.nan, np.float32), np.ones((4, 5), np.float32)):
        if sparse is not None:
            write_pfm(tmp_path / "sparse.pfm", sparse)
        refused(InputError, load_sparse_frame, find(tmp_path)[0])


@pytest.mark.parametrize("real", [True, False])
def test_cleargrasp(tmp_path: Path, real: bool):
    mask = np.zeros((4, 6), bool)
    mask[1:3, 2:4] = True
    write_png(tmp_path / "mask_transparent.png", mask)
    write_png(tmp_path / ("rgb_transparent.png" if real else "rgb.png"), np.zeros((4, 6, 3), np.uint8))
    write_depth_png(tmp_path / ("depth_opaque_gt_mm.png" if real else "depth_gt_mm.png"), FLAT)
    if real:
        write_depth_png(tmp_path / "depth_sensor_mm.png", 2 * FLAT)
    scene = find(tmp_path)[0]
    assert (scene.layout, scene.protocol, scene.has_truth) == ("cleargrasp", "depth", True)
    np.testing.assert_allclose(load(scene).depth, 2 * FLAT if real else np.where(mask, np.nan, FLAT))
    np.testing.assert_allclose(true(scene).depth, FLAT)
    np.testing.assert_array_equal(true(scene).masks["transparent"], mask)


@needs_data
def test_the_shared_folders_are_recognized_as_they_lie_there():
    if not (DATA / "transparent").is_dir():
        pytest.skip("transparent is not in ../shared/data")
    scenes = find(DATA / "transparent")
    assert [scene.layout for scene in scenes] == ["cleargrasp"] * 5
    for scene in scenes:
        frame, truth = load(scene), true(scene)
        inside = truth.masks["transparent"]
        assert np.isfinite(frame.depth[~inside]).mean() > 0.5
        assert np.isfinite(frame.depth[inside]).mean() < (0.75 if "real" in scene.name else 1e-9)


@needs_data
class TestRealFrames:
    @pytest.mark.slow
    def test_every_folder_runs_as_it_lies_there(self):
        folders = ("rgbd_nyu", "rgbd_primesense", "rgbd_sun", "rgbd_tum", "kinect_v1_raw")
        for folder in folders:
            for scene in find(DATA / folder):
                frame = load(scene)
                assert 0.5 < np.isfinite(frame.depth).mean() < 0.95, scene.name

    def test_raw_depth_lies_on_the_checkerboards(self):
        """Within 1.2 mm of the residual that the set's own calibration has."""
        folder = DATA / "kinect_v1_raw" / "herrera"
        calibration = read_kinect_calibration(folder / "calib.json")
        plain = replace(calibration, beta=None)
        facts = json.loads((folder / "calib.json").read_text())["frames"]
        for number, frame in facts.items():
            plane = read_grey(folder / f"plane_depth_gt_{number}.png").astype(float)
            raw = read_kinect_raw(folder / f"disparity_{number}.pgm")
            on = plane > 0

            def distance(model: KinectCalibration, raw=raw, plane=plane, on=on) -> float:
                return float(np.nanmedian(np.abs(1000 * model.depth_of_raw(raw)[on] - plane[on])))

            own = abs(frame["kinect_minus_plane_median_mm"]) + 0.6745 * frame["kinect_minus_plane_std_mm"]
            assert distance(calibration) <= own + 1.2
            assert distance(calibration) < distance(plain) < distance(calibration) + 5


K = [[190.0, 0, 20], [0, 190, 15], [0, 0, 1]]
RIG = {
    "color": {"K": K, "distortion": [0.1, 0, 0, 0, 0], "size": [40, 30]},
    "infrared": {"K": K, "size": [36, 28]},
    "R": np.eye(3).tolist(),
    "t": [-0.05, 0, 0],
}


def write_infrared(folder, calibration=RIG, infrared=(28, 36), dtype=np.uint8):
    rng = np.random.default_rng(0)
    write_png(folder / "color.png", rng.integers(0, 256, (30, 40, 3)).astype(np.uint8))
    write_png(folder / "ir.png", rng.integers(0, 200, infrared).astype(dtype))
    write_pfm(folder / "depth.pfm", np.full((30, 40), 0.9, np.float32))
    if calibration is not None:
        (folder / "calib.json").write_text(json.dumps(calibration))


def loaded(folder):
    (scene,) = discover_scenes(folder, FRAMES)
    assert isinstance(scene, RgbIrScene) and scene.layout == "rgb-ir"
    return load_infrared_frame(scene)


def test_a_rig_and_a_rectified_pair(tmp_path):
    write_infrared(tmp_path)
    frame = loaded(tmp_path)
    assert isinstance(frame.rig, Rig) and frame.infrared.shape == (28, 36)
    assert frame.rig.left.distortion[0] == 0.1
    write_infrared(tmp_path, {"rectified": True, "fb": 12.5}, (30, 40))
    frame = loaded(tmp_path)
    assert (frame.rig, frame.fb) == (None, 12.5)


def test_yaml_of_opencv(tmp_path):
    write_infrared(tmp_path, None)
    left, right = (Camera(np.array(K, float), lens) for lens in ((0.1, 0.0, 0.0, 0.0, 0.0), (0.0,) * 5))
    opencv(tmp_path / "calib.yml", Rig(left, right, np.eye(3), np.array([-0.05, 0, 0])), "M1 D1 M2 D2 R T")
    rig = loaded(tmp_path).rig
    assert rig is not None
    np.testing.assert_allclose(rig.translation, [-0.05, 0, 0])
    assert rig.left.distortion == (0.1, 0, 0, 0, 0)


def test_the_image_without_the_projector_is_used(tmp_path):
    write_infrared(tmp_path)
    write_png(tmp_path / "ir_noprojector.png", np.full((28, 36), 77, np.uint8))
    assert (loaded(tmp_path).infrared == 77).all()


def test_sixteen_bits_use_their_own_range(tmp_path):
    write_infrared(tmp_path, dtype=np.uint16)
    infrared = loaded(tmp_path).infrared
    assert infrared.dtype == np.uint8
    assert infrared.max() == 255
    assert 100 < infrared.mean() < 150


@pytest.mark.parametrize(
    "change",
    [
        None,
        {"color": None},
        {"t": [80, 0, 0]},
        {"infrared": {"K": K, "size": [640, 480]}},
        {"infrared": {"K": K, "distortion": [1, 2, 3]}},
        {"rectified": True, "fb": 10.0},
    ],
)
def test_what_cannot_be_used_says_why_in_a_line(tmp_path, change):
    write_infrared(tmp_path, None if change is None else {**RIG, **change})
    refused(InputError, loaded, tmp_path)


@pytest.mark.parametrize("scale", [1000.0, 4000.0])
@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.float32])
def test_a_scale_that_is_given_holds_for_every_kind_of_file(tmp_path: Path, scale: float, dtype):
    codes = (DEPTH / 2000.0 * scale).astype(dtype)
    write(tmp_path / "a")
    (tmp_path / "a" / "depth.png").unlink()
    np.save(tmp_path / "a" / "depth.npy", codes)
    np.save(tmp_path / "a" / "depth_true.npy", codes)
    np.save(tmp_path / "a" / "sparse.npy", codes)
    (scene,) = find(tmp_path)
    given = scene.with_scale(scale)
    (tmp_path / "a" / "meta.json").write_text(json.dumps({"depth_scale": scale}))
    for one in (given, *find(tmp_path)):
        np.testing.assert_array_equal(load(one).depth[1:], 1)
        np.testing.assert_array_equal(true(one).depth[1:], 1)
        np.testing.assert_array_equal(load_sparse_frame(one).sparse[1:], 1)


def test_beside_codes_floats_are_meters(tmp_path: Path):
    write(tmp_path / "a", depth_scale=4000)
    np.save(tmp_path / "a" / "depth_true.npy", np.full(DEPTH.shape, 0.5, np.float32))
    (scene,) = find(tmp_path)
    np.testing.assert_array_equal(load(scene).depth[1:], 0.5)
    np.testing.assert_array_equal(true(scene).depth, 0.5)


def test_truth_is_read_by_the_scale_of_the_run(tmp_path: Path):
    write(tmp_path / "a")
    (scene,) = find(tmp_path)
    for problem in (RefineKinect, Transparent):
        config = load_config(
            problem.model, {"refine-kinect": "nearest"}.get(problem.command, "sensor"), depth_scale=4000
        )
        (one,) = problem.ready(config).truth_scenes([scene])
        assert (one.depth_scale, one.scale_floats) == (4000, True)


def test_a_mark_that_is_given_holds_for_true_depth_and_disparity(tmp_path: Path):
    write(tmp_path / "a", depth_scale=2000)
    write_png(tmp_path / "a" / "depth_true.png", np.where(DEPTH == 0, 7000, DEPTH).astype(np.uint16))
    (scene,) = find(tmp_path)
    assert np.isnan(DepthProtocol(Settings(invalid=7000.0)).truth(scene).depth[0]).all()
    assert (DepthProtocol().truth(scene).depth[0] == 3.5).all()
    for name in ("left", "right"):
        write_png(tmp_path / "s" / f"{name}.png", COLOR)
    write_pfm(tmp_path / "s" / "disp_left.pfm", np.where(DEPTH == 0, 7, 3).astype(np.float32))
    (pair,) = discover_scenes(tmp_path / "s", PAIRS)
    assert np.isnan(Eth3dProtocol(Settings(invalid=7.0)).truth(pair).values[0]).all()
    assert (Eth3dProtocol().truth(pair).values[0] == 7).all()

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
from depthcli.io import rgbd_frames
from depthcli.io.formats.images import read_grey, write_png
from depthcli.io.scenes import RgbIrScene, SequenceScene, StereoScene, VolumePairScene, sequences
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.frames import FRAMES
from depthcli.io.scenes.pairs import PAIRS
from depthcli.problems.inputs import load_config
from depthcli.problems.kinect import RefineKinect
from depthcli.problems.transparent import Transparent
from tests.boards import opencv
from tests.command_line import run
from tests.contracts.layouts import check_layout
from tests.files import laid
from tests.golden import refused, warned
from tests.scenes import DATA, load, needs_data, true

COLOR = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)
DEPTH = np.full((6, 8), 2000, np.uint16)
DEPTH[0] = 0
FRAME = {"color.png": COLOR, "depth.png": DEPTH}


def find(folder: Path) -> list:
    return discover_scenes(folder, FRAMES)


def test_our_layout(tmp_path: Path):
    pose = [[0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]]
    meta = {"depth_scale": 2000, "intrinsics": {"fx": 500, "fy": 510, "cx": 4, "cy": 3}, "fb": 40, "pose": pose}
    truth_files = {"depth_true.png": DEPTH * np.uint16(2), "mask_gap.png": DEPTH == 0}
    laid(tmp_path / "in/a", FRAME | truth_files | {"meta.json": meta})
    (scene,) = find(tmp_path / "in")
    assert (scene.name, scene.layout, scene.protocol, scene.has_truth) == ("a", "rgbd", "depth", True)
    frame, truth = load(scene), true(scene)
    assert np.isnan(frame.depth[0]).all() and (frame.depth[1:] == 1).all() and (truth.depth[1:] == 2).all()
    assert (frame.fb, frame.intrinsics.fy, frame.pose.tolist()) == (40, 510, pose)
    np.testing.assert_array_equal(truth.masks["gap"], DEPTH == 0)
    np.testing.assert_array_equal(load(replace(scene, depth_scale=1000)).depth[1:], 2)
    meters = np.where(DEPTH > 0, np.float32(1.5), np.float32(np.nan))
    frame = load(*find(laid(tmp_path / "b", {"color.png": COLOR[..., 0], "depth.pfm": meters})))
    assert (frame.depth[1:] == 1.5).all() and frame.color.shape == (6, 8, 3) and frame.fb == pytest.approx(43.5)
    (scene,) = find(laid(tmp_path / "c", {"depth.png": DEPTH}))
    frame = load(scene)
    assert not frame.has_color and (frame.color == 128).all() and frame.shape == DEPTH.shape
    assert rgbd_frames.frame_size(scene) == DEPTH.shape and set(scene.input_files) == {"depth"}
    refused(InputError, rgbd_frames.load_sparse_frame, scene)


def test_frames_in_folders_of_color_and_depth(tmp_path: Path):
    color, depth = np.zeros((4, 4, 3), np.uint8), np.ones((4, 4), np.uint16)
    laid(tmp_path / "a/rgb", {"frame_7.png": color, "frame_8.png": color})
    laid(tmp_path / "b/rgb", {"rgb_cup7.png": color, "rgb_cup8.png": color})
    for name in ("a/depth/frame_7", "a/mask_transparent/frame_7", "b/depth/depth_cup7", "b/depth/depth_cup8"):
        write_png(tmp_path / f"{name}.png", depth)
    first, second = find(tmp_path / "a")
    assert (first.name, first.layout, first.sequence, first.number) == ("frame_7", "rgb-depth", "a", 7)
    assert list(first.masks) == ["transparent"] and not first.problem and second.problem
    found = [(scene.name, scene.depth.name, scene.sequence) for scene in find(tmp_path / "b")]
    assert found == [("cup7", "depth_cup7.png", ""), ("cup8", "depth_cup8.png", "")]
    (tmp_path / "a/rgb.txt").touch()
    refused(InputError, find, tmp_path / "a")


def test_a_mask_of_hidden_pixels_is_of_the_depth_s_size(tmp_path: Path):
    (scene,) = find(laid(tmp_path / "a", FRAME))
    mask = np.eye(6, 8, dtype=np.uint8)
    laid(tmp_path, {"hidden.npy": mask, "row.npy": mask[:1]})
    assert np.isnan(load(replace(scene, hidden=tmp_path / "hidden.npy")).depth[mask > 0]).all()
    refused(InputError, load, replace(scene, hidden=tmp_path / "row.npy"))


@pytest.mark.parametrize(("meta", "texts"), [
    ({"depth_scale": 2000, "fb": 6}, []),
    ({"depth_scale": 2000, "fb": 60000}, ["meta.json: fb 60000 makes the median disparity 6e+04 px"]),
    ({"depth_scale": 5e5}, ["depth.png: the median depth is 0.004 m at 500000 codes per meter"]),
])  # fmt: skip
def test_implausible_inputs_are_warned_of(tmp_path: Path, meta: dict[str, float], texts: list[str]):
    (scene,) = find(laid(tmp_path / "a", FRAME | {"depth_true.png": DEPTH, "meta.json": meta}))
    for read, end in ((load, "depth.png"), (true, "depth_true.png")):
        _, lines = warned(read, scene)
        assert len(lines) == len(texts)
        assert all(text.replace("depth.png", end) in line for line, text in zip(lines, texts, strict=True))


@pytest.mark.parametrize("key", ["intrinsics", "depth_intrinsics"])
@pytest.mark.parametrize(("center", "is_said"), [((29.5, 19.5), False), ((60, 40), True), ((14.5, 9.5), True)])
def test_intrinsics_of_another_size_are_warned_of(tmp_path: Path, key: str, center: tuple[float, float], is_said: bool):
    """Of meta.json and of options, of color and of depth, with a color image and without; from Python, too."""
    own = {"fx": 60.0, "fy": 60.0, "cx": 29.5, "cy": 19.5}
    cameras = {"intrinsics": own, key: own | {"cx": center[0], "cy": center[1]}}
    color, depth = np.full((40, 60, 3), 90, np.uint8), np.full((40, 60), 1000, np.uint16)
    laid(tmp_path / "in/a", {"color.png": color, "depth.png": depth, "meta.json": cameras})

    def said(*words: str | Path) -> bool:
        assert run("refine-kinect", "nearest", *words, "-o", tmp_path / "out", "--overwrite", "-q") == 0
        (row,) = json.loads((tmp_path / "out/report.json").read_text())["scenes"]
        return any(f"{key}: the principal point" in line for line in row["warnings"] or [])

    assert said("-i", tmp_path / "in") is is_said
    fields = {name: tuple(value.values()) for name, value in cameras.items()}
    options = [f"--{name.replace('_', '-')}={','.join(map(str, values))}" for name, values in fields.items()]
    (tmp_path / "in/a/meta.json").unlink()
    assert said("-i", tmp_path / "in", *options) is is_said
    if key == "intrinsics":
        assert said("--depth", tmp_path / "in/a/depth.png", *options) is is_said
    result = depthcli.refine_depth(color, depth, preset="nearest", **fields)
    assert is_said is any(f"{key}: the principal point" in line for line in result.warnings)
    assert is_said is bool(warned(result.to_points, intrinsics=(60, 60, *center))[1])


@pytest.mark.parametrize(("color", "depth", "lost"), [
    ("color/{:05}.png", "depth/{:05}.png", "s/00001"), ("color_{:05}.png", "depth_{}.png", "s/1"),
])  # fmt: skip
def test_sequences_are_frames_by_number(tmp_path: Path, color: str, depth: str, lost: str):
    laid(tmp_path / "s", {color.format(number): COLOR for number in (0, 3, 10)})
    laid(tmp_path / "s", {depth.format(number): DEPTH for number in (0, 1, 3, 10)})
    scenes = {scene.name: scene for scene in find(tmp_path)}
    found = {name: (scene.number, bool(scene.problem)) for name, scene in scenes.items()}
    assert found == {"s/00000": (0, False), lost: (1, True), "s/00003": (3, False), "s/00010": (10, False)}
    assert {scene.sequence for scene in scenes.values()} == {"s"} and load(scenes["s/00003"]).shape == (6, 8)
    refused(InputError, load, scenes[lost])


def test_tum_pairs_by_time(tmp_path: Path):
    laid(tmp_path / "t", {"rgb/1.png": COLOR, "rgb/2.png": COLOR, "depth/a.png": DEPTH,
         "rgb.txt": "# color\n1.000 rgb/1.png\n1.040 rgb/2.png\n", "depth.txt": "1.019 depth/a.png\n"})  # fmt: skip
    near, far = find(tmp_path)
    assert load(near).depth[1, 0] == pytest.approx(0.4)  # 5000 codes a meter
    assert "0.021 s off" in refused(InputError, load, far)
    for line in ("2.0 rgb/2.png 2.001 depth/a.png\n", "2.001 depth/a.png 2.0 rgb/2.png\n"):
        (tmp_path / "t/associations.txt").write_text(line)
        assert [(i.name, i.problem) for i in find(tmp_path)] == [("t/2.000000", "")]
    for line, said in (
        ("# nothing\n", "t: no line pairs a color image"),
        ("2.0 rgb/2.png nonsense\n", "associations.txt:1: expected time file time file"),
    ):
        (tmp_path / "t/associations.txt").write_text(line)
        (broken,) = find(tmp_path)
        assert said in broken.problem


def poses_of(folder: Path) -> list:
    return [None if scene.pose is None else np.array(scene.pose).reshape(4, 4) for scene in find(folder)]


def test_names_of_other_layouts_spoil_none(tmp_path: Path):
    for second in (3, 4):  # one fraction of a second, which is no number of a frame
        laid(tmp_path, {f"tum/rgb/{second}.25.png": COLOR, f"tum/depth/{second}.24.png": DEPTH})
        laid(tmp_path / "other", {f"image/{second}.png": DEPTH, f"depth/{second}.png": DEPTH})
    for folder, name in (("rgb", "25"), ("depth", "24")):
        lines = [f"{second}.{name} {folder}/{second}.{name}.png" for second in (3, 4)]
        (tmp_path / "tum" / f"{folder}.txt").write_text("\n".join(lines))
    found = [(scene.depth.name, scene.depth_scale) for scene in find(tmp_path / "tum")]
    assert found == [("3.24.png", 5000), ("4.24.png", 5000)]
    laid(tmp_path / "tum", {"meta.json": {"depth_scale": 1000}})
    assert {scene.depth_scale for scene in find(tmp_path / "tum")} == {1000}
    refused(InputError, find, tmp_path / "other")  # as SUN RGB-D, but for intrinsics.txt


@pytest.mark.parametrize("color", ["color", "rgb"])
def test_names_that_are_times_are_in_the_order_of_time(tmp_path: Path, color: str):
    times = ["1305031101.900000", "1305031102.100000", "1305031103.100000"]
    for time in times:
        laid(tmp_path / "s", {f"{color}/{time}.png": COLOR, f"depth/{time}.png": DEPTH})
    (sequence,) = sequences(find(tmp_path))
    assert isinstance(sequence, SequenceScene)
    assert [frame.name for frame in sequence.frames] == [f"s/{time}" for time in times]


def test_tum_frames_have_the_pose_of_their_time(tmp_path: Path):
    times = {0: 1.0, 1: 1.015, 2: 1.09, 3: 2.0}
    for k in times:
        laid(tmp_path / "t", {f"rgb/{k}.png": COLOR, f"depth/{k}.png": DEPTH})
    pairs = "".join(f"{time} rgb/{k}.png {time} depth/{k}.png\n" for k, time in times.items())
    laid(tmp_path / "t", {"associations.txt": pairs})
    assert poses_of(tmp_path) == [None] * 4
    lines = "1.0 1 2 3 0 0 0 1", "1.02 2 2 3 0 0 .7071068 .7071068", "1.08 4 0 0 0 0 0 1\n"
    laid(tmp_path / "t", {"groundtruth.txt": "\n".join(["# timestamp tx ty tz qx qy qz qw", *lines])})
    exact, between, nearest, none = poses_of(tmp_path)
    np.testing.assert_array_equal(exact[:3], np.c_[np.eye(3), (1, 2, 3)])
    np.testing.assert_allclose(between[:3, 3], (1.75, 2, 3))
    turn = Rotation.from_euler("z", 67.5, degrees=True)
    np.testing.assert_allclose(between[:3, :3], turn.as_matrix(), atol=1e-6)
    assert nearest[0, 3] == 4 and none is None
    np.testing.assert_array_equal(load(find(tmp_path)[0]).pose, exact)


@pytest.mark.parametrize("lines", [1, 4])
def test_numbered_frames_have_poses_by_order_or_by_number(tmp_path: Path, lines: int):
    for k in (3, 4, 7):
        laid(tmp_path / "s", {f"color_{k:05}.png": COLOR, f"depth_{k:05}.png": DEPTH})
    matrix = (" " if lines == 1 else "\n").join(["1 0 0 5", "0 1 0 6", "0 0 1 7", "0 0 0 1"]) + "\n"
    (tmp_path / "s/poses.txt").write_text(matrix + "\n" + matrix.replace("5", "8"))  # fewer than frames
    first, second, third = poses_of(tmp_path)
    assert first[:3, 3].tolist() == [5, 6, 7] and second[0, 3] == 8 and third is None
    (tmp_path / "s/poses.txt").write_text("3 1 2 3 0 0 0 1\n7 4 2 3 .1 .3 .5 .8\n")
    first, second, third = poses_of(tmp_path)
    np.testing.assert_allclose(third[:3, :3], Rotation.from_quat((0.1, 0.3, 0.5, 0.8)).as_matrix())
    assert first[0, 3] == 1 and second is None and third[0, 3] == 4


def test_wrong_poses_are_one_line(tmp_path: Path):
    for text, said in (
        ("", "poses.txt: holds no pose"), ("0 1 2 3 0 0 0 1\n1 x 2 3 0 0 0 1\n", "line 2: expected"),
        ("0 1 2 3 0 0 0 2\n", "quaternion"), ("1 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n", "two poses of one time"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n", "not 4 rows"),
        ("2 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n", "not the matrix of a pose"),
    ):  # fmt: skip
        (broken,) = find(laid(tmp_path, {"s/color_0.png": COLOR, "s/depth_0.png": DEPTH, "s/poses.txt": text}))
        assert said in broken.problem and "\n" not in broken.problem


def test_scenes_without_ground_truth_are_refused(tmp_path: Path):
    (frame,) = find(laid(tmp_path / "s", FRAME))
    pair = StereoScene(name="p", folder=tmp_path, left=tmp_path / "s/color.png")
    for scene in (frame, pair, VolumePairScene(name="v", folder=tmp_path, fixed=tmp_path / "fixed.mha")):
        refused(InputError, true, scene)


def test_sun_rotates_its_bits(tmp_path: Path):
    codes = (DEPTH << np.uint16(3)) | (DEPTH >> np.uint16(13))
    laid(tmp_path / "s", {"image/x.png": COLOR, "depth/y.png": codes, "intrinsics.txt": "500 0 4\n0 510 3\n0 0 1\n"})
    (scene,) = find(tmp_path)
    assert scene.layout == "sun-rgbd" and (load(scene).depth[1:] == 2).all()
    assert run("refine-kinect", "nearest", "-i", tmp_path / "s", "-o", tmp_path / "r", "-q") == 0
    assert (read_grey(tmp_path / "r/s/depth.png") == codes)[1:].all()  # rotated again


def test_cameras_of_meta_json_that_cannot_be(tmp_path: Path):
    laid(tmp_path, {"color.png": np.zeros((90, 120, 3), np.uint8), "depth.png": np.full((20, 30), 2000, np.uint16)})
    camera = {"fx": 20, "fy": 20, "cx": 15, "cy": 10}
    for meta in (
        {"depth_intrinsics": camera}, {"depth_intrinsics": {**camera, "fx": 0}}, {"depth_intrinsics": {"fx": 3}},
        {"depth_intrinsics": [20, 20, 15, 10]}, {"depth_to_color": 3},
        {"depth_to_color": {"rotation": np.eye(3).tolist()}},
    ):  # fmt: skip
        laid(tmp_path, {"meta.json": meta})
        refused(InputError, lambda: load(find(tmp_path)[0]))


def test_triangulation_is_its_own_inverse():
    depth = np.array([[0.5, 2.0, np.nan, -1.0, 0.0]], np.float32)
    disparity = disparity_of_depth(depth, 43.5, 2.0)
    np.testing.assert_allclose(disparity, [[85.0, 19.75, np.nan, np.nan, np.nan]])
    np.testing.assert_allclose(depth_of_disparity(disparity, 43.5, 2.0), [[0.5, 2, np.nan, np.nan, np.nan]])


def test_raw_codes_follow_the_thesis_s_formula():
    """Eq. 1.1, Z = Zr / (1 + Zr / (f b) d): d counts from the code of the reference plane."""
    camera = Camera(np.eye(3))
    model = rgbd_frames.KinectCalibration(camera, camera, np.eye(3), np.zeros(3), offset=1090.0, factor=350.0)
    raw = np.array([[390, 740, 1089, 1090, 2047]], np.uint16)
    reference = 350.0 / (1090 - 740)
    shift = (740 - raw[0, :3].astype(float)) / 350.0
    np.testing.assert_allclose(model.depth_of_raw(raw)[0, :3], reference / (1 + reference * shift), rtol=1e-6)
    assert np.isnan(model.depth_of_raw(raw)[0, 3:]).all()
    # Herrera et al.: raw + beta(x, y) exp(alpha_0 - alpha_1 raw).
    codes = raw[0, :3] + 2 * np.exp(0.3 - 0.002 * raw[0, :3])
    distorted = replace(model, beta=np.full(raw.shape, 2.0), alpha=(0.3, 0.002))
    np.testing.assert_allclose(distorted.depth_of_raw(raw)[0, :3], 350 / (1090 - codes), rtol=1e-6)


@pytest.mark.parametrize("names", ["intrinsic/intrinsic_{}.txt", "intrinsics_{}.txt"])
def test_scannet(tmp_path: Path, names: str):
    matrix, folder = "{0} 0 {1} 0\n0 {0} {2} 0\n0 0 1 0\n0 0 0 1\n", tmp_path / "scene0000_00"
    color, depth = np.full((24, 32, 3), 100, np.uint8), np.full((12, 16), 1500, np.uint16)
    for number in (0, 10):
        laid(folder, {f"color/{number}.jpg": color, f"depth/{number}.png": depth})
    cameras = {"color": (40, 15.5, 11.5), "depth": (20, 7.5, 5.5)}
    laid(folder, {names.format(kind): matrix.format(*numbers) for kind, numbers in cameras.items()})
    first, second = find(tmp_path)
    assert [scene.name for scene in (first, second)] == ["scene0000_00/0", "scene0000_00/10"]
    assert (first.layout, second.number, second.sequence) == ("scannet", 10, "scene0000_00")
    assert (first.intrinsics, first.depth_intrinsics) == ((40, 40, 15.5, 11.5), (20, 20, 7.5, 5.5))
    frame = load(first)
    assert frame.depth.shape == (24, 32)
    np.testing.assert_allclose(frame.depth[8:16, 8:24], 1.5)
    check_layout("scannet", tmp_path)
    (folder / "depth" / "10.png").unlink()
    refused(InputError, load, find(tmp_path)[1])
    camera = folder / names.format("color")
    for text in ("1 2 3", "a", matrix.format(-1, 2, 3)):
        camera.write_text(text)
        refused(InputError, find, folder)
    camera.unlink()
    refused(InputError, find, folder)


FLAT = np.full((4, 6), 0.75, np.float32)
MILLIMETERS = np.full((4, 6), 750, np.uint16)
BLACK = np.zeros((4, 6, 3), np.uint8)


def test_sparse_depth_has_the_codes_of_the_depth(tmp_path: Path):
    sparse = np.where(np.eye(4, 6, dtype=bool), np.uint16(500), np.uint16(0))
    laid(tmp_path, {"color.png": BLACK, "depth.png": MILLIMETERS, "sparse.png": sparse})
    frame = rgbd_frames.load_sparse_frame(find(tmp_path)[0])
    np.testing.assert_allclose(frame.depth, FLAT)
    np.testing.assert_allclose(frame.sparse, np.where(sparse, 0.5, np.nan))
    assert frame.sparse_confidence is None
    write_png(tmp_path / "sparse_confidence.png", np.full((4, 6), 51, np.uint8))
    np.testing.assert_allclose(rgbd_frames.load_sparse_frame(find(tmp_path)[0]).sparse_confidence, 0.2)
    laid(tmp_path / "b", {"color.png": BLACK, "depth.pfm": FLAT})
    for useless in (None, np.full((4, 6), np.nan, np.float32), np.ones((4, 5), np.float32)):
        laid(tmp_path / "b", {} if useless is None else {"sparse.pfm": useless})
        refused(InputError, rgbd_frames.load_sparse_frame, find(tmp_path / "b")[0])


@pytest.mark.parametrize("real", [True, False])
def test_cleargrasp(tmp_path: Path, real: bool):
    mask = np.zeros((4, 6), bool)
    mask[1:3, 2:4] = True
    names = ("rgb_transparent", "depth_opaque_gt_mm", "depth_sensor_mm") if real else ("rgb", "depth_gt_mm")
    laid(tmp_path, dict(zip((f"{name}.png" for name in names), (BLACK, MILLIMETERS, 2 * MILLIMETERS), strict=False)))
    (scene,) = find(laid(tmp_path, {"mask_transparent.png": mask.astype(np.uint8)}))
    assert (scene.layout, scene.protocol, scene.has_truth) == ("cleargrasp", "depth", True)
    np.testing.assert_allclose(load(scene).depth, 2 * FLAT if real else np.where(mask, np.nan, FLAT))
    np.testing.assert_allclose(true(scene).depth, FLAT)
    np.testing.assert_array_equal(true(scene).masks["transparent"], mask)


@pytest.mark.slow
@needs_data
def test_every_folder_runs_as_it_lies_there():
    for folder in ("rgbd_nyu", "rgbd_primesense", "rgbd_sun", "rgbd_tum", "kinect_v1_raw"):
        for scene in find(DATA / folder):
            assert 0.5 < np.isfinite(load(scene).depth).mean() < 0.95, scene.name
    scenes = find(DATA / "transparent") if (DATA / "transparent").is_dir() else []
    assert [scene.layout for scene in scenes] in (["cleargrasp"] * 5, [])
    for scene in scenes:
        depth, inside = load(scene).depth, true(scene).masks["transparent"]
        assert np.isfinite(depth[~inside]).mean() > 0.5
        assert np.isfinite(depth[inside]).mean() < (0.75 if "real" in scene.name else 1e-9)


@needs_data
def test_raw_depth_lies_on_the_checkerboards():
    """Within 1.2 mm of the residual that the set's own calibration has."""
    folder = DATA / "kinect_v1_raw" / "herrera"
    calibration = rgbd_frames.read_kinect_calibration(folder / "calib.json")
    for number, frame in json.loads((folder / "calib.json").read_text())["frames"].items():
        plane = read_grey(folder / f"plane_depth_gt_{number}.png").astype(float)
        raw = rgbd_frames.read_kinect_raw(folder / f"disparity_{number}.pgm")
        distance, plain = (
            float(np.nanmedian(np.abs(1000 * model.depth_of_raw(raw) - plane)[plane > 0]))
            for model in (calibration, replace(calibration, beta=None))
        )
        own = abs(frame["kinect_minus_plane_median_mm"]) + 0.6745 * frame["kinect_minus_plane_std_mm"]
        assert distance <= own + 1.2
        assert distance < plain < distance + 5


HERRERA = {
    "depth_K": [[580, 0, 319.5], [0, 580, 239.5], [0, 0, 1]], "color_K": [[520, 0, 319.5], [0, 520, 239.5], [0, 0, 1]],
    "depth_kc": [0] * 5, "color_kc": [0] * 5, "depth_to_color_R": np.eye(3).tolist(), "depth_to_color_t": [0] * 3,
    "dc": [3.0, -0.0028], "dc_alpha": [1, 0.01],
}  # fmt: skip


def test_calibrations_of_a_kinect_that_cannot_be(tmp_path: Path):
    frame = {"color.png": np.full((480, 640, 3), 90, np.uint8), "disparity.png": np.full((480, 640), 500, np.uint16)}
    laid(tmp_path, frame | {"calib.json": HERRERA})
    plain = rgbd_frames.read_kinect_calibration(tmp_path / "calib.json")
    assert (plain.offset, plain.factor) == (pytest.approx(3 / 0.0028), pytest.approx(1 / 0.0028))
    assert np.nanmedian(load(*find(tmp_path)).depth) == pytest.approx(1 / (3 - 0.0028 * 500), rel=1e-6)
    laid(tmp_path, {"dc_beta.npy": np.zeros((48, 64))})
    refused(InputError, load, *find(tmp_path))
    for change in ({"dc": [3.0, 0]}, {"color_K": np.diag([520, 0, 1]).tolist()}, {"depth_kc": [0]}):
        laid(tmp_path, {"calib.json": HERRERA | change})
        refused(InputError, load, *find(tmp_path))


K = [[190.0, 0, 20], [0, 190, 15], [0, 0, 1]]
RIG = {
    "color": {"K": K, "distortion": [0.1, 0, 0, 0, 0], "size": [40, 30]}, "infrared": {"K": K, "size": [36, 28]},
    "R": np.eye(3).tolist(), "t": [-0.05, 0, 0],
}  # fmt: skip


def write_infrared(folder, calibration=RIG, infrared=(28, 36), dtype=np.uint8):
    rng = np.random.default_rng(0)
    laid(folder, {"color.png": rng.integers(0, 256, (30, 40, 3)).astype(np.uint8),
                  "ir.png": rng.integers(0, 200, infrared).astype(dtype),
                  "depth.pfm": np.full((30, 40), 0.9, np.float32)})  # fmt: skip
    laid(folder, {} if calibration is None else {"calib.json": calibration})


def loaded(folder):
    (scene,) = find(folder)
    assert isinstance(scene, RgbIrScene) and scene.layout == "rgb-ir"
    return rgbd_frames.load_infrared_frame(scene)


def test_a_rig_and_a_rectified_pair(tmp_path):
    write_infrared(tmp_path / "a")
    frame = loaded(tmp_path / "a")
    assert isinstance(frame.rig, Rig) and frame.infrared.shape == (28, 36) and frame.rig.left.distortion[0] == 0.1
    assert not any(frame.rig.right.distortion)
    write_png(tmp_path / "a/ir_noprojector.png", np.full((28, 36), 77, np.uint8))
    assert (loaded(tmp_path / "a").infrared == 77).all()
    for fb, n_doubts in ((12.5, 0), (1250.0, 1)):  # millimeters
        write_infrared(tmp_path / "b", {"rectified": True, "fb": fb}, (30, 40))
        frame, lines = warned(loaded, tmp_path / "b")
        assert (frame.rig, frame.fb, len(lines)) == (None, fb, n_doubts)
    write_infrared(tmp_path / "c", None)
    left, right = (Camera(np.array(K, float), lens) for lens in ((0.1, 0.0, 0.0, 0.0, 0.0), (0.0,) * 5))
    opencv(tmp_path / "c/calib.yml", Rig(left, right, np.eye(3), np.array([-0.05, 0, 0])), "M1 D1 M2 D2 R T")
    rig = loaded(tmp_path / "c").rig
    np.testing.assert_allclose(rig.translation, [-0.05, 0, 0])
    assert rig.left.distortion == (0.1, 0, 0, 0, 0)
    write_infrared(tmp_path / "d", dtype=np.uint16)  # 16 bits use their own range
    infrared = loaded(tmp_path / "d").infrared
    assert infrared.dtype == np.uint8 and infrared.max() == 255 and 100 < infrared.mean() < 150


@pytest.mark.parametrize("change", [
    None, {"color": None}, {"t": [80, 0, 0]}, {"infrared": {"K": K, "size": [640, 480]}},
    {"infrared": {"K": K, "distortion": [1, 2, 3]}}, {"rectified": True, "fb": 10.0},
])  # fmt: skip
def test_what_cannot_be_used_says_why_in_a_line(tmp_path, change):
    write_infrared(tmp_path, None if change is None else {**RIG, **change})
    refused(InputError, loaded, tmp_path)


@pytest.mark.parametrize("scale", [1000.0, 4000.0])
@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.float32])
def test_a_scale_that_is_given_holds_for_every_kind_of_file(tmp_path: Path, scale: float, dtype):
    codes = (DEPTH / 2000.0 * scale).astype(dtype)
    laid(tmp_path / "a", {"color.png": COLOR, "depth.npy": codes, "depth_true.npy": codes, "sparse.npy": codes})
    (scene,) = find(tmp_path)
    given = scene.with_scale(scale)
    laid(tmp_path / "a", {"meta.json": {"depth_scale": scale}})
    for one in (given, *find(tmp_path)):
        for depth in (load(one).depth, true(one).depth, rgbd_frames.load_sparse_frame(one).sparse):
            np.testing.assert_array_equal(depth[1:], 1)


def test_the_scale_of_a_run_and_of_floats_beside_codes(tmp_path: Path):
    laid(tmp_path / "a", FRAME)
    (scene,) = find(tmp_path)
    for problem, preset in ((RefineKinect, "nearest"), (Transparent, "sensor")):
        (one,) = problem.ready(load_config(problem.model, preset, depth_scale=4000)).truth_scenes([scene])
        assert (one.depth_scale, one.scale_floats) == (4000, True)
    laid(tmp_path / "a", {"meta.json": {"depth_scale": 4000}, "depth_true.npy": np.full(DEPTH.shape, 0.5, np.float32)})
    (scene,) = find(tmp_path)
    np.testing.assert_array_equal(load(scene).depth[1:], 0.5)
    np.testing.assert_array_equal(true(scene).depth, 0.5)


def test_a_mark_that_is_given_holds_for_true_depth_and_disparity(tmp_path: Path):
    codes = np.where(DEPTH == 0, 7000, DEPTH).astype(np.uint16)
    (scene,) = find(laid(tmp_path / "a", FRAME | {"depth_true.png": codes, "meta.json": {"depth_scale": 2000}}))
    assert np.isnan(DepthProtocol(Settings(invalid=7000.0)).truth(scene).depth[0]).all()
    assert (DepthProtocol().truth(scene).depth[0] == 3.5).all()
    disparity = np.where(DEPTH == 0, 7, 3).astype(np.float32)
    laid(tmp_path / "s", {"left.png": COLOR, "right.png": COLOR, "disp_left.pfm": disparity})
    (pair,) = discover_scenes(tmp_path / "s", PAIRS)
    assert np.isnan(Eth3dProtocol(Settings(invalid=7.0)).truth(pair).values[0]).all()
    assert (Eth3dProtocol().truth(pair).values[0] == 7).all()

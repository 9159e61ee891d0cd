"""``depthcli cloud``: clouds of frames that were taken at known places, as one."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from depthcli.cli import main
from depthcli.core.cameras.camera import Intrinsics
from depthcli.io.formats.depth import read_points, write_points
from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.images import write_png
from depthcli.io.formats.rigs import read_rig
from depthcli.io.scenes.stereo import StereoScene
from depthcli.io.walk import discover_scenes

SIZE = (64, 48)
CAMERA = Intrinsics(60.0, 60.0, 31.5, 23.5)
WALL = np.array([0.1, -0.05, 1.0])  # in the world: WALL . X = 2


def run(*arguments: str | Path) -> int:
    return main([str(a) for a in arguments])


def pose(k: int) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = cv2.Rodrigues(np.radians([1.0 * k, -3.0 * k, 5.0 * k]))[0]
    matrix[:3, 3] = (0.1 * k, -0.05 * k, 0.2 * k)
    return matrix


def depth_of_wall(place: np.ndarray) -> np.ndarray:
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    rays = np.stack([(x - CAMERA.cx) / CAMERA.fx, (y - CAMERA.cy) / CAMERA.fy, np.ones(x.shape)], -1)
    turned = rays @ place[:3, :3].T
    return ((2 - WALL @ place[:3, 3]) / (turned @ WALL)).astype(np.float32)


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    """Four frames of a wall, with poses as lines of quaternions."""
    from scipy.spatial.transform import Rotation

    folder = tmp_path / "frames" / "room"
    (folder / "color").mkdir(parents=True)
    lines = []
    for k in range(4):
        write_png(folder / "color" / f"{k:06}.png", np.full((SIZE[1], SIZE[0], 3), 40 * k, np.uint8))
        (folder / "depth").mkdir(exist_ok=True)
        write_pfm(folder / "depth" / f"{k:06}.pfm", depth_of_wall(pose(k)))
        turn = Rotation.from_matrix(pose(k)[:3, :3]).as_quat()
        lines.append(" ".join(map(str, (k, *pose(k)[:3, 3], *turn))))
    (folder / "poses.txt").write_text("\n".join(lines) + "\n")
    camera = {"fx": CAMERA.fx, "fy": CAMERA.fy, "cx": CAMERA.cx, "cy": CAMERA.cy}
    (folder / "meta.json").write_text(json.dumps({"intrinsics": camera}))
    return folder.parent


@pytest.fixture
def clouds(frames: Path, tmp_path: Path) -> Path:
    """What ``refine-kinect --ply`` writes of them, without its time."""
    for k in range(4):
        depth = depth_of_wall(pose(k))
        points = CAMERA.points(depth, np.isfinite(depth))
        target = tmp_path / "run" / "room" / f"{k:06}" / "points.ply"
        write_points(target, points, np.full((len(points), 3), 40 * k, np.uint8))
    return tmp_path / "run"


def test_clouds_meet_on_the_wall(frames: Path, clouds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    target = tmp_path / "cloud.ply"
    assert run("cloud", clouds, "--input", frames, "--output", target, "--voxel", "0.05", "--json") == 0
    points, color = read_points(target)
    np.testing.assert_allclose(points @ WALL, 2, atol=2e-3)
    row = json.loads(capsys.readouterr().out)
    assert (row["frames"], row["without"], row["points"], row["voxels"]) == (4, 0, 4 * 48 * 64, len(points))
    assert 300 < len(points) < 4 * 48 * 64 / 2
    assert color.min() == 0 and color.max() == 120 and len(np.unique(color)) > 4  # where several see it, means
    other = tmp_path / "again.ply"
    assert run("cloud", clouds, "--input", frames, "--output", other, "--voxel", "0.05", "-q") == 0
    assert other.read_bytes() == target.read_bytes()


@pytest.mark.slow
def test_clouds_of_refined_frames(frames: Path, tmp_path: Path):
    for name, preset in (("single", "fast"), ("sequence", "sequence")):
        assert run("refine-kinect", preset, "-i", frames, "-o", tmp_path / name, "--ply", "-q") == 0
        target = tmp_path / f"{name}.ply"
        assert run("cloud", tmp_path / name, "-i", frames, "-o", target, "--voxel", "0.05", "-q") == 0
        points, _ = read_points(target)
        assert np.quantile(np.abs(points @ WALL - 2), 0.9) < 0.05


def view_of_wall(place: np.ndarray) -> np.ndarray:
    """(H, W) uint8: a textured wall as a camera at ``place`` sees it."""
    noise = cv2.GaussianBlur(np.random.default_rng(1).random((512, 512)).astype(np.float32), (0, 0), 1.5)
    noise = (noise - noise.min()) / np.ptp(noise) * 255
    depth = depth_of_wall(place)
    points = CAMERA.points(depth, np.isfinite(depth)).astype(np.float64) @ place[:3, :3].T + place[:3, 3]
    u, v = (((points[:, k] * 60 + 256).reshape(depth.shape)).astype(np.float32) for k in (0, 1))
    return cv2.remap(noise, u, v, cv2.INTER_LINEAR).round().astype(np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_recording_of_two_views_and_poses_becomes_one_cloud(tmp_path: Path, kind: str):
    pytest.importorskip("rosbags", reason="no rosbags, which reads recordings")
    from scipy.spatial.transform import Rotation

    from tests.recordings import START, Messages, Record, write_recording

    ros, records, baseline = Messages(kind), [], np.eye(4)
    baseline[0, 3] = 0.2
    for k in range(4):
        time = START + k * 10**8
        for side, place, shift in (("left", pose(k), 0.0), ("right", pose(k) @ baseline, -12.0)):
            image = ros.image(view_of_wall(place), "mono8", time, side)
            projection = np.hstack([CAMERA.matrix, [[shift], [0], [0]]])
            info = ros.info(SIZE, CAMERA.matrix, projection, frame=side)
            records += [Record(f"/{side}/image_rect", time, image), Record(f"/{side}/camera_info", time, info)]
        turn = Rotation.from_matrix(pose(k)[:3, :3]).as_quat().tolist()
        records.append(Record("/pose", time, ros.pose_stamped(time, pose(k)[:3, 3].tolist(), turn)))
    bag = write_recording(tmp_path / f"drive.{kind}", records)
    for line in (
        ("extract", bag, "-o", tmp_path / "frames", "--pose-topic", "/pose"),
        ("stereo", "fast", "-i", tmp_path / "frames", "-o", tmp_path / "run", "--max-disparity", "16"),
        ("depth", tmp_path / "run", "-o", tmp_path / "depth", "--ply"),
        ("cloud", tmp_path / "depth", "-i", tmp_path / "frames", "-o", tmp_path / "cloud.ply", "--voxel", "0.05"),
    ):
        assert run(*line, "-q") == 0
    points, _ = read_points(tmp_path / "cloud.ply")
    assert len(points) > 500
    assert np.quantile(np.abs(points @ WALL - 2), 0.8) < 0.05  # a tenth of a pixel of disparity is 0.03 m


def test_what_is_missing_is_said_and_the_rest_is_done(
    frames: Path, clouds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    poses = frames / "room" / "poses.txt"
    lines = poses.read_text().splitlines()
    poses.write_text("\n".join(lines[:1] + lines[2:]) + "\n")
    (clouds / "room" / "000002" / "points.ply").write_bytes(b"ply\nhello")
    (clouds / "room" / "extra").mkdir()
    (clouds / "room" / "extra" / "points.ply").write_bytes((clouds / "room" / "000000" / "points.ply").read_bytes())
    assert run("cloud", clouds, "-i", frames, "-o", tmp_path / "cloud.ply") == 3
    said = capsys.readouterr()
    assert "room/000001: has no pose" in said.err and "no point cloud of depthcli" in said.err
    assert "room/extra: no frame of that name in the input" in said.err
    assert said.out.split()[5:7] == ["2", "3"]
    assert len(read_points(tmp_path / "cloud.ply")[0]) > 100


def test_errors_before_anything_is_written(
    frames: Path, clouds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    target = tmp_path / "cloud.ply"
    (tmp_path / "nothing").mkdir()
    for arguments, wanted in (
        ([tmp_path / "none", "-i", frames], "no such run folder"),
        ([tmp_path / "nothing", "-i", frames], "no points.ply of any frame"),
        ([clouds, "-i", frames, "--scenes", "other*"], "no frame matches other*"),
        ([clouds, "-i", tmp_path / "nothing"], "no scenes found"),
    ):
        assert run("cloud", *arguments, "-o", target) == 2
        assert wanted in capsys.readouterr().err
    (frames / "room" / "poses.txt").unlink()
    assert run("cloud", clouds, "-i", frames, "-o", target) == 2
    assert "no frame has a pose" in capsys.readouterr().err
    assert not target.exists()
    target.write_bytes(b"mine")
    assert run("cloud", clouds, "-i", frames, "-o", target) == 2
    assert target.read_bytes() == b"mine"


def test_rectification_turns_the_pose(tmp_path: Path):
    folder = tmp_path / "photos"
    rng = np.random.default_rng(0)
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
        image = cv2.GaussianBlur(rng.integers(0, 256, (90, 120), dtype=np.uint8), (0, 0), 1.5)
        write_png(folder / side / "000007.png", image)
    (folder / "poses.txt").write_text("7 0.3 -0.15 0.6 0 0 0 1\n")
    turn = cv2.Rodrigues(np.radians([1.0, -2.0, 0.5]))[0]
    file = cv2.FileStorage(str(tmp_path / "rig.yml"), cv2.FILE_STORAGE_WRITE)
    camera = np.array([[100.0, 0, 59.5], [0, 100, 44.5], [0, 0, 1]])
    parts = {"K1": camera, "D1": np.zeros((1, 5)), "K2": camera, "D2": np.zeros((1, 5)), "R": turn,
             "T": turn @ np.array([[-0.1], [0.01], [0.0]])}  # fmt: skip
    for name, value in parts.items():
        file.write(name, value)
    file.release()
    line = ["rectify", "-i", folder, "--calibration", tmp_path / "rig.yml", "-o", tmp_path / "out", "-q"]
    assert run(*line) == 0
    (scene,) = discover_scenes(tmp_path / "out")
    assert isinstance(scene, StereoScene) and scene.pose is not None
    found = np.array(scene.pose).reshape(4, 4)
    rig = read_rig([tmp_path / "rig.yml"]).rectified((120, 90), (120, 90), 0.0)
    np.testing.assert_allclose(found[:3, 3], (0.3, -0.15, 0.6))
    np.testing.assert_allclose(found[:3, :3], rig.rotation.T, atol=1e-9)
    # The rectified camera's x axis lies along the baseline, in the world.
    np.testing.assert_allclose(found[:3, 0], np.array([0.1, -0.01, 0]) / np.hypot(0.1, 0.01), atol=1e-6)


def test_a_broken_file_of_poses_does_not_keep_pairs_from_being_matched(tmp_path: Path):
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        write_png(tmp_path / side / "1.png", np.zeros((8, 8), np.uint8))
    (tmp_path / "poses.txt").write_text("of another program\n")
    (scene,) = discover_scenes(tmp_path)
    assert isinstance(scene, StereoScene) and scene.pose is None and not scene.problem

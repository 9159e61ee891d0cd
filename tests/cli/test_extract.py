"""``depthcli extract``: recordings that tests write, as frames, and what the other commands make of them."""

from __future__ import annotations

import csv
import json
import os
import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags", reason="no rosbags, which reads recordings")

from depthcli.cli import main
from depthcli.commands._extraction import nearest_pairs
from depthcli.io.formats.disparity import read_pfm
from depthcli.io.formats.images import png_bytes, read_image
from depthcli.io.formats.pair_geometry import read_geometry
from depthcli.io.formats.poses import read_poses
from depthcli.io.formats.rigs import read_rig
from depthcli.io.scenes.rgbd import RgbdScene
from depthcli.io.walk import discover_scenes
from tests.recordings import FORMATS, START, Messages, Record, write_recording
from tests.scenes import DATA

MS = 1_000_000  # nanoseconds
SIZE = (48, 32)
K = np.array([[60.0, 0, 23.5], [0, 60, 15.5], [0, 0, 1]])
RNG = np.random.default_rng(3)
VIEWS = RNG.integers(0, 256, (2, 4, SIZE[1], SIZE[0]), dtype=np.uint8)
CODES = RNG.integers(500, 4000, (4, SIZE[1], SIZE[0])).astype(np.uint16)
COLORS = RNG.integers(0, 256, (4, SIZE[1], SIZE[0], 3), dtype=np.uint8)


def run(*arguments: str | Path) -> int:
    return main([str(a) for a in arguments])


def projection(shift: float = 0.0) -> np.ndarray:
    return np.hstack([K, [[shift], [0], [0]]])


def pair(kind: str, offsets: Sequence[int] = (0, 0, 0, 0), info: bool = True, name: str = "image_raw") -> list[Record]:
    """Four frames of two views, whose right images are later by ``offsets`` milliseconds."""
    ros, records = Messages(kind), []
    for k, offset in enumerate(offsets):
        for side, late in ((0, 0), (1, offset)):
            view, time = ("left", "right")[side], START + k * 100 * MS + late * MS
            records.append(Record(f"/rig/{view}/{name}", time, ros.image(VIEWS[side, k], "mono8", time, f"{view}_eye")))
            if info:
                message = ros.info(SIZE, K, projection(-6.0 * side), frame=f"{view}_eye")
                records.append(Record(f"/rig/{view}/camera_info", time, message))
    return records


def color_and_depth(kind: str, late: int = 5) -> list[Record]:
    ros, records = Messages(kind), []
    for k in range(4):
        time = START + k * 100 * MS
        records += [
            Record("/camera/color/image_raw", time, ros.image(COLORS[k], "rgb8", time)),
            Record("/camera/depth/image", time, ros.image(CODES[k], "16UC1", time + late * MS)),
            Record("/camera/color/camera_info", time, ros.info(SIZE, K)),
            Record("/camera/depth/camera_info", time, ros.info(SIZE, K)),
        ]
    return records


def report(folder: Path, scene: str = "rec") -> dict[str, Any]:
    rows = json.loads((folder / "report.json").read_text())["scenes"]
    return next(row for row in rows if row["scene"] == scene)


def files(folder: Path) -> dict[str, bytes]:
    """Bytes of all files by path, but for reports and records, which have measured seconds."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in ("report.json", "report.csv", "record.json")
    }


@pytest.mark.parametrize("kind", FORMATS)
def test_a_pair_becomes_rectified_scenes(tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]):
    bag = write_recording(tmp_path / f"rec.{kind}", pair(kind, (0, 3, 30, 8)))
    assert run("extract", bag, "-o", tmp_path / "out") == 0
    out = tmp_path / "out" / "rec"
    assert sorted(p.name for p in (out / "left").iterdir()) == ["000000.png", "000001.png", "000003.png"]
    for number in (0, 1, 3):
        for side in (0, 1):
            view = read_image(out / ("left", "right")[side] / f"{number:06}.png")
            np.testing.assert_array_equal(view, VIEWS[side, number])
    geometry = read_geometry(out / "calib.txt")
    assert (geometry.baseline, geometry.size, geometry.left.fx) == (pytest.approx(0.1), SIZE, 60)
    rows = list(csv.DictReader((out / "times.csv").read_text().splitlines()))
    assert [row["frame"] for row in rows] == ["0", "1", "3"]
    assert rows[1]["seconds"] == "1700000000.100000000" and [float(row["offset_ms"]) for row in rows] == [0, 3, 8]
    row = report(tmp_path / "out")
    assert (row["frames"], row["unmatched"], row["damaged"], row["tolerance"]) == (3, 1, 0, 10)
    assert (row["median_offset"], row["max_offset"], row["calibration"]) == (3, 8, "calib.txt")
    table = capsys.readouterr().out.splitlines()
    assert "10.0 ms" in table[1] and "tolerance" in table[0]
    assert [scene.name for scene in discover_scenes(tmp_path / "out")] == ["rec/000000", "rec/000001", "rec/000003"]


@pytest.mark.slow
def test_stereo_and_depth_read_the_frames(tmp_path: Path, made_scenes: Path):
    ros, records = Messages("bag"), []
    scene = sorted(path for path in made_scenes.iterdir() if path.is_dir())[0]
    for k, side in enumerate(("left", "right")):
        color = read_image(scene / f"{side}.png")
        size = (color.shape[1], color.shape[0])
        records.append(Record(f"/{side}/image_rect_color", START, ros.image(color, "rgb8", START)))
        records.append(Record(f"/{side}/camera_info", START, ros.info(size, K, projection(-6.0 * k))))
    bag = write_recording(tmp_path / "rec.bag", records)
    assert run("extract", bag, "-o", tmp_path / "out", "-q") == 0
    assert run("stereo", "fast", "-i", tmp_path / "out", "-o", tmp_path / "run", "--max-disparity", "12", "-q") == 0
    single = ("--left", scene / "left.png", "--right", scene / "right.png")
    assert run("stereo", "fast", *single, "-o", tmp_path / "one", "--max-disparity", "12", "-q") == 0
    (map_,), (own,) = ((tmp_path / name).rglob("disp_left.pfm") for name in ("run", "one"))
    assert map_.read_bytes() == own.read_bytes()
    assert run("depth", tmp_path / "run", "-o", tmp_path / "depth", "--ply", "-q") == 0
    depth = read_pfm(next((tmp_path / "depth").rglob("depth.pfm")))
    np.testing.assert_allclose(depth, 6.0 / read_pfm(map_), rtol=1e-5)
    assert next((tmp_path / "depth").rglob("points.ply")).stat().st_size > 1000


def test_raw_views_become_files_of_a_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    ros = Messages("mcap")
    lens = (-0.1, 0.02, 0.001, 0.0, 0.0)
    records = pair("mcap", info=False)
    for side, shift in (("left", 0.0), ("right", -6.0)):
        message = ros.info(SIZE, K, projection(shift), distortion=lens)
        records.append(Record(f"/rig/{side}/camera_info", START, message))
    bag = write_recording(tmp_path / "rec.mcap", records)
    assert run("extract", bag, "-o", tmp_path / "out") == 0
    out = tmp_path / "out" / "rec"
    rig = read_rig([out / "calib_left.yaml", out / "calib_right.yaml"])
    assert rig.left.distortion == lens and rig.baseline == pytest.approx(0.1)
    assert not (out / "calib.txt").exists()
    assert "not rectified yet: depthcli rectify takes calib_left.yaml, calib_right.yaml" in capsys.readouterr().err


@pytest.mark.parametrize("kind", FORMATS)
def test_color_and_depth_become_a_sequence(tmp_path: Path, kind: str):
    bag = write_recording(tmp_path / f"rec.{kind}", color_and_depth(kind))
    assert run("extract", bag, "-o", tmp_path / "out", "--every", "2", "-q") == 0
    scenes = discover_scenes(tmp_path / "out")
    assert [scene.name for scene in scenes] == ["rec/000000", "rec/000002"]
    for scene, number in zip(scenes, (0, 2), strict=True):
        assert isinstance(scene, RgbdScene) and scene.intrinsics == (60, 60, 23.5, 15.5)
        assert scene.depth_intrinsics is None and scene.color is not None
        np.testing.assert_array_equal(read_image(scene.color), COLORS[number])
        np.testing.assert_array_equal(read_image(scene.depth), CODES[number])


def test_the_bytes_do_not_depend_on_the_kind_of_recording(tmp_path: Path):
    made = []
    for kind in FORMATS:
        folder = tmp_path / kind
        folder.mkdir()
        bag = write_recording(folder / f"rec.{kind}", color_and_depth(kind))
        assert run("extract", bag, "-o", folder / "out", "-q") == 0
        made.append({n: b for n, b in files(folder / "out").items() if not n.endswith(("meta.json", "run.yaml"))})
    assert made[0] == made[1] == made[2] and len(made[0]) == 9


def test_compressed_images_and_depth(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    ros = Messages("bag")
    jpeg = cv2.imencode(".jpg", COLORS[0][..., ::-1])[1].tobytes()
    data = struct.pack("<iff", 0, 0, 0) + png_bytes(CODES[0])
    records = [
        Record("/c/color/image/compressed", START, ros.compressed(jpeg, "rgb8; jpeg compressed bgr8")),
        Record("/c/depth/image/compressedDepth", START, ros.compressed(data, "16UC1; compressedDepth png")),
        Record("/c/color/camera_info", START, ros.info(SIZE, K)),
    ]
    bag = write_recording(tmp_path / "rec.bag", records)
    assert run("extract", bag, "-o", tmp_path / "out") == 0
    assert "camera_info" not in capsys.readouterr().err  # the depth has the frame of the color camera
    out = tmp_path / "out" / "rec"
    assert (out / "color" / "000000.jpg").read_bytes() == jpeg
    np.testing.assert_array_equal(read_image(out / "depth" / "000000.png"), CODES[0])
    assert json.loads((out / "meta.json").read_text())["intrinsics"]["fx"] == 60


def test_depth_alone_has_a_folder_a_frame(tmp_path: Path):
    bag = write_recording(tmp_path / "rec.bag", color_and_depth("bag"))
    assert run("extract", bag, "-o", tmp_path / "out", "--depth-topic", "/camera/depth/image", "-q") == 0
    scenes = discover_scenes(tmp_path / "out", (RgbdScene,))
    assert [scene.name for scene in scenes] == [f"rec/{k:06}" for k in range(4)]
    frame = scenes[3].load()
    np.testing.assert_allclose(frame.depth, CODES[3] / 1000, rtol=1e-6)
    assert frame.intrinsics is not None and frame.intrinsics.fx == 60


def realsense() -> list[Record]:
    """A bag as librealsense writes it."""
    ros = Messages("bag")
    device, records = "/device_0", []
    streams = {"sensor_0/Depth_0": (CODES, "mono16", 0.0), "sensor_1/Color_0": (COLORS, "rgb8", -0.015)}
    for name, (pixels, encoding, shift) in streams.items():
        empty = ros.info(SIZE, K, np.zeros((3, 4)), np.zeros((3, 3)), model="Brown Conrady", frame="")
        records.append(Record(f"{device}/{name}/info/camera_info", 1, empty))
        records.append(Record(f"{device}/{name}/tf/0", 1, ros.transform((shift, 0, 0))))
        for k in range(4):
            image = ros.image(pixels[k], encoding, START + 33 * k * MS, "0")
            records.append(Record(f"{device}/{name}/image/data", START + 33 * k * MS, image))
    option = f"{device}/sensor_0/option"
    records.append(Record(f"{option}/Depth_Units/value", 1, ros.make("std_msgs/Float32", data=np.float32(0.0001))))
    records.append(Record(f"{option}/Stereo_Baseline/value", 1, ros.make("std_msgs/Float32", data=50.0)))
    return records


def test_a_bag_of_librealsense(tmp_path: Path):
    bag = write_recording(tmp_path / "rec.bag", realsense())
    assert run("extract", bag, "-o", tmp_path / "out", "-q") == 0
    meta = json.loads((tmp_path / "out" / "rec" / "meta.json").read_text())
    assert meta["depth_scale"] == 10000 and meta["fb"] == 3
    assert meta["depth_intrinsics"] == meta["intrinsics"] == {"fx": 60, "fy": 60, "cx": 23.5, "cy": 15.5}
    assert meta["depth_to_color"] == {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "translation": [-0.015, 0, 0]}
    (scene, *_) = discover_scenes(tmp_path / "out")
    assert isinstance(scene, RgbdScene)
    depth = scene.load().depth
    assert 0.04 < np.nanmedian(depth) < 0.4
    assert run("extract", bag, "-o", tmp_path / "mm", "--depth-scale", "1000", "-q") == 0
    assert json.loads((tmp_path / "mm" / "rec" / "meta.json").read_text())["depth_scale"] == 1000


def test_the_place_of_the_depth_camera_by_fixed_transforms(tmp_path: Path):
    ros, records = Messages("mcap"), []
    for record in color_and_depth("mcap"):
        depth = "/depth/" in record.topic
        record.message.header.frame_id = "depth_eye" if depth else "color_eye"
        records.append(record)
    edges = (("body", "depth_eye", (0, 0, 0)), ("body", "color_eye", (0.02, 0, 0)))
    static = Record("/tf_static", START, ros.tf(START, *edges))
    bag = write_recording(tmp_path / "rec.mcap", [*records, static])
    assert run("extract", bag, "-o", tmp_path / "out", "-q") == 0
    meta = json.loads((tmp_path / "out" / "rec" / "meta.json").read_text())
    assert meta["depth_to_color"]["translation"] == [-0.02, 0, 0]


QUARTER = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))  # about the world's z


@pytest.mark.parametrize("kind", ["bag", "mcap"])
@pytest.mark.parametrize("source", ["pose", "odometry", "tf"])
def test_poses_are_those_of_the_camera(tmp_path: Path, kind: str, source: str):
    ros, records = Messages(kind), color_and_depth(kind)
    for k in range(-1, 8):
        time, place = START + k * 50 * MS + 20 * MS, (0.5 * k + 0.2, 0, 0)
        if source == "pose":
            records.append(Record("/where", time, ros.pose_stamped(time, place, QUARTER)))
        elif source == "odometry":
            records.append(Record("/where", time, ros.odometry(time, "body", place, QUARTER)))
        else:
            records.append(Record("/where", time, ros.tf(time, ("map", "body", place, QUARTER))))
    if source != "pose":
        records.append(Record("/tf_static", START, ros.tf(START, ("body", "camera", (0.1, 0, 0)))))
    bag = write_recording(tmp_path / f"rec.{kind}", records)
    assert run("extract", bag, "-o", tmp_path / "out", "--pose-topic", "/where", "-q") == 0
    for scene, poses in zip(discover_scenes(tmp_path / "out"), (0, 1, 2, 3), strict=True):
        assert isinstance(scene, RgbdScene) and scene.pose is not None
        matrix = np.array(scene.pose).reshape(4, 4)
        y = 0.0 if source == "pose" else 0.1  # the camera is ahead of the body, which looks along the world's y
        np.testing.assert_allclose(matrix[:3, 3], (1.0 * poses, y, 0), atol=1e-6)
        np.testing.assert_allclose(matrix[:3, :3] @ (1, 0, 0), (0, 1, 0), atol=1e-9)
    assert report(tmp_path / "out")["poses"] == 4


def test_poses_of_depth_alone(tmp_path: Path):
    ros = Messages("bag")
    poses = [
        Record("/where", START + k * 100 * MS, ros.pose_stamped(START + k * 100 * MS, (k, 0, 0))) for k in range(4)
    ]
    bag = write_recording(tmp_path / "rec.bag", [*color_and_depth("bag", 0), *poses])
    topics = ("--depth-topic", "/camera/depth/image", "--pose-topic", "/where")
    assert run("extract", bag, "-o", tmp_path / "out", *topics, "-q") == 0
    found = [scene.pose for scene in discover_scenes(tmp_path / "out") if isinstance(scene, RgbdScene)]
    assert [pose and pose[3] for pose in found] == [0, 1, 2, 3]


def test_frames_without_a_pose_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    ros = Messages("bag")
    pose = Record("/where", START, ros.pose_stamped(START, (1, 2, 3)))
    bag = write_recording(tmp_path / "rec.bag", [*color_and_depth("bag"), pose])
    assert run("extract", bag, "-o", tmp_path / "out", "--pose-topic", "/where", "-q") == 0
    run("extract", bag, "-o", tmp_path / "again", "--pose-topic", "/where")
    assert (
        "3 of 4 frames have no poses of /where within 100 ms on both sides, nor one within 20 ms"
        in capsys.readouterr().err
    )
    assert len(read_poses(tmp_path / "out" / "rec" / "poses.txt").times) == 1


TUM = DATA / "rgbd_tum" / "open3d_sample"


@pytest.mark.slow
@pytest.mark.skipif(not TUM.is_dir(), reason="the real scenes of ../shared/data are missing")
@pytest.mark.parametrize("kind", FORMATS)
def test_a_frame_of_tum_gives_the_same_maps_from_a_recording(tmp_path: Path, kind: str):
    color, codes = read_image(TUM / "color.png"), read_image(TUM / "depth.png")
    meters = (codes / np.float64(5000)).astype(np.float32)
    meters[codes == 0] = np.nan
    ros = Messages(kind)
    matrix = np.array([[525.0, 0, 319.5], [0, 525, 239.5], [0, 0, 1]])
    info = ros.info((640, 480), matrix)
    records = [
        Record("/camera/rgb/image_color", START, ros.image(color[..., ::-1], "bgr8")),
        Record("/camera/depth/image", START, ros.image(meters, "32FC1")),
        *(Record(f"/camera/{name}/camera_info", START, info) for name in ("rgb", "depth")),
    ]
    bag = write_recording(tmp_path / f"rec.{kind}", records)
    assert run("extract", bag, "-o", tmp_path / "frames", "--depth-scale", "5000", "-q") == 0
    given = tmp_path / "given" / "frame"
    given.mkdir(parents=True)
    for name in ("color.png", "depth.png"):
        (given / name).write_bytes((TUM / name).read_bytes())
    cameras = {"depth_scale": 5000, "fx": 525.0, "fy": 525.0, "cx": 319.5, "cy": 239.5}
    (given / "meta.json").write_text(json.dumps(cameras))
    for name, folder in (("a", tmp_path / "frames"), ("b", given.parent)):
        assert run("refine-kinect", "fast", "-i", folder, "-o", tmp_path / name, "--ply", "-q") == 0
    (one,), (other,) = (list((tmp_path / name).rglob("depth.pfm")) for name in "ab")
    compared = sorted(path.name for path in other.parent.iterdir() if path.name != "record.json")
    assert {"depth.pfm", "depth.png", "sigma.pfm", "status.png", "points.ply"} <= set(compared)
    for name in compared:
        assert (one.parent / name).read_bytes() == (other.parent / name).read_bytes(), name


def test_times_are_matched_to_the_nearest_of_both():
    assert nearest_pairs([0, 10, 20], [1, 11, 19], 2) == [(0, 0), (1, 1), (2, 2)]
    assert nearest_pairs([0, 10, 20], [9], 100) == [(1, 0)]
    assert nearest_pairs([20, 0, 10], [12, 1], 2) == [(1, 1), (2, 0)]  # in the order of time
    assert nearest_pairs([0], [5], 4) == [] == nearest_pairs([], [5], 4)
    assert nearest_pairs([5, 5], [5, 5], 0) == [(0, 0)]
    assert nearest_pairs([5], [0, 10], 9) == [(0, 0)]


def naive_pairs(first: list[int], second: list[int], tolerance: int) -> set[tuple[int, int]]:
    def nearest(time: int, others: list[int]) -> int:
        return min(range(len(others)), key=lambda k: (abs(others[k] - time), others[k], k))

    return {
        (a, b)
        for a, time in enumerate(first)
        if abs(second[b := nearest(time, second)] - time) <= tolerance and nearest(second[b], first) == a
    }


def test_matching_agrees_with_the_obvious_one():
    rng = np.random.default_rng(0)
    for _ in range(200):
        first, second = (rng.integers(0, 40, rng.integers(1, 12)).tolist() for _ in range(2))
        assert set(nearest_pairs(first, second, 5)) == naive_pairs(first, second, 5)


def test_messages_out_of_order_make_the_same_frames(tmp_path: Path):
    records = pair("bag", (0, 3, 2, 8))
    shuffled = [
        record._replace(time=START + int(k)) for record, k in zip(records, RNG.permutation(len(records)), strict=True)
    ]
    for name, written in (("a", records), ("b", shuffled)):
        (tmp_path / name).mkdir()
        bag = write_recording(tmp_path / name / "rec.bag", written)
        assert run("extract", bag, "-o", tmp_path / name / "out", "-q") == 0
    pictures = [
        {bytes_: other.read_bytes() for bytes_, other in
         ((p.read_bytes(), p.parent.parent / "right" / p.name) for p in (tmp_path / n / "out/rec/left").iterdir())}
        for n in "ab"
    ]  # fmt: skip
    assert pictures[0] == pictures[1] and len(pictures[0]) == 4


def test_images_without_times_are_matched_by_the_recorder(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    records = pair("bag", (0, 3, 2, 8))
    for record in records:
        record.message.header.stamp.sec = record.message.header.stamp.nanosec = 0
    bag = write_recording(tmp_path / "rec.bag", records)
    assert run("extract", bag, "-o", tmp_path / "out") == 0
    assert report(tmp_path / "out")["max_offset"] == 8
    assert "those of the recorder are matched" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["--left-topic", "/rig/left/image_raw"], "--left-topic and --right-topic belong together"),
        (["--left-topic", "/a", "--depth-topic", "/b"], "frames are pairs"),
        (["--color-topic", "/a"], "--color-topic wants --depth-topic"),
        ([], "give --output DIR, or --list-topics"),
    ],
)
def test_options_that_do_not_go_together(
    tmp_path: Path, arguments: list[str], wanted: str, capsys: pytest.CaptureFixture[str]
):
    bag = write_recording(tmp_path / "rec.bag", pair("bag"))
    assert run("extract", bag, *arguments, *(["-o", tmp_path / "out"] if arguments else [])) == 2
    assert wanted in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["--left-topic", "/nowhere", "--right-topic", "/rig/right/image_raw"], "no topic '/nowhere'"),
        (["--left-topic", "/rig/left/camera_info", "--right-topic", "/rig/right/image_raw"], "holds CameraInfo"),
        (["--depth-topic", "/rig/left/image_raw"], "encoding"),
        (["--pose-topic", "/rig/left/image_raw"], "--pose-topic wants PoseStamped"),
        (["--tolerance", "1"], "the nearest are 3.0 ms apart"),
    ],
)
def test_topics_that_do_not_fit_are_one_line(
    tmp_path: Path, arguments: list[str], wanted: str, capsys: pytest.CaptureFixture[str]
):
    bag = write_recording(tmp_path / "rec.bag", pair("bag", (3, 4, 5, 6)))
    assert run("extract", bag, "-o", tmp_path / "out", *arguments) == 3
    line = next(line for line in capsys.readouterr().err.splitlines() if wanted in line)
    assert "rec" in line


def test_several_pairs_are_asked_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    records = [*pair("bag"), *pair("bag", name="image_rect")]
    bag = write_recording(tmp_path / "rec.bag", records)
    assert run("extract", bag, "-o", tmp_path / "out") == 3
    assert "several pairs of topics: /rig/left/image_raw, /rig/left/image_rect, /rig/right" in capsys.readouterr().err
    assert run("extract", bag, "--list-topics") == 0
    table = capsys.readouterr().out
    assert "/rig/left/image_rect" in table and "CameraInfo" in table and "Hz" in table


def test_damaged_images_are_left_out_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    records = pair("bag")
    records[0].message.height = 500
    other = next(record for record in records[6:] if "right/image" in record.topic)
    other.message.encoding = "secret"
    bag = write_recording(tmp_path / "rec.bag", records)
    assert run("extract", bag, "-o", tmp_path / "out") == 3
    said = capsys.readouterr().err
    assert "/rig/left/image_raw: message 1: truncated" in said and "message 2: encoding" in said
    assert "not everything could be used" in said
    row = report(tmp_path / "out")
    assert (row["status"], row["frames"], row["damaged"]) == ("done", 2, 2)
    assert len(list((tmp_path / "out").rglob("*.png"))) == 4
    assert len(discover_scenes(tmp_path / "out")) == 2


def test_calibrations_that_contradict_the_images_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    ros = Messages("bag")
    for name, infos, wanted in (
        ("size", [ros.info((9, 9), K, projection(-6.0 * k)) for k in (0, 1)], "of 9 x 9 pixels"),
        ("side", [ros.info(SIZE, K, projection(6.0 * k)) for k in (0, 1)], "left and right exchanged"),
        ("lens", [ros.info(SIZE, K, projection(-6.0 * k), distortion=(9.0, 1.0)) for k in (0, 1)], "coefficients"),
    ):
        records = pair("bag", info=False)
        for side, info in zip(("left", "right"), infos, strict=True):
            records.append(Record(f"/rig/{side}/camera_info", START, info))
        bag = write_recording(tmp_path / f"{name}.bag", records)
        assert run("extract", bag, "-o", tmp_path / name) == 3
        said = capsys.readouterr().err
        assert "no calibration is written" in said and wanted in said
        row = report(tmp_path / name, name)
        assert (row["calibration"], row["frames"]) == ("refused", 4)
        assert not list((tmp_path / name / name).glob("calib*"))


def test_bad_recordings_do_not_spoil_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = tmp_path / "recordings"
    folder.mkdir()
    whole = write_recording(folder / "whole.bag", pair("bag")).read_bytes()
    (folder / "cut.bag").write_bytes(whole[:-900])
    (folder / "empty.bag").write_bytes(b"")
    (folder / "other.mcap").write_bytes(b"hello")
    os.mkfifo(folder / "pipe.bag")
    assert run("extract", folder, "-o", tmp_path / "out") == 3
    said = capsys.readouterr().err
    for name in ("cut.bag", "empty.bag", "other.mcap", "pipe.bag"):
        assert sum(f"{name}: " in line for line in said.splitlines()) == 1
    assert "rosbag reindex" in said and "a named pipe" in said
    assert report(tmp_path / "out", "whole")["frames"] == 4
    assert run("extract", folder, "--list-topics") == 3
    assert "/rig/left/image_raw" in capsys.readouterr().out


def test_a_recording_that_breaks_in_the_middle_gives_what_is_before(tmp_path: Path):
    bag = write_recording(tmp_path / "rec.db3", pair("db3"))
    (file,) = bag.glob("*.db3")
    data = bytearray(file.read_bytes())
    pages = range(len(data) // 4096)
    last = max(k for k in pages if VIEWS[1, 3].tobytes()[:60] in bytes(data[k * 4096 : (k + 1) * 4096]))
    data[last * 4096 : last * 4096 + 64] = b"\xff" * 64
    file.write_bytes(bytes(data))
    assert run("extract", bag, "-o", tmp_path / "out", "-q") == 3


def test_the_same_again_is_skipped_and_what_is_left_is_completed(tmp_path: Path):
    bag = write_recording(tmp_path / "rec.bag", pair("bag"))
    assert run("extract", bag, "-o", tmp_path / "out", "-q") == 0
    before = files(tmp_path / "out")
    assert run("extract", bag, "-o", tmp_path / "out", "-q") == 0
    assert report(tmp_path / "out")["status"] in ("done", "skipped") and files(tmp_path / "out") == before
    (tmp_path / "out" / "rec" / "left" / "000001.png").unlink()
    assert run("extract", bag, "-o", tmp_path / "out", "-q") == 0
    assert files(tmp_path / "out") == before


def test_without_the_library_one_line_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    bag = write_recording(tmp_path / "rec.bag", pair("bag"))
    for name in ("rosbags.rosbag1", "rosbags.rosbag2"):
        monkeypatch.setitem(sys.modules, name, None)
    assert run("extract", bag, "--list-topics") == 2
    assert "pip install 'depthcli[ros]'" in capsys.readouterr().err
    assert run("extract", bag, "-o", tmp_path / "out") == 2
    assert "pip install 'depthcli[ros]'" in capsys.readouterr().err

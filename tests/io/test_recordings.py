"""Images, cameras and poses in messages of ROS."""

from __future__ import annotations

import contextlib
import sqlite3
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags", reason="no rosbags, which reads recordings")

from depthcli.core.errors import InputError
from depthcli.io.formats.images import decode_image, png_bytes
from depthcli.io.formats.recordings import find_recordings, open_recording
from depthcli.io.formats.ros_cameras import camera_info, rectified_geometry, write_raw_pair
from depthcli.io.formats.ros_images import depth_of, image_of, stored_image
from depthcli.io.formats.ros_poses import StampedPose, Track, Transforms, poses_in
from tests.recordings import FORMATS, START, Messages, Record, write_recording

ROS1 = Messages("bag")
GREY8 = np.arange(6 * 8, dtype=np.uint8).reshape(6, 8) * 5
NO_SCALE = struct.pack("<iff", 0, np.nan, 0)
RGB8 = np.random.default_rng(1).integers(0, 256, (6, 8, 3), dtype=np.uint8)


@pytest.mark.parametrize(
    ("stored", "encoding", "expected"),
    [
        (GREY8, "mono8", GREY8),
        (GREY8, "8UC1", GREY8),
        (GREY8.astype("<u2") * 250, "mono16", GREY8.astype(np.uint16) * 250),
        (GREY8.astype(">u2") * 250, "16UC1", GREY8.astype(np.uint16) * 250),
        (RGB8, "rgb8", RGB8),
        (RGB8[..., ::-1], "bgr8", RGB8),
        (np.dstack([RGB8, GREY8]), "rgba8", RGB8),
        (np.dstack([RGB8[..., ::-1], GREY8]), "bgra8", RGB8),
        (RGB8[..., ::-1].astype(">u2") * 257, "bgr16", RGB8.astype(np.uint16) * 257),
    ],
)
@pytest.mark.parametrize("padding", [0, 6])
def test_pixels_are_those_of_the_encoding(stored: np.ndarray, encoding: str, expected: np.ndarray, padding: int):
    pixels = image_of(ROS1.image(stored, encoding, padding=padding))
    assert pixels.dtype == expected.dtype
    np.testing.assert_array_equal(pixels, expected)
    file = stored_image(ROS1.image(stored, encoding, padding=padding))
    np.testing.assert_array_equal(decode_image(file.data), expected)
    assert (file.suffix, file.shape) == (".png", (6, 8))


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("bits", [8, 16])
def test_bayer_patterns_give_the_color_of_one_colored_image(pattern: str, bits: int):
    color = np.array([200, 120, 40]) * (1 if bits == 8 else 256)
    mosaic = np.empty((8, 10), f"u{bits // 8}")
    for k, letter in enumerate(pattern):
        mosaic[k // 2 :: 2, k % 2 :: 2] = color["rgb".index(letter)]
    for message in (
        ROS1.image(mosaic, f"bayer_{pattern}{bits}"),
        ROS1.compressed(png_bytes(mosaic), f"bayer_{pattern}{bits}; png compressed bayer_{pattern}{bits}"),
    ):
        pixels = image_of(message)
        assert pixels.dtype == mosaic.dtype
        np.testing.assert_array_equal(pixels[2:-2, 2:-2], np.broadcast_to(color, (4, 6, 3)))
        np.testing.assert_array_equal(decode_image(stored_image(message).data), pixels)


@pytest.mark.parametrize(("encoding", "luma"), [("yuv422", 1), ("yuv422_yuy2", 0)])
def test_yuv_without_color_is_grey(encoding: str, luma: int):
    samples = np.full((4, 6, 2), 128, np.uint8)
    samples[..., luma] = 126
    pixels = image_of(ROS1.image(samples, encoding))
    assert np.ptp(pixels) == 0 and abs(int(pixels[0, 0, 0]) - 128) <= 1


def test_compressed_images_are_kept_as_they_are():
    for end, suffix in ((".jpg", ".jpg"), (".png", ".png")):
        data = cv2.imencode(end, RGB8[..., ::-1])[1].tobytes()
        message = ROS1.compressed(data, f"bgr8; {end[1:]} compressed bgr8")
        assert stored_image(message)[:2] == (data, suffix)
        np.testing.assert_array_equal(image_of(message), decode_image(data))


def test_depth_of_every_encoding():
    codes = np.array([[0, 1, 1000], [2500, 40000, 65535]], np.uint16)
    meters = np.array([[np.nan, 0.001, 1], [2.5, 40, 65.535]], np.float32)
    for message in (
        ROS1.image(codes, "16UC1"),
        ROS1.image(codes.astype(">u2"), "mono16", padding=2),
        ROS1.compressed(png_bytes(codes), "16UC1; png compressed "),
        ROS1.compressed(struct.pack("<iff", 0, 0, 0) + png_bytes(codes), "16UC1; compressedDepth png"),
    ):
        found = depth_of(message)
        assert found.dtype == np.uint16
        np.testing.assert_array_equal(found, codes)
    bad = meters.copy()
    bad[0, 0] = np.inf
    for stored in (meters, bad, np.nan_to_num(meters), meters.astype(">f4"), meters.astype(np.float64)):
        found = depth_of(ROS1.image(stored, "32FC1" if stored.itemsize == 4 else "64FC1"))
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found, meters)


def test_quantized_inverse_depth_is_within_half_a_step():
    depth = np.array([[np.nan, 0.5, 1], [2.5, 4, 9.5]], np.float32)
    quantization, largest = 100.0, 10.0  # the defaults of compressed_depth_image_transport
    scale = quantization * (quantization + 1)
    offset = 1 - scale / largest
    codes = np.where(np.isfinite(depth), scale / np.nan_to_num(depth, nan=1) + offset + 0.5, 0).astype(np.uint16)
    data = struct.pack("<iff", 0, scale, offset) + png_bytes(codes)
    found = depth_of(ROS1.compressed(data, "32FC1; compressedDepth"))
    assert np.isnan(found[0, 0])
    step = depth**2 / scale
    assert (np.abs(found - depth)[np.isfinite(depth)] <= 0.51 * step[np.isfinite(depth)]).all()


@pytest.mark.parametrize(
    ("message", "wanted"),
    [
        (ROS1.image(GREY8, "weird8"), "encoding .*weird8"),
        (ROS1.image(GREY8, "rgb8"), "truncated: 48 bytes"),
        (ROS1.image(GREY8[:5], "bayer_rggb8"), "want even numbers"),
        (ROS1.image(GREY8[:0], "mono8"), "an image of 8 x 0 pixels"),
        (ROS1.compressed(b"", "jpeg"), "unknown|not an image|empty"),
        (ROS1.compressed(cv2.imencode(".jpg", RGB8)[1].tobytes()[:-40], "jpeg"), "JPEG"),
        (ROS1.compressed(b"123", "16UC1; compressedDepth"), "compressedDepth"),
    ],
)
def test_damaged_images_are_refused(message: Any, wanted: str):
    with pytest.raises(InputError, match=wanted):
        image_of(message)


@pytest.mark.parametrize(
    ("message", "wanted"),
    [
        (ROS1.image(RGB8, "rgb8"), "encoding .*rgb8"),
        (ROS1.compressed(b"123", "16UC1; compressedDepth"), "no header"),
        (ROS1.compressed(bytes(12) + png_bytes(GREY8), "16UC1; compressedDepth png"), "8-bit"),
        (ROS1.compressed(bytes(40), "16UC1; compressedDepth rvl"), "RVL"),
        (ROS1.compressed(NO_SCALE + png_bytes(GREY8.astype(np.uint16)), "32FC1; compressedDepth"), "damaged header"),
    ],
)
def test_damaged_depth_is_refused(message: Any, wanted: str):
    with pytest.raises(InputError, match=wanted):
        depth_of(message)


def camera(ros: Messages = ROS1, shift: float = 0.0, **more: Any) -> Any:
    matrix = np.array([[500.0, 0, 31.5], [0, 501, 23.5], [0, 0, 1]])
    projection = np.hstack([matrix, [[shift], [0], [0]]])
    return ros.info((64, 48), matrix, **{"projection": projection} | more)


@pytest.mark.parametrize("ros", [Messages("bag"), Messages("mcap")])
def test_geometry_of_a_rectified_pair(ros: Messages):
    left, right = camera_info(camera(ros)), camera_info(camera(ros, -60.0))
    assert left.is_undistorted and left.is_calibrated and right.is_undistorted
    geometry = rectified_geometry(left, right)
    assert geometry.baseline == pytest.approx(0.12) and geometry.size == (64, 48)
    assert rectified_geometry(left, left, 0.05).baseline == 0.05
    assert not camera_info(camera(ros, distortion=(0.1, 0, 0, 0, 0))).is_undistorted
    assert not camera_info(ros.info((64, 48), np.zeros((3, 3)))).is_calibrated


@pytest.mark.parametrize(
    ("right", "wanted"),
    [
        (camera(), "holds no baseline"),
        (camera(shift=60.0), "are left and right exchanged"),
        (camera(shift=-60000.0), "want meters"),
        (camera(shift=-60.0, projection=np.array([[510, 0, 31.5, -60], [0, 501, 23.5, 0], [0, 0, 1, 0]])), "fx is 500"),
        (camera(shift=-60.0, projection=np.array([[500, 0, 31.5, -60], [0, 501, 25.5, 0], [0, 0, 1, 0]])), "the rows"),
        (ROS1.info((32, 48), np.diag([500.0, 501, 1])), "images of"),
    ],
)
def test_cameras_that_contradict_each_other_are_refused(right: Any, wanted: str):
    with pytest.raises(InputError, match=wanted):
        rectified_geometry(camera_info(camera()), camera_info(right))


def test_camera_info_of_parts_of_images_is_refused():
    region = ROS1.make("sensor_msgs/RegionOfInterest", x_offset=8, y_offset=0, height=48, width=32, do_rectify=False)
    for message, wanted in (
        (camera(binning_x=2), "binned"),
        (camera(roi=region), "region of interest"),
        (camera(rotation=np.zeros((3, 3)) + 1), "no rotation"),
        (camera(distortion=(np.nan,) * 5), "not finite"),
    ):
        with pytest.raises(InputError, match=wanted):
            camera_info(message)


def test_a_raw_pair_becomes_files_that_rectify_reads(tmp_path: Path):
    from depthcli.io.formats.rigs import read_rig

    lens = (-0.2, 0.05, 0.001, -0.002, 0.0)
    left, right = (camera_info(camera(shift=shift, distortion=lens)) for shift in (0.0, -60.0))
    rig = read_rig([tmp_path / name for name in write_raw_pair(tmp_path, left, right)])
    assert rig.left.distortion == lens and rig.left.size == (64, 48)
    np.testing.assert_allclose(rig.translation, [-0.12, 0, 0])
    empty = tmp_path / "empty"
    empty.mkdir()
    for pair, wanted in (((right, left), "exchanged|no baseline"), ((left, left), "holds no baseline")):
        with pytest.raises(InputError, match=wanted):
            write_raw_pair(empty, *pair)
        assert not list(empty.iterdir())


def test_places_in_a_tree_of_frames():
    def edge(time: float, parent: str, child: str, *place: float) -> StampedPose:
        matrix = np.eye(4)
        matrix[:3, 3] = place
        return StampedPose(round(time * 1e9), parent, child, matrix)

    tree = Transforms()
    tree.add_fixed(
        [edge(0, "base", "mast", 0, 0, 1), edge(0, "mast", "left", 0.1, 0, 0), edge(0, "mast", "right", 0.3, 0, 0)]
    )
    tree.add([edge(1.0, "map", "base", 1, 0, 0), edge(1.1, "map", "base", 2, 0, 0), edge(9, "map", "base", 0, 0, 0)])
    fixed = tree.fixed("right", "left")
    assert fixed is not None and fixed[:3, 3] == pytest.approx([0.2, 0, 0])
    at = tree.at("/left", 1_050_000_000)
    assert at is not None and at[:3, 3] == pytest.approx([1.6, 0, 1])
    assert tree.at("left", 5 * 10**9) is None and tree.at("elsewhere", 10**9) is None
    assert tree.fixed("left", "elsewhere") is None
    with pytest.raises(InputError, match="two parents"):
        tree.add([edge(1.2, "odom", "base", 0, 0, 0)])
    tree.add_fixed([edge(0, "b", "a", 0, 0, 0), edge(0, "a", "b", 0, 0, 0)])  # a circle
    assert tree.at("a", 10**9) is None and tree.fixed("a", "left") is None


@pytest.mark.parametrize(
    ("times", "time", "place"),
    [
        ((0, 100), 30, 0.3),
        ((0, 200), 100, 1.0),  # both are 100 ms away
        ((0, 210), 100, None),  # one is farther
        ((0, 210), 20, 0.0),
        ((0, 100), 120, 1.0),
        ((0, 100), 121, None),
    ],
)
def test_poses_between_and_beside_those_that_are_known(times, time, place):
    track, start = Track("map"), START + 7  # in seconds since 1970, the last digits of it are lost
    for k, each in enumerate(times):
        matrix = np.eye(4)
        matrix[0, 3] = k * times[1] / 100 if times[1] != 210 else k
        track.times.append(start + each * 10**6)
        track.matrices.append(matrix)
    found = track.at(start + time * 10**6)
    assert (None if found is None else found[0, 3]) == (None if place is None else pytest.approx(place, abs=1e-9))


def test_a_pose_is_a_rotation():
    message = ROS1.pose_stamped(START, (1, 2, 3), (0, 0, np.sqrt(0.5), np.sqrt(0.5)))
    (pose,) = poses_in(message, "PoseStamped")
    assert (pose.time, pose.parent, pose.child) == (START, "world", "")
    np.testing.assert_allclose(pose.matrix @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-12)
    with pytest.raises(InputError, match="no pose"):
        poses_in(ROS1.pose_stamped(START, (1, 2, 3), (0, 0, 0, 0)), "PoseStamped")


@pytest.mark.parametrize("kind", FORMATS)
def test_recordings_are_found_and_their_topics_listed(tmp_path: Path, kind: str):
    ros = Messages(kind)
    records = [Record("/a", START + k * 10**8, ros.image(GREY8, "mono8", START + k)) for k in range(3)]
    path = write_recording(
        tmp_path / f"one.{kind}", [*records, Record("/b", START, ros.pose_stamped(START, (0, 0, 0)))]
    )
    assert find_recordings(tmp_path) == [path] == find_recordings(path)
    with open_recording(path) as recording:
        topics = recording.topics
        assert [(topic.name, topic.kind, topic.count) for topic in topics.values()] == [
            ("/a", "Image", 3),
            ("/b", "PoseStamped", 1),
        ]
        assert topics["/a"].rate == pytest.approx(10, rel=1e-3)
        messages = list(recording.messages({"/a"}))
        assert [message.time for message in messages] == [record.time for record in records]
        np.testing.assert_array_equal(image_of(recording.decode(messages[0])), GREY8)
    if kind != "bag":  # a file alone, without metadata.yaml
        (file,) = path.glob(f"*.{kind}")
        with open_recording(file) as recording:
            assert len(list(recording.messages({"/a"}))) == 3


@pytest.mark.parametrize("kind", FORMATS)
def test_damaged_recordings_are_one_line(tmp_path: Path, kind: str):
    ros = Messages(kind)
    path = write_recording(tmp_path / f"one.{kind}", [Record("/a", START, ros.image(GREY8, "mono8"))])
    file = path if kind == "bag" else next(path.glob(f"*.{kind}"))
    whole = file.read_bytes()
    for length in (0, 1, 20, len(whole) // 3, len(whole) - 40):
        file.write_bytes(whole[:length])
        for place in {path, file}:
            try:
                with open_recording(place) as recording:
                    for message in recording.messages(recording.topics):
                        recording.decode(message)
            except InputError as error:
                assert "\n" not in str(error) and str(error).startswith(str(place))
    rng = np.random.default_rng(0)
    for _ in range(60):
        bytes_ = np.frombuffer(whole, np.uint8).copy()
        bytes_[rng.integers(0, bytes_.size, 4)] = rng.integers(0, 256, 4)
        file.write_bytes(bytes_.tobytes())
        try:
            with open_recording(path) as recording:
                for message in recording.messages(recording.topics):
                    recording.read(message, image_of)
        except InputError as error:
            assert "\n" not in str(error)


def test_what_is_no_recording_is_refused(tmp_path: Path):
    (tmp_path / "a.txt").write_text("hello")
    for path, wanted in (
        (tmp_path / "a.txt", "no recording; want .bag"),
        (tmp_path, "no recordings in it"),
        (tmp_path / "none.bag", "no such file or folder"),
    ):
        with pytest.raises(InputError, match=wanted):
            open_recording(find_recordings(path)[0]).__enter__()


def test_bags_without_definitions_have_those_of_ros(tmp_path: Path):
    """As bags of ROS 2 before Iron are."""
    ros = Messages("db3")
    path = write_recording(tmp_path / "one.db3", [Record("/a", START, ros.image(GREY8, "mono8"))])
    (file,) = path.glob("*.db3")
    with contextlib.closing(sqlite3.connect(file)) as database, database:
        assert database.execute("DELETE FROM message_definitions").rowcount > 0
    with open_recording(path) as recording:
        (message,) = recording.messages({"/a"})
        np.testing.assert_array_equal(recording.read(message, image_of), GREY8)

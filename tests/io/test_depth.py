"""Depth files: the codes of the data sets, meters, round trips, point clouds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.kinect import kinect_v1
from depthcli.core.errors import InputError
from depthcli.io.formats.depth import SENSOR, implausible_depth, read_depth, write_depth_png, write_points
from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.images import write_png
from depthcli.io.formats.kinect import read_kinect_raw
from tests.scenes import DATA, needs_data


def test_codes_are_divided_by_their_scale(tmp_path: Path):
    path = tmp_path / "depth.png"
    write_png(path, np.array([[0, 1, 1500, 65535]], np.uint16))
    np.testing.assert_array_equal(read_depth(path), np.array([[np.nan, 0.001, 1.5, 65.535]], np.float32))
    np.testing.assert_array_equal(read_depth(path, 5000), np.array([[np.nan, 0.0002, 0.3, 13.107]], np.float32))
    write_png(path, np.array([[0, 100]], np.uint8))
    np.testing.assert_array_equal(read_depth(path, 50), np.array([[np.nan, 2]], np.float32))
    with pytest.raises(InputError, match=r"depth\.png: 8-bit depth needs a scale"):
        read_depth(path)


@pytest.mark.parametrize(
    ("depth", "scale", "says"),
    [
        (1.5, 1000, ""), (4.5, 1000, ""), (7.5, 1000, "a depth scale of 5000 would fit"),
        (0.3, 5000, "a depth scale of 1000 would fit"), (12, 1000, "a depth scale of 5000 would fit"),
        (30, 1000, "a depth scale of 8000 would fit"), (45, 1000, "a depth scale of 10000 would fit"),
    ],
)  # fmt: skip
def test_depths_that_no_such_sensor_sees_have_a_hint(depth: float, scale: float, says: str):
    text = implausible_depth("d.png", np.full((4, 5), depth, np.float32), scale, SENSOR)
    assert text.endswith(says) and bool(text) == bool(says)


def test_far_depths_are_no_sensors_whatever_the_median():
    depth = np.full((10, 10), 4, np.float32)
    depth[0] = 15
    text = implausible_depth("d.png", depth, 1000, SENSOR)
    assert "5 % are beyond 15 m, at 1000 codes per meter; a depth scale of 5000 would fit" in text
    assert implausible_depth("d.png", depth, 1000) == ""


def test_rotated_codes_and_what_are_none(tmp_path: Path):
    codes = np.array([[0, 7, 0x1234, 65535]], np.uint16)
    write_png(tmp_path / "sun.png", (codes << 3) | (codes >> 13))
    np.testing.assert_array_equal(read_depth(tmp_path / "sun.png", rotate=3)[0, 1:], codes[0, 1:] / np.float32(1000))
    for bad in (np.array([[-1]]), np.array([[70000]]), np.array([[1.5]])):
        np.save(tmp_path / "bad.npy", bad)
        with pytest.raises(InputError, match=r"bad\.npy: want codes"):
            read_kinect_raw(tmp_path / "bad.npy")


def test_meters(tmp_path: Path):
    values = np.array([[1.25, np.nan, np.inf, 0, -1]], np.float32)
    wanted = np.array([[1.25] + [np.nan] * 4], np.float32)
    write_pfm(tmp_path / "a.pfm", values)
    np.save(tmp_path / "a.npy", values.astype(np.float64))
    for name in ("a.pfm", "a.npy"):
        np.testing.assert_array_equal(read_depth(tmp_path / name), wanted)
        np.testing.assert_array_equal(read_depth(tmp_path / name, 1000), wanted / 1000)


def test_png_round_trip(tmp_path: Path):
    depth = np.random.default_rng(0).uniform(0.3, 9, (7, 9)).astype(np.float32)
    depth[0, :5] = np.nan, np.inf, 0, -2, 1e-9
    depth[1, 0] = 70  # meters: no code of a millimeter
    for scale in (1000.0, 5000.0):
        write_depth_png(tmp_path / "d.png", depth, scale)
        read = read_depth(tmp_path / "d.png", scale)
        assert np.isnan(read[0, :4]).all() and np.isnan(read[1, 0])
        assert read[0, 4] == np.float32(1 / scale)
        known = ~np.isnan(read)
        known[0, 4] = False
        assert known.sum() == 7 * 9 - 6
        assert np.abs(read - depth)[known].max() <= 0.5001 / scale


def test_point_cloud(tmp_path: Path):
    depth = np.array([[2, np.nan, 4], [1, 8, np.inf]], np.float32)
    color = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    camera = Intrinsics(fx=2, fy=4, cx=1, cy=0.5)
    near = depth < 5
    write_points(tmp_path / "a.ply", camera.points(depth, near), color[near])
    header, _, body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    assert header.split(b"\n") == [
        b"ply", b"format binary_little_endian 1.0", b"element vertex 3", b"property float x", b"property float y",
        b"property float z", b"property uchar red", b"property uchar green", b"property uchar blue", b"",
    ]  # fmt: skip
    points = np.frombuffer(body, [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    np.testing.assert_array_equal(points["xyz"], [[-1, -0.25, 2], [2, -0.5, 4], [-0.5, 0.125, 1]])
    np.testing.assert_array_equal(points["rgb"], [[0, 1, 2], [6, 7, 8], [9, 10, 11]])
    for row, column, (x, y, z) in zip([0, 0, 1], [0, 2, 0], points["xyz"], strict=True):  # projects onto its pixel
        assert (camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy) == (column, row)


@needs_data
def test_raw_kinect_codes():
    codes = read_kinect_raw(DATA / "rgbd_nyu/raw_dump/disparity_raw_byteswapped.pgm")
    assert codes.max() == 2047
    known = codes < 2047
    assert 0.5 < np.nanmedian(kinect_v1().depth_of_raw(codes)) < 5 and known.mean() > 0.5

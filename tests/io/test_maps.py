"""Files of disparities and depths: exact round trips, the formats of the benchmarks and sensors byte by byte."""

import struct
import sys
import tempfile
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import depthcli
from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.errors import InputError
from depthcli.io.formats import disparity
from depthcli.io.formats.depth import SENSOR, implausible_depth, read_depth, write_depth_png, write_points
from depthcli.io.formats.disparity import (
    ScaleError,
    encode_pfm,
    known_truth,
    read_disparity,
    read_foreign_map,
    read_mask,
    read_pfm,
    read_plane,
    write_disparity_png,
    write_pfm,
)
from depthcli.io.formats.images import image_size, read_image, write_png
from depthcli.io.rgbd_frames import kinect_v1, load_masked_frame, read_kinect_raw
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.frames import FRAMES
from depthcli.io.scenes.pairs import PAIRS
from depthcli.problems.inputs import as_depth, as_image, as_map, as_volume
from tests.command_line import vertices
from tests.files import laid
from tests.golden import refused, saying, warned
from tests.scenes import DATA, needs_data, true

maps = hnp.arrays(np.float32, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9), elements=st.floats(width=32))
PLANE = np.arange(1, 21, dtype=np.float32).reshape(4, 5)


def usual() -> np.ndarray:
    """Disparities or depths that nothing is said about."""
    return np.random.default_rng(0).uniform(2, 40, (40, 60)).astype(np.float32)


def truth(path: Path, *options: float) -> np.ndarray:
    """A map read as the ground truth is: of a scale, if any, with a mark, if any."""
    return known_truth(path, read_disparity(path, *options[:1]), *options[1:])


@given(maps)
@settings(max_examples=100, deadline=None)
def test_round_trips(values):
    known = np.isfinite(values)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.pfm"
        write_pfm(path, values)
        np.testing.assert_array_equal(read_pfm(path), np.where(np.isnan(values), np.float32(np.inf), values))
        np.testing.assert_array_equal(read_disparity(path), np.where(known, values, np.float32(np.nan)))
        write_disparity_png(Path(folder) / "a.png", values)
        read = read_disparity(Path(folder) / "a.png")
    np.testing.assert_array_equal(np.isnan(read), ~known)
    kept = np.clip(values[known].astype(float), 1 / 256, 65535 / 256)
    assert np.all(np.abs(read[known] - kept) <= 0.5 / 256 + 1e-9)


def test_pfm_bytes_both_byte_orders_and_what_follows(tmp_path: Path):
    values = np.array([[1, 2, np.nan], [4, 5, 6]], np.float32)
    path = tmp_path / "a.pfm"
    write_pfm(path, values)
    stored = np.array([[4, 5, 6], [1, 2, np.inf]])
    assert path.read_bytes() == b"Pf\n3 2\n-1\n" + stored.astype("<f4").tobytes()
    for header in (b"Pf\n3 2\n1.0\n", b"Pf 3 2 1\n", b"Pf\r\n3 2\r\n0.25\r\n"):
        path.write_bytes(header + stored.astype(">f4").tobytes())
        np.testing.assert_array_equal(read_disparity(path), values)
    path.write_bytes(b"PF\n3 2\n-1\n" + np.repeat(stored[..., None], 3, axis=2).astype("<f4").tobytes())
    np.testing.assert_array_equal(read_disparity(path), values)
    for more in (b"\0", b"\n", bytes(24), b"Pf\n3 2\n-1\n"):
        path.write_bytes(encode_pfm(PLANE / 8) + more)
        for read in (read_pfm, read_plane, read_disparity):
            found, lines = warned(read, path)
            np.testing.assert_array_equal(found, PLANE / 8)
            assert lines == [f"{path}: the PFM has {len(more)} bytes more than its 5 x 4 values; they are ignored"]
        assert image_size(path) == (4, 5)


@pytest.mark.parametrize("factor", [1, 256, -256])
def test_disparities_wider_than_the_image_are_warned_of(tmp_path: Path, factor: int):
    write_pfm(tmp_path / "map.pfm", np.full((4, 20), 7 * factor, np.float32))
    _, lines = warned(read_disparity, tmp_path / "map.pfm")
    assert ["wider than the image of 20 px" in line for line in lines] == [True] * (factor != 1)


def test_bad_pfm(tmp_path: Path):
    for data in (
        b"", b"Pf", b"Pf\n3 2\n", b"Pf\n3 2\n0\n" + bytes(24), b"Pf\n3 2\nx\n" + bytes(24), b"Pf\n0 2\n-1\n",
        b"Pf\n3 2\n-1\n" + bytes(23), b"P5\n3 2\n-1\n" + bytes(24), b"Pf\n-3 2\n-1\n" + bytes(24),
        b"PF\n1 1\n-1\n" + bytes(range(12)), b"Pf\n3 2\n-\n" + bytes(24), b"Pf\n99999999 99999999\n-1\n" + bytes(24),
    ):  # fmt: skip
        (tmp_path / "bad.pfm").write_bytes(data)
        refused(InputError, read_disparity, tmp_path / "bad.pfm")
    for write in (write_pfm, write_disparity_png):
        refused(ValueError, write, tmp_path / "bad.pfm", PLANE[None])


def test_codes_are_divided_by_their_scale(tmp_path: Path):
    path = tmp_path / "a.png"
    write_png(path, np.array([[0, 40, 255]], np.uint8))
    np.testing.assert_array_equal(read_disparity(path, 4), [[np.nan, 10, 63.75]])
    np.testing.assert_array_equal(read_disparity(path, scale_8bit=8), [[np.nan, 5, 31.875]])
    refused(InputError, read_disparity, path)
    codes = np.array([[0, 256, 640]], np.uint16)
    write_png(path, codes)
    np.testing.assert_array_equal(read_disparity(path, scale_8bit=8), [[np.nan, 1, 2.5]])
    assert read_image(path).dtype == np.uint16
    write_png(path, np.tile(codes, 20))  # wider than 40 px, OpenCV's reading
    for read in (read_foreign_map, partial(read_disparity, asks=True)):
        refused(ScaleError, read, path)
    for known in (path, tmp_path / "disp_0" / "a.png"):
        write_png(known, codes)
        np.testing.assert_array_equal(read_foreign_map(known, is_kitti=known == path), [[np.nan, 1, 2.5]])
    for dtype in ("i4", "u4", "i8", "u1", "i1", "?"):  # without a usual scale
        np.save(tmp_path / "a.npy", np.full((4, 5), 3).astype(dtype))
        refused(InputError, read_disparity, tmp_path / "a.npy")
        assert dtype == "?" or (read_disparity(tmp_path / "a.npy", 1) == 3).all()


@pytest.mark.parametrize(("name", "write"), [("a.npy", np.save), ("a.tif", tifffile.imwrite)])
def test_integers_and_halves_of_npy_and_tiff(tmp_path: Path, name: str, write):
    """Signed codes are OpenCV's; a mark that is given is rounded as the numbers."""
    path = tmp_path / name
    write(path, np.array([[-16, 0, 24, 320]], np.int16))
    read, lines = warned(read_disparity, path)
    np.testing.assert_array_equal(read, [[np.nan, np.nan, 1.5, 20]])
    assert f"{name}: int16 disparities are divided by 16" in lines[0]
    for dtype in (np.float16, np.float32, np.float64, np.int16):
        write(path, np.array([[-9999, 3, 4.0]]).astype(dtype))
        for reader in (read_foreign_map, truth):
            np.testing.assert_array_equal(reader(path, 1.0, -9999.0), [[np.nan, 3, 4]])


@pytest.mark.parametrize("read", [read_foreign_map, truth])
def test_marks_of_no_value_are_the_same_for_maps_and_truth(tmp_path: Path, read):
    path, values = tmp_path / "a.npy", usual()
    for mark in (-9999.0, -999.0, -1.0, 1e6, 65535.0):
        values[:9] = mark
        np.save(path, values)
        found, lines = warned(read, path)
        np.testing.assert_array_equal(found[9:], values[9:])
        assert np.isnan(found[:9]).all() and any(f"22.5 % of the pixels are {mark:g}" in line for line in lines)
    for dtype, scale in ((np.uint8, 8.0), (np.uint16, 2000.0), (np.int16, 1000.0)):  # whose largest code is none
        top = np.iinfo(dtype).max
        codes = np.random.default_rng(0).uniform(2 * scale, 0.7 * top, (40, 60)).astype(dtype)
        codes[:9], codes[20, 20:24] = top, 3 * scale
        np.save(path, codes)
        found, lines = warned(read, path, scale)
        np.testing.assert_array_equal(np.isnan(found), codes == top)
        assert any(f"22.5 % of the pixels are {top}" in line for line in lines)
        assert not np.isnan(read_foreign_map(path, scale, np.nan)).any()
    several = usual()
    several[0, :4], several[1, :9], several[2:6], several[7, 0] = -9999, 1e6, -1, 55
    np.save(path, several)
    found, lines = warned(read, path)
    np.testing.assert_array_equal(np.isnan(found), (several < 0) | (several > 100))
    assert len(lines) == 3


def test_zero_stays_a_true_disparity_with_a_warning(tmp_path: Path):
    path, values = tmp_path / "a.pfm", usual()
    values[:9] = 0
    write_pfm(path, values)
    found, lines = warned(known_truth, path, values)
    np.testing.assert_array_equal(found, values)
    assert "22.5 % of the pixels are 0" in lines[0] and "--invalid 0" in lines[0]
    assert np.isnan(known_truth(path, values, 0.0)[:9]).all()
    np.testing.assert_array_equal(known_truth(path, values, np.nan), values)


@pytest.mark.parametrize("shape", [(1, 4, 5), (4, 5, 1), (1, 1, 4, 5), (1, 4, 5, 1)])
def test_axes_of_length_one_are_dropped(tmp_path: Path, shape):
    values = PLANE.reshape(shape)
    np.save(tmp_path / "a.npy", values)
    np.savez(tmp_path / "a.npz", values)
    of_files = [read_disparity(tmp_path / name) for name in ("a.npy", "a.npz")]
    for found in (*of_files, as_map(values, "map"), as_depth(values, "map", None)):
        np.testing.assert_array_equal(found, PLANE)


def test_masked_arrays_keep_their_mask():
    values = np.ma.masked_less(PLANE, 6)
    for one in (values, (values * 1000).astype(np.uint16)):
        for found in (as_map(one, "map"), as_depth(one, "map", 1000.0)):
            assert np.isnan(found[0]).all() and not np.isnan(found[1:]).any()
    refused(InputError, as_image, np.ma.masked_less(np.arange(20).reshape(4, 5), 6), "image")
    assert np.isnan(as_volume(np.ma.masked_less(np.ones((2, 3, 4)), 2), "volume")).all()


def test_npy_and_npz(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.npy"
    np.save(path, np.array([[1.5, np.inf, np.nan]]))
    np.testing.assert_array_equal(read_disparity(path), [[1.5, np.nan, np.nan]])
    assert image_size(path) == (1, 3)
    for bad in (np.zeros(3), np.array([["a"]]), np.zeros((0, 3)), np.array([[{}]], object)):
        np.save(path, bad, allow_pickle=True)
        refused(InputError, read_disparity, path)
    np.savez(tmp_path / "one.npz", anything=PLANE)
    np.savez(tmp_path / "named.npz", depth=PLANE, seconds=np.ones(2))
    np.savez(tmp_path / "unnamed.npz", x=PLANE, y=PLANE)
    for name in ("one", "named"):
        np.testing.assert_array_equal(read_disparity(tmp_path / f"{name}.npz"), PLANE)
    refused(InputError, read_disparity, tmp_path / "unnamed.npz")
    whole = (tmp_path / "one.npz").read_bytes()
    for n_bytes in (10, len(whole) // 2, len(whole) - 3):
        (tmp_path / "cut.npz").write_bytes(whole[:n_bytes])
        refused(InputError, read_disparity, tmp_path / "cut.npz")
    np.savez(tmp_path / "a.npz", disp=PLANE, valid=PLANE > 3)
    with (tmp_path / "b.npy").open("wb") as file:
        np.save(file, PLANE)
        np.save(file, PLANE + 1)
    for name, said in (("a.npz", "'disp' is read, not valid"), ("b.npy", "bytes follow")):
        found, lines = warned(read_plane, tmp_path / name)
        np.testing.assert_array_equal(found, PLANE)
        assert len(lines) == 1 and f"{name}: " in lines[0] and said in lines[0]
    monkeypatch.setattr(disparity, "_MAX_UNPACKED_BYTES", 20)
    refused(InputError, read_plane, tmp_path / "one.npz")


def test_codes_and_meters_of_depth(tmp_path: Path):
    path, codes = tmp_path / "depth.png", np.array([[0, 1, 1500, 65534]], np.uint16)
    write_png(path, codes)
    np.testing.assert_array_equal(read_depth(path), np.array([[np.nan, 0.001, 1.5, 65.534]], np.float32))
    np.testing.assert_array_equal(read_depth(path, 5000), np.array([[np.nan, 0.0002, 0.3, 13.1068]], np.float32))
    write_png(path, (codes << 3) | (codes >> 13))
    np.testing.assert_array_equal(read_depth(path, rotate=3)[0, 1:], codes[0, 1:] / np.float32(1000))
    write_png(path, np.array([[0, 100]], np.uint8))
    np.testing.assert_array_equal(read_depth(path, 50), [[np.nan, 2]])
    refused(InputError, read_depth, path)
    values = np.array([[1.25, np.nan, np.inf, 0, -1]], np.float32)
    wanted = np.where(values == 1.25, values, np.float32(np.nan))
    laid(tmp_path, {"a.pfm": values, "a.npy": values.astype(np.float64)})  # meters
    for name in ("a.pfm", "a.npy"):
        np.testing.assert_array_equal(read_depth(tmp_path / name), wanted)
        np.testing.assert_array_equal(read_depth(tmp_path / name, 1000), wanted / 1000)
    for bad in ([[-1]], [[70000]], [[1.5]], [[2048 + 8]]):  # the last one in either byte order
        np.save(tmp_path / "bad.npy", np.array(bad))
        refused(InputError, read_kinect_raw, tmp_path / "bad.npy")
    np.save(tmp_path / "swapped.npy", np.array([[917, 2047]], np.uint16).byteswap())
    np.testing.assert_array_equal(read_kinect_raw(tmp_path / "swapped.npy"), [[917, 2047]])
    np.save(tmp_path / "bad.npy", np.array([[True]]))
    refused(InputError, read_depth, tmp_path / "bad.npy")


def test_depths_that_no_such_sensor_sees_have_a_hint():
    for depth, scale, fitting in (
        (1.5, 1000, ""), (4.5, 1000, ""), (7.5, 1000, 5000), (0.3, 5000, 1000), (12, 1000, 5000), (30, 1000, 8000),
        (45, 1000, 10000),
    ):  # fmt: skip
        text = implausible_depth("d.png", np.full((4, 5), depth, np.float32), scale, SENSOR)
        assert text.endswith(f"a depth scale of {fitting} would fit" if fitting else "") and bool(text) == bool(fitting)
    depth = np.full((10, 10), 4, np.float32)
    depth[0] = 15  # far ones are no sensor's, whatever the median
    text = implausible_depth("d.png", depth, 1000, SENSOR)
    assert "5 % are beyond 15 m, at 1000 codes per meter; a depth scale of 5000 would fit" in text
    assert implausible_depth("d.png", depth, 1000) == ""


def test_png_round_trip(tmp_path: Path):
    depth = np.random.default_rng(0).uniform(0.3, 9, (7, 9)).astype(np.float32)
    depth[0, :5] = np.nan, np.inf, 0, -2, 1e-9
    depth[1, 0] = 70  # meters: no code of a millimeter
    for scale in (1000.0, 5000.0):
        depth[1, 1] = 65534 / scale
        write_depth_png(tmp_path / "d.png", depth, scale)
        read = read_depth(tmp_path / "d.png", scale)
        assert np.isnan(read[0, :4]).all() and np.isnan(read[1, 0]) and read[0, 4] == np.float32(1 / scale)
        known = ~np.isnan(read)
        known[0, 4] = False
        assert known.sum() == 7 * 9 - 6
        assert np.abs(read - depth)[known].max() <= 0.5001 / scale


@pytest.mark.parametrize(("stored", "dtype", "mark"), [
    ([1500, 65535, 2000], np.uint16, "65535"), ([1.5, 1e10, 2], np.float32, "1e+10"),
    ([1.5, 65504, 2], np.float16, "65504"), ([1.5, 1e6, 2], np.float64, "1e+06"),
    ([30, 255, 40], np.uint8, "255"), ([150, 32767, 200], np.int16, "32767"),
])  # fmt: skip
def test_largest_numbers_are_no_depth(tmp_path: Path, stored, dtype, mark):
    np.save(tmp_path / "d.npy", np.array([stored], dtype))
    read, lines = warned(read_depth, tmp_path / "d.npy", {np.uint8: 20.0, np.int16: 100.0}.get(dtype))
    np.testing.assert_array_equal(read, [[1.5, np.nan, 2]])
    assert "d.npy: 33.3 %" in lines[0] and mark in lines[0]


def test_a_depth_far_beyond_all_others_is_none(tmp_path: Path):
    path, depth = tmp_path / "d.pfm", np.random.default_rng(0).uniform(1, 30, (20, 30)).astype(np.float32)
    depth[:2, :3], depth[5, 5] = 10_000, 45
    write_pfm(path, depth)
    read, lines = warned(read_depth, path)
    np.testing.assert_array_equal(np.isnan(read), depth == 10_000)
    assert "d.pfm: 1 % of the pixels are 10000" in lines[0]
    write_pfm(path, np.where(depth == 10_000, 95, depth))
    assert not np.isnan(read_depth(path)).any()


def test_raw_codes_of_a_kinect_are_no_millimeters(tmp_path: Path):
    codes = np.full((20, 30), 917, np.uint16)
    write_png(tmp_path / "d.png", codes)
    assert read_depth(tmp_path / "d.png")[0, 0] == np.float32(0.917)
    codes[:3] = 2047
    write_png(tmp_path / "d.png", codes)
    np.save(tmp_path / "d.npy", codes.astype(np.int32))
    for name in ("d.png", "d.npy"):
        refused(InputError, read_depth, tmp_path / name)
        assert read_depth(tmp_path / name, 1000)[0, 0] == np.float32(2.047)
    codes[5, 5] = 2048  # not the largest code
    write_png(tmp_path / "d.png", codes)
    assert read_depth(tmp_path / "d.png")[0, 0] == np.float32(2.047)


def test_point_cloud(tmp_path: Path):
    depth = np.array([[2, np.nan, 4], [1, 8, np.inf]], np.float32)
    color = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    camera = Intrinsics(fx=2, fy=4, cx=1, cy=0.5)
    near = depth < 5
    write_points(tmp_path / "a.ply", camera.points(depth, near), color[near])
    header = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")[0]
    assert header.split(b"\n") == [
        b"ply", b"format binary_little_endian 1.0", b"element vertex 3", b"property float x", b"property float y",
        b"property float z", b"property uchar red", b"property uchar green", b"property uchar blue", b"",
    ]  # fmt: skip
    points = vertices(tmp_path / "a.ply")
    np.testing.assert_array_equal(points["xyz"], [[-1, -0.25, 2], [2, -0.5, 4], [-0.5, 0.125, 1]])
    np.testing.assert_array_equal(points["rgb"], [[0, 1, 2], [6, 7, 8], [9, 10, 11]])


@needs_data
def test_raw_kinect_codes():
    codes = read_kinect_raw(DATA / "rgbd_nyu/raw_dump/disparity_raw_byteswapped.pgm")
    known = codes < 2047
    assert codes.max() == 2047 and known.mean() > 0.5
    assert 0.5 < np.nanmedian(kinect_v1().depth_of_raw(codes)) < 5


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8", "i1", "i2", "i4", "u4", ">i2", ">f4", ">f2", ">f8"])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_maps_of_every_kind_of_number(tmp_path: Path, dtype, compression):
    values = np.random.default_rng(0).integers(*((0, 1 << 31) if "u" in dtype else (-100, 100)), (40, 50))
    values = (values.astype(dtype) / (8 if "f" in dtype else 1)).astype(dtype)
    if "f" in dtype:
        values[0, 0], values[5, 3], values[9, 9] = np.nan, np.inf, np.finfo(dtype).max
    order = {"byteorder": ">"} if dtype.startswith(">") else {}
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, values, compression=compression, rowsperstrip=6, **order)
    data, read = path.read_bytes(), read_plane(path)
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(read, values.astype(read.dtype))
    assert read.dtype == np.float32 if "f4" in dtype or "f8" in dtype else read.dtype.kind == values.dtype.kind
    for size in range(0, len(data) - 4, len(data) // 25):
        path.write_bytes(data[:size])
        with pytest.raises(InputError):
            read_plane(path)


# Channels of OpenEXR.

DEPTHS = np.random.default_rng(0).uniform(0.5, 3, (5, 7)).astype(np.float32)


def exr(folder: Path, **channels: np.ndarray) -> Path:
    OpenEXR = pytest.importorskip("OpenEXR")
    path = folder / "a.exr"
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name.replace("_", "."): values for name, values in channels.items()}).write(str(path))
    return path


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("names", [("Z",), ("V",), ("R", "G", "B"), ("R", "G", "B", "A"), ("Depth_V",)])
def test_one_channel_of_values_of_an_exr(tmp_path: Path, dtype, names):
    values = DEPTHS.astype(dtype)
    channels = {name: np.ones_like(values) if name == "A" else values for name in names}
    path = exr(tmp_path, **channels)
    found, lines = warned(read_plane, path)
    np.testing.assert_array_equal(found, values)
    assert not lines and image_size(path) == (5, 7)


def test_the_channels_that_are_left_out_are_named_and_guesses_refused(tmp_path: Path, monkeypatch, capfd):
    path = exr(tmp_path, R=DEPTHS, G=DEPTHS + 1, B=DEPTHS + 2, Z=DEPTHS + 3)
    found, lines = warned(read_plane, path)
    np.testing.assert_array_equal(found, DEPTHS + 3)
    assert "a.exr: its channel 'Z' is read" in lines[0] and "G" in lines[0]
    refused(InputError, read_plane, exr(tmp_path, R=DEPTHS, G=DEPTHS + 1, B=DEPTHS))
    refused(InputError, read_image, path)
    OpenEXR = pytest.importorskip("OpenEXR")
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage}, {"Z": DEPTHS}, name=name) for name in ("left", "right")]
    OpenEXR.File(parts).write(str(path))
    refused(InputError, read_plane, path)
    whole = exr(tmp_path, Z=DEPTHS).read_bytes()
    start = whole.index(b"dataWindow") + 21  # behind "dataWindow", "box2i" and a size
    box, huge = struct.pack("<4i", 0, 0, 6, 4), struct.pack("<4i", 0, 0, 1 << 20, 1 << 20)
    shown = whole.rindex(box)
    assert whole[start : start + 16] == box and shown != start
    for data in (
        whole[:200], whole[:-20], whole[:start] + huge + whole[start + 16 :],
        whole[:shown] + struct.pack("<4i", 0, 0, 9, 9) + whole[shown + 16 :],  # a part of a larger image
    ):  # fmt: skip
        path.write_bytes(data)
        refused(InputError, read_plane, path)
    halved = OpenEXR.Channel(DEPTHS[:4, :6].copy(), 2, 2)  # a value for each four pixels
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Z": halved}).write(str(path))
    refused(InputError, read_plane, path)
    assert capfd.readouterr() == ("", "")  # of the library
    path = exr(tmp_path, Z=DEPTHS)  # without the library the extra is named
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    refused(InputError, read_plane, path)


# Masks are read by one rule: above half of the largest value is inside, whatever that is.

INSIDE = np.zeros((24, 32), bool)
INSIDE[6:18, 8:24] = True
CODES = np.full(INSIDE.shape, 2000, np.uint16)
COLOR = np.full((*INSIDE.shape, 3), 90, np.uint8)
VIEWS = {"left.png": COLOR, "right.png": COLOR, "disp_left.pfm": np.full(INSIDE.shape, 3, np.float32)}


def frame(folder: Path, mask: np.ndarray):
    images = {"color.png": COLOR, "depth.png": CODES, "depth_true.png": CODES, "mask_transparent.png": mask}
    (scene,) = discover_scenes(laid(folder, images), FRAMES)
    return scene


@pytest.mark.parametrize("top", [1, 2, 128, 200, 255, 1000, 65535])
def test_any_largest_value(tmp_path: Path, top: int):
    """In every reader, that of glass and those of an evaluation."""
    mask = (INSIDE * top).astype(np.uint8 if top < 256 else np.uint16)
    scene = frame(tmp_path / "a", mask)
    found, lines = warned(read_mask, tmp_path / "a/mask_transparent.png")
    assert not lines
    (pair,) = discover_scenes(laid(tmp_path / "s", VIEWS | {"mask_nonocc.png": mask}), PAIRS)
    of_truth = true(scene).masks["transparent"], true(pair).masks["nonocc"]
    for read in (found, load_masked_frame(scene).objects, *of_truth):
        np.testing.assert_array_equal(read, INSIDE)


def test_masks_of_middlebury_jpeg_and_labels(tmp_path: Path):
    three, labels = INSIDE.astype(np.uint8) * 255, INSIDE.astype(np.uint8) * 5
    three[:3], labels[0, :4] = 128, 2
    laid(tmp_path, {"m.png": three, "l.png": labels})
    cv2.imwrite(str(tmp_path / "m.jpg"), cv2.GaussianBlur(INSIDE.astype(np.uint8) * 255, (3, 3), 0))
    for name, is_said in (("m.png", False), ("m.jpg", True), ("l.png", True)):
        found, lines = warned(read_mask, tmp_path / name)
        np.testing.assert_array_equal(found, INSIDE)
        assert [name in line for line in lines] == [True] * is_said
    for value in (-1, np.nan, np.inf):
        laid(tmp_path, {"m.npy": np.where(INSIDE, 1, value)})
        refused(InputError, read_mask, tmp_path / "m.npy")


def test_an_empty_mask_fails_the_glass_and_is_said_in_evaluation(tmp_path: Path):
    scene = frame(tmp_path / "a", np.zeros(INSIDE.shape, np.uint8))
    refused(InputError, load_masked_frame, scene)
    refused(InputError, load_masked_frame, frame(tmp_path / "full", np.full(INSIDE.shape, 255, np.uint8)))
    _, lines = warned(true, scene)
    assert "mask_transparent.png: no pixel is inside" in lines[0]
    with saying(InputError):
        depthcli.complete_transparent(np.zeros((24, 32, 3), np.uint8), CODES, objects=np.zeros((24, 32), bool))

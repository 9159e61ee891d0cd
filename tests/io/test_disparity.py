"""Disparity files: exact round trips, the formats of the benchmarks byte by byte."""

from __future__ import annotations

import struct
import tempfile
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from depthcli.core.errors import InputError
from depthcli.io.formats.disparity import (
    encode_pfm,
    read_disparity,
    read_pfm,
    read_plane,
    write_disparity_png,
    write_pfm,
)
from depthcli.io.formats.files import collected_warnings
from depthcli.io.formats.images import read_image, write_png

maps = hnp.arrays(np.float32, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9), elements=st.floats(width=32))


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


def test_pfm_bytes_and_both_byte_orders(tmp_path: Path):
    values = np.array([[1, 2, np.nan], [4, 5, 6]], np.float32)
    path = tmp_path / "a.pfm"
    write_pfm(path, values)
    stored = np.array([[4, 5, 6], [1, 2, np.inf]])
    assert path.read_bytes() == b"Pf\n3 2\n-1\n" + stored.astype("<f4").tobytes()
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), stored[::-1])
    for header in (b"Pf\n3 2\n1.0\n", b"Pf 3 2 1\n", b"Pf\r\n3 2\r\n0.25\r\n"):
        path.write_bytes(header + stored.astype(">f4").tobytes())
        np.testing.assert_array_equal(read_disparity(path), values)
    path.write_bytes(b"PF\n3 2\n-1\n" + np.repeat(stored[..., None], 3, axis=2).astype("<f4").tobytes())
    np.testing.assert_array_equal(read_disparity(path), values)


@pytest.mark.parametrize("more", [b"\0", b"\n", bytes(24), b"Pf\n3 2\n-1\n"])
def test_bytes_behind_a_pfm_are_ignored_with_a_warning(tmp_path: Path, more: bytes):
    file = tmp_path / "long.pfm"
    values = np.arange(6, dtype=np.float32).reshape(2, 3)
    file.write_bytes(encode_pfm(values) + more)
    for read in (read_pfm, read_plane, read_disparity):
        with collected_warnings() as lines:
            assert np.array_equal(read(file), values)
        assert lines == [f"{file}: the PFM has {len(more)} bytes more than its 3 x 2 values; they are ignored"]


@pytest.mark.parametrize("factor", [1, 256, -256])
def test_disparities_wider_than_the_image_are_warned_of(tmp_path: Path, factor: int):
    file = tmp_path / "map.pfm"
    write_pfm(file, np.full((4, 20), 7 * factor, np.float32))
    with collected_warnings() as lines:
        read_disparity(file)
    assert ["wider than the image of 20 px" in line for line in lines] == [True] * (factor != 1)


@pytest.mark.parametrize("data", [
    b"", b"Pf", b"Pf\n3 2\n", b"Pf\n3 2\n0\n" + bytes(24), b"Pf\n3 2\nx\n" + bytes(24), b"Pf\n0 2\n-1\n",
    b"Pf\n3 2\n-1\n" + bytes(23), b"P5\n3 2\n-1\n" + bytes(24),
    b"Pf\n-3 2\n-1\n" + bytes(24), b"PF\n1 1\n-1\n" + bytes(range(12)), b"Pf\n3 2\n-\n" + bytes(24),
    b"Pf\n99999999 99999999\n-1\n" + bytes(24),
])  # fmt: skip
def test_bad_pfm(tmp_path: Path, data):
    (tmp_path / "bad.pfm").write_bytes(data)
    with pytest.raises(InputError, match=r"bad\.pfm"):
        read_disparity(tmp_path / "bad.pfm")


def test_codes_are_divided_by_their_scale(tmp_path: Path):
    path = tmp_path / "a.png"
    write_png(path, np.array([[0, 40, 255]], np.uint8))
    np.testing.assert_array_equal(read_disparity(path, 4), np.array([[np.nan, 10, 63.75]], np.float32))
    np.testing.assert_array_equal(read_disparity(path, scale_8bit=8), np.array([[np.nan, 5, 31.875]], np.float32))
    with pytest.raises(InputError, match="disp_scale"):
        read_disparity(path)
    write_png(path, np.array([[0, 256, 640]], np.uint16))
    np.testing.assert_array_equal(read_disparity(path, scale_8bit=8), np.array([[np.nan, 1, 2.5]], np.float32))
    assert read_image(path).dtype == np.uint16


def test_npy(tmp_path: Path):
    path = tmp_path / "a.npy"
    np.save(path, np.array([[1.5, np.inf, np.nan]]))
    np.testing.assert_array_equal(read_disparity(path), np.array([[1.5, np.nan, np.nan]], np.float32))
    np.save(path, np.array([[-16, 0, 24]], np.int16))  # OpenCV's fixed point, -16 = none
    np.testing.assert_array_equal(read_disparity(path, 16), np.array([[np.nan, np.nan, 1.5]], np.float32))
    for bad in (np.zeros(3), np.array([["a"]]), np.zeros((0, 3)), np.array([[{}]], object)):
        np.save(path, bad, allow_pickle=True)
        with pytest.raises(InputError, match=r"a\.npy"):
            read_disparity(path)


def _float_tiff(values: np.ndarray, order: str, deflated: bool, rows: int) -> bytes:
    """Strips of ``rows`` rows, samples of 32 or 64 bit, little (<) or big (>) endian."""
    height, width = values.shape
    bits = 8 * values.dtype.itemsize
    parts = [values[y : y + rows].astype(values.dtype.newbyteorder(order)).tobytes() for y in range(0, height, rows)]
    parts = [zlib.compress(part) if deflated else part for part in parts]
    places = [8 + sum(map(len, parts[:k])) for k in range(len(parts))]
    head = {256: width, 257: height, 258: bits, 259: 8 if deflated else 1, 262: 1, 277: 1, 278: rows, 339: 3}
    body = b"".join(parts)
    lists, tables = {273: places, 279: [len(part) for part in parts]}, b""
    for tag, numbers in lists.items():
        head[tag] = 8 + len(body) + len(tables)
        tables += struct.pack(f"{order}{len(numbers)}I", *numbers)
    entries = b""
    for tag, value in sorted(head.items()):
        count = len(lists.get(tag, [0]))
        entries += struct.pack(f"{order}HHII", tag, 4, count, lists[tag][0] if tag in lists and count == 1 else value)
    start = struct.pack(f"{order}HI", 42, 8 + len(body) + len(tables))
    order_mark = b"II" if order == "<" else b"MM"
    return order_mark + start + body + tables + struct.pack(f"{order}H", len(head)) + entries + bytes(4)


@pytest.mark.parametrize("deflated", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_float_tiff_of_either_width_and_byte_order(tmp_path: Path, dtype: type, order: str, deflated: bool):
    values = np.random.default_rng(6).uniform(1, 90, (23, 17)).astype(dtype)
    values[0, 0], values[5, 3], values[9, 9] = np.nan, np.inf, np.finfo(dtype).max
    data = _float_tiff(values, order, deflated, rows=6)
    path = tmp_path / "map.tif"
    path.write_bytes(data)
    with np.errstate(over="ignore"):
        nearest = values.astype(np.float32)
    plane = read_plane(path)
    assert plane.dtype == np.float32
    assert np.array_equal(plane, nearest, equal_nan=True)
    expected = np.where(np.isfinite(nearest), nearest, np.nan)
    assert np.array_equal(read_disparity(path), expected, equal_nan=True)
    for size in range(0, len(data) - 4, max(1, len(data) // 50)):
        path.write_bytes(data[:size])
        with pytest.raises(InputError):
            read_plane(path)


def test_npz_files(tmp_path: Path):
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    np.savez(tmp_path / "one.npz", anything=values)
    np.savez(tmp_path / "named.npz", depth=values, seconds=np.ones(2))
    np.savez(tmp_path / "unnamed.npz", x=values, y=values)
    for name in ("one", "named"):
        np.testing.assert_array_equal(read_disparity(tmp_path / f"{name}.npz"), values)
    with pytest.raises(InputError, match=r"an .npz file of 2 arrays \(x, y\); want a single one"):
        read_disparity(tmp_path / "unnamed.npz")
    whole = (tmp_path / "one.npz").read_bytes()
    for n_bytes in (10, len(whole) // 2, len(whole) - 3):
        (tmp_path / "cut.npz").write_bytes(whole[:n_bytes])
        with pytest.raises(InputError, match=r"cut\.npz: damaged"):
            read_disparity(tmp_path / "cut.npz")
